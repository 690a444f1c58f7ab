//! The command line of `vitreo replay`.

use super::numbers::{not_negative, positive, share};
use super::processes::CollisionArgs;
use super::{SpanArgs, WhatIfArgs};
use outputs::Force;
use std::path::PathBuf;

/// Arguments of `vitreo replay`.
#[derive(Debug, clap::Args)]
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
    #[arg(long = "loop", conflicts_with_all = ["verify", "poses", "blobs", "report"])]
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
    /// What is changed.
    #[command(flatten)]
    pub what_if: WhatIfArgs,
    /// Who looks for collisions.
    #[command(flatten)]
    pub collision: CollisionArgs,
    /// Exit with 6 where a body was tracked in a smaller share of frames, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub assert_tracking: Option<f64>,
    /// Write figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
    /// Does nothing any more: a replay needs no processes of its own.
    #[arg(long, value_name = "NAME", hide = true)]
    pub instance: Option<String>,
}
