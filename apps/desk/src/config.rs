//! Arguments of the process.

use ipc::shell::ShellArgs;
use settings::commands::processes::{DeskArgs, GAMEPAD, MOUSE, RigArgs, SceneArgs};

/// Move two instruments by mouse, keyboard or gamepad.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-desk", version)]
pub struct Config {
    /// The rig; its trocars are where the shafts pass.
    #[command(flatten)]
    pub rig: RigArgs,
    /// The scene: instruments, and where they are at the start.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// What a person works with.
    #[command(flatten)]
    pub desk: DeskArgs,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}

impl Config {
    /// What is listened to.
    pub fn input(&self) -> InputSource {
        match self.desk.input.as_deref() {
            Some(MOUSE) => InputSource::Mouse,
            Some(GAMEPAD) => InputSource::Gamepad,
            _ => InputSource::Auto,
        }
    }
}

/// Sources of inputs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum InputSource {
    /// The window, and a gamepad where there is one.
    #[default]
    Auto,
    /// The window: mouse and keyboard.
    Mouse,
    /// A gamepad, which must be there, and the keyboard.
    Gamepad,
}
