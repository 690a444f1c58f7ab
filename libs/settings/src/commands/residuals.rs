//! The command line of `vitreo residuals`.

use super::numbers::positive;
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
    /// Find the causes in the last S seconds instead, and print nothing else: quick in a long recording too.
    #[arg(long, value_name = "S", requires = "causes", conflicts_with = "plot", value_parser = positive)]
    pub last: Option<f64>,
    /// Leave the search for causes off after S seconds, and say so.
    #[arg(long, value_name = "S", requires = "causes", value_parser = positive)]
    pub within: Option<f64>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}
