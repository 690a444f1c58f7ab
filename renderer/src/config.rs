//! Arguments of the program.

use crate::photograph::FundusArgs;
use crate::present::window::WindowConfig;
use crate::stereo::Arrangement;
use ipc::shell::ShellArgs;
use std::path::PathBuf;

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

/// Draws the surgeon's stereo view.
#[derive(Debug, Clone, clap::Parser)]
#[command(name = "vitreo-renderer")]
pub struct Config {
    /// What every process takes.
    #[command(flatten)]
    pub shell: ShellArgs,
    /// Rig file (default: the shipped rig); gives the length of the instruments.
    #[arg(long, value_name = "RIG.json")]
    pub rig: Option<PathBuf>,
    /// Scene by name or file; gives eye, membrane size and shafts.
    #[arg(long, value_name = "NAME|FILE", default_value = scene::DEFAULT_SCENE)]
    pub scene: String,
    /// The fundus photograph.
    #[command(flatten)]
    pub fundus: FundusArgs,
    /// Folder with the instruments' meshes (forceps.glb, light-pipe.glb, pick.glb, vitrector.glb,
    /// needle.glb) to draw instead of the shipped ones.
    #[arg(long, value_name = "DIR")]
    pub instruments: Option<PathBuf>,
    /// Draw without a window (the default).
    #[arg(long, conflicts_with = "window")]
    pub headless: bool,
    /// Show the picture in a window.
    #[arg(long)]
    pub window: bool,
    /// How the two channels share the picture, in the window and in files.
    #[arg(long, value_enum, value_name = "HOW", default_value_t)]
    pub arrange: Arrangement,
    /// Fill the monitor (F11 or F switches, Escape leaves).
    #[arg(long, requires = "window")]
    pub full_screen: bool,
    /// The monitor to fill, by name or number.
    #[arg(long, requires = "full_screen", value_name = "NAME|N")]
    pub monitor: Option<String>,
    /// A person works by mouse and keyboard: texts name keys; a click into the window takes the
    /// mouse, Escape frees it.
    #[arg(long)]
    pub desk: bool,
    /// Draw the dose of light over the retina (L in the window shows and hides it).
    #[arg(long)]
    pub show_dose: bool,
    /// Save a still every second, and the last picture as last.png, in this folder.
    #[arg(long, value_name = "DIR")]
    pub stills: Option<PathBuf>,
    /// Save a video at 25 pictures a second, by its ending MP4 (H.264) or Y4M.
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = outputs::video_file)]
    pub video: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: outputs::Force,
    /// Small pictures a second for console and recorder, 0 to 15.
    #[arg(long, value_name = "HZ", default_value_t = 2.0, value_parser = pictures_hz)]
    pub pictures_hz: f64,
    /// Destroy the graphics device after this many frames, to test that the other processes go on.
    #[arg(long, value_name = "FRAMES", hide = true)]
    pub lose_device_after: Option<u64>,
    /// Niceness of the process; below 0 it needs a right, without which it stays as it is.
    #[arg(long, value_name = "N", hide = true, allow_negative_numbers = true, value_parser = clap::value_parser!(i32).range(-20..20))]
    pub niceness: Option<i32>,
    /// Begin at this quality tier, at which a predecessor was drawing.
    #[arg(long, value_name = "N", hide = true, value_parser = clap::value_parser!(u32).range(0..crate::governor::TIERS.len() as i64))]
    pub start_tier: Option<u32>,
    /// Prepare everything, then wait for a line on standard input before taking part.
    #[arg(long, conflicts_with = "window", hide = true)]
    pub standby: bool,
    /// Draw at this quality tier (0 is the best) instead of letting the governor choose.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..crate::governor::TIERS.len() as i64))]
    pub tier: Option<u32>,
}

impl Config {
    /// The window, if one is wanted.
    pub fn window_config(&self) -> Option<WindowConfig> {
        let window = WindowConfig {
            arrangement: self.arrange,
            full_screen: self.full_screen,
            desk: self.desk,
            monitor: self.monitor.clone(),
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
