//! The command line of `vitreo suite`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo suite`.
#[derive(Debug, clap::Args)]
pub struct SuiteArgs {
    /// The suite: cases with what is expected of them (docs/suites.md).
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Only cases whose name contains this text.
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
    /// Cases at a time [default: one a processor].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=256))]
    pub jobs: Option<u32>,
    /// Write the outcome as JUnit XML, which build servers show.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}
