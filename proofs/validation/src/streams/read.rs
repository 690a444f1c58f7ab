//! Streams of another generator: which blob is of which marker, and how noisy blobs are, by the truth.

use super::imaging::{Noise, Scene, Seen, Spot, images, merge};
use super::motion::Motion;
use super::recorded::Recorded;
use super::{Sighting, Stream};
use anyhow::Context;
use blob_stream::BlobReader;
use nalgebra::Vector2;
use protocol::blobs::{Blob, BlobField, Colour};
use protocol::limits::BODIES;
use protocol::poses::EYE;
use rig::Rig;
use rig::camera::Camera;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::Path;

/// Largest difference of the area of a blob from that of its marker if it is seen whole, as a share.
const WHOLE: f64 = 0.05;
/// Standard deviation of a normal variable over the median of its absolute value.
const OF_MEDIAN: f64 = 1.4826;

impl Stream {
    /// Reads a folder with `rig.json`, `blobs.jsonl` and `truth.csv`. The noise of the blobs and the spectra of the
    /// motion are estimated with the truth.
    ///
    /// # Errors
    /// If a file is missing or makes no sense.
    pub fn read(folder: &Path) -> anyhow::Result<Self> {
        let rig = Rig::load(&folder.join("rig.json"))?;
        let fields = BlobReader::open(&folder.join("blobs.jsonl"))?.collect::<Result<Vec<_>, _>>()?;
        let motion = Recorded::read(&folder.join("truth.csv"), &rig)?;
        Self::recorded(rig, fields, motion).with_context(|| folder.display().to_string())
    }

    /// Of fields and a table of poses.
    pub(super) fn recorded(rig: Rig, fields: Vec<BlobField>, motion: Recorded) -> anyhow::Result<Self> {
        let (end_s, motion) = (motion.end_s(), Motion::Recorded(Box::new(motion)));
        let cameras = rig.cameras();
        let (mut sightings, mut residuals) = (Vec::new(), Residuals::new());
        for field in &fields {
            let exposed_s = field.exposed_ns as f64 * 1e-9;
            let Some(camera) = cameras.iter().find(|c| c.id == field.camera).filter(|_| exposed_s <= end_s)
            else {
                continue;
            };
            let Seen { markers, merged } = recognise(&rig, camera, &motion, field, &mut residuals);
            sightings.push(Sighting { exposed_s, camera: camera.id, markers, merged });
        }
        sightings.sort_by(|a, b| a.exposed_s.total_cmp(&b.exposed_s));
        let noise = measured_noise(residuals).context("too few blobs to measure their noise")?;
        Ok(Stream { rig, fields, motion, sightings, noise })
    }

    /// Standard deviations of a blob's column and line of the frame, px, and whether they are those of an area of 1 px
    /// and fall with the root of the area.
    pub fn noise_px(&self) -> ([f64; 2], bool) {
        (self.noise.px, self.noise.falls)
    }
}

/// Residuals of whole markers in the order of time, px, with the area of each in px of the field; by camera, body and
/// marker.
type Residuals = BTreeMap<(u32, usize, usize), Vec<(Vector2<f64>, f64)>>;

/// The markers whose blobs a field holds: nearest first, within the marker's own disc.
fn recognise(
    rig: &Rig,
    camera: &Camera,
    motion: &Motion,
    field: &BlobField,
    residuals: &mut Residuals,
) -> Seen {
    let scene = Scene { motion, t_s: field.exposed_ns as f64 * 1e-9, row_s: 0.0 };
    let spots = whole_spots(rig, camera, &scene);
    let centre = |blob: &Blob| Vector2::new(blob.x_px, field.y_frame_px(blob));
    let mut seen = Seen { markers: [0; BODIES], merged: Vec::new() };
    let mut used = (vec![false; spots.len()], vec![false; field.blobs().len()]);
    for (s, b) in pairs(&spots, field) {
        if used.0[s] || used.1[b] {
            continue;
        }
        (used.0[s], used.1[b]) = (true, true);
        let (spot, blob) = (&spots[s], &field.blobs()[b]);
        spot.parts.iter().for_each(|part| seen.markers[part.body] |= 1 << part.marker);
        let area_px = field.area_of_half_px(blob);
        match spot.parts[..] {
            [part] if (area_px / spot.area_px - 1.0).abs() < WHOLE => {
                let own = residuals.entry((camera.id, part.body, part.marker)).or_default();
                own.push((centre(blob) - spot.centre, spot.area_px));
            }
            [_] => {}
            _ => seen.merged.push(spot.parts.clone()),
        }
    }
    seen
}

/// Spots and blobs of one colour of which the blob lies on the spot, nearest first.
fn pairs(spots: &[Spot], field: &BlobField) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for (s, spot) in spots.iter().enumerate() {
        for (b, blob) in field.blobs().iter().enumerate() {
            let off = Vector2::new(blob.x_px, field.y_frame_px(blob)) - spot.centre;
            let apart = off.component_div(&(spot.size * 0.5)).norm();
            if Colour::from_wire(blob.colour) == Some(spot.colour) && apart < 1.0 {
                pairs.push((apart, s, b));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    pairs.into_iter().map(|(_, s, b)| (s, b)).collect()
}

/// What would be seen of all markers that are there if nothing hid any.
fn whole_spots(rig: &Rig, camera: &Camera, scene: &Scene<'_>) -> Vec<Spot> {
    let there = scene.motion.at(scene.t_s).present;
    let discs = images(rig, camera, scene).0.into_iter();
    let mut spots = discs.filter(|d| d.body == EYE || there[d.body]).map(Spot::whole).collect();
    merge(&mut spots);
    spots
}

/// Noise by the differences of successive residuals, which slow errors of a rig do not enter: of one size for all
/// areas, or falling with their root, whichever makes that of small and of large blobs more alike.
fn measured_noise(residuals: Residuals) -> Option<Noise> {
    let pairs = residuals.values().flat_map(|own| own.windows(2));
    let mut steps: Vec<(Vector2<f64>, f64)> =
        pairs.map(|w| ((w[1].0 - w[0].0) / libm::sqrt(2.0), 0.5 * (w[0].1 + w[1].1))).collect();
    if steps.len() < 100 {
        return None;
    }
    steps.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (small, large) = steps.split_at(steps.len() / 2);
    let models = [false, true].map(|falls| {
        let [all, small, large] = [&steps[..], small, large].map(|of| sigma_px(of, falls));
        let unlike = (0..2).map(|i| libm::log(small[i] / large[i]).abs()).sum::<f64>();
        (unlike, Noise { px: all, falls })
    });
    models.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, noise)| noise)
}

/// Standard deviations of columns and lines, for an area of 1 px if they fall with its root.
fn sigma_px(steps: &[(Vector2<f64>, f64)], falls: bool) -> [f64; 2] {
    [0, 1].map(|axis| {
        let scaled =
            |(off, area): &(Vector2<f64>, f64)| off[axis].abs() * if falls { libm::sqrt(*area) } else { 1.0 };
        let mut sizes: Vec<f64> = steps.iter().map(scaled).collect();
        sizes.sort_by(f64::total_cmp);
        OF_MEDIAN * sizes[sizes.len() / 2]
    })
}

impl Spot {
    /// A marker of which nothing is hidden.
    fn whole(disc: super::imaging::Disc) -> Self {
        let area_px = 0.5 * PI * disc.radii.x * disc.radii.y;
        let part = super::imaging::Part { body: disc.body, marker: disc.marker, area_px };
        Spot { centre: disc.centre, area_px, size: disc.radii * 2.0, colour: disc.colour, parts: vec![part] }
    }
}
