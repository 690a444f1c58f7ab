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
    /// Largest difference of a pose that counts as the same, µm at the tip, and at the eye's wall for the
    /// eye. With 0 every recorded input, pose, event and state must be the same to the bit.
    #[arg(long, value_name = "UM", default_value_t = 0.0, value_parser = not_negative)]
    pub tolerance: f64,
    /// Compare only what was recorded; leave the scores out.
    #[arg(long)]
    pub quick: bool,
    /// Write everything that was found as JSON; - is standard output, where the text is then left out.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Plot the differences of the poses over time.
    #[arg(long, value_name = "FILE.svg|FILE.png", value_parser = plot_file)]
    pub plot: Option<PathBuf>,
    /// Write a page with everything that was found, which needs no network.
    #[arg(long, value_name = "FILE.html")]
    pub html: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// A file of a plot, by its ending.
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
