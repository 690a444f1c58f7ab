//! Recover.

use std::process::ExitCode;

/// Arguments of `vitreo recover`.
#[derive(Debug, clap::Args)]
pub struct RecoverArgs {}

/// Runs it.
pub fn run(_args: &RecoverArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
