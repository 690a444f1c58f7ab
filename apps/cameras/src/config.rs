//! Arguments of `vitreo-cameras`.

use crate::commands::Command;
use ipc::shell::ShellArgs;
use protocol::handles::ControlChannels;
use settings::commands::cameras::Streams;
use settings::commands::processes::{RigArgs, SceneArgs};
use settings::{Program, SettingsArgs};

/// What vitreo.toml says to the sub-command; a process of a run reads no file.
pub const SETTINGS: Program = Program { prefix: "", without: &[], elsewhere: None };

/// Read cameras, pipes or files as the live cameras of a rig.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-cameras", version)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
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
    /// The scene, whose tools are in the hands where no handles are connected.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Sources in the order of the rig's cameras, separated by commas: v4l2:/dev/videoN for a camera of this machine;
    /// genicam:NAME for GigE Vision or USB3 Vision, with settings such as ?exposure_us=2000&gain=4&trigger=external;
    /// y4m:PATH for a pipe or file, with ?parity=1 if its first field has the odd lines.
    #[arg(long, value_name = "v4l2:DEVICE|genicam:NAME|y4m:PATH,...", required = true)]
    pub cameras: Option<Streams>,
    /// Leave these channels to another program of the run.
    #[arg(long, value_name = "handles,pedal", hide = true)]
    pub leave: Option<ControlChannels>,
    /// Stop S seconds after the first picture of the last source.
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}

/// A length of time in seconds.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if value > 0.0 && value <= 1e6 { Ok(value) } else { Err("expected more than 0 and at most 1e6 s".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn sources_are_read_and_nonsense_is_refused() {
        let parse = |args: &[&str]| {
            Config::try_parse_from(std::iter::once("vitreo-cameras").chain(args.iter().copied()))
        };
        let config = parse(&["--cameras", "y4m:a,y4m:b?parity=1", "--duration", "2.5"]).unwrap();
        let sources = config.cameras.expect("sources").0;
        assert_eq!((sources.len(), sources[1].parity), (2, Some(1)));
        for args in [
            &["cameras"][..],
            &["cameras", "--list"],
            &["cameras", "virtual", "--snapshot", "s", "--force"],
            &["cameras", "v4l2:/dev/video0?gain=4,y4m:b", "--duration", "2", "--rig", "r.json"],
        ] {
            assert!(parse(args).is_ok_and(|c| c.command.is_some()), "{args:?}");
        }
        assert_eq!(config.duration, Some(2.5));
        for args in [
            &[][..],
            &["--cameras", "driver"],
            &["cameras", "--list", "virtual"],
            &["cameras", "--snapshot", "s"],
            &["cameras", "usb:3"],
            &["--cameras", "virtual"],
            &["--cameras", "y4m:a", "--duration", "0"],
            &["--cameras", "y4m:a", "--leave", "fields"],
            &["--cameras", "y4m:a", "--duration", "inf"],
        ] {
            assert!(parse(args).is_err(), "{args:?}");
        }
    }
}
