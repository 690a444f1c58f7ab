//! Arguments of `vitreo-cameras`.

use ipc::shell::ShellArgs;
use protocol::handles::ControlChannels;
use settings::commands::cameras::Streams;
use settings::commands::processes::{RigArgs, SceneArgs};

/// Pictures from pipes and files as the live cameras of a rig.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-cameras", version)]
pub struct Config {
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// The scene, whose tools are in the hands where no handles are connected.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The source of each camera of the rig, in its order: y4m:PATH, a pipe or a file, with ?parity=1
    /// where its first field has the odd lines.
    #[arg(long, value_name = "y4m:PATH,...")]
    pub cameras: Streams,
    /// Leave these channels to another program of the run.
    #[arg(long, value_name = "handles,pedal", hide = true)]
    pub leave: Option<ControlChannels>,
    /// Finish S seconds after all sources have brought their first picture.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub duration: Option<f64>,
}

fn seconds(text: &str) -> Result<f64, String> {
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
        assert_eq!((config.cameras.0.len(), config.cameras.0[1].parity), (2, Some(1)));
        assert_eq!(config.duration, Some(2.5));
        for args in [
            &[][..],
            &["--cameras", "driver"],
            &["--cameras", "virtual"],
            &["--cameras", "y4m:a", "--duration", "0"],
            &["--cameras", "y4m:a", "--leave", "fields"],
            &["--cameras", "y4m:a", "--duration", "inf"],
        ] {
            assert!(parse(args).is_err(), "{args:?}");
        }
    }
}
