//! What is left in the pictures when a rig tracks blobs.

use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, Blob, BlobField};
use protocol::matches::{BlobUse, MatchFrame};
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use rig::Rig;
use std::collections::BTreeMap;
use tracker::Tracker;
use tracker::assembler::FrameAssembler;

/// Largest residual that counts, px; also that of a blob that no marker explains. Larger, a single reflex
/// outweighs what a small defect leaves in all blobs.
pub const CAP_PX: f64 = 2.0;
/// A fresh tracker has found its bodies after this, ns.
pub const START_NS: u64 = 300_000_000;
/// A camera of whose fields a smaller share goes into frames is left out.
const TAKEN: f64 = 0.1;
/// Period of the slices in which a defect's begin is looked for, ns.
pub const SLICE_NS: u64 = 500_000_000;

/// Sum and number of squared residuals.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Squares {
    /// px².
    pub sum: f64,
    /// Blobs.
    pub count: u64,
}

impl Squares {
    /// Root mean square, px; `None` of nothing.
    pub fn rms(self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum / self.count as f64).sqrt())
    }

    fn add(&mut self, square: f64) {
        (self.sum, self.count) = (self.sum + square, self.count + 1);
    }
}

/// What is left in the pictures.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Left {
    /// Of all blobs that have a marker's colour and are whole; one that no marker explains counts as
    /// [`CAP_PX`].
    pub all: Squares,
    /// Of those that measured a pose.
    pub explained: Squares,
}

impl Left {
    /// Share of the blobs that measured a pose.
    pub fn explained_share(&self) -> f64 {
        self.explained.count as f64 / self.all.count.max(1) as f64
    }

    /// True where more than this share of the blobs measured poses, and left less than this, px.
    pub fn is_less(&self, (share, px): (f64, f64)) -> bool {
        self.explained_share() > share && self.explained.rms().is_some_and(|rms| rms < px)
    }

    /// Mean square of all, px²; the largest of nothing.
    pub fn mean(&self) -> f64 {
        self.all.rms().map_or(CAP_PX * CAP_PX, |rms| rms * rms)
    }
}

/// Tracks fields with a rig that is trusted, and hands over each frame with its fields and matches.
pub fn track(
    rig: &Rig,
    fields: &[BlobField],
    mut visit: impl FnMut(&TrackerFrame, &[BlobField], &MatchFrame),
) {
    let (mut assembler, mut tracker) = (FrameAssembler::new(rig), Tracker::with(rig, false));
    let mut now = 0;
    for field in fields {
        now = now.max(field.blobs_out_ns);
        assembler.add(field, now, |used, closed| {
            let frame = tracker.track(used, &closed.reference);
            visit(&frame, used, tracker.matches());
        });
    }
}

/// True for a blob that has a marker's colour and is whole.
fn is_whole_marker(rig: &Rig, blob: &Blob) -> bool {
    let is_marker = |colour| rig.bodies.iter().any(|b| b.markers.iter().any(|m| m.colour as u32 == colour));
    blob.flags & (BLOB_MERGED | BLOB_CLIPPED) == 0 && is_marker(blob.colour)
}

/// Adds what is left of a frame.
fn add(rig: &Rig, used: &[BlobField], matches: &MatchFrame, left: &mut Left) {
    for (field, matched) in used.iter().zip(matches.fields()) {
        for (blob, entry) in field.blobs().iter().zip(matched.blobs()) {
            if !is_whole_marker(rig, blob) || entry.outcome() == BlobUse::UsedInPart {
                continue;
            }
            if entry.outcome() != BlobUse::Used {
                left.all.add(CAP_PX * CAP_PX);
                continue;
            }
            let [x, y] = [entry.residual_x_px, entry.residual_y_px].map(f64::from);
            let square = (x * x + y * y).min(CAP_PX * CAP_PX);
            left.all.add(square);
            left.explained.add(square);
        }
    }
}

/// Exposure from which on is measured.
fn begin(fields: &[BlobField]) -> Nanos {
    fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0) + START_NS
}

/// What a rig leaves of fields, after its tracker has found the bodies.
pub fn measure(rig: &Rig, fields: &[BlobField]) -> Left {
    let (mut left, begin) = (Left::default(), begin(fields));
    let mut taken: BTreeMap<u32, usize> = rig.cameras.iter().map(|c| (c.id, 0)).collect();
    track(rig, fields, |frame, used, matches| {
        if frame.instants.exposed >= begin {
            used.iter().for_each(|field| *taken.entry(field.camera).or_default() += 1);
            add(rig, used, matches, &mut left);
        }
    });
    // What a camera sees whose fields never come in time, by their stamps, is explained by nothing.
    for (camera, taken) in taken {
        let own = || fields.iter().filter(|f| f.camera == camera && f.exposed_ns >= begin);
        if taken as f64 >= TAKEN * own().count() as f64 {
            continue;
        }
        let blobs = own().flat_map(|f| f.blobs()).filter(|blob| is_whole_marker(rig, blob));
        blobs.for_each(|_| left.all.add(CAP_PX * CAP_PX));
    }
    left
}

/// What a rig leaves of fields, by slices: the begin of each, and its residuals.
pub fn slices(rig: &Rig, fields: &[BlobField]) -> Vec<(Nanos, Left)> {
    let (mut slices, begin): (Vec<(Nanos, Left)>, _) = (Vec::new(), begin(fields));
    track(rig, fields, |frame, used, matches| {
        let Some(since) = frame.instants.exposed.checked_sub(begin) else { return };
        let at = begin + since / SLICE_NS * SLICE_NS;
        if slices.last().is_none_or(|(last, _)| *last != at) {
            slices.push((at, Left::default()));
        }
        if let Some((_, left)) = slices.last_mut() {
            add(rig, used, matches, left);
        }
    });
    slices
}
