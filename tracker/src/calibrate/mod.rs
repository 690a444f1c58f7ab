//! Calibration of a rig: lenses, places of cameras, markers, trocars; and whether it still holds.
//!
//! Nothing here runs on the hot path; matrices may grow. Files are read by [`cli`] and by the
//! readers it calls, everything else is pure.

pub mod board;
pub mod bundle;
pub mod cli;
pub mod corners;
pub mod dots;
pub mod drift;
pub mod grey;
pub mod grid;
pub mod known_target;
pub mod lens;
pub mod linear;
pub mod many;
pub mod output;
pub mod picture;
pub mod pivot;
pub mod points;
pub mod poses;
pub mod report;
pub mod sightings;
pub mod solve;
pub mod targets;
pub mod waved;

/// Why a calibration was refused.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The arrangement of points or views does not fix what is asked for.
    #[error("degenerate geometry: {0}")]
    Geometry(String),
    /// Too few pictures with a target in them.
    #[error("the target was found in {found} pictures; at least {needed} are needed, tilted differently")]
    TooFewViews {
        /// With the target.
        found: usize,
        /// Least number.
        needed: usize,
    },
    /// The least squares have no answer.
    #[error(transparent)]
    Solve(#[from] solve::SolveError),
}
