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
    /// Trust the rig file: do not estimate how far the rig has drifted since it was calibrated.
    #[arg(long)]
    pub fixed_rig: bool,
}
