//! The command line of `vitreo check`.

use std::path::PathBuf;

/// Arguments of `vitreo check`.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// The recordings.
    #[arg(value_name = "FILE.mcap", required = true)]
    pub files: Vec<PathBuf>,
    /// Print JSON, one line per recording.
    #[arg(long)]
    pub json: bool,
}
