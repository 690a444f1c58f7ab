//! Arguments of `vitreo-virtual-rig`.

use ipc::shell::ShellArgs;
use protocol::handles::ControlChannels;
use settings::commands::processes::{RigArgs, SceneArgs, VirtualRigArgs};

/// Longest delay of a late camera, ms.
const MAX_LATE_MS: f64 = 500.0;

/// Simulate a scripted surgeon, the eye and the cameras that observe them.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-virtual-rig", version, mut_arg("force", |arg| arg.help_heading(None::<&str>)))]
pub struct Config {
    /// The rig.
    #[command(flatten)]
    pub rig: RigArgs,
    /// The scene, whose script the virtual surgeon performs.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// What the cameras see.
    #[command(flatten)]
    pub cameras: VirtualRigArgs,
    /// Leave these channels to another program of the run.
    #[arg(long, value_name = "handles,pedal", hide = true)]
    pub leave: Option<ControlChannels>,
    /// Whether a fault log that exists is written over.
    #[command(flatten)]
    pub force: outputs::Force,
    /// Stop after S seconds.
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true, help_heading = None::<&str>)]
    pub duration: Option<f64>,
    /// Stop S seconds after the end of the script, including retries, or after --duration if that is earlier.
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true, help_heading = None::<&str>)]
    pub after_round: Option<f64>,
    /// Go on with the script where a predecessor in this instance stood, who was killed.
    #[arg(long, hide = true)]
    pub resume: bool,
    /// Goals that are reached already, a bit for each.
    #[arg(long, value_name = "BITS", default_value_t = 0, requires = "resume", hide = true)]
    pub goals_reached: u64,
    /// Delay the fields of camera CAM by MS milliseconds.
    #[arg(long, value_name = "CAM=MS", value_parser = late_camera, conflicts_with = "blobs", hide = true)]
    pub late_camera: Option<LateCamera>,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}

/// A camera whose fields come too late.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LateCamera {
    /// Its id in the rig.
    pub camera: u32,
    /// By how much, ns.
    pub delay_ns: u64,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if value > 0.0 && value <= 1e6 { Ok(value) } else { Err("expected more than 0 and at most 1e6 s".into()) }
}

fn late_camera(text: &str) -> Result<LateCamera, String> {
    let (camera, ms) = text.split_once('=').ok_or("expected CAM=MS")?;
    let camera = camera.parse().map_err(|e| format!("camera {camera:?}: {e}"))?;
    let ms: f64 = ms.parse().map_err(|e| format!("delay {ms:?}: {e}"))?;
    if !(0.0..=MAX_LATE_MS).contains(&ms) {
        return Err(format!("expected a delay of 0 to {MAX_LATE_MS} ms, found {ms}"));
    }
    Ok(LateCamera { camera, delay_ns: (ms * 1e6) as u64 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn parse(args: &[&str]) -> Result<Config, clap::Error> {
        Config::try_parse_from(std::iter::once("vitreo-virtual-rig").chain(args.iter().copied()))
    }

    #[test]
    fn defaults_run_the_demo_scene_through_pixels() {
        let config = parse(&[]).unwrap();
        assert_eq!((config.scene.scene, config.cameras.direct, config.duration), (None, false, None));
        let late = parse(&["--late-camera", "2=7.5"]).unwrap().late_camera;
        assert_eq!(late, Some(LateCamera { camera: 2, delay_ns: 7_500_000 }));
    }

    #[test]
    fn nonsense_is_refused() {
        for args in [
            &["--duration", "nan"][..],
            &["--duration", "-1"],
            &["--leave", "poses"],
            &["--late-camera", "2"],
            &["--late-camera", "1=1e9"],
            &["--motion-full"],
            &["--blobs", "a", "--motion", "b"],
            &["--blobs", "a", "--late-camera", "2=7"],
        ] {
            assert!(parse(args).is_err(), "{args:?}");
        }
    }
}
