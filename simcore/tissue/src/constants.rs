//! Tolerances of the tissue, each with its unit and what moving it would break.

use protocol::limits::SUBSTEP_NS;

/// A substep, s. Explicit integration is stable only while dt·√(2·Σk/m) stays below 2 (see
/// [`crate::sheet::solver`]); a longer one breaks that for the shipped scene.
pub const SUBSTEP_S: f64 = SUBSTEP_NS as f64 * 1e-9;
/// A substep is split into at most so many parts where its springs are too stiff for it; a tissue
/// that needs more is refused, because a step could no longer be computed in time.
pub const MAX_SPLITS: u32 = 64;
/// A node farther from the eye's centre than this has run away, mm: farther than [`MAX_TIP_RADII`]
/// of the largest retina with a tool's length on top, so that held tissue never is.
pub const RUNAWAY_MM: f32 = 100.0;
/// A node faster than this has run away, mm/s: ten times the largest v_max that a scene can ask
/// for; smaller would catch nodes that are only fast.
pub const RUNAWAY_MM_S: f32 = 1e7;
/// Sweeps of strain limiting in a substep, at most. One draws a spring; more carry that on to its
/// neighbours, so that a pulled edge of fewer springs than this is rigid beyond the limit, and a
/// longer one gives a little.
pub const STRAIN_SWEEPS: u32 = 8;
/// Nodes one instrument can hold.
pub const MAX_HELD: usize = 256;
/// Shortest spring length that still has a direction, mm²: protects a division, 1 nm.
pub const TINY_LENGTH2_MM2: f32 = 1e-12;
/// A first contact deeper than the tip's way since the last look plus this, mm, did not come
/// through the membrane: the instrument came round an edge and is under it. Larger than what the
/// membrane itself moves in a substep; much larger would push what lies over the shaft.
pub const UNDER_MARGIN_MM: f64 = 0.25;
/// Longest travel per step, mm, at which the collision volume cannot miss the membrane that the tip
/// crosses, and the tip's path is not tested beside it: less than the volume's depth behind the
/// tip.
pub const CHECKED_WAY_MM: f64 = 1.0;
/// A needle is out of its hole when the tip is so far before it, mm: a membrane that swings as it
/// is pierced does not flood the events; less than what a hand moves in 0.1 s.
pub const NEEDLE_OUT_MM: f64 = 0.02;
