//! The command line of `vitreo inspect`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo inspect`.
#[derive(Debug, clap::Args)]
pub struct InspectArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Draw the cameras' view of this field: blobs, what became of them, predictions and residuals. Without
    /// it, residuals, NIS and status over time.
    #[arg(long, value_name = "N")]
    pub field: Option<u64>,
    /// Show both in a window, and go through the recording by keys; h lists them.
    #[arg(long)]
    pub window: bool,
    /// Where the picture goes; the ending says how.
    #[arg(short, long, value_name = "OUT.png|svg", default_value = "inspect.png", conflicts_with = "window")]
    pub output: PathBuf,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}
