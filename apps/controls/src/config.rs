//! Arguments of `vitreo-controls`.

use crate::commands::Command;
use ipc::shell::ShellArgs;
use settings::commands::controls::ControlsArgs;
use settings::commands::processes::{RigArgs, SceneArgs};
use settings::{Program, SettingsArgs};

/// What vitreo.toml says to the sub-commands; a process of a run reads no file.
pub const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Read a foot pedal and the handles of the instruments.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-controls", version)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Config {
    /// Sub-command, instead of running as a process.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Whether files of settings are read.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// The rig, whose section handles says how far jaws open.
    #[command(flatten)]
    pub rig: RigArgs,
    /// The scene, whose tools are in the hands until the handles state others.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The devices.
    #[command(flatten)]
    pub controls: ControlsArgs,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn devices_are_read_and_nonsense_is_refused() {
        let parse = |args: &[&str]| {
            Config::try_parse_from(std::iter::once("vitreo-controls").chain(args.iter().copied()))
        };
        let config = parse(&["--pedal", "evdev:e", "--handles", "serial:s?baud=9600"]).unwrap();
        assert!(config.command.is_none() && config.controls.any());
        assert!(parse(&["pedal", "evdev:e", "--learn", "m.toml"]).unwrap().command.is_some());
        assert!(parse(&["handles", "serial:s"]).unwrap().command.is_some());
        for args in [&["--pedal", "e"][..], &["--handles", "evdev:e"], &["pedal"], &["handles", "evdev:e"]] {
            assert!(parse(args).is_err(), "{args:?}");
        }
    }
}
