//! Arguments of the process.

use ipc::shell::ShellArgs;
use scene::DEFAULT_SCENE;
use std::path::PathBuf;

/// Moves two instruments by mouse, keyboard or gamepad.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-desk", version)]
pub struct Config {
    /// What every process takes.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// Rig file; the shipped one if none is named. Its trocars are where the shafts pass.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Scene: instruments, and where they are at the start.
    #[arg(long, default_value = DEFAULT_SCENE, value_name = "NAME|FILE")]
    pub scene: String,
    /// What to listen to.
    #[arg(long, value_enum, default_value_t, value_name = "WHAT", conflicts_with = "inputs")]
    pub input: InputSource,
    /// Play a file of inputs instead, and finish with it.
    #[arg(long, value_name = "FILE")]
    pub inputs: Option<PathBuf>,
}

/// Sources of inputs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum InputSource {
    /// The window, and a gamepad where there is one.
    #[default]
    Auto,
    /// The window: mouse and keyboard.
    Mouse,
    /// A gamepad, which must be there, and the keyboard.
    Gamepad,
}
