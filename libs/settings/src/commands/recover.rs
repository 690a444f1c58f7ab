//! The command line of `vitreo recover`.

use super::WritingArgs;
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo recover`.
#[derive(Debug, clap::Args)]
pub struct RecoverArgs {
    /// Recording to repair.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Repaired recording to write.
    #[arg(short, long, value_name = "OUT.mcap")]
    pub output: PathBuf,
    /// Compression and splitting.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
