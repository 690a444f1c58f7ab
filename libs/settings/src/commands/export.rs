//! The command line of `vitreo export`.

use outputs::Force;
use protocol::poses::BODY_NAMES;
use std::path::PathBuf;

/// Topics that `--csv` can write as tables.
pub const TABLES: [&str; 11] = [
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
    "poses",
];

/// Arguments of `vitreo export`.
#[derive(Debug, clap::Args)]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
pub struct ExportArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Data to export.
    #[command(flatten)]
    pub what: What,
    /// File for --csv [default: standard output].
    #[arg(short, long, value_name = "OUT.csv", requires = "csv", help_heading = "Outputs")]
    pub output: Option<PathBuf>,
    /// With --tum FILE: the body to write.
    #[arg(long, value_name = "BODY", requires = "tum", value_parser = BODY_NAMES)]
    pub body: Option<String>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Data to export; at least one.
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
    /// Write a topic as a table; matches has one row per blob, poses one per body (status, covariance,
    /// residual).
    #[arg(long, value_name = "TOPIC", value_parser = TABLES)]
    pub csv: Option<String>,
    /// Write the measured poses as TUM trajectories for evo (timestamp tx ty tz qx qy qz qw; s, m):
    /// inst0.tum, inst1.tum and eye.tum in a folder, or one file with --body.
    #[arg(long, value_name = "DIR|OUT.tum")]
    pub tum: Option<PathBuf>,
}
