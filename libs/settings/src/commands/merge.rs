//! The command line of `vitreo merge`.

use super::WritingArgs;
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo merge`.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// Parts of one run, in any order, or the name of a split recording; data contained in several parts is written once.
    #[arg(value_name = "FILE.mcap", required = true, num_args = 1..)]
    pub files: Vec<PathBuf>,
    /// Joined recording to write.
    #[arg(short, long, value_name = "OUT.mcap")]
    pub output: PathBuf,
    /// Compression and splitting.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
