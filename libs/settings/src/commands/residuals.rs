//! The command line of `vitreo residuals`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo residuals`.
#[derive(Debug, clap::Args)]
pub struct ResidualsArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// As JSON, for programs.
    #[arg(long)]
    pub json: bool,
    /// Draw them: means and deviations of each marker, and mean residuals over the frame of each camera.
    #[arg(long, value_name = "OUT.png|svg")]
    pub plot: Option<PathBuf>,
    /// Find out why residuals are large: undo each cause that there may be, track again, and compare. Takes the
    /// first minute.
    #[arg(long)]
    pub causes: bool,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}
