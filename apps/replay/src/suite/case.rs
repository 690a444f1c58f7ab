//! A case of a suite is run, and compared with what is expected of it.

use super::file::Case;
use super::truth::Tips;
use crate::engine::{Made, Recorded, Streamed, stream};
use crate::film::scripted::FIELDS_PER_S;
use crate::perception::perform;
use crate::resimulate::scene_of;
use crate::verify::Verdict;
use anyhow::{Context, bail, ensure};
use blob_stream::BlobReader;
use bytemuck::Zeroable;
use diagnosis::Tracking;
use protocol::budget::{Stage, frame_latencies, pose_latencies, step_latencies};
use protocol::events::{Event, EventKind};
use protocol::poses::BODY_NAMES;
use protocol::steps::StepRecord;
use recording::{DESK, Item, Recording, Source};
use results::scored::score_file;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use simcore::world::World;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use surgeon::rehearsal::Rehearsal;
use tracker::stream::track_stream;
use training::score::Score;
use training::score::recording::{Reader, is_over};
use training::score::table::Category;

/// Percentile at which latencies are compared.
const PERCENTILE: f64 = 0.99;

/// What was compared in a case, and what is not as expected.
#[derive(Debug, Default)]
pub struct Checked {
    /// Expectations that were compared.
    pub compared: u64,
    /// Those that do not hold, in words.
    pub failures: Vec<String>,
    /// Poses and states that were compared to the bit.
    pub verified: u64,
}

impl Checked {
    fn expect(&mut self, holds: bool, failure: impl FnOnce() -> String) {
        self.compared += 1;
        if !holds {
            self.failures.push(failure());
        }
    }

    fn counts(&mut self, case: &Case, events: &[Event]) {
        for (name, range) in &case.events {
            let kind = EventKind::from_name(name);
            let count =
                events.iter().filter(|e| kind.is_some_and(|kind| e.kind == kind as u32)).count() as u64;
            self.expect(range.holds(count), || {
                format!("{name}: expected {}, found {count}", between(range.limits()))
            });
        }
    }

    fn score(&mut self, case: &Case, score: &Score) {
        for (name, range) in &case.score {
            let category = Category::ALL.into_iter().find(|c| c.key() == name);
            let points = category.map_or(score.total, |c| score.categories[c as usize]);
            self.expect(range.holds(points), || {
                format!("score, {name}: expected {}, found {points:.2}", between(range.limits()))
            });
        }
    }

    fn tracked(&mut self, case: &Case, tracking: &Tracking) {
        let Some(least) = case.tracked else { return };
        let (body, share) = tracking.least_share();
        self.expect(share >= least, || {
            format!("tracked: expected each body in {least} of the frames, found {body} in {share:.4}")
        });
    }
}

/// A range in words.
fn between<T: PartialEq + std::fmt::Display>([least, most]: [T; 2]) -> String {
    if least == most { format!("{least}") } else { format!("{least} to {most}") }
}

/// Runs a case whose files lie in `folder`.
///
/// # Errors
/// Where it cannot be run.
pub fn check(case: &Case, folder: &Path) -> anyhow::Result<Checked> {
    match (&case.recording, &case.stream, &case.module) {
        (Some(file), ..) => of_recording(case, &folder.join(file)),
        (_, Some(blobs), _) => of_stream(case, folder, &folder.join(blobs)),
        (.., Some(module)) => of_module(case, module),
        _ => bail!("nothing to run"),
    }
}

fn of_recording(case: &Case, file: &Path) -> anyhow::Result<Checked> {
    let recording = Recording::open(file)?;
    let rig = Rig::parse(&recording.provenance().rig_json, "of the recording")?;
    tracker::rig_check::check(&rig).context("the recording's rig is not usable")?;
    let mut checked = Checked::default();
    let (tracking, events) = match recording.provenance().source {
        Source::Live => again(case, &recording, &rig, &mut checked)?,
        Source::Import => imported(&recording, &rig)?,
    };
    checked.tracked(case, &tracking);
    checked.counts(case, &events);
    if !case.score.is_empty() {
        checked.score(case, &score_file(file)?.score);
    }
    latencies(case, &recording, &mut checked)?;
    Ok(checked)
}

/// Runs a recorded run again; how bodies were tracked, and the events of the states.
fn again(
    case: &Case,
    recording: &Recording,
    rig: &Rig,
    checked: &mut Checked,
) -> anyhow::Result<(Tracking, Vec<Event>)> {
    let desk = recording.provenance().config.contains_key(DESK);
    let mut verdict = Verdict::new(recording.provenance(), desk);
    let (mut tracking, mut events, mut lost) = (Tracking::new(rig), Vec::new(), None);
    let world = World::new(&scene_of(recording)?).context("scene")?.unseen();
    let mut run = Recorded::new(recording, rig, world);
    run.run(|made| {
        match made {
            Made::Frame(turn, frame, _) => {
                turn.fields.iter().for_each(|field| tracking.note_field(field));
                let _ = tracking.note_frame(frame);
                lost = lost.take().or_else(|| turn.lost.clone());
                if turn.determined {
                    verdict.pose(&turn.recorded, frame);
                } else {
                    verdict.pass_over_pose();
                }
            }
            Made::Step(again) => {
                verdict.pass_over_steps(again.left_out);
                verdict.step(&again.recorded, &again.step);
                events.extend_from_slice(again.world.events());
            }
        }
        Ok(ControlFlow::Continue(()))
    })?;
    if let Some(damage) = &run.damage {
        bail!("{damage}");
    }
    if case.verify != Some(false) {
        verdict.states.missing += run.steps.done.missing;
        verdict.pass_over_steps(run.steps.left_out());
        let mut reasons = verdict.left_out();
        let without_frame = if desk { 0 } else { run.frames.due.frames_missing() };
        reasons.extend((without_frame > 0).then(|| format!("{without_frame} fields have no tracker frame")));
        reasons.extend(lost.or(run.steps.lost).or(run.frames.lost));
        reasons.extend((!recording.is_finished()).then(|| "the recording was not closed properly".into()));
        checked.verified = verdict.poses.compared + verdict.states.compared;
        checked.expect(verdict.difference.is_none() && reasons.is_empty() && checked.verified > 0, || {
            [vec![verdict.text()], reasons].concat().join("; ")
        });
    }
    Ok((tracking, events))
}

/// Runs an imported stream.
fn imported(recording: &Recording, rig: &Rig) -> anyhow::Result<(Tracking, Vec<Event>)> {
    let (mut tracking, mut events) = (Tracking::new(rig), Vec::new());
    let world = World::new(&scene_of(recording)?).context("scene")?.unseen();
    let damage = stream(recording, rig, world, |made| {
        match made {
            Streamed::Field(field, _) => tracking.note_field(field),
            Streamed::Frame { frame, world, .. } => {
                let _ = tracking.note_frame(frame);
                events.extend_from_slice(world.events());
            }
        }
        Ok(ControlFlow::Continue(()))
    })?;
    damage.map_or(Ok((tracking, events)), |damage| bail!("{damage}"))
}

/// Compares the latencies that a recorded run had.
fn latencies(case: &Case, recording: &Recording, checked: &mut Checked) -> anyhow::Result<()> {
    if case.latency_ms.is_empty() {
        return Ok(());
    }
    let mut found = BTreeMap::<Stage, Vec<u64>>::new();
    for item in recording.items_of(&["poses", "steps", "frames"]) {
        let spans = match item?.1 {
            Item::Poses(frame) => pose_latencies(&frame),
            Item::Step(step) => step_latencies(&step),
            Item::Frame(frame) => frame_latencies(&frame),
            _ => continue,
        };
        for (stage, ns) in spans {
            found.entry(stage).or_default().extend(ns);
        }
    }
    for (stage, most) in &case.latency_ms {
        let all = found.entry(*stage).or_default();
        all.sort_unstable();
        let at = (all.len() as f64 * PERCENTILE) as usize;
        let ms = all.get(at.min(all.len().saturating_sub(1))).map(|ns| *ns as f64 * 1e-6);
        checked.expect(ms.is_some_and(|ms| ms <= *most), || match ms {
            Some(ms) => format!("latency, {}: expected p99 up to {most} ms, found {ms:.3}", stage.name()),
            None => format!("latency, {}: the recording has no measurement of it", stage.name()),
        });
    }
    Ok(())
}

fn of_stream(case: &Case, folder: &Path, blobs: &Path) -> anyhow::Result<Checked> {
    let file = |path: &Option<std::path::PathBuf>| path.as_ref().map(|path| folder.join(path));
    let rig = Rig::load(&file(&case.rig).context("rig")?)?;
    tracker::rig_check::check(&rig).context("the rig is not usable")?;
    let fields = BlobReader::open(blobs)?.collect::<Result<Vec<_>, _>>()?;
    ensure!(!fields.is_empty(), "{}: contains no field", blobs.display());
    let mut tips = file(&case.truth).map(|path| Tips::load(&path)).transpose()?;
    let (mut tracking, mut events) = (Tracking::new(&rig), Vec::new());
    let mut world = World::new(&SceneFile::load(DEFAULT_SCENE)?).context("scene")?.unseen();
    fields.iter().for_each(|field| tracking.note_field(field));
    track_stream(&rig, &fields, |frame, _| {
        let _ = tracking.note_frame(frame);
        tips.iter_mut().for_each(|tips| tips.note(frame));
        let input = protocol::steps::StepInput { frame, handles: &[], pedals: &[] };
        world.step(&input, &mut simcore::world::no_clock);
        events.extend_from_slice(world.events());
    });
    let mut checked = Checked::default();
    checked.tracked(case, &tracking);
    checked.counts(case, &events);
    for (name, most) in &case.tips_um {
        let body = BODY_NAMES.iter().position(|body| body == name).unwrap_or_default();
        let rms = tips.as_ref().and_then(|tips| tips.rms_um(body));
        checked.expect(rms.is_some_and(|rms| rms <= *most), || match rms {
            Some(rms) => format!("{name}: expected a tip within {most} µm RMS, found {rms:.2}"),
            None => format!("{name}: the truth contains no instant at which it was measured"),
        });
    }
    Ok(checked)
}

/// A scripted surgeon does a module, without cameras.
fn of_module(case: &Case, name: &str) -> anyhow::Result<Checked> {
    let module = surgeon::load(name)?;
    let skill = surgeon::skill::named(case.surgeon.as_deref().unwrap_or("expert"))?;
    let seed = case.seed.unwrap_or(1);
    let scene = surgeon::compose(&module, case.level.unwrap_or(1), &skill, seed)?;
    let mut reader = Reader::new(&scene).context("the module has no task")?;
    let mut rehearsal = Rehearsal::shipped(&scene).with_tremor(seed);
    let mut world = World::new(&scene).context("scene")?.unseen();
    let (last, mut events) = ((surgeon::longest_s(&scene) * FIELDS_PER_S) as u64, Vec::new());
    for field in 0..last {
        let (poses, report) = perform(&mut rehearsal, &mut world, field);
        let step = StepRecord {
            step: world.state().step,
            field: poses.field,
            frame: poses.frame,
            state_hash: report.state_hash,
            ..StepRecord::zeroed()
        };
        reader.take_poses(poses);
        world.events().iter().for_each(|event| reader.take_event(*event));
        reader.take_step(&step);
        events.extend_from_slice(world.events());
        if world.task().is_some_and(|(_, state)| is_over(state)) {
            break;
        }
    }
    let mut checked = Checked::default();
    let verdict = reader.finish();
    checked.expect(verdict.unmatched == 0, || format!("{} steps have no poses", verdict.unmatched));
    checked.counts(case, &events);
    checked.score(case, &verdict.score);
    Ok(checked)
}
