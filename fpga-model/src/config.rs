//! Arguments of `vitreo-fpga-model`.

use crate::commands::Command;
use ipc::shell::ShellArgs;
use settings::commands::processes::{ExtractionArgs, RigArgs};
use settings::{Program, SettingsArgs};

/// What vitreo.toml says to the sub-commands; a process of a run reads no file.
pub const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Emulate the camera hardware: turn fields of pixels into blobs.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-fpga-model", version)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Config {
    /// Sub-command, instead of running as a process.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Whether files of settings are read.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// What it finds.
    #[command(flatten)]
    pub extraction: ExtractionArgs,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}
