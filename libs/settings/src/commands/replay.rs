//! The command line of `vitreo replay`.

use super::numbers::{not_negative, positive, share};
use super::processes::CollisionArgs;
use super::what_if::NOT_WITH_OUTPUT;
use super::{DrawingArgs, SpanArgs, WhatIfArgs, WritingArgs};
use outputs::{Force, video_file};
use std::path::PathBuf;

/// Arguments of `vitreo replay`.
#[derive(Debug, clap::Args)]
#[command(mut_arg("stills", |arg| arg.conflicts_with_all(["window", "interactive"])))]
#[command(mut_arg("force", |arg| arg.help_heading("Outputs")))]
#[command(mut_arg("compress", |arg| arg.requires("output").conflicts_with_all(NOT_WITH_OUTPUT).help_heading("What if")))]
#[command(mut_arg("split", |arg| arg.requires("output").conflicts_with_all(NOT_WITH_OUTPUT).help_heading("What if")))]
pub struct ReplayArgs {
    /// The recording, or a recording of pixels (vitreo cameras --record-fields FILE.mcap), in which blobs are found first.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    // Arguments without a heading come first, then the headings in the order of their first arguments.
    /// Run as fast as possible instead of at the recorded timing.
    #[arg(long)]
    pub lockstep: bool,
    /// Speed relative to the recording.
    #[arg(long, value_name = "R", default_value_t = 1.0, value_parser = positive, allow_negative_numbers = true, conflicts_with = "lockstep")]
    pub rate: f64,
    /// Repeat until Ctrl-C.
    #[arg(long = "loop", conflicts_with_all = ["verify", "poses", "blobs", "report", "video", "stills"])]
    pub endless: bool,
    /// Show the replay in a window; keys pause, step and seek (H lists them).
    #[arg(long, conflicts_with_all = ["verify", "poses", "blobs", "report", "assert_tracking", "assert_no_warnings"])]
    pub window: bool,
    /// Pause, step and seek by keys in the terminal, with or without a window (h lists them).
    #[arg(long, conflicts_with_all = ["verify", "poses", "blobs", "report", "assert_tracking", "assert_no_warnings", "video", "headless"])]
    pub interactive: bool,
    /// The part to be shown.
    #[command(flatten, next_help_heading = "Part of the recording")]
    pub span: SpanArgs,
    /// Track the recorded blobs and simulate the recorded poses again, and compare both with the recording.
    /// Exit code 5: they differ; 3: only partly verified (gaps, an unclosed file, missing frames, another
    /// version of tracker or state hash); 1: nothing to compare.
    #[arg(long, help_heading = "Checks")]
    pub verify: bool,
    /// Write the poses. For those of a what-if (--rig, --scene, --set), record it with --output and replay that recording.
    #[arg(long, value_name = "OUT.csv", help_heading = "Outputs")]
    pub poses: Option<PathBuf>,
    /// Add poses predicted for a display of this rate, Hz.
    #[arg(long, value_name = "HZ", requires = "poses", value_parser = positive, allow_negative_numbers = true, help_heading = "Outputs")]
    pub display_hz: Option<f64>,
    /// Time from a frame's newest pose to its display, ms.
    #[arg(long, value_name = "MS", default_value_t = 15.0, value_parser = not_negative, allow_negative_numbers = true, help_heading = "Outputs")]
    pub display_lead_ms: f64,
    /// Time from the newest camera-field to its pose in the written timestamps, µs.
    #[arg(long, value_name = "US", default_value_t = 1000, help_heading = "Outputs")]
    pub processing_us: u64,
    /// Write the replayed blob stream.
    #[arg(long, value_name = "OUT.jsonl", help_heading = "Outputs")]
    pub blobs: Option<PathBuf>,
    /// Draw off screen, as fast as possible; --video and --stills imply it.
    #[arg(long, conflicts_with = "window", help_heading = "Picture")]
    pub headless: bool,
    /// Save a film: .mp4 (H.264) or .y4m (uncompressed).
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = video_file, conflicts_with = "window", help_heading = "Picture")]
    pub video: Option<PathBuf>,
    /// Stills, and how all pictures are drawn.
    #[command(flatten)]
    pub drawing: DrawingArgs,
    /// Show the recorded poses instead of tracking the recorded blobs again.
    #[arg(long, conflicts_with = "verify", help_heading = "Tracking")]
    pub as_recorded: bool,
    /// Colour classes of the blobs in a recording of pixels [default: the shipped classes].
    #[arg(long, value_name = "FILE.toml", help_heading = "Tracking")]
    pub colours: Option<PathBuf>,
    /// Changes of a what-if.
    #[command(flatten)]
    pub what_if: WhatIfArgs,
    /// How the recording of a what-if is written.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// Replay with another build's vitreo or vitreo-replay as well and compare the results, like vitreo diff.
    /// Exit code 0: equal; 5: different.
    #[arg(long, value_name = "OTHER_VITREO", help_heading = "What if", conflicts_with_all = ["output", "verify",
        "poses", "blobs", "endless", "assert_tracking", "assert_no_warnings", "from", "until", "window", "interactive", "headless", "video",
        "stills", "as_recorded"])]
    pub with: Option<PathBuf>,
    /// Back end of collision detection.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// Exit with code 6 if a body was tracked in a smaller fraction of the frames, 0 to 1.
    #[arg(long, value_name = "FRACTION", value_parser = share, allow_negative_numbers = true, help_heading = "Checks")]
    pub assert_tracking: Option<f64>,
    /// Exit with code 7 if the report has warnings about cameras, rig or tracking, or too little was seen to judge them.
    #[arg(long, help_heading = "Checks")]
    pub assert_no_warnings: bool,
    /// Write statistics of the replay as JSON; with --with, the comparison.
    #[arg(long, value_name = "FILE.json", help_heading = "Outputs")]
    pub report: Option<PathBuf>,
    /// `--force`.
    #[command(flatten)]
    pub force: Force,
    /// Simulator name of the window's renderer [default: replay].
    #[arg(long, value_name = "NAME", hide_short_help = true, help_heading = "Picture")]
    pub instance: Option<String>,
}

impl ReplayArgs {
    /// True if a film or stills are drawn.
    pub fn draws(&self) -> bool {
        self.video.is_some() || self.drawing.stills.is_some()
    }

    /// True if a user watches and controls the replay.
    pub fn is_watched(&self) -> bool {
        self.window || self.interactive
    }

    /// True if the replay runs as fast as possible.
    pub fn is_unpaced(&self) -> bool {
        self.lockstep || self.headless || self.draws()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        replay: ReplayArgs,
    }

    #[test]
    fn pictures_are_drawn_at_full_speed_or_shown_at_their_pace() {
        let parse = |words: &[&str]| Line::try_parse_from(["replay", "a.mcap"].iter().chain(words));
        let unpaced = |words: &[&str]| parse(words).unwrap().replay.is_unpaced();
        assert!(!unpaced(&[]) && !unpaced(&["--window", "--rate", "2"]));
        assert!(unpaced(&["--stills", "s", "--every", "1"]) && unpaced(&["--video", "a.y4m", "--verify"]));
        assert!(parse(&["--video", "a.mp4"]).unwrap().replay.draws());
        for wrong in [
            &["--window", "--headless"][..],
            &["--window", "--video", "a.mp4"],
            &["--window", "--stills", "s"],
            &["--video", "a.avi"],
            &["--loop", "--video", "a.mp4"],
            &["--as-recorded", "--verify"],
            &["--every", "1"],
            &["--verify", "--set", "tracker.gate=20"],
            &["--report", "r.json", "--rig", "r.json"],
            &["--verify", "--scene", "peel"],
            &["--with", "v", "--split", "5m"],
            &["--verify", "--compress", "lz4"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
