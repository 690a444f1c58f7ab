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
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// Plot the mean and deviation of each marker, and the mean residual over each camera's image.
    #[arg(long, value_name = "FILE.png|FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Find the cause of large residuals: undo each possible cause, track again, and compare. Uses the first
    /// minute.
    #[arg(long)]
    pub causes: bool,
    /// Search the last S seconds instead and print only the causes; fast in long recordings too.
    #[arg(long, value_name = "S", requires = "causes", conflicts_with = "plot", value_parser = positive, allow_negative_numbers = true)]
    pub last: Option<f64>,
    /// Give up the search for causes after S seconds, with a message.
    #[arg(long, value_name = "S", requires = "causes", value_parser = positive, allow_negative_numbers = true)]
    pub within: Option<f64>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
