//! Command line of `vitreo-tracker`.

use ipc::shell::ShellArgs;
use settings::commands::processes::RigArgs;

/// Track instruments and eye: turn marker blobs into poses.
#[derive(Debug, clap::Parser)]
#[command(name = "vitreo-tracker", version)]
pub struct Config {
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// Do not estimate the drift of the rig since its calibration.
    #[arg(long)]
    pub fixed_rig: bool,
    /// Wake this many microseconds before fields are due, warm the caches and look for them without resting; 0: rest
    /// until they come. The launcher sets it where the tracker has the real-time scheduler.
    #[arg(long, value_name = "US", default_value_t = 0, hide = true)]
    pub ready_ahead_us: u64,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}
