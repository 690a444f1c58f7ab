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

/// Commands on recordings: `vitreo` declares them, `vitreo-replay` carries them out.
#[derive(Debug, clap::Subcommand)]
pub enum RecordingCommand {
    /// Run a recording through tracker and tissue again.
    Replay(ReplayArgs),
    /// Make a recording from a rig and a blob stream.
    Import(ImportArgs),
    /// Write the contents of a recording as CSV or JSON lines.
    Export(ExportArgs),
    /// Mend a truncated recording.
    Recover(RecoverArgs),
    /// Say what a recording holds.
    Info(InfoArgs),
    /// Show the way of one field through all instants.
    Trace(TraceArgs),
}
