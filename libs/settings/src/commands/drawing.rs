//! Options for pictures that are drawn off-line, not in real time.

use super::FundusArgs;
use super::arrangement::{Arrangement, of_films};
use std::path::PathBuf;

/// Stills, and the quality of stills and films.
#[derive(Debug, Clone, clap::Args)]
pub struct DrawingArgs {
    /// Save stills in this folder, named by their time in s. Without a film, only the stills are drawn.
    #[arg(long, value_name = "DIR", help_heading = "Picture")]
    pub stills: Option<PathBuf>,
    /// Time between stills, s.
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = seconds, allow_negative_numbers = true, requires = "stills", help_heading = "Picture")]
    pub every: f64,
    /// Save stills as JPEG of at most KB kB instead of PNG.
    #[arg(long, value_name = "KB", requires = "stills", help_heading = "Picture")]
    pub jpeg: Option<u32>,
    /// Quality tier, 0 (best, 2×1280×1024) to 8 [default: 0; 1 for a film of a module].
    #[arg(long, value_name = "N", value_parser = super::numbers::whole::<u32>(0, 8), help_heading = "Picture")]
    pub tier: Option<u32>,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// Stereo layout: side-by-side, anaglyph, interleaved, left or right.
    #[arg(long, value_name = "LAYOUT", default_value_t, value_parser = of_films(), hide_possible_values = true, help_heading = "Picture")]
    pub arrange: Arrangement,
}

/// Parses a duration, 0.04 s to 3600 s.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected seconds, found '{text}'"))?;
    if (0.04..=3_600.0).contains(&value) { Ok(value) } else { Err("expected 0.04 to 3600 s".into()) }
}
