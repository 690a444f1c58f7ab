//! Replay.

use std::process::ExitCode;

/// Arguments of `vitreo replay`.
#[derive(Debug, clap::Args)]
pub struct ReplayArgs {}

/// Runs it.
pub fn run(_args: &ReplayArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
