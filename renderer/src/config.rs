//! Arguments of the program.

use crate::present::window::WindowConfig;
use crate::stereo::Arrangement;
use ipc::shell::ShellArgs;
use settings::commands::processes::{PictureArgs, RigArgs, SceneArgs};

/// Pictures a second of a video.
pub const VIDEO_HZ: u32 = 25;
/// Time between two stills, ns.
pub const STILL_NS: u64 = 1_000_000_000;
/// Age of the newest scene from which on the picture says that it is held, ns.
pub const HELD_NS: u64 = 250_000_000;
/// A window is redrawn and its events are served at least this often, and any picture that is held
/// is redrawn, ns.
pub const IDLE_REDRAW_NS: u64 = 50_000_000;
/// Time for which the picture shows a new tier and its reason, ns.
pub const STATUS_NS: u64 = 4_000_000_000;
/// Most small pictures a second.
pub const MAX_PICTURES_HZ: f64 = 15.0;

/// Draw the surgeon's stereo view.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-renderer", mut_arg("full_screen", |arg| arg.requires("window")),
    mut_arg("force", |arg| arg.help_heading(None::<&str>)))]
pub struct Config {
    /// The rig; gives the length of the instruments.
    #[command(flatten)]
    pub rig: RigArgs,
    /// The scene; gives eye, membrane size and shafts.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Draw without a window (the default).
    #[arg(long, conflicts_with = "window")]
    pub headless: bool,
    /// Show the picture in a window.
    #[arg(long)]
    pub window: bool,
    /// How the picture is drawn, and where it goes: a still every second, and the last picture as
    /// last.png; a video of 25 pictures a second.
    #[command(flatten)]
    pub picture: PictureArgs,
    /// Control the instruments with mouse and keyboard: texts name keys, a click captures the mouse, Escape releases it.
    #[arg(long, help_heading = None::<&str>)]
    pub desk: bool,
    /// Show a replay: each scene with the poses of its own instant, and the keys of a replay.
    #[arg(long, hide = true, conflicts_with = "desk")]
    pub replay: bool,
    /// `--force`.
    #[command(flatten)]
    pub force: outputs::Force,
    /// Rate of the small pictures for console and recorder, 0 to 15 Hz.
    #[arg(long, value_name = "HZ", default_value_t = 2.0, value_parser = pictures_hz)]
    pub pictures_hz: f64,
    /// Niceness of the process; below 0 it needs a right, without which it stays as it is.
    #[arg(long, value_name = "N", hide = true, allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-20..20))]
    pub niceness: Option<i32>,
    /// Begin at this quality tier, at which a predecessor was drawing.
    #[arg(long, value_name = "N", hide = true, value_parser = settings::commands::numbers::whole::<u32>(0, crate::governor::TIERS.len() as u64 - 1))]
    pub start_tier: Option<u32>,
    /// Prepare everything, then wait for a line on standard input before taking part.
    #[arg(long, conflicts_with = "window", hide = true)]
    pub standby: bool,
    /// Draw at this quality tier (0 is the best) instead of letting the governor choose.
    #[arg(long, value_name = "N", value_parser = settings::commands::numbers::whole::<u32>(0, crate::governor::TIERS.len() as u64 - 1))]
    pub tier: Option<u32>,
    /// Arguments of every process.
    #[command(flatten)]
    pub shell: ShellArgs,
}

impl Config {
    /// How the two channels share the picture.
    pub fn arrangement(&self) -> Arrangement {
        self.picture.arrange.unwrap_or_default()
    }

    /// The window, if one is wanted.
    pub fn window_config(&self) -> Option<WindowConfig> {
        let window = WindowConfig {
            arrangement: self.arrangement(),
            full_screen: self.picture.full_screen,
            desk: self.desk,
            letters: self.desk || self.replay,
            monitor: self.picture.monitor.clone(),
        };
        self.window.then_some(window)
    }
}

fn pictures_hz(text: &str) -> Result<f64, String> {
    let hz: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    if (0.0..=MAX_PICTURES_HZ).contains(&hz) {
        Ok(hz)
    } else {
        Err(format!("expected 0 to {MAX_PICTURES_HZ}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

    #[test]
    fn arguments_are_consistent() {
        Config::command().debug_assert();
        let parse = |args: &[&str]| Config::try_parse_from([&["vitreo-renderer"], args].concat());
        assert!(parse(&["--headless", "--stills", "out", "--tier", "5"]).is_ok());
        assert!(parse(&["--headless", "--window"]).is_err());
        assert!(parse(&["--window", "--full-screen", "--monitor", "1", "--arrange", "sequential"]).is_ok());
        assert!(parse(&["--full-screen"]).is_err() && parse(&["--arrange", "cross-eyed"]).is_err());
        assert!(parse(&["--fundus", "a.jpg", "--fundus-eye", "right", "--fundus-fovea", "0.6,0.5"]).is_ok());
        for wrong in [&["--fundus-eye", "up"][..], &["--fundus-fovea", "2,0.5"], &["--fundus-field", "180"]] {
            assert!(parse(&[&["--fundus", "a.jpg"], wrong].concat()).is_err(), "{wrong:?}");
        }
        assert!(parse(&["--fundus-eye", "right"]).is_err(), "of no photograph");
        assert!(parse(&["--pictures-hz", "nan"]).is_err() && parse(&["--tier", "99"]).is_err());
    }
}
