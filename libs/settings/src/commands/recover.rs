//! The command line of `vitreo recover`.

use super::WritingArgs;
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo recover`.
#[derive(Debug, clap::Args)]
pub struct RecoverArgs {
    /// The recording to mend.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// The whole recording to write.
    #[arg(short, long, value_name = "OUT.mcap")]
    pub output: PathBuf,
    /// How it is written.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// Whether a file that exists is written over.
    #[command(flatten)]
    pub force: Force,
}
