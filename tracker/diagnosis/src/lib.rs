//! How well bodies are tracked, live and in a replay: shares, residuals, frames that should have been;
//! and what is wrong with it, with its likely cause and what helps. Pure.

mod agreement;
mod due;
mod finding;
mod residual_table;
mod residuals;
mod summary;
mod tracking;
mod watch;

pub use due::{Due, is_loss};
pub use finding::Finding;
pub use residual_table::{ResidualRow, ResidualTable};
pub use summary::{BodySummary, Summary};
pub use tracking::{BodyFigures, CameraFigures, Tracking, TrackingFigures, untracked};
pub use watch::{Judged, SHORTEST_S, Warning, Watch, sentences, unjudged, warned, with_judged};
