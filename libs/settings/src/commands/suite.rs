//! The command line of `vitreo suite`.

use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo suite`.
#[derive(Debug, clap::Args)]
pub struct SuiteArgs {
    /// Suite: cases and their expected figures (docs/suites.md).
    #[arg(value_name = "FILE.toml")]
    pub file: PathBuf,
    /// Run only cases whose name contains TEXT.
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
    /// Cases to run in parallel [default: one per processor].
    #[arg(long, value_name = "N", value_parser = super::numbers::whole::<u32>(1, 256))]
    pub jobs: Option<u32>,
    /// Write the results as JUnit XML, for build servers.
    #[arg(long, value_name = "FILE.xml")]
    pub junit: Option<PathBuf>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
}
