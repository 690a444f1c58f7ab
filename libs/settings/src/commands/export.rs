//! The command line of `vitreo export`.

use outputs::Force;
use std::path::PathBuf;

/// Topics that can be written as tables.
pub const TABLES: [&str; 10] = [
    "handles",
    "pedal",
    "steps",
    "events",
    "frames",
    "notes",
    "checkpoints",
    "tracker-checkpoints",
    "pictures",
    "matches",
];

/// Arguments of `vitreo export`.
#[derive(Debug, clap::Args)]
pub struct ExportArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// What is written.
    #[command(flatten)]
    pub what: What,
    /// Where `--csv` goes [default: standard output].
    #[arg(short, long, value_name = "OUT.csv", requires = "csv")]
    pub output: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// What is written; one of it at least.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = true)]
pub struct What {
    /// Write the recorded poses.
    #[arg(long, value_name = "OUT.csv")]
    pub poses: Option<PathBuf>,
    /// Write the blob stream.
    #[arg(long, value_name = "OUT.jsonl")]
    pub blobs: Option<PathBuf>,
    /// Write the rig file.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Write a topic as a table: handles, pedal, steps, events, frames, notes, checkpoints,
    /// tracker-checkpoints, pictures, matches (a row a blob).
    #[arg(long, value_name = "TOPIC", value_parser = TABLES)]
    pub csv: Option<String>,
}
