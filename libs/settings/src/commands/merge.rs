//! The command line of `vitreo merge`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo merge`.
#[derive(Debug, clap::Args)]
pub struct MergeArgs {
    /// Parts of one run, in any order; what two of them hold is taken once.
    #[arg(value_name = "FILE.mcap", required = true, num_args = 2..)]
    pub files: Vec<PathBuf>,
    /// The whole.
    #[arg(short, long, value_name = "OUT.mcap")]
    pub output: PathBuf,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}
