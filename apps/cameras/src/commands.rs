//! Sub-commands of `vitreo-cameras`, for a person at a terminal.
//!
//! `vitreo cameras …` is `vitreo-cameras cameras …`.

pub mod clips;
pub mod list;
pub mod look;
pub mod pixels;
pub mod watch;

use anyhow::Result;
use outputs::Force;
use settings::commands::cameras::Cameras;
use settings::commands::processes::{ExtractionArgs, RigArgs};
use std::path::PathBuf;

/// The sub-commands.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Command {
    /// List the cameras of this machine, or show the condition of a rig's cameras.
    Cameras(CamerasArgs),
}

/// Arguments of `vitreo cameras`.
#[derive(Debug, Clone, clap::Args)]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
#[command(
    after_help = "Without cameras, the command lists those of this machine with their modes. With cameras, it prints \
    one line per second for each, with its condition and a remedy for each problem, until Ctrl-C (docs/cameras.md)."
)]
pub struct CamerasArgs {
    /// Cameras in the order of the rig, separated by commas: v4l2:/dev/videoN, genicam:NAME, y4m:PATH or mcap:FILE; or
    /// virtual for simulated cameras.
    #[arg(value_name = "SPEC,...", conflicts_with = "list")]
    pub cameras: Option<Cameras>,
    /// List the cameras of this machine and their modes.
    #[arg(long)]
    pub list: bool,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// What counts as a blob.
    #[command(flatten)]
    pub extraction: ExtractionArgs,
    /// Write a picture of each camera into a folder, as camera-0.png and so on, and stop.
    #[arg(long, value_name = "DIR", requires = "cameras", help_heading = "Outputs")]
    pub snapshot: Option<PathBuf>,
    /// Record all fields: losslessly compressed with their timestamps into FILE.mcap, for vitreo blobs and --cameras
    /// mcap:, or as clips camera-0.y4m and so on into a folder, for vitreo blobs and --cameras y4m:.
    #[arg(long, value_name = "FILE.mcap|DIR", requires = "cameras", help_heading = "Outputs")]
    pub record_fields: Option<PathBuf>,
    /// Stop after S seconds.
    #[arg(long, value_name = "S", value_parser = crate::config::seconds, allow_negative_numbers = true, requires = "cameras")]
    pub duration: Option<f64>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
}

/// Runs a sub-command.
///
/// # Errors
/// As the command run.
pub fn run(command: &Command) -> Result<()> {
    let Command::Cameras(args) = command;
    match &args.cameras {
        None => list::run(),
        Some(cameras) => look::run(args, cameras),
    }
}
