//! Export.

use std::process::ExitCode;

/// Arguments of `vitreo export`.
#[derive(Debug, clap::Args)]
pub struct ExportArgs {}

/// Runs it.
pub fn run(_args: &ExportArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
