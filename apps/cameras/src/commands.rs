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
    /// List the cameras of this machine, or show how those of a rig stand.
    Cameras(CamerasArgs),
}

/// Arguments of `vitreo cameras`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    after_help = "Without cameras, those of this machine are listed with their modes. With them, a line a second \
    for each says how it stands and what to do, until Ctrl-C (docs/cameras.md)."
)]
pub struct CamerasArgs {
    /// The cameras: v4l2:/dev/videoN, genicam:NAME, y4m:PATH, mcap:FILE, several separated by commas, or virtual; the first stands
    /// for the first of the rig, and so on.
    #[arg(value_name = "SPEC,...", conflicts_with = "list")]
    pub cameras: Option<Cameras>,
    /// List the cameras of this machine, and their modes.
    #[arg(long)]
    pub list: bool,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// What counts as a blob.
    #[command(flatten)]
    pub extraction: ExtractionArgs,
    /// Write a picture of each camera into a folder, camera-0.png and so on, and end.
    #[arg(long, value_name = "DIR", requires = "cameras")]
    pub snapshot: Option<PathBuf>,
    /// Keep all fields: in FILE.mcap, packed without loss and with their stamps, for vitreo blobs and --cameras mcap:, or
    /// in a folder, camera-0.y4m and so on, clips for vitreo blobs and --cameras y4m:.
    #[arg(long, value_name = "FILE.mcap|DIR", requires = "cameras")]
    pub record_fields: Option<PathBuf>,
    /// End after S seconds.
    #[arg(long, value_name = "S", value_parser = crate::config::seconds, requires = "cameras")]
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
