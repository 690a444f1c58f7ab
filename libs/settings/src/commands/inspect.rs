//! The command line of `vitreo inspect`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo inspect`.
#[derive(Debug, clap::Args)]
pub struct InspectArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Draw this field: each camera's blobs, how they were matched, predictions and residuals. Without it:
    /// residuals, NIS and status over time.
    #[arg(long, value_name = "N")]
    pub field: Option<u64>,
    /// Browse the recording in a window; h lists the keys.
    #[arg(long)]
    pub window: bool,
    /// File to draw, .png or .svg.
    #[arg(
        short,
        long,
        value_name = "FILE.png|FILE.svg",
        default_value = "inspect.png",
        conflicts_with = "window"
    )]
    pub output: PathBuf,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
