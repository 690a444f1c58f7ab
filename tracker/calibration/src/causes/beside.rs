//! Errors of the rig that no residual shows: markers whose blobs lie beside them all the time or have another colour,
//! and bodies that are seen and never tracked.
//!
//! A tracker takes a blob that is far from its marker for another's, or for a reflection, and follows the others. So does
//! an estimation that bounds the weight of outliers. Neither then measures what is wrong: that the marker never has its
//! blob, while one of its colour lies free near it, or one of another colour lies free in its place. A body of which
//! several colours are wrong is not tracked at all, and its blobs count as others'.

use super::measure::{START_NS, track};
use super::places::{is_free, nearest, nearest_of, poses_at};
use crate::median;
use nalgebra::Vector2;
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, Blob, BlobField};
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::matches::{MatchFrame, MatchedBlob};
use protocol::poses::TrackerFrame;
use rig::Rig;
use rig::camera::Camera;
use std::collections::{BTreeMap, BTreeSet};
use tracker::projection::{PoseMatrix, project_marker};
use tracker::rig_model::RigModel;

/// Distance of a free blob from the marker that it may belong to, px.
const REACH_PX: f64 = 8.0;
/// Share of the images of a marker that have such a blob instead of their own, above which its place is wrong.
const SHARE: f64 = 0.3;
/// Images that say so, at least.
const IMAGES: usize = 30;

/// Distance of a free blob of another colour from the marker whose place it has, px.
const IN_PLACE_PX: f64 = 3.0;
/// A body is there where so many of its colours are free in a field, for this share of the fields, and it is not
/// tracked where it is measured in a smaller share of the frames than the last.
const THERE: (usize, f64, f64) = (3, 0.5, 0.1);

/// Difference of a blob's area from that of its marker, as a share of it, above which the marker is hidden in part, or one
/// blob with another: its centre is elsewhere for that reason. Extractors measure areas differently, so it is compared
/// with the median of the camera.
const WHOLE: f64 = 0.12;

/// Of the images of markers in the pictures this share has its blob, and every body is measured in this share of the
/// frames, where the rig is followed whatever else the cameras see. Markers that are hidden or touch others have none.
const COMPLETE: (f64, f64) = (0.8, 0.9);

/// What was seen of the markers.
#[derive(Default)]
struct Seen {
    /// Ratios of the areas of blobs to those of their markers, by camera.
    ratios: BTreeMap<u32, Vec<f64>>,
    /// Images that have their blob, by body and marker.
    own: BTreeMap<(usize, usize), usize>,
    /// The same by camera, too; and images with a free blob of another colour instead.
    by_camera: BTreeMap<(u32, (usize, usize)), [usize; 2]>,
    /// Images that lie in the pictures, of all markers.
    expected: usize,
    /// Frames, and those that measure a body.
    frames: usize,
    measured: [usize; BODIES],
    /// Fields, and those in which free blobs have several colours of a body.
    fields: usize,
    there: [usize; BODIES],
    /// Free blobs beside a marker without one, with their camera and the ratio of their areas.
    beside: Vec<((usize, usize), u32, f64)>,
}

/// True where a marker has its blobs beside it or in another colour, or a body is there and never tracked.
pub fn hides_an_error(rig: &Rig, fields: &[BlobField]) -> bool {
    seen(rig, fields).hides_an_error()
}

/// True where no such error is there, and either few blobs belong to no marker or nearly every marker of every body has
/// its blob: all others, even if they are half of all, then belong to nothing of the rig.
pub fn is_followed(rig: &Rig, fields: &[BlobField], few_strangers: bool) -> bool {
    let seen = seen(rig, fields);
    (few_strangers || seen.is_complete()) && !seen.hides_an_error()
}

/// What a tracker makes of the markers in fields.
fn seen(rig: &Rig, fields: &[BlobField]) -> Seen {
    let model = RigModel::new(rig);
    let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0) + START_NS;
    let mut seen = Seen::default();
    track(rig, fields, |frame, used, matches| {
        if frame.instants.exposed < begin {
            return;
        }
        seen.count(&model, frame, used, matches);
        for (n, field) in used.iter().enumerate() {
            if let Some(camera) = model.cameras.get(field.camera as usize).and_then(Option::as_ref) {
                seen.add(&model, camera, frame, (n, field), matches);
            }
        }
    });
    seen
}

impl Seen {
    fn hides_an_error(&self) -> bool {
        self.has_other_colour() || self.has_untracked_body() || self.has_marker_beside()
    }

    fn is_complete(&self) -> bool {
        let own: usize = self.own.values().sum();
        let (images, frames) = COMPLETE;
        own > IMAGES
            && own as f64 > images * self.expected as f64
            && self.measured.iter().all(|measured| *measured as f64 > frames * self.frames as f64)
    }

    /// Counts the bodies of a frame that are measured, and those whose blobs are free.
    fn count(&mut self, model: &RigModel, frame: &TrackerFrame, used: &[BlobField], matches: &MatchFrame) {
        self.frames += 1;
        for (body, measured) in self.measured.iter_mut().enumerate() {
            *measured += usize::from(frame.bodies[body].validity() == Validity::Measured);
        }
        for (field, matched) in used.iter().zip(matches.fields()) {
            self.fields += 1;
            let blobs = field.blobs().iter().zip(matched.blobs());
            let is_free = |(blob, entry): &(&Blob, &MatchedBlob)| {
                blob.flags & (BLOB_MERGED | BLOB_CLIPPED) == 0 && !entry.outcome().is_used()
            };
            let free: BTreeSet<u32> = blobs.filter(is_free).map(|(blob, _)| blob.colour).collect();
            for (there, body) in self.there.iter_mut().zip(&model.bodies) {
                let own: BTreeSet<u32> = body.markers.iter().map(|m| m.colour).collect();
                *there += usize::from(own.intersection(&free).count() >= THERE.0);
            }
        }
    }

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
                self.expected += usize::from(is_in_picture(camera, &image.pixel));
                let ratio = |blob: usize| field.blobs()[blob].area_px / image.area_px;
                let is_own = |e: &MatchedBlob| e.outcome().is_used() && e.marker() == Some((body, m));
                if let Some(own) = matched.blobs().iter().position(is_own) {
                    *self.own.entry((body, m)).or_default() += 1;
                    self.by_camera.entry((field.camera, (body, m))).or_default()[0] += 1;
                    self.ratios.entry(field.camera).or_default().push(ratio(own));
                    continue;
                }
                let is_whole = |blob: usize| field.blobs()[blob].flags & (BLOB_MERGED | BLOB_CLIPPED) == 0;
                let is_free = |b: &usize| is_whole(*b) && is_free(matches, n, *b, [body, m]);
                let other = nearest_of(field, |colour| colour != marker.colour, image.pixel, IN_PLACE_PX);
                if other.filter(is_free).is_some() {
                    self.by_camera.entry((field.camera, (body, m))).or_default()[1] += 1;
                }
                let near = nearest(field, marker.colour, image.pixel, REACH_PX);
                if let Some(free) = near.filter(is_free) {
                    self.beside.push(((body, m), field.camera, ratio(free)));
                }
            }
        }
    }

    /// True where a camera sees a marker in another colour.
    fn has_other_colour(&self) -> bool {
        let is_other =
            |[own, other]: &[usize; 2]| *other >= IMAGES && *other as f64 > SHARE * (own + other) as f64;
        self.by_camera.values().any(is_other)
    }

    /// True where a body's blobs are there, and it is not tracked.
    fn has_untracked_body(&self) -> bool {
        let (_, there, tracked) = THERE;
        let mut bodies = self.measured.iter().zip(&self.there);
        bodies.any(|(measured, free)| {
            *free > IMAGES
                && *free as f64 > there * self.fields as f64
                && (*measured as f64) < tracked * self.frames as f64
        })
    }

    /// True where enough whole blobs lie beside a marker, for the images that have their own.
    fn has_marker_beside(&self) -> bool {
        let usual: BTreeMap<u32, Option<f64>> =
            self.ratios.iter().map(|(c, of)| (*c, median(of.iter().copied()))).collect();
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

fn is_in_picture(camera: &Camera, pixel: &Vector2<f64>) -> bool {
    let [width, height] = camera.size_px.map(f64::from);
    (0.0..width).contains(&pixel.x) && (0.0..height).contains(&pixel.y)
}
