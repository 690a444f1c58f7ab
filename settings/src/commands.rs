//! Command lines that several programs read: `vitreo` checks, describes and completes them, the program
//! that does the work takes them again.

mod export;
mod import;
mod info;
pub mod numbers;
mod recover;
mod replay;
mod span;
mod trace;

pub use export::{ExportArgs, TABLES, What};
pub use import::ImportArgs;
pub use info::InfoArgs;
pub use recover::RecoverArgs;
pub use replay::ReplayArgs;
pub use span::SpanArgs;
pub use trace::TraceArgs;
