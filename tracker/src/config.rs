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
    /// Wake this many microseconds before fields are due, warm the caches and look for them without resting; 0: rest
    /// until they come. The launcher sets it where the tracker has the real-time scheduler.
    #[arg(long, value_name = "US", default_value_t = 0, hide = true)]
    pub ready_ahead_us: u64,
}
