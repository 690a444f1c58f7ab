//! Import.

use std::process::ExitCode;

/// Arguments of `vitreo import`.
#[derive(Debug, clap::Args)]
pub struct ImportArgs {}

/// Runs it.
pub fn run(_args: &ImportArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
