//! The command line of `vitreo diff`.

use super::numbers::not_negative;
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo diff`.
#[derive(Debug, clap::Args)]
pub struct DiffArgs {
    /// The first recording.
    #[arg(value_name = "A.mcap")]
    pub a: PathBuf,
    /// The second recording.
    #[arg(value_name = "B.mcap")]
    pub b: PathBuf,
    /// Largest pose difference that counts as equal, µm at the tip (for the eye: at its wall). With 0, every
    /// recorded input, pose, event and state must be identical.
    #[arg(long, value_name = "UM", default_value_t = 0.0, value_parser = not_negative, allow_negative_numbers = true)]
    pub tolerance: f64,
    /// Compare the recordings only, not their scores.
    #[arg(long)]
    pub quick: bool,
    /// Write the whole result as JSON; - is standard output, which then replaces the text.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Plot pose differences over time.
    #[arg(long, value_name = "FILE.svg|FILE.png", value_parser = plot_file)]
    pub plot: Option<PathBuf>,
    /// Write the whole result as a self-contained page.
    #[arg(long, value_name = "FILE.html")]
    pub html: Option<PathBuf>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}

/// Checks the file name of a plot, whose extension selects the format.
pub(super) fn plot_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("svg" | "png") => Ok(path),
        _ => Err("expected a file that ends in .svg or .png".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_is_svg_or_png() {
        assert!(plot_file("a.svg").is_ok() && plot_file("out/a.png").is_ok());
        for wrong in ["a.jpg", "a", "svg"] {
            assert!(plot_file(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
