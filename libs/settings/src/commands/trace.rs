//! The command line of `vitreo trace`.

use std::path::PathBuf;

/// Arguments of `vitreo trace`.
#[derive(Debug, clap::Args)]
pub struct TraceArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Field number, as in tables and logs.
    #[arg(value_parser = super::numbers::whole::<u64>(0, u64::MAX))]
    pub field: u64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
