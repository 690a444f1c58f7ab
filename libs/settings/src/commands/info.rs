//! The command line of `vitreo info`.

use std::path::PathBuf;

/// Arguments of `vitreo info`.
#[derive(Debug, clap::Args)]
pub struct InfoArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
