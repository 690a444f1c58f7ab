//! Command line of `vitreo-tracker`.

use ipc::shell::ShellArgs;
use std::path::PathBuf;

/// Turns marker blobs into poses.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo-tracker", version)]
pub struct Config {
    /// Name, supervision.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// Rig file (vitreo-rig-1): cameras, markers, trocars. Without it the shipped rig.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Read the time from the fields (when they were received) instead of the clock: for imported
    /// streams.
    #[arg(long, conflicts_with = "replay")]
    pub stream_clock: bool,
    /// Consume exactly the fields that the `recorded-frames` channel lists: for recorded runs.
    #[arg(long)]
    pub replay: bool,
    /// Trust the rig file: do not estimate how far the rig has drifted since it was calibrated.
    #[arg(long)]
    pub fixed_rig: bool,
}
