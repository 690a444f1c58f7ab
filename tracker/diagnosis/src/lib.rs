//! How well bodies are tracked, live and in a replay: shares, residuals, frames that should have been;
//! and what is wrong with it, with its likely cause and what helps. Pure.

mod agreement;
mod due;
mod residuals;
mod tracking;
mod watch;

pub use due::{Due, is_loss};
pub use tracking::{BodyFigures, CameraFigures, Finding, Tracking, TrackingFigures, untracked};
pub use watch::{Warning, Watch};
