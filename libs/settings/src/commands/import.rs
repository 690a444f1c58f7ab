//! The command line of `vitreo import`.

use super::WritingArgs;
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo import`.
#[derive(Debug, clap::Args)]
pub struct ImportArgs {
    /// Rig file of the stream's cameras.
    #[arg(long, value_name = "RIG.json")]
    pub rig: PathBuf,
    /// Blob stream, one camera-field per line.
    #[arg(value_name = "BLOBS.jsonl")]
    pub blobs: PathBuf,
    /// Scene for replays [default: peel].
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<String>,
    /// The recording to write.
    #[arg(short, long, value_name = "FILE.mcap")]
    pub output: PathBuf,
    /// Compression and splitting.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
