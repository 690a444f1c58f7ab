//! Colours that are exchanged in one camera, or between two markers of the rig file.
//!
//! There are many such pairs. Worth a try are those of which a part is hardly ever measured: a colour whose
//! blobs measure less in one camera than in another, and a marker that has no blob of its own.

use super::Cause;
use super::measure::{START_NS, track};
use protocol::blobs::{BlobField, Colour};
use protocol::matches::MatchFrame;
use protocol::poses::BODY_NAMES;
use rig::Rig;
use std::collections::BTreeMap;

/// A colour is used less in one camera than in another where its share is below this part of the other's.
const LESS: f64 = 0.6;
/// Blobs of a colour that no marker has, as a share of those that another camera shows of a marker's colour: fewer are
/// reflections, and the marker's blobs are not among them.
const AS_MANY: f64 = 0.5;
/// A marker is hardly ever measured where it has its blob in a smaller share of the fields than this.
const SELDOM: f64 = 0.3;

/// How often blobs measured poses.
#[derive(Default)]
struct Usage {
    /// Used blobs, and all, by camera and colour.
    colours: BTreeMap<(u32, u32), [u32; 2]>,
    /// Used blobs by body and marker.
    markers: BTreeMap<(usize, usize), u32>,
    /// Fields.
    fields: u32,
}

impl Usage {
    fn of(rig: &Rig, fields: &[BlobField]) -> Self {
        let mut usage = Usage::default();
        let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0) + START_NS;
        track(rig, fields, |frame, used, matches| {
            if frame.instants.exposed >= begin {
                usage.add(used, matches);
            }
        });
        usage
    }

    fn add(&mut self, used: &[BlobField], matches: &MatchFrame) {
        for (field, matched) in used.iter().zip(matches.fields()) {
            self.fields += 1;
            for (blob, entry) in field.blobs().iter().zip(matched.blobs()) {
                let is_used = entry.outcome().is_used();
                let count = self.colours.entry((field.camera, blob.colour)).or_default();
                *count = [count[0] + u32::from(is_used), count[1] + 1];
                if let Some(marker) = entry.marker().filter(|_| is_used) {
                    *self.markers.entry(marker).or_default() += 1;
                }
            }
        }
    }

    fn share(&self, camera: u32, colour: Colour) -> f64 {
        let [used, all] = self.colours.get(&(camera, colour as u32)).copied().unwrap_or_default();
        f64::from(used) / f64::from(all.max(1))
    }

    /// True where a camera has blobs of a colour and uses fewer of them than another camera does.
    fn is_hardly_used(&self, rig: &Rig, camera: u32, colour: Colour) -> bool {
        let best = rig.cameras.iter().map(|c| self.share(c.id, colour)).fold(0.0, f64::max);
        let is_seen = self.colours.contains_key(&(camera, colour as u32));
        is_seen && self.share(camera, colour) < LESS * best
    }

    fn count(&self, camera: u32, colour: Colour) -> u32 {
        self.colours.get(&(camera, colour as u32)).map_or(0, |[_, all]| *all)
    }

    /// True where the blobs of these colours may be each other's in a camera. Where no marker has one of them, there must be
    /// about as many blobs of it as others see of the marker's colour; else the swap only hides what a moved camera shows.
    fn may_be_swapped(&self, rig: &Rig, camera: u32, colours: [Colour; 2]) -> bool {
        let has_markers =
            |colour: Colour| rig.bodies.iter().any(|b| b.markers.iter().any(|m| m.colour == colour));
        let as_many = |without: Colour, with: Colour| {
            let others = rig.cameras.iter().map(|c| c.id).filter(|id| *id != camera);
            let most = others.map(|id| self.count(id, with)).max().unwrap_or(0);
            f64::from(self.count(camera, without)) > AS_MANY * f64::from(most)
        };
        let [a, b] = colours;
        match (has_markers(a), has_markers(b)) {
            (true, true) => true,
            (true, false) => as_many(b, a),
            (false, true) => as_many(a, b),
            (false, false) => false,
        }
    }

    fn is_seldom_measured(&self, marker: (usize, usize)) -> bool {
        let used = self.markers.get(&marker).copied().unwrap_or(0);
        f64::from(used) < SELDOM * f64::from(self.fields)
    }
}

/// The swaps that are worth a try.
pub fn swaps(rig: &Rig, fields: &[BlobField]) -> Vec<Cause> {
    let usage = Usage::of(rig, fields);
    let mut causes = Vec::new();
    for camera in rig.cameras.iter().map(|c| c.id) {
        let hardly_used = |colour: &Colour| usage.is_hardly_used(rig, camera, *colour);
        for (i, a) in Colour::ALL.iter().enumerate() {
            let others = Colour::ALL[i + 1..].iter().filter(|b| hardly_used(a) || hardly_used(b));
            let others = others.filter(|b| usage.may_be_swapped(rig, camera, [*a, **b]));
            causes.extend(others.map(|b| Cause::ColoursSwapped { colours: [*a, *b], cameras: vec![camera] }));
        }
    }
    causes.extend(of_markers(rig, &usage));
    causes
}

/// Every two markers of different colours, one of which is seldom measured.
fn of_markers(rig: &Rig, usage: &Usage) -> Vec<Cause> {
    let of_body = |(body, name): (usize, &&'static str)| {
        let markers = rig.body(name).map_or(&[][..], |b| &b.markers);
        markers.iter().enumerate().map(move |(m, marker)| (body, m, marker.colour)).collect::<Vec<_>>()
    };
    let all: Vec<(usize, usize, Colour)> = BODY_NAMES.iter().enumerate().flat_map(of_body).collect();
    let mut causes = Vec::new();
    for (i, &(body, marker, colour)) in all.iter().enumerate() {
        for &(other, second, its) in &all[i + 1..] {
            let seldom = [(body, marker), (other, second)].iter().any(|m| usage.is_seldom_measured(*m));
            if colour == its || !seldom {
                continue;
            }
            causes.push(if body == other {
                Cause::MarkersSwapped { body: BODY_NAMES[body], markers: [marker, second] }
            } else {
                let bodies = [BODY_NAMES[body], BODY_NAMES[other]];
                Cause::MarkerColoursSwapped { bodies, markers: [marker, second] }
            });
        }
    }
    causes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_that_no_marker_has_is_swapped_where_it_has_as_many_blobs() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let has = |colour: Colour| rig.bodies.iter().any(|b| b.markers.iter().any(|m| m.colour == colour));
        let with = *Colour::ALL.iter().find(|c| has(**c)).expect("markers");
        let without = *Colour::ALL.iter().find(|c| !has(**c)).expect("a colour without markers");
        let [here, there] = [0, 1].map(|i| rig.cameras[i].id);
        let swapped = |blobs: u32| {
            let colours = BTreeMap::from([
                ((here, without as u32), [0, blobs]),
                ((here, with as u32), [3, 20]),
                ((there, with as u32), [95, 100]),
            ]);
            let usage = Usage { colours, ..Usage::default() };
            assert_eq!(
                usage.may_be_swapped(&rig, here, [with, without]),
                usage.may_be_swapped(&rig, here, [without, with])
            );
            usage.may_be_swapped(&rig, here, [with, without])
        };
        assert!(!swapped(10), "reflections");
        assert!(swapped(90), "the marker's blobs");
    }
}
