//! The command line of `vitreo cut`.

use super::{SpanArgs, WritingArgs};
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo cut`.
#[derive(Debug, clap::Args)]
#[command(mut_arg("from", |arg| arg.help("Begin S seconds after the recording's start")))]
pub struct CutArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// The part that is kept.
    #[command(flatten)]
    pub span: SpanArgs,
    /// The new recording.
    #[arg(short, long, value_name = "OUT.mcap")]
    pub output: PathBuf,
    /// Compression and splitting.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
