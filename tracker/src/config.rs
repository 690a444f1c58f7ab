//! Command line of `vitreo-tracker`.

use ipc::shell::ShellArgs;
use settings::commands::processes::RigArgs;

/// Turns marker blobs into poses.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo-tracker", version)]
pub struct Config {
    /// Name, supervision.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// Trust the rig file: do not estimate how far the rig has drifted since it was calibrated.
    #[arg(long)]
    pub fixed_rig: bool,
}
