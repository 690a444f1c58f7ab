//! Every tolerance of the simulation, with its unit and what moving it would break.

use protocol::limits::{SUBSTEP_NS, TICK_NS};

/// Faster than this a tip does not move, mm/s; a larger speed is a jump of the tracker, and a jump
/// sweeps nothing. Surgeons stay below 20 mm/s.
pub const MAX_TIP_SPEED_MM_S: f64 = 1_000.0;
/// A tip farther from the eye's centre than this, in retina radii, touches nothing.
pub const MAX_TIP_RADII: f64 = 2.0;

/// The rim warning is armed again when the force falls below this share of its limit.
pub const RIM_REARM: f32 = 0.8;
/// A fold (second layer) is reported at most once in this time, ns.
pub const FOLD_QUIET_NS: u64 = 1_000_000_000;
/// Time that a warning stays on the picture, ns.
pub const NOTICE_NS: u64 = 2_000_000_000;

/// Substeps of a tick, in which the vitreous moves once: how far a move spreads does not depend on
/// its length, so shorter ones cost more and change little; at a surgeon's 10 mm/s a tip moves
/// 0.2 mm in one.
pub const TICK_SUBSTEPS: u64 = TICK_NS / SUBSTEP_NS;
/// A tick may be so many substeps early, so that cameras whose instants tremble have one a field and
/// not none and then two; the next one is later by as much.
pub const TICK_EARLY_SUBSTEPS: u64 = 2;
/// Ticks between two checks of the vitreous' traction on the retina: 80 ms, faster than a surgeon
/// reacts.
pub const TRACTION_EVERY: u64 = 4;
/// Ticks between two counts of the removed vitreous for the task: 200 ms.
pub const GEL_EVERY: u64 = 10;
/// A warning about traction on the retina is armed again when the stress falls below this share of
/// its limit.
pub const TRACTION_REARM: f64 = 0.8;
/// A detachment that goes on raises at most one event in this time, ns.
pub const VITREOUS_QUIET_NS: u64 = 1_000_000_000;

/// Events of one step; more are counted and left out.
pub const MAX_EVENTS: usize = 256;
/// Bleeding points kept.
pub const MAX_MARKS: usize = 64;

/// Speed of the microscope at full pedal, mm/s.
pub const PEDAL_MOVE_MM_S: f64 = 5.0;
/// Full pedal changes the field of view by a factor e in 1/this, 1/s.
pub const PEDAL_ZOOM_PER_S: f64 = 0.5;
/// Speed of the plane of focus at full pedal, mm/s.
pub const PEDAL_FOCUS_MM_S: f64 = 2.0;
/// Farthest the microscope's target goes from the eye's centre along an axis, mm.
pub const MICROSCOPE_REACH_MM: f64 = 15.0;
/// Smallest and largest field of view, mm.
pub const FIELD_RANGE_MM: [f64; 2] = [4.0, 30.0];
/// Farthest plane of focus from the target, mm.
pub const FOCUS_REACH_MM: f64 = 10.0;

const _: () = assert!(RIM_REARM < 1.0);
