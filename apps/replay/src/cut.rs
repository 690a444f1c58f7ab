//! `vitreo cut`: a part of a recording as a recording of its own, which verifies to the bit: it begins with
//! what tracker and simulation knew there.
//!
//! Behind the two checkpoints stand the step and the frame after which they were made, and what was under
//! way then; [`crate::engine::Recorded`] goes on from them.

use crate::frames::AHEAD_NS;
use crate::new_recording::{NewRecording, claim};
use crate::pace::Stopped;
use crate::resimulate::scene_of;
use crate::stop::StopSignal;
use crate::timeline::player::Player;
use crate::timeline::{Target, index, saving};
use anyhow::{Context, bail, ensure};
use ipc::logging::{inform, warn};
use outputs::exit::LOSS;
use outputs::progress::bytes_bar;
use outputs::{Outputs, println};
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::limits::FIELD_PERIOD_NS;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use recording::{CUT, Item, Note, Provenance, Recording, Source, files_of};
use rig::Rig;
use settings::commands::CutArgs;
use simcore::world::World;
use std::process::ExitCode;

/// What of a recording is kept.
struct Part {
    /// First and last exposure, ns.
    exposed: [Nanos; 2],
    /// Number of the step and of the frame after which the part begins; 0 for those of the beginning.
    begins_after: Option<[u64; 2]>,
    /// First and last log time, ns.
    logged: [Nanos; 2],
    /// How much later than the last frame a camera that is not in step may have exposed what it consumed, ns: a
    /// field's period.
    out_of_step_ns: Nanos,
}

impl Part {
    /// Whether an item belongs to it.
    fn holds(&self, at: Nanos, item: &Item) -> bool {
        let [first, last] = self.exposed;
        let after = |number: u64, which: usize| self.begins_after.is_none_or(|from| number >= from[which]);
        let logged = (self.logged[0]..=self.logged[1]).contains(&at);
        match item {
            Item::Poses(frame) => frame.instants.exposed <= last && after(frame.frame, 1) && logged,
            Item::Step(step) => step.instants.exposed <= last && after(step.step, 0) && logged,
            Item::Matches(matches) => after(matches.frame, 1) && matches.exposed_ns <= last && logged,
            Item::Event(event) => (first..=last).contains(&event.exposed_ns),
            Item::Blobs(field) => field.exposed_ns <= last + self.out_of_step_ns && logged,
            Item::Frame(frame) => (first..=last).contains(&frame.instants.exposed),
            Item::Picture(..) | Item::Note(_) => (self.logged[0] + AHEAD_NS..=self.logged[1]).contains(&at),
            // Later ones would stand before what they were made of.
            Item::Checkpoint(header, _) => after(header.step, 0) && logged,
            Item::TrackerCheckpoint(header, _) => {
                after(header.frame, 1) && header.exposed_ns <= last && logged
            }
            Item::Handle(_) | Item::Pedal(_) => logged,
        }
    }
}

/// Runs it.
///
/// # Errors
/// Where the recording cannot be read or replayed, does not have the part, or the file cannot be written.
pub fn run(args: &CutArgs) -> anyhow::Result<ExitCode> {
    let stop = StopSignal::install().context("signals")?;
    let mut outputs = Outputs::new(args.force.force).reading_all(files_of(&args.file));
    claim(&args.output, &args.writing, &mut outputs)?;
    let recording = Recording::open(&args.file)?;
    args.span.check(&args.file, || recording.exposed_s())?;
    let output = NewRecording::begin(&args.output, &args.writing, &mut outputs)?;
    let Copied { items, lost } = match recording.provenance().source {
        Source::Live => of_run(args, &recording, &output, &stop)?,
        Source::Import => of_stream(args, &recording, &output, &stop)?,
    };
    ensure!(items > 0, "{}: contains nothing in that part", args.file.display());
    let files = output.appear()?;
    inform(&format!("{items} messages written"));
    files.iter().for_each(|file| println!("{}", file.display()));
    let Some(lost) = lost else { return Ok(ExitCode::SUCCESS) };
    warn(&lost);
    Ok(ExitCode::from(LOSS))
}

/// The instants of the part, ns.
fn exposed(args: &CutArgs, recording: &Recording) -> [Nanos; 2] {
    let start = recording.exposures().next().unwrap_or(0);
    let at = |s: f64| start.saturating_add((s * 1e9) as Nanos);
    [at(args.span.from), args.span.until.map_or(Nanos::MAX / 2, at)]
}

/// A part of a run: with what tracker and simulation knew before it.
fn of_run(
    args: &CutArgs,
    recording: &Recording,
    output: &NewRecording,
    stop: &StopSignal,
) -> anyhow::Result<Copied> {
    let exposed = exposed(args, recording);
    let mut provenance = recording.provenance().clone();
    let rig = Rig::parse(&provenance.rig_json, "of the recording").ok();
    let out_of_step_ns = rig.map_or(FIELD_PERIOD_NS, |rig| rig.field_period_ns());
    let mut part = Part { exposed, begins_after: None, logged: [0, Nanos::MAX], out_of_step_ns };
    let mut known = Vec::new();
    if args.span.from > 0.0 {
        let world = World::new(&scene_of(recording)?).context("scene")?.unseen();
        let mut player = Player::new(index::open(recording, stop)?, world)?;
        let arrival = player.seek(Target::Exposed(exposed[0]))?;
        let Some(at) = arrival.at else { bail!("{}: contains no step there", args.file.display()) };
        if let Some(lost) = arrival.lost.filter(|_| arrival.left_out > 0) {
            bail!("{}: the recording does not determine that part: {lost}", args.file.display());
        }
        let last = player.last().context("a step")?;
        let stepped = last.record.instants.stepped;
        let run = player.run();
        known.push(saving::of_world(player.world())?);
        let mut frame = last.record.frame;
        if let (Some((tracker, _)), Some(made)) = (&run.tracker, run.made.back()) {
            let TrackerFrame { frame: number, field, .. } = **made;
            let header =
                TrackerCheckpointHeader { frame: number, field, exposed_ns: made.instants.exposed, bytes: 0 };
            known.push(saving::of_tracker(header, tracker)?);
            frame = frame.min(number);
        }
        part.begins_after = Some([at.step, frame]);
        part.logged[0] = stepped.saturating_sub(2 * AHEAD_NS);
        provenance.config.insert(CUT.into(), format!("after step {} of {}", at.step, args.file.display()));
    }
    if args.span.until.is_some() {
        part.logged[1] = exposed[1].saturating_add(2 * AHEAD_NS);
    }
    copy(recording, &provenance, output, known, stop, |at, item| part.holds(at, item))
}

/// A part of a stream, which holds nothing but blobs.
fn of_stream(
    args: &CutArgs,
    recording: &Recording,
    output: &NewRecording,
    stop: &StopSignal,
) -> anyhow::Result<Copied> {
    let [first, last] = exposed(args, recording);
    copy(recording, recording.provenance(), output, Vec::new(), stop, |_, item| match item {
        Item::Blobs(field) => (first..=last).contains(&field.exposed_ns),
        _ => true,
    })
}

/// What went into the new recording.
struct Copied {
    items: u64,
    /// What of the old one could not be read, first.
    lost: Option<String>,
}

/// Writes `known` and then the items that are wanted. What could not be read is noted among them.
fn copy(
    recording: &Recording,
    provenance: &Provenance,
    output: &NewRecording,
    known: Vec<Item>,
    stop: &StopSignal,
    wanted: impl Fn(Nanos, &Item) -> bool,
) -> anyhow::Result<Copied> {
    let bar = bytes_bar(recording.bytes(), "cut");
    let mut writer = output.writer(provenance)?;
    let (mut items, mut copied) = (recording.items(), Copied { items: 0, lost: None });
    let (mut known, mut newest) = (known.into_iter(), 0);
    while let Some(item) = items.next() {
        if stop.is_raised() {
            bail!(Stopped);
        }
        let (at, item) = item.unwrap_or_else(|problem| {
            let text = problem.to_string();
            copied.lost.get_or_insert_with(|| text.clone());
            (newest, Item::Note(Note::loss(newest, 1, text)))
        });
        newest = at;
        if wanted(at, &item) {
            known.by_ref().try_for_each(|known| writer.write(at, &known))?;
            writer.write(at, &item)?;
            copied.items += 1;
        }
        bar.set_position(items.bytes_read());
    }
    bar.finish_and_clear();
    writer.finish()?;
    Ok(copied)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{Made, Recorded};
    use settings::commands::WritingArgs;
    use std::ops::ControlFlow;
    use std::path::{Path, PathBuf};

    fn golden() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap")
    }

    /// State hashes by step, and poses by frame, of a recording that is run again; and what is missing.
    type Again = (Vec<(u64, u64)>, Vec<(u64, TrackerFrame)>, Option<String>);

    fn again(file: &Path) -> Again {
        let recording = Recording::open(file).unwrap();
        let rig = Rig::parse(&recording.provenance().rig_json, "test").unwrap();
        let world = World::new(&scene_of(&recording).unwrap()).unwrap().unseen();
        let mut run = Recorded::new(&recording, &rig, world);
        let (mut states, mut poses) = (Vec::new(), Vec::new());
        run.run(|made| {
            match made {
                Made::Frame(turn, frame, _) => {
                    assert!(turn.determined && turn.lost.is_none(), "{:?}", turn.lost);
                    assert_eq!(bytemuck::bytes_of(&turn.recorded.bodies), bytemuck::bytes_of(&frame.bodies));
                    poses.push((frame.frame, *frame));
                }
                Made::Step(again) => {
                    assert_eq!(again.recorded.state_hash, again.step.state_hash);
                    states.push((again.step.step, again.step.state_hash));
                }
            }
            Ok(ControlFlow::Continue(()))
        })
        .unwrap();
        assert_eq!(
            (run.steps.done.undone, run.steps.done.missing, run.frames.due.frames_missing()),
            (0, 0, 0)
        );
        (states, poses, run.steps.lost.or(run.frames.lost))
    }

    fn cut(folder: &Path, from: f64, until: Option<f64>) -> PathBuf {
        let (file, output) = (folder.join("a.mcap"), folder.join(format!("cut-{from}.mcap")));
        std::fs::copy(golden(), &file).unwrap();
        let span = settings::commands::SpanArgs { from, until };
        let force = outputs::Force { force: true };
        let writing = WritingArgs::default();
        let args = CutArgs { file, span, output: output.clone(), writing, force };
        let recording = Recording::open(&args.file).unwrap();
        let mut outputs = Outputs::new(true);
        let file = NewRecording::begin(&output, &args.writing, &mut outputs).unwrap();
        let copied = of_run(&args, &recording, &file, &StopSignal::default()).unwrap();
        assert!(copied.lost.is_none() && copied.items > 0);
        file.appear().unwrap();
        output
    }

    #[test]
    fn a_part_is_that_of_the_whole_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let (states, poses, _) = again(&golden());
        let start = poses[0].1.instants.exposed;
        for (from, until) in [(0.0, Some(0.6)), (0.5, None), (0.7, Some(1.4)), (1.0, Some(1.2))] {
            let (own_states, own_poses, lost) = again(&cut(folder.path(), from, until));
            assert_eq!(lost, None, "{from} to {until:?}");
            let first = states.iter().position(|state| *state == own_states[0]).unwrap();
            assert_eq!(own_states[..], states[first..][..own_states.len()], "{from} to {until:?}");
            let of = |number: u64| poses.iter().find(|(frame, _)| *frame == number).unwrap();
            for (number, frame) in &own_poses {
                assert_eq!(bytemuck::bytes_of(&frame.bodies), bytemuck::bytes_of(&of(*number).1.bodies));
            }
            let at_s = |frame: &TrackerFrame| (frame.instants.exposed - start) as f64 * 1e-9;
            let [begin, end] = [own_poses.first(), own_poses.last()].map(|pose| at_s(&pose.unwrap().1));
            // Poses are made ahead of the steps.
            assert!(from - 0.02 <= begin && begin < from + 0.5, "{begin} for {from}");
            assert!(until.is_none_or(|until| (until - end).abs() < 0.021), "{end} for {until:?}");
            assert!(own_states.len() > 8 && own_poses.len() > 8, "{} {}", own_states.len(), own_poses.len());
        }
    }
}
