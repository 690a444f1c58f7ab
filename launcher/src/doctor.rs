//! Doctor.

use std::process::ExitCode;

/// Arguments of `vitreo doctor`.
#[derive(Debug, clap::Args)]
pub struct DoctorArgs {}

/// Runs it.
pub fn run(_args: &DoctorArgs) -> anyhow::Result<ExitCode> {
    anyhow::bail!("not there yet")
}
