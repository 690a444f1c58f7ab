//! How pictures are drawn that nobody waits for, on a command line.

use super::FundusArgs;
use super::arrangement::{Arrangement, of_films};
use std::path::PathBuf;

/// Stills, and how they and films are drawn.
#[derive(Debug, Clone, clap::Args)]
pub struct DrawingArgs {
    /// Stills into this folder, named by their instants in s. Without a film nothing else is drawn.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Time from one still to the next, s.
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = seconds, requires = "stills")]
    pub every: f64,
    /// Stills are JPEG of at most so many kB instead of PNG.
    #[arg(long, value_name = "KB", requires = "stills")]
    pub jpeg: Option<u32>,
    /// Quality tier of the picture, 0 (2×1280×1024) to 8 [default: 1 of a module, 0 of a recording].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..9))]
    pub tier: Option<u32>,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// How the two channels share the picture: side-by-side, anaglyph, interleaved, left or right.
    #[arg(long, value_name = "HOW", default_value_t, value_parser = of_films(), hide_possible_values = true)]
    pub arrange: Arrangement,
}

/// A length of time, s.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected seconds, found '{text}'"))?;
    if (0.04..=3_600.0).contains(&value) { Ok(value) } else { Err("expected 0.04 to 3600 s".into()) }
}
