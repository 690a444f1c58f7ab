//! Markers whose blobs lie beside them all the time.
//!
//! A tracker takes a blob that is far from its marker for another's, or for a reflection, and follows the others. So does
//! an estimation that bounds the weight of outliers. Neither then measures what is wrong: that the marker never has its
//! blob, while one of its colour lies free near it.

use super::measure::{START_NS, track};
use super::places::{is_free, nearest, poses_at};
use crate::median;
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BlobField};
use protocol::matches::{MatchFrame, MatchedBlob};
use protocol::poses::TrackerFrame;
use rig::Rig;
use rig::camera::Camera;
use std::collections::BTreeMap;
use tracker::projection::{PoseMatrix, project_marker};
use tracker::rig_model::RigModel;

/// Distance of a free blob from the marker that it may belong to, px.
const REACH_PX: f64 = 8.0;
/// Share of the images of a marker that have such a blob instead of their own, above which its place is wrong.
const SHARE: f64 = 0.3;
/// Images that say so, at least.
const IMAGES: usize = 30;

/// Difference of a blob's area from that of its marker, as a share of it, above which the marker is hidden in part, or one
/// blob with another: its centre is elsewhere for that reason. Extractors measure areas differently, so it is compared
/// with the median of the camera.
const WHOLE: f64 = 0.12;

/// What was seen of the markers.
#[derive(Default)]
struct Seen {
    /// Ratios of the areas of blobs to those of their markers, by camera.
    ratios: BTreeMap<u32, Vec<f64>>,
    /// Images that have their blob, by body and marker.
    own: BTreeMap<(usize, usize), usize>,
    /// Free blobs beside a marker without one, with their camera and the ratio of their areas.
    beside: Vec<((usize, usize), u32, f64)>,
}

/// True where a marker has its blobs beside it.
pub fn is_a_marker_beside(rig: &Rig, fields: &[BlobField]) -> bool {
    let model = RigModel::new(rig);
    let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0) + START_NS;
    let mut seen = Seen::default();
    track(rig, fields, |frame, used, matches| {
        if frame.instants.exposed < begin {
            return;
        }
        for (n, field) in used.iter().enumerate() {
            if let Some(camera) = model.cameras.get(field.camera as usize).and_then(Option::as_ref) {
                seen.add(&model, camera, frame, (n, field), matches);
            }
        }
    });
    seen.has_marker_beside()
}

impl Seen {
    /// Adds the markers in a field.
    fn add(
        &mut self,
        model: &RigModel,
        camera: &Camera,
        frame: &TrackerFrame,
        (n, field): (usize, &BlobField),
        matches: &MatchFrame,
    ) {
        let Some(matched) = matches.fields().get(n) else { return };
        let poses = poses_at(frame, field.exposed_ns);
        for (body, pose) in poses.iter().enumerate() {
            let Some(pose) = pose.as_ref().map(PoseMatrix::from) else { continue };
            for (m, marker) in model.bodies[body].markers.iter().enumerate() {
                let Some(image) = project_marker(marker, &pose, camera) else { continue };
                let ratio = |blob: usize| field.blobs()[blob].area_px / image.area_px;
                let is_own = |e: &MatchedBlob| e.outcome().is_used() && e.marker() == Some((body, m));
                if let Some(own) = matched.blobs().iter().position(is_own) {
                    *self.own.entry((body, m)).or_default() += 1;
                    self.ratios.entry(field.camera).or_default().push(ratio(own));
                    continue;
                }
                let near = nearest(field, marker.colour, image.pixel, REACH_PX);
                let is_whole = |blob: usize| field.blobs()[blob].flags & (BLOB_MERGED | BLOB_CLIPPED) == 0;
                if let Some(free) = near.filter(|b| is_whole(*b) && is_free(matches, n, *b, [body, m])) {
                    self.beside.push(((body, m), field.camera, ratio(free)));
                }
            }
        }
    }

    /// True where enough whole blobs lie beside a marker, for the images that have their own.
    fn has_marker_beside(self) -> bool {
        let usual: BTreeMap<u32, Option<f64>> =
            self.ratios.into_iter().map(|(c, of)| (c, median(of.into_iter()))).collect();
        let is_whole = |camera: &u32, ratio: &f64| {
            usual.get(camera).copied().flatten().is_some_and(|usual| (ratio / usual - 1.0).abs() < WHOLE)
        };
        let mut beside: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        for (marker, camera, ratio) in &self.beside {
            *beside.entry(*marker).or_default() += usize::from(is_whole(camera, ratio));
        }
        beside.into_iter().any(|(marker, beside)| {
            let own = self.own.get(&marker).copied().unwrap_or(0);
            beside >= IMAGES && beside as f64 > SHARE * (own + beside) as f64
        })
    }
}
