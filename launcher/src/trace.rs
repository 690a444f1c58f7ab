//! Trace.

use std::process::ExitCode;

/// Arguments of `vitreo trace`.
#[derive(Debug, clap::Args)]
pub struct TraceArgs {}

/// Runs it.
pub fn run(_args: &TraceArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
