//! Command lines shared by several programs: `vitreo` checks, documents and completes them, and the program
//! that does the work parses them again.

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

/// Commands on recordings: `vitreo` declares them, `vitreo-replay` runs them.
#[derive(Debug, clap::Subcommand)]
pub enum RecordingCommand {
    /// Track and simulate a recording again.
    Replay(Box<ReplayArgs>),
    /// Make a recording from a rig file and a blob stream.
    Import(ImportArgs),
    /// Export a recording as CSV, JSON lines or trajectories.
    Export(ExportArgs),
    /// Cut a part out of a recording; the part is a recording that verifies bit for bit.
    Cut(CutArgs),
    /// Join the parts of one run.
    Merge(MergeArgs),
    /// Repair a truncated recording.
    Recover(RecoverArgs),
    /// Show a recording's contents.
    Info(InfoArgs),
    /// Check that recordings are complete, in order and without gaps.
    Check(CheckArgs),
    /// Show when each stage handled one field.
    Trace(TraceArgs),
    /// Print the reprojection residuals by camera and marker.
    Residuals(ResidualsArgs),
    /// Plot one field's blobs and matches, or residuals over time.
    Inspect(InspectArgs),
    /// Compare two recordings and name the cause of each difference.
    Diff(DiffArgs),
    /// List the constants that replay --set and sweep --set can change.
    Settings(SettingsListArgs),
    /// Replay recordings with one constant at several values.
    Sweep(SweepArgs),
    /// Make a film of a recording, or of a module performed by a scripted surgeon.
    Film(FilmArgs),
    /// Score recorded attempts.
    Score(ScoreArgs),
    /// Check recordings, streams and modules against expected figures.
    Suite(SuiteArgs),
    /// List, plot, export and delete trainees' results.
    Results(ResultsArgs),
}
