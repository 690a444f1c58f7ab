//! Markers whose blobs lie beside them all the time.
//!
//! A tracker takes a blob that is far from its marker for another's, or for a reflection, and follows the others. So does
//! an estimation that bounds the weight of outliers. Neither then measures what is wrong: that the marker never has its
//! blob, while one of its colour lies free near it.

use super::measure::{START_NS, track};
use super::places::{is_free, nearest, poses_at};
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

/// Images of a marker that have their blob, and those beside which one lies free.
#[derive(Default, Clone, Copy)]
struct Images {
    own: usize,
    beside: usize,
}

/// True where a marker has its blobs beside it.
pub fn is_a_marker_beside(rig: &Rig, fields: &[BlobField]) -> bool {
    let model = RigModel::new(rig);
    let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0) + START_NS;
    let mut markers: BTreeMap<(usize, usize), Images> = BTreeMap::new();
    track(rig, fields, |frame, used, matches| {
        if frame.instants.exposed < begin {
            return;
        }
        for (n, field) in used.iter().enumerate() {
            if let Some(camera) = model.cameras.get(field.camera as usize).and_then(Option::as_ref) {
                add(&model, camera, frame, (n, field), matches, &mut markers);
            }
        }
    });
    let is_beside = |images: &Images| images.beside as f64 > SHARE * (images.own + images.beside) as f64;
    markers.values().any(|images| images.beside >= IMAGES && is_beside(images))
}

/// Counts the markers in a field.
fn add(
    model: &RigModel,
    camera: &Camera,
    frame: &TrackerFrame,
    (n, field): (usize, &BlobField),
    matches: &MatchFrame,
    markers: &mut BTreeMap<(usize, usize), Images>,
) {
    let Some(matched) = matches.fields().get(n) else { return };
    let poses = poses_at(frame, field.exposed_ns);
    for (body, pose) in poses.iter().enumerate() {
        let Some(pose) = pose.as_ref().map(PoseMatrix::from) else { continue };
        for (m, marker) in model.bodies[body].markers.iter().enumerate() {
            let own = |e: &MatchedBlob| e.outcome().is_used() && e.marker() == Some((body, m));
            if matched.blobs().iter().any(own) {
                markers.entry((body, m)).or_default().own += 1;
                continue;
            }
            let Some(image) = project_marker(marker, &pose, camera) else { continue };
            let near = nearest(field, marker.colour, image.pixel, REACH_PX);
            let is_whole = |blob: usize| field.blobs()[blob].flags & (BLOB_MERGED | BLOB_CLIPPED) == 0;
            let free = near.filter(|b| is_whole(*b) && is_free(matches, n, *b, [body, m]));
            markers.entry((body, m)).or_default().beside += usize::from(free.is_some());
        }
    }
}
