//! Live run.

use std::process::ExitCode;

/// Arguments of `vitreo run`.
#[derive(Debug, clap::Args)]
pub struct RunArgs {}

/// Runs it.
pub fn run(_args: &RunArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
