//! `poses`: tracked poses of the two instruments and the eye, with covariance and motion.

use crate::geometry::{Pose, Validity};
use crate::limits::{BODIES, MAX_FIELDS_USED, OSCILLATORS};
use crate::message::{Invalid, Message, all_finite, require};
use crate::time::{Instants, Nanos};
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Index of the eye in [`TrackerFrame::bodies`]; instruments are 0 and 1.
pub const EYE: usize = 2;
/// Names of the bodies in exchange files, by index.
pub const BODY_NAMES: [&str; BODIES] = ["inst0", "inst1", "eye"];

/// Tracking status of a body, in the terms of surgical trackers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
#[allow(missing_docs)]
pub enum BodyStatus {
    Tracked = 0,
    PartlyOutOfVolume = 1,
    TooFewMarkers = 2,
    BadFit = 3,
    Interference = 4,
    FellBehind = 5,
    Predicted = 6,
    Lost = 7,
    CamerasDisagree = 8,
}

impl BodyStatus {
    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        use BodyStatus::*;
        [
            Tracked,
            PartlyOutOfVolume,
            TooFewMarkers,
            BadFit,
            Interference,
            FellBehind,
            Predicted,
            Lost,
            CamerasDisagree,
        ]
        .get(code as usize)
        .copied()
    }

    /// In words.
    pub fn text(self) -> &'static str {
        match self {
            BodyStatus::Tracked => "tracked",
            BodyStatus::PartlyOutOfVolume => "partially out of volume",
            BodyStatus::TooFewMarkers => "too few markers",
            BodyStatus::BadFit => "bad fit",
            BodyStatus::Interference => "interference",
            BodyStatus::FellBehind => "fell behind",
            BodyStatus::Predicted => "predicted",
            BodyStatus::Lost => "lost",
            BodyStatus::CamerasDisagree => "cameras disagree",
        }
    }
}

/// One damped oscillator of a tremor, per axis: x'' + 2 ζ ω x' + ω² x = 0 about the smooth motion.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct Oscillator {
    /// ω, rad/s; 0 means unused.
    #[wire(tag = 1)]
    pub omega_rad_s: f64,
    /// ζ.
    #[wire(tag = 2)]
    pub damping: f64,
    /// Displacement at the frame's instant, mm (world).
    #[wire(tag = 3)]
    pub position_mm: [f64; 3],
    /// Its velocity, mm/s (world).
    #[wire(tag = 4)]
    pub velocity_mm_s: [f64; 3],
}

/// Motion state by which [`crate::predict`] carries a pose to another instant. World frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct Predictor {
    /// Velocity of the origin (tip), without the oscillators, mm/s.
    #[wire(tag = 1)]
    pub velocity_mm_s: [f64; 3],
    /// Acceleration, without the oscillators, mm/s².
    #[wire(tag = 2)]
    pub acceleration_mm_s2: [f64; 3],
    /// Time constant with which the acceleration dies out, s; 0 means it is not used.
    #[wire(tag = 3)]
    pub acceleration_tau_s: f64,
    /// Time constant with which the velocity dies out, s; 0 means that it is constant.
    #[wire(tag = 4)]
    pub velocity_tau_s: f64,
    /// Angular velocity in the world, rad/s.
    #[wire(tag = 5)]
    pub angular_velocity_rad_s: [f64; 3],
    /// Tremor.
    #[wire(tag = 6)]
    pub oscillators: [Oscillator; OSCILLATORS],
}

/// Entries of a symmetric 6×6 matrix, upper triangle row by row.
pub const COVARIANCE_ENTRIES: usize = 21;

/// One body at the frame's instant.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct BodyState {
    /// `world_from_body`: tip and axes of an instrument; the eye's rotation, position 0.
    #[wire(tag = 1)]
    pub world_from_body: Pose,
    /// Upper triangle of the covariance of (position, mm; rotation vector, rad), both in the world.
    #[wire(tag = 2)]
    pub covariance: [f64; COVARIANCE_ENTRIES],
    /// Its motion.
    #[wire(tag = 3)]
    pub predictor: Predictor,
    /// Root mean square of the image residuals of markers that are seen whole, px; 0 where there is none.
    #[wire(tag = 4)]
    pub residual_px: f64,
    /// Instant of the last measurement that took part.
    #[wire(tag = 5)]
    pub measured_ns: Nanos,
    /// [`Validity`] on the wire.
    #[wire(tag = 6)]
    pub validity: u32,
    /// [`BodyStatus`] on the wire.
    #[wire(tag = 7)]
    pub status: u32,
    /// Blobs that took part.
    #[wire(tag = 8)]
    pub blobs_used: u32,
    /// Cameras that took part.
    #[wire(tag = 9)]
    pub cameras_used: u32,
}

impl BodyState {
    /// Validity; a foreign code counts as lost.
    pub fn validity(&self) -> Validity {
        Validity::from_wire(self.validity).unwrap_or(Validity::Lost)
    }
}

/// A camera-field that went into a frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct FieldUsed {
    /// Field number of that camera.
    #[wire(tag = 1)]
    pub field: u64,
    /// Its mid-exposure.
    #[wire(tag = 2)]
    pub exposed_ns: Nanos,
    /// Camera id.
    #[wire(tag = 3)]
    pub camera: u32,
    /// Blobs of it that a body took.
    #[wire(tag = 4)]
    pub blobs_used: u32,
}

/// What closed a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ClosedBy {
    /// Every living camera's field was there.
    Inputs = 0,
    /// The wait for a late camera ran out.
    TimeOut = 1,
    /// A later field of the reference camera came before the frame was complete.
    NextField = 2,
}

impl ClosedBy {
    /// From the wire; a foreign code counts as a time-out.
    pub fn from_wire(code: u32) -> Self {
        match code {
            0 => ClosedBy::Inputs,
            2 => ClosedBy::NextField,
            _ => ClosedBy::TimeOut,
        }
    }
}

/// The tracker's result for one exposure of the reference camera.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Wire, Zeroable)]
pub struct TrackerFrame {
    /// Field number of the reference camera.
    #[wire(tag = 1)]
    pub field: u64,
    /// Counts up by one from 0 since the tracker started; 0 therefore marks a fresh tracker.
    #[wire(tag = 2)]
    pub frame: u64,
    /// Instants so far; `stepped` is 0.
    #[wire(tag = 3)]
    pub instants: Instants,
    /// Time spent waiting for a late camera after the first field arrived, ns.
    #[wire(tag = 4)]
    pub waited_ns: u64,
    /// Reference camera.
    #[wire(tag = 5)]
    pub camera: u32,
    /// [`ClosedBy`] on the wire.
    #[wire(tag = 6)]
    pub closed_by: u32,
    /// Camera-fields consumed by this frame, in this order.
    pub used_count: u32,
    /// Fields refused since the start: unknown camera, invalid, twice or out of order.
    #[wire(tag = 7)]
    pub fields_refused: u32,
    /// The consumed camera-fields; the first `used_count` are meaningful.
    #[wire(tag = 8, count = used_count)]
    pub used: [FieldUsed; MAX_FIELDS_USED],
    /// Instruments 0 and 1, then the eye.
    #[wire(tag = 9)]
    pub bodies: [BodyState; BODIES],
    /// Set of the cameras (a bit each, by id) that were moved, so that their blobs are not used.
    #[wire(tag = 10)]
    pub cameras_left_out: u32,
    /// Set of the cameras that are used where they were estimated to stand, not where the rig file has
    /// them.
    #[wire(tag = 11)]
    pub cameras_estimated: u32,
}

impl TrackerFrame {
    /// The camera-fields that went in.
    pub fn used(&self) -> &[FieldUsed] {
        &self.used[..(self.used_count as usize).min(MAX_FIELDS_USED)]
    }
}

impl Message for TrackerFrame {
    const CHANNEL: &'static str = "poses";
    const VERSION: u32 = 1;
    const QUEUE: usize = 128;

    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected, found| require(holds, "TrackerFrame", field, expected, found);
        check(self.instants.exposed > 0, "instants.exposed", "an instant", 0.0)?;
        let used = f64::from(self.used_count);
        check(self.used_count as usize <= MAX_FIELDS_USED, "used_count", "at most 16", used)?;
        for body in &self.bodies {
            check(body.world_from_body.is_valid(), "bodies.world_from_body", "a rigid pose", f64::NAN)?;
            check(all_finite(&body.covariance), "bodies.covariance", "finite numbers", f64::NAN)?;
            let motion: &[f64] = bytemuck::cast_slice(std::slice::from_ref(&body.predictor));
            check(all_finite(motion), "bodies.predictor", "finite numbers", f64::NAN)?;
            let known = Validity::from_wire(body.validity).is_some();
            check(known, "bodies.validity", "0 to 2", f64::from(body.validity))?;
        }
        Ok(())
    }
}
