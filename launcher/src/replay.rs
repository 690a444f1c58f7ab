//! `vitreo replay`: a recording runs through tracker and simulation again.
//!
//! A recorded run is replayed by its record (which camera-fields a frame consumed, which inputs a
//! step consumed), so that the result is the same to the bit at any speed. An imported stream has
//! no such record; there the tracker decides by the stream's own clock.

mod imported;
mod outputs;
mod pace;
mod processes;
mod recorded;
mod turns;
mod verify;

pub use verify::states_incomparable;

use crate::exit::{DIFFERS, LOSS, UNTRACKED};
use crate::results::DESK;
use crate::run::share;
use crate::runtime::{StopSignal, block_on};
use crate::span::{SpanArgs, not_negative};
use crate::tracking::untracked;
use ::outputs::{Force, println};
use anyhow::bail;
use ipc::logging::warn;
use outputs::{Figures, Outputs};
use pace::Pace;
use processes::{ReplayProcesses, Stopped, TrackerMode};
use protocol::control::Command;
use protocol::rig::Rig;
use recording::{Recording, RecordingError, Source};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use verify::Verdict;

/// Arguments of `vitreo replay`.
#[derive(Debug, clap::Args)]
pub struct ReplayArgs {
    /// The recording.
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// As fast as the processes take it, instead of with the recorded spacing.
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
    /// Who looks for collisions with the membrane: auto (the faster one, measured at start-up), cpu
    /// or gpu. It changes no result.
    #[arg(long, value_name = "WHO", value_parser = ["auto", "cpu", "gpu"])]
    pub collision: Option<String>,
    /// Exit with 6 where a body was tracked in a smaller share of frames, 0 to 1.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub assert_tracking: Option<f64>,
    /// Write figures as JSON.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
    /// Whether files that exist are written over.
    #[command(flatten)]
    pub force: Force,
    /// Name of the replay's instances, up to 16 characters.
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
}

fn positive(text: &str) -> Result<f64, String> {
    not_negative(text).ok().filter(|v| *v > 0.0).ok_or("expected a number above 0".into())
}

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read or replayed, a process fails, or a file cannot be written.
pub fn run(args: &ReplayArgs) -> anyhow::Result<ExitCode> {
    block_on(replay(args))
}

async fn replay(args: &ReplayArgs) -> anyhow::Result<ExitCode> {
    let recording = Recording::open(&args.file)?;
    let desk = recording.provenance().config.contains_key(DESK);
    if desk && (!args.verify || args.poses.is_some() || args.assert_tracking.is_some()) {
        let file = args.file.display();
        bail!(
            "{file}: made at a desk, without cameras: there are no blobs to replay; --verify alone compares its \
             states, vitreo score --resimulate simulates it again"
        );
    }
    let mode = match recording.provenance().source {
        Source::Live => TrackerMode::Recorded,
        Source::Import => TrackerMode::StreamClock,
    };
    if args.verify && mode == TrackerMode::StreamClock {
        bail!("{}: an imported stream holds no results to compare with", args.file.display());
    }
    args.span.check(&recording)?;
    let stop = StopSignal::install()?;
    let rig = Rig::parse(&recording.provenance().rig_json, "of the recording")?;
    let mut outputs = Outputs::open(args, &rig)?;
    outputs.figures.desk = desk;
    let mut verdict = args.verify.then(|| Verdict::new(recording.provenance(), desk));
    let mut shown = Shown { outputs: &mut outputs, verdict: verdict.as_mut() };
    let outcome = play(args, &recording, mode, &stop, &mut shown).await;
    let stopped = match outcome {
        Ok(damage) => {
            outputs.figures.cut = matches!(damage, Some(RecordingError::Truncated { .. }));
            outputs.figures.damage = damage.map(|d| d.to_string());
            false
        }
        Err(error) if error.is::<Stopped>() => true,
        Err(error) => return Err(error),
    };
    outputs.figures.unclosed = !recording.is_finished();
    outputs.figures.verify = verdict;
    let figures = outputs.finish()?;
    print(&figures);
    if stopped && args.lockstep {
        bail!(Stopped);
    }
    if let Some(verdict) = figures.verify.as_ref().filter(|v| v.is_empty()) {
        bail!("{}: nothing could be compared: {}", args.file.display(), verdict.reasons.join("; "));
    }
    let (body, tracked) = figures.least_tracked;
    if let Some(asserted) = args.assert_tracking.filter(|asserted| tracked < *asserted) {
        warn(&untracked(body, tracked, asserted));
        return Ok(ExitCode::from(UNTRACKED));
    }
    Ok(ExitCode::from(code(&figures)))
}

/// What a replay produces.
struct Shown<'a> {
    outputs: &'a mut Outputs,
    verdict: Option<&'a mut Verdict>,
}

/// Starts the processes, replays once or for ever, and ends them; returns how the recording ends.
async fn play(
    args: &ReplayArgs,
    recording: &Recording,
    mode: TrackerMode,
    stop: &StopSignal,
    shown: &mut Shown<'_>,
) -> anyhow::Result<Option<RecordingError>> {
    let default_name = format!("replay-{}", std::process::id());
    let name = args.instance.as_deref().unwrap_or(&default_name);
    let mut processes = ReplayProcesses::open(name, stop)?;
    let outcome = async {
        processes.start(recording.provenance(), mode, args.collision.as_deref()).await?;
        let mut pace = Pace::new(args, stop);
        loop {
            let begun = Instant::now();
            let outcome = match mode {
                TrackerMode::Recorded => recorded::run(recording, &mut processes, &mut pace, shown).await,
                TrackerMode::StreamClock => {
                    imported::run(recording, &mut processes, &mut pace, shown.outputs).await
                }
            };
            // Also where the user stopped it.
            shown.outputs.figures.wall_s += begun.elapsed().as_secs_f64();
            let damage = outcome?;
            if !args.endless {
                return Ok(damage);
            }
            processes.tracker.command(Command::Reset).await?;
            processes.world.command(Command::Reset).await?;
            pace.rewind();
        }
    };
    let outcome = outcome.await;
    processes.end().await;
    outcome
}

/// What was replayed, and how fast as far as that was measured.
fn summary(figures: &Figures) -> String {
    let Figures { camera_fields, frames, steps, stream_s, wall_s, .. } = figures;
    let counts = format!("{camera_fields} camera-fields, {frames} tracker frames, {steps} steps");
    match (*stream_s > 0.0, *wall_s > 0.0) {
        (true, true) => {
            let speed = stream_s / wall_s;
            format!("{counts}; {stream_s:.2} s in {wall_s:.2} s ({speed:.1} times real time)")
        }
        (true, false) => format!("{counts}; {stream_s:.2} s"),
        (false, _) => counts,
    }
}

fn print(figures: &Figures) {
    println!("{}", summary(figures));
    let fields_refused = figures.fields_refused;
    if fields_refused > 0 {
        println!(
            "{fields_refused} camera-fields refused by the tracker (twice, out of order, unknown camera)"
        );
    }
    if let Some(verdict) = &figures.verify {
        println!("{}", verdict.text());
        if !verdict.reasons.is_empty() {
            println!("not all is verified: {}", verdict.reasons.join("; "));
        }
    }
    if let (Some(lost), None) = (&figures.lost, &figures.verify) {
        println!("the recording has gaps; the first: {lost}");
    }
    if figures.unclosed && figures.damage.is_none() {
        warn("the recording was not closed in order: what it holds to its end was replayed");
    }
    for warning in &figures.warnings {
        let to = warning.to_s.map_or("the end".into(), |s| format!("{s:.0} s"));
        warn(&format!("from {:.0} s to {to}: {}", warning.from_s, warning.finding.text()));
    }
    if let Some(damage) = &figures.damage {
        warn(&damage.to_string());
    }
}

/// The exit code. A recording that was not closed is what a crash leaves, and no loss of the replay's;
/// but to verify it is to ask whether it is whole.
fn code(figures: &Figures) -> u8 {
    let Some(verdict) = &figures.verify else {
        let damaged = figures.damage.is_some() && !figures.cut;
        return if damaged || figures.lost.is_some() { LOSS } else { 0 };
    };
    match (&verdict.difference, verdict.reasons.is_empty()) {
        (Some(_), _) => DIFFERS,
        (None, true) => 0,
        (None, false) => LOSS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_codes_follow_the_contract() {
        let verified = |difference: Option<&str>, change: fn(&mut Figures)| {
            let mut verdict = Verdict { difference: difference.map(Into::into), ..Verdict::default() };
            (verdict.poses.recorded, verdict.poses.compared, verdict.states.recorded) = (1, 1, 1);
            let mut figures = Figures { verify: Some(verdict), camera_fields: 1, ..Figures::default() };
            change(&mut figures);
            let reasons = figures.reasons();
            figures.verify.as_mut().unwrap().reasons = reasons;
            figures
        };
        assert_eq!(code(&verified(None, |_| {})), 0);
        assert_eq!(code(&verified(Some("field 4"), |f| f.lost = Some("field 9".into()))), DIFFERS);
        let losses: [fn(&mut Figures); 9] = [
            |f| f.camera_fields = 0,
            |f| f.lost = Some("field 9".into()),
            |f| (f.damage, f.cut) = (Some("cut".into()), true),
            |f| f.damage = Some("damaged".into()),
            |f| f.unclosed = true,
            |f| f.tracking.frames_due = 1,
            |f| f.verify.as_mut().unwrap().states.other_version = Some(7),
            |f| f.verify.as_mut().unwrap().poses.other_version = Some(7),
            |f| f.verify.as_mut().unwrap().poses.recorded = 2,
        ];
        for loss in losses {
            let figures = verified(None, loss);
            let reasons = &figures.verify.as_ref().unwrap().reasons;
            assert_eq!((code(&figures), reasons.len()), (LOSS, 1), "{reasons:?}");
        }
        let replayed = |damage: &str, cut| Figures { damage: Some(damage.into()), cut, ..Figures::default() };
        assert_eq!((code(&replayed("cut", true)), code(&replayed("damaged", false))), (0, LOSS));
        assert_eq!(code(&Figures { unclosed: true, ..Figures::default() }), 0);
    }

    #[test]
    fn a_speed_is_told_where_it_was_measured() {
        let figures = |stream_s, wall_s| Figures { stream_s, wall_s, frames: 147, ..Figures::default() };
        assert!(summary(&figures(2.94, 1.47)).ends_with("2.94 s in 1.47 s (2.0 times real time)"));
        assert!(summary(&figures(2.94, 0.0)).ends_with("147 tracker frames, 0 steps; 2.94 s"));
        assert!(summary(&figures(0.0, 0.0)).ends_with("147 tracker frames, 0 steps"));
    }

    #[test]
    fn numbers_are_checked() {
        assert!(positive("0").is_err() && positive("nan").is_err() && positive("-1").is_err());
        assert_eq!((positive("2.5"), not_negative("0")), (Ok(2.5), Ok(0.0)));
    }
}
