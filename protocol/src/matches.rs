//! `matches`: which blob the tracker took for which marker, with what residual, and why it used none of
//! the others.

use crate::blobs::WHOLE_FRAME;
use crate::limits::{BODIES, MAX_BLOBS, MAX_FIELDS_USED, MAX_MARKERS};
use crate::message::{Invalid, Message, require};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// [`MatchedBlob::body`] of a blob that belongs to no marker.
pub const NO_BODY: u32 = BODIES as u32;
/// Most markers of a rig.
const ALL_MARKERS: usize = BODIES * MAX_MARKERS;
/// NIS (two degrees of freedom) that 95 % of the blobs of a consistent filter stay below.
pub const NIS_95: f64 = 5.991;

/// What became of a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u32)]
pub enum BlobUse {
    /// Measured a pose.
    Used = 0,
    /// Measured a pose with a larger covariance: by its size, its flags or what is predicted to lie before it, its
    /// marker is partly hidden, clipped by the border of the frame, or merged with another.
    UsedInPart = 1,
    /// Matched, and rejected by the fit.
    Outlier = 2,
    /// Matched, and the whole fit of its body was rejected.
    BadFit = 3,
    /// In the gate of a marker that another blob fitted better.
    Duplicate = 4,
    /// Near a marker of its colour, outside of the gate.
    Gated = 5,
    /// Near a marker of its colour, too large or too small for it.
    WrongSize = 6,
    /// No predicted marker of its colour is near.
    Unassigned = 7,
    /// No body with a marker of its colour is tracked.
    NotTracked = 8,
    /// Not finite, without size, or outside of the frame.
    Malformed = 9,
    /// Its camera was moved and is left out.
    CameraLeftOut = 10,
    /// All blobs of its field jumped together.
    FieldJumped = 11,
    /// The rig has no such camera.
    UnknownCamera = 12,
}

impl BlobUse {
    /// Every one, by code.
    pub const ALL: [BlobUse; 13] = {
        use BlobUse::*;
        [
            Used,
            UsedInPart,
            Outlier,
            BadFit,
            Duplicate,
            Gated,
            WrongSize,
            Unassigned,
            NotTracked,
            Malformed,
            CameraLeftOut,
            FieldJumped,
            UnknownCamera,
        ]
    };

    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        Self::ALL.get(code as usize).copied()
    }

    /// True for a blob that measured a pose.
    pub fn is_used(self) -> bool {
        matches!(self, BlobUse::Used | BlobUse::UsedInPart)
    }

    /// True where the blob was matched to a marker, so that it has an innovation and a residual.
    pub fn is_matched(self) -> bool {
        self <= BlobUse::BadFit
    }

    /// In words.
    pub fn text(self) -> &'static str {
        match self {
            BlobUse::Used => "used",
            BlobUse::UsedInPart => "used in part",
            BlobUse::Outlier => "outlier",
            BlobUse::BadFit => "bad fit",
            BlobUse::Duplicate => "duplicate",
            BlobUse::Gated => "gated",
            BlobUse::WrongSize => "wrong size",
            BlobUse::Unassigned => "unassigned",
            BlobUse::NotTracked => "not tracked",
            BlobUse::Malformed => "malformed",
            BlobUse::CameraLeftOut => "camera left out",
            BlobUse::FieldJumped => "field jumped",
            BlobUse::UnknownCamera => "unknown camera",
        }
    }
}

/// One blob of a camera-field. Pixels are those of the frame; `y` counts lines of the frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct MatchedBlob {
    /// Index of the blob in its field on `blobs`.
    #[wire(tag = 1)]
    pub blob: u32,
    /// [`BlobUse`] on the wire.
    #[wire(tag = 2)]
    pub outcome: u32,
    /// Index of the body; of one that was not matched, that of the nearest marker, or [`NO_BODY`].
    #[wire(tag = 3)]
    pub body: u32,
    /// Index of the marker in the body; 0 with [`NO_BODY`].
    #[wire(tag = 4)]
    pub marker: u32,
    /// Centre of the blob, px, rounded to 1/16 px (`blobs` has all digits).
    #[wire(tag = 5)]
    pub x_px: f32,
    /// The same, line of the frame.
    #[wire(tag = 6)]
    pub y_px: f32,
    /// Blob less the marker's image as predicted before the update, px, rounded to 1/1024 px; 0 where a body was
    /// just found and there was no prediction.
    #[wire(tag = 7)]
    pub innovation_x_px: f32,
    /// The same, lines of the frame.
    #[wire(tag = 8)]
    pub innovation_y_px: f32,
    /// Blob less the marker's image at the fitted pose, px, rounded to 1/1024 px; 0 without a fit.
    #[wire(tag = 9)]
    pub residual_x_px: f32,
    /// The same, lines of the frame.
    #[wire(tag = 10)]
    pub residual_y_px: f32,
    /// Normalised innovation squared: the innovation by the covariances of blob and prediction; two degrees
    /// of freedom. Rounded to 1/16, and 1/16 at least; 0 without a prediction.
    #[wire(tag = 11)]
    pub nis: f32,
}

impl MatchedBlob {
    /// What became of it; a foreign code counts as unassigned.
    pub fn outcome(&self) -> BlobUse {
        BlobUse::from_wire(self.outcome).unwrap_or(BlobUse::Unassigned)
    }

    /// Body and marker; of one that was not matched, the nearest.
    pub fn marker(&self) -> Option<(usize, usize)> {
        (self.body < NO_BODY).then_some((self.body as usize, self.marker as usize))
    }

    /// Where its marker was predicted before the update, px of the frame; `None` without a prediction.
    pub fn predicted_px(&self) -> Option<[f32; 2]> {
        let there = self.body < NO_BODY && self.nis > 0.0;
        there.then_some([self.x_px - self.innovation_x_px, self.y_px - self.innovation_y_px])
    }
}

/// A marker that was predicted in the frame of a camera and got no blob.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct MissedMarker {
    /// Index of the body.
    #[wire(tag = 1)]
    pub body: u32,
    /// Index of the marker in the body.
    #[wire(tag = 2)]
    pub marker: u32,
    /// Where it was predicted, px of the frame.
    #[wire(tag = 3)]
    pub x_px: f32,
    /// The same, line of the frame.
    #[wire(tag = 4)]
    pub y_px: f32,
}

/// The matches of one camera-field.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct MatchedField {
    /// Field number of the camera.
    #[wire(tag = 1)]
    pub field: u64,
    /// Camera id.
    #[wire(tag = 2)]
    pub camera: u32,
    /// Blobs of the field.
    pub blob_count: u32,
    /// Markers predicted and not seen.
    pub missed_count: u32,
    /// 0: even lines, 1: odd lines.
    #[wire(tag = 3)]
    pub parity: u32,
    /// The blobs; the first `blob_count` are meaningful.
    #[wire(tag = 4, count = blob_count)]
    pub blobs: [MatchedBlob; MAX_BLOBS],
    /// The markers; the first `missed_count` are meaningful.
    #[wire(tag = 5, count = missed_count)]
    pub missed: [MissedMarker; ALL_MARKERS],
}

impl MatchedField {
    /// The blobs in use.
    pub fn blobs(&self) -> &[MatchedBlob] {
        &self.blobs[..(self.blob_count as usize).min(MAX_BLOBS)]
    }

    /// Markers that were predicted in its frame and got no blob.
    pub fn missed(&self) -> &[MissedMarker] {
        &self.missed[..(self.missed_count as usize).min(ALL_MARKERS)]
    }

    /// Adds a blob; one beyond the capacity is left out.
    pub fn push(&mut self, blob: MatchedBlob) {
        if let Some(slot) = self.blobs.get_mut(self.blob_count as usize) {
            *slot = blob;
            self.blob_count += 1;
        }
    }

    /// Adds a marker without a blob; one beyond the capacity is left out.
    pub fn push_missed(&mut self, marker: MissedMarker) {
        if let Some(slot) = self.missed.get_mut(self.missed_count as usize) {
            *slot = marker;
            self.missed_count += 1;
        }
    }
}

/// What the tracker matched in one of its frames.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
#[wire(name = "Matches")]
pub struct MatchFrame {
    /// Field of [`crate::poses::TrackerFrame`].
    #[wire(tag = 1)]
    pub field: u64,
    /// Number of that frame.
    #[wire(tag = 2)]
    pub frame: u64,
    /// Exposure of that frame.
    #[wire(tag = 3)]
    pub exposed_ns: Nanos,
    /// Camera-fields in use.
    pub field_count: u32,
    /// Reference camera.
    #[wire(tag = 4)]
    pub camera: u32,
    /// The camera-fields of the frame in the order in which it consumed them; the first `field_count` are
    /// meaningful.
    #[wire(tag = 5, count = field_count)]
    pub fields: [MatchedField; MAX_FIELDS_USED],
}

impl MatchFrame {
    /// Makes it the same as `other`; what neither uses is left alone, which is most of it.
    pub fn copy_from(&mut self, other: &MatchFrame) {
        let used = other.fields().len();
        let before = self.fields().len();
        let MatchFrame { field, frame, exposed_ns, field_count, camera, fields } = self;
        (*field, *frame, *exposed_ns) = (other.field, other.frame, other.exposed_ns);
        (*field_count, *camera) = (other.field_count, other.camera);
        let all = used.max(before);
        fields[..all].copy_from_slice(&other.fields[..all]);
    }

    /// The camera-fields in use.
    pub fn fields(&self) -> &[MatchedField] {
        &self.fields[..(self.field_count as usize).min(MAX_FIELDS_USED)]
    }

    /// The camera-fields in use, to be written.
    pub fn fields_mut(&mut self) -> &mut [MatchedField] {
        &mut self.fields[..(self.field_count as usize).min(MAX_FIELDS_USED)]
    }
}

impl Message for MatchFrame {
    const CHANNEL: &'static str = "matches";
    const VERSION: u32 = 1;
    const QUEUE: usize = 64;

    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected, found| require(holds, "MatchFrame", field, expected, found);
        check(self.exposed_ns > 0, "exposed_ns", "an instant", 0.0)?;
        let count = self.field_count;
        check(count as usize <= MAX_FIELDS_USED, "field_count", "at most 16", f64::from(count))?;
        self.fields().iter().try_for_each(MatchedField::validate)
    }
}

impl MatchedField {
    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected, found| require(holds, "MatchFrame", field, expected, found);
        let [blobs, missed] = [self.blob_count, self.missed_count];
        check(blobs as usize <= MAX_BLOBS, "fields.blob_count", "at most 64", f64::from(blobs))?;
        check(missed as usize <= ALL_MARKERS, "fields.missed_count", "at most 48", f64::from(missed))?;
        check(
            self.parity <= WHOLE_FRAME,
            "fields.parity",
            "0 or 1, or 2 of a whole frame",
            f64::from(self.parity),
        )?;
        for b in self.blobs() {
            let known = BlobUse::from_wire(b.outcome).is_some();
            check(known, "fields.blobs.outcome", "0 to 12", f64::from(b.outcome))?;
            let index = (b.blob as usize) < MAX_BLOBS;
            check(index, "fields.blobs.blob", "below 64", f64::from(b.blob))?;
            check(b.body <= NO_BODY, "fields.blobs.body", "0 to 3", f64::from(b.body))?;
            let marker = (b.marker as usize) < MAX_MARKERS;
            check(marker, "fields.blobs.marker", "below 16", f64::from(b.marker))?;
            let matched = b.body < NO_BODY || !b.outcome().is_matched();
            check(matched, "fields.blobs.body", "a body of a blob that was matched", f64::from(b.body))?;
            let place = [b.x_px, b.y_px, b.innovation_x_px, b.innovation_y_px];
            let rest = [b.residual_x_px, b.residual_y_px, b.nis];
            let finite = place.iter().chain(&rest).all(|v| v.is_finite());
            check(finite, "fields.blobs.x_px…nis", "finite numbers", f64::NAN)?;
            check(b.nis >= 0.0, "fields.blobs.nis", "0 or more", f64::from(b.nis))?;
        }
        for m in self.missed() {
            check(m.body < NO_BODY, "fields.missed.body", "0 to 2", f64::from(m.body))?;
            let marker = (m.marker as usize) < MAX_MARKERS;
            check(marker, "fields.missed.marker", "below 16", f64::from(m.marker))?;
            let finite = m.x_px.is_finite() && m.y_px.is_finite();
            check(finite, "fields.missed.x_px, y_px", "finite numbers", f64::NAN)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_list() {
        for (code, outcome) in BlobUse::ALL.into_iter().enumerate() {
            assert_eq!((outcome as usize, BlobUse::from_wire(code as u32)), (code, Some(outcome)));
        }
        assert_eq!(BlobUse::from_wire(BlobUse::ALL.len() as u32), None);
        let matched = BlobUse::ALL.into_iter().filter(|b| b.is_matched()).count();
        assert_eq!((matched, BlobUse::ALL.into_iter().filter(|b| b.is_used()).count()), (4, 2));
    }

    #[test]
    fn a_copy_is_the_same_in_all_that_is_used() {
        let mut copy = MatchFrame::zeroed();
        for count in [3, 1, 0, 16] {
            let mut frame = MatchFrame { exposed_ns: 7, field: 5, frame: 6, camera: 2, ..Zeroable::zeroed() };
            frame.field_count = count;
            frame.fields_mut().iter_mut().zip(1..).for_each(|(slot, field)| slot.field = field);
            copy.copy_from(&frame);
            assert_eq!(copy, frame, "{count} fields");
        }
    }

    #[test]
    fn what_does_not_fit_is_left_out() {
        let mut field = MatchedField::zeroed();
        (0..70).for_each(|blob| field.push(MatchedBlob { blob: blob % 64, ..Zeroable::zeroed() }));
        (0..50).for_each(|_| field.push_missed(Zeroable::zeroed()));
        assert_eq!((field.blobs().len(), field.missed().len()), (MAX_BLOBS, ALL_MARKERS));
        let mut frame = MatchFrame { exposed_ns: 1, field_count: 1, ..Zeroable::zeroed() };
        frame.fields[0] = field;
        assert_eq!(frame.validate(), Ok(()));
        frame.fields[0].blobs[63].body = NO_BODY;
        assert_eq!(frame.validate().unwrap_err().field, "fields.blobs.body");
        frame.fields[0].blobs[63].outcome = BlobUse::Unassigned as u32;
        assert_eq!(frame.validate(), Ok(()));
        frame.fields[0].blobs[63].nis = f32::NAN;
        assert_eq!(frame.validate().unwrap_err().field, "fields.blobs.x_px…nis");
    }
}
