//! Info.

use std::process::ExitCode;

/// Arguments of `vitreo info`.
#[derive(Debug, clap::Args)]
pub struct InfoArgs {}

/// Runs it.
pub fn run(_args: &InfoArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
