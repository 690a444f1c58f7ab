//! Calibration of a rig: lenses, camera poses, marker positions, trocars; and whether it still
//! holds.
//!
//! Nothing here runs on the hot path; matrices may grow. Files are read by [`cli`] and by the
//! readers it calls, everything else is pure. Bodies are tracked by the crate `tracker`.

pub mod agreement;
mod best_half;
pub mod board;
pub mod bundle;
pub mod causes;
pub mod charuco;
pub mod cli;
pub mod corners;
pub mod dots;
mod draws;
pub mod drift_check;
pub mod exchanged;
pub mod fixed_dots;
mod frames;
pub mod grey_image;
pub mod grid;
pub mod halves;
pub mod known_target;
pub mod lens;
pub mod lens_doubt;
pub mod linear;
pub mod mend;
pub mod multi_camera;
pub mod observations;
pub mod pivot;
pub mod point_lists;
pub mod pose_file;
pub mod printed;
pub mod relative_motion;
pub mod repeats;
pub mod report;
pub mod residual_plot;
pub mod rig_output;
pub mod rig_view;
pub mod self_calibration;
pub mod solve;
pub mod starts;
pub mod target_problem;
pub mod weak_terms;
pub mod words;
pub mod wrong_points;

use target_problem::FEWEST_VIEWS;

/// Why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Points or views do not determine the parameters.
    #[error("degenerate geometry: {0}")]
    Geometry(String),
    /// Only a mirrored world fits the image points.
    #[error("the world of the dots is left-handed: exchange two of X, Y, Z, or change the sign of one")]
    LeftHanded,
    /// Points that contradict the camera or each other; the message says whose.
    #[error("{0}")]
    Disagreement(String),
    /// Too few pictures with a target in them.
    #[error("the target was found in {0} pictures; at least {FEWEST_VIEWS} are needed, tilted differently")]
    TooFewViews(usize),
    /// The least-squares problem has no solution.
    #[error(transparent)]
    Solve(#[from] solve::SolveError),
}

impl CalibrationError {
    /// True if fewer unknowns may have a solution.
    pub(crate) fn is_undetermined(&self) -> bool {
        use solve::SolveError::{Endless, TooFew, Undetermined};
        matches!(self, CalibrationError::Solve(Undetermined { .. } | Endless { .. } | TooFew { .. }))
    }
}

/// The median of some values, of an even number of them the upper one; `None` of none.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

fn disagreement(problem: impl Into<String>) -> CalibrationError {
    CalibrationError::Disagreement(problem.into())
}

fn degenerate(problem: impl Into<String>) -> CalibrationError {
    CalibrationError::Geometry(problem.into())
}
