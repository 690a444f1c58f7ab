//! Command lines that several programs read: `vitreo` checks, describes and completes them, the program
//! that does the work takes them again.

pub mod arrangement;
pub mod bridge;
pub mod cameras;
mod check;
pub mod controls;
mod cut;
mod diff;
mod drawing;
mod export;
pub mod external;
mod film;
mod fundus;
mod import;
mod info;
mod inspect;
mod merge;
pub mod numbers;
pub mod processes;
mod recover;
mod replay;
mod residuals;
mod results;
mod score;
mod span;
mod suite;
mod trace;
mod what_if;
mod writing;

pub use arrangement::Arrangement;
pub use check::CheckArgs;
pub use cut::CutArgs;
pub use diff::DiffArgs;
pub use drawing::DrawingArgs;
pub use export::{ExportArgs, TABLES, What};
pub use film::FilmArgs;
pub use fundus::{FundusArgs, FundusEye};
pub use import::ImportArgs;
pub use info::InfoArgs;
pub use inspect::InspectArgs;
pub use merge::MergeArgs;
pub use recover::RecoverArgs;
pub use replay::ReplayArgs;
pub use residuals::ResidualsArgs;
pub use results::{ResultsArgs, ResultsCommand, StoreArgs, TERMINAL};
pub use score::{BatchArgs, ScoreArgs};
pub use span::SpanArgs;
pub use suite::SuiteArgs;
pub use trace::TraceArgs;
pub use what_if::{Assignment, Range, SettingsListArgs, SweepArgs, WhatIfArgs};
pub use writing::{PACKINGS, Split, WritingArgs};

/// Commands on recordings: `vitreo` declares them, `vitreo-replay` carries them out.
#[derive(Debug, clap::Subcommand)]
pub enum RecordingCommand {
    /// Run a recording through tracker and tissue again.
    Replay(Box<ReplayArgs>),
    /// Make a recording from a rig and a blob stream.
    Import(ImportArgs),
    /// Write the contents of a recording as CSV or JSON lines.
    Export(ExportArgs),
    /// Cut a part out of a recording, as a recording that verifies to the bit.
    Cut(CutArgs),
    /// Put parts of one run together again.
    Merge(MergeArgs),
    /// Mend a truncated recording.
    Recover(RecoverArgs),
    /// Say what a recording holds.
    Info(InfoArgs),
    /// Check that recordings are whole, in order and without gaps.
    Check(CheckArgs),
    /// Show the way of one field through all instants.
    Trace(TraceArgs),
    /// Print how far blobs lie from the fitted markers, by camera and marker.
    Residuals(ResidualsArgs),
    /// Draw what the cameras saw of a field and what the tracker made of it, or residuals over time.
    Inspect(InspectArgs),
    /// Compare two recordings, and name the cause of what differs.
    Diff(DiffArgs),
    /// List the constants that a what-if may set.
    Settings(SettingsListArgs),
    /// Run recordings with a constant at several values.
    Sweep(SweepArgs),
    /// Make a film of a module as a scripted surgeon does it, or of a recording as it was.
    Film(FilmArgs),
    /// Score recorded attempts at a module.
    Score(ScoreArgs),
    /// Check recordings, streams and modules against what is expected of them.
    Suite(SuiteArgs),
    /// List, plot, export and delete what trainees achieved.
    Results(ResultsArgs),
}
