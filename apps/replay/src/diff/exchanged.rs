//! Cameras or colours that are exchanged between two recordings: blobs are where the other's were.

use super::blobs::evenly;
use super::causes::{Cause, Confidence, Finding};
use super::inputs::{FieldPair, FieldPairs};
use super::side::{BlobSeen, Side};
use nalgebra::Vector2;
use protocol::blobs::Colour;
use rig::camera::Camera;
use std::collections::{BTreeMap, BTreeSet};

/// Share of the blobs by which colours or cameras count as exchanged.
const EXCHANGED: f64 = 0.8;
/// Distance within which a blob is at the same place, px.
const SAME_PLACE_PX: f64 = 2.0;
/// Fields looked at for what is exchanged.
const EXCHANGED_FIELDS: usize = 60;

/// The fields from the first on whose blobs differ: before it nothing had been done.
pub fn changed_part<'p>(a: &Side, b: &Side, pairs: &'p [FieldPair]) -> &'p [FieldPair] {
    let first = pairs.iter().position(|pair| a.blobs_of(&pair.a) != b.blobs_of(&pair.b));
    first.map_or(pairs, |first| &pairs[first..])
}

/// Two cameras of which each shows what the other one showed.
pub fn swapped_cameras(a: &Side, b: &Side, fields: &FieldPairs, cameras: &[Camera]) -> Option<Finding> {
    let shares = |camera: u32, other: u32| {
        let own: Vec<FieldPair> = fields.pairs.iter().filter(|p| p.a.camera == camera).copied().collect();
        let (mut same, mut all) = (0, 0);
        for pair in evenly(&own, EXCHANGED_FIELDS) {
            let of_other = b.fields_of(other);
            let at = of_other.partition_point(|f| f.field < pair.b.field);
            let Some(field) = of_other.get(at).filter(|f| f.field == pair.b.field) else { continue };
            let places: Vec<_> =
                b.blobs_of(field).iter().map(|q| (Vector2::from(q.at_px), q.colour)).collect();
            for p in a.blobs_of(&pair.a) {
                all += 1;
                let here = Vector2::from(p.at_px);
                same += usize::from(
                    places.iter().any(|(q, colour)| *colour == p.colour && (q - here).norm() < SAME_PLACE_PX),
                );
            }
        }
        if all == 0 { 0.0 } else { same as f64 / all as f64 }
    };
    for (number, one) in cameras.iter().enumerate() {
        for other in &cameras[number + 1..] {
            let [p, q] = [shares(one.id, other.id), shares(other.id, one.id)];
            if p.min(q) > EXCHANGED && shares(one.id, one.id).max(shares(other.id, other.id)) < 0.5 {
                let evidence =
                    format!("{:.0} % of the blobs of each are where the other's were", 100.0 * p.min(q));
                return Some(Finding::new(
                    Cause::CamerasSwapped { cameras: [one.id, other.id] },
                    Confidence::Likely,
                    evidence,
                ));
            }
        }
    }
    None
}

/// Colours of the second recording, and what they are in the first.
pub type Recoloured = Vec<(u32, u32)>;

/// Colours that are exchanged: blobs are where they were, in the other's colour. Where that is so in some
/// cameras only, their blobs of these colours are compared no further.
pub fn swapped_colours(a: &Side, b: &Side, fields: &FieldPairs) -> (Recoloured, Vec<Finding>) {
    let mut by_pair: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
    let cameras: BTreeSet<u32> = fields.pairs.iter().map(|p| p.a.camera).collect();
    for camera in &cameras {
        let own: Vec<FieldPair> = fields.pairs.iter().filter(|p| p.a.camera == *camera).copied().collect();
        let counts = colours_at_places(a, b, &evenly(changed_part(a, b, &own), EXCHANGED_FIELDS));
        let all =
            |colour: u32| counts.iter().filter(|((from, _), _)| *from == colour).map(|(_, n)| n).sum::<u32>();
        let became = |from: u32, to: u32| {
            let n = counts.get(&(from, to)).copied().unwrap_or(0);
            n >= 10 && f64::from(n) >= EXCHANGED * f64::from(all(from))
        };
        for (from, to) in counts.keys().filter(|(from, to)| from < to) {
            if became(*from, *to) && became(*to, *from) {
                by_pair.entry([*from, *to]).or_default().push(*camera);
            }
        }
    }
    let everywhere = by_pair.iter().filter(|(_, own)| own.len() == cameras.len());
    let recoloured = everywhere.flat_map(|([x, y], _)| [(*x, *y), (*y, *x)]).collect();
    let finding = |([a, b], cameras): ([u32; 2], Vec<u32>)| {
        let colours = [Colour::from_wire(a)?, Colour::from_wire(b)?];
        let evidence = "blobs are where they were, in the other's colour";
        Some(Finding::new(Cause::ColoursSwapped { colours, cameras }, Confidence::Likely, evidence))
    };
    (recoloured, by_pair.into_iter().filter_map(finding).collect())
}

/// How often a blob of one colour is, in the second recording, one of another at the same place.
fn colours_at_places(a: &Side, b: &Side, pairs: &[FieldPair]) -> BTreeMap<(u32, u32), u32> {
    let mut counts = BTreeMap::new();
    for pair in pairs {
        for p in a.blobs_of(&pair.a) {
            let here = Vector2::from(p.at_px);
            let distance = |q: &BlobSeen| (Vector2::from(q.at_px) - here).norm();
            let nearest = b.blobs_of(&pair.b).iter().min_by(|q, r| distance(q).total_cmp(&distance(r)));
            if let Some(q) = nearest.filter(|q| distance(q) < SAME_PLACE_PX) {
                *counts.entry((p.colour, q.colour)).or_insert(0) += 1;
            }
        }
    }
    counts
}
