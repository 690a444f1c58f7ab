//! The command line of `vitreo replay`.

use super::numbers::{not_negative, positive, share};
use super::processes::CollisionArgs;
use super::{DrawingArgs, SpanArgs, WhatIfArgs, WritingArgs};
use outputs::{Force, video_file};
use std::path::PathBuf;

/// Arguments of `vitreo replay`.
#[derive(Debug, clap::Args)]
#[command(mut_arg("stills", |arg| arg.conflicts_with_all(["window", "interactive"])))]
#[command(mut_arg("compress", |arg| arg.requires("output").help_heading("What if")))]
#[command(mut_arg("split", |arg| arg.requires("output").help_heading("What if")))]
pub struct ReplayArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// As fast as it can be computed, instead of with the recorded spacing.
    #[arg(long)]
    pub lockstep: bool,
    /// Compare what this tracker makes of the recorded blobs with the recorded poses, and what this
    /// simulation makes of the recorded poses with the recorded states; exit 5 where they differ, 3 where not
    /// all was verified: the recording has gaps, was not closed, lacks frames, or is of another version of
    /// tracker or state hash; 1 where nothing could be compared.
    #[arg(long)]
    pub verify: bool,
    /// Speed: 2 is twice as fast as recorded.
    #[arg(long, value_name = "R", default_value_t = 1.0, value_parser = positive, conflicts_with = "lockstep")]
    pub rate: f64,
    /// The part to be shown.
    #[command(flatten)]
    pub span: SpanArgs,
    /// Begin again at the end, until Ctrl-C.
    #[arg(long = "loop", conflicts_with_all = ["verify", "poses", "blobs", "report", "video", "stills"])]
    pub endless: bool,
    /// Write the poses.
    #[arg(long, value_name = "OUT.csv")]
    pub poses: Option<PathBuf>,
    /// Add predicted poses for a display of this rate, Hz.
    #[arg(long, value_name = "HZ", requires = "poses", value_parser = positive)]
    pub display_hz: Option<f64>,
    /// How long before its display a picture takes the newest pose, ms.
    #[arg(long, value_name = "MS", default_value_t = 15.0, value_parser = not_negative)]
    pub display_lead_ms: f64,
    /// Time from the newest camera-field to the pose, in the instants written with poses, µs.
    #[arg(long, value_name = "US", default_value_t = 1000)]
    pub processing_us: u64,
    /// Write the blob stream that was replayed.
    #[arg(long, value_name = "OUT.jsonl")]
    pub blobs: Option<PathBuf>,
    /// Draw off-screen, as fast as it can be computed (what --video and --stills do without --window).
    #[arg(long, conflicts_with = "window")]
    pub headless: bool,
    /// Show the replay in a window, at its pace; keys stop, step and move it (H shows them).
    #[arg(long, conflicts_with_all = ["verify", "poses", "blobs", "report", "assert_tracking", "assert_no_warnings"])]
    pub window: bool,
    /// Stop, step and move the replay by keys in the terminal, with or without the window (h shows them).
    #[arg(long, conflicts_with_all = ["verify", "poses", "blobs", "report", "assert_tracking", "assert_no_warnings", "video", "headless"])]
    pub interactive: bool,
    /// Write a film, by its ending MP4 (H.264), or Y4M without compression.
    #[arg(long, value_name = "FILE.mp4|FILE.y4m", value_parser = video_file, conflicts_with = "window")]
    pub video: Option<PathBuf>,
    /// Stills, and how all pictures are drawn.
    #[command(flatten)]
    pub drawing: DrawingArgs,
    /// Show the recorded poses instead of what this tracker makes of the recorded blobs.
    #[arg(long, conflicts_with = "verify")]
    pub as_recorded: bool,
    /// What is changed.
    #[command(flatten)]
    pub what_if: WhatIfArgs,
    /// How the recording of a what-if is written.
    #[command(flatten)]
    pub writing: WritingArgs,
    /// Run the recording through another build as well, by its program vitreo or vitreo-replay, and compare what
    /// comes of it with what this build makes, as diff does: exit code 0 where that is the same, 5 where it
    /// differs.
    #[arg(long, value_name = "OTHER_VITREO", help_heading = "What if", conflicts_with_all = ["output", "verify",
        "poses", "blobs", "endless", "assert_tracking", "assert_no_warnings", "from", "until", "window", "interactive", "headless", "video",
        "stills", "as_recorded"])]
    pub with: Option<PathBuf>,
    /// Who looks for collisions.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// Exit with 6 where a body was tracked in a smaller share of frames, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub assert_tracking: Option<f64>,
    /// Exit with 7 if the report has a warning about cameras, rig or tracking.
    #[arg(long)]
    pub assert_no_warnings: bool,
    /// Write figures as JSON; with --with what the comparison found.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
    /// Name of the simulator that the window's renderer belongs to [default: replay].
    #[arg(long, value_name = "NAME", hide_short_help = true)]
    pub instance: Option<String>,
}

impl ReplayArgs {
    /// Whether a film or stills are drawn.
    pub fn draws(&self) -> bool {
        self.video.is_some() || self.drawing.stills.is_some()
    }

    /// Whether somebody watches it, who can stop and move it.
    pub fn is_watched(&self) -> bool {
        self.window || self.interactive
    }

    /// As fast as it can be computed: nobody watches it.
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
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
