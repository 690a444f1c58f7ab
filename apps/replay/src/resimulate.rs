//! A recording is resimulated, in one go and without the other processes: every step from the
//! recorded poses, handles and pedal, for a film or a score. Pure; the same bits as in the live run.
//!
//! Over a gap it goes on from the next checkpoint, as `vitreo replay --verify` does.

use crate::steps::{Resimulated, StepAgain, Steps};
use anyhow::Context;
use ipc::logging::message;
use outputs::exit::{DIFFERS, LOSS};
use recording::{Recording, states_incomparable};
use scene::SceneFile;
use simcore::world::World;
use std::ops::ControlFlow;
use std::path::Path;

/// What a step consumes, its record, and the checkpoints from which it can continue after a gap.
const TOPICS: [&str; 5] = ["poses", "handles", "pedal", "steps", "checkpoints"];

/// The scene of a recording.
///
/// # Errors
/// Where it is refused.
pub fn scene_of(recording: &Recording) -> anyhow::Result<SceneFile> {
    let file = recording.path().display().to_string();
    SceneFile::parse(&recording.provenance().scene_toml, &file).context("its scene")
}

/// Does every step of a recording again in `world`, which stands at the start of the recording's
/// scene, and gives each to `each`, until that has enough.
///
/// # Errors
/// Those of `each`.
pub fn steps(
    recording: &Recording,
    world: World,
    mut each: impl FnMut(StepAgain<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Resimulated> {
    let mut steps = Steps::of(recording, world);
    let mut items = recording.items_of(&TOPICS);
    loop {
        while let Some(again) = steps.next_step() {
            if each(again)?.is_break() {
                return Ok(steps.done);
            }
        }
        match items.next() {
            Some(Ok((at, item))) => steps.note(at, item),
            Some(Err(problem)) => steps.done.damage = steps.done.damage.take().or(Some(problem.to_string())),
            None if steps.is_ended() => return Ok(steps.done),
            None => steps.end(),
        }
    }
}

/// Reports what differs from the recording; returns the exit code.
pub fn tell(file: &Path, done: &Resimulated) -> u8 {
    let warn = |text: String| message(tracing::Level::WARN, &format!("{}: {text}", file.display()));
    if let Some(step) = done.differs_at {
        warn(format!("from step {step} on, the state differs from the recording"));
    }
    let (undone, gaps) = (done.undone, done.gaps);
    if undone > 0 || gaps > 0 {
        warn(format!("inputs of {undone} steps are missing; continued from a checkpoint {gaps} times"));
    }
    if done.has_gaps() { LOSS } else { 0 }
}

/// As [`tell`], for a film. Viewers take a film for what happened, so differences from it must be clear.
pub fn tell_of_film(file: &Path, done: &Resimulated) -> u8 {
    if let Some(damage) = &done.damage {
        message(tracing::Level::WARN, damage);
    }
    if let Some(version) = done.other_state_hash_version {
        message(tracing::Level::WARN, &format!("{}: {}", file.display(), states_incomparable(version)));
    }
    match (tell(file, done), done) {
        (_, Resimulated { differs_at: Some(_), .. }) => DIFFERS,
        (0, Resimulated { other_state_hash_version: Some(_), .. }) => LOSS,
        (code, _) => code,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::steps::{CheckpointHeader, StepRecord};
    use recording::{Item, Provenance, STATE_HASH, Writer};
    use simcore::resume::{InputHistory, Repeated};
    use std::path::PathBuf;

    /// What comes of a recording: hash by step, and its events as bytes.
    type Again = (Resimulated, Vec<(u64, u64)>, Vec<Vec<u8>>);

    fn resimulated(file: &Path) -> Again {
        let recording = Recording::open(file).unwrap();
        let world = World::new(&scene_of(&recording).unwrap()).unwrap().unseen();
        let (mut hashes, mut events) = (Vec::new(), Vec::new());
        let done = steps(&recording, world, |again| {
            hashes.push((again.step.step, again.step.state_hash));
            events.extend(again.world.events().iter().map(|event| bytemuck::bytes_of(event).to_vec()));
            Ok(ControlFlow::Continue(()))
        });
        (done.unwrap(), hashes, events)
    }

    fn golden() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap")
    }

    fn items(file: &Path, topics: &[&'static str]) -> Vec<Item> {
        Recording::open(file).unwrap().items_of(topics).map(|i| i.unwrap().1).collect()
    }

    #[test]
    fn a_live_run_comes_out_to_the_bit() {
        let (done, hashes, events) = resimulated(&golden());
        assert_eq!(done.differs_at, None);
        let recorded: Vec<(u64, u64)> =
            items(&golden(), &["steps"])
                .into_iter()
                .map(|item| {
                    if let Item::Step(s) = item { (s.step, s.state_hash) } else { unreachable!("steps only") }
                })
                .collect();
        assert!(done.steps > 50 && hashes == recorded);
        let of = |item| if let Item::Event(e) = item { bytemuck::bytes_of(&e).to_vec() } else { Vec::new() };
        let recorded: Vec<Vec<u8>> = items(&golden(), &["events"]).into_iter().map(of).collect();
        assert_eq!(events, recorded);
    }

    #[test]
    fn over_a_gap_it_goes_on_from_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let bad = folder.path().join("bad.mcap");
        let recording = Recording::open(&golden()).unwrap();
        // A checkpoint of the state after step 60, of a world that does the steps.
        let scene = SceneFile::parse(&recording.provenance().scene_toml, "golden").unwrap();
        let (mut world, mut past) = (World::new(&scene).unwrap().unseen(), InputHistory::default());
        let mut writer = Writer::create(&bad, recording.provenance()).unwrap();
        for item in items(&golden(), &TOPICS[..4]) {
            past.note(item.clone().into_entry().unwrap());
            if !matches!(&item, Item::Poses(p) if p.frame == 40) {
                writer.write(1, &item).unwrap();
            }
            while let Some(Repeated { recorded: step, report, .. }) = past.advance(&mut world) {
                let state_hash = report.state_hash;
                if step.step == 60 {
                    let mut state = Vec::new();
                    world.save(&mut state).unwrap();
                    let (handles_below, pedals_below) = (step.handles_below, step.pedals_below);
                    let (field, bytes) = (step.field, state.len() as u64);
                    let header =
                        CheckpointHeader { step: 60, field, handles_below, pedals_below, state_hash, bytes };
                    writer.write(1, &Item::Checkpoint(header, state)).unwrap();
                }
            }
        }
        writer.finish().unwrap();
        let done = resimulated(&bad).0;
        let all = items(&golden(), &["steps"]).len() as u64;
        assert_eq!((done.gaps, done.differs_at, done.steps + done.undone), (1, None, all), "{done:?}");
        assert!(done.undone > 0 && done.undone <= 22, "from the lost pose to the checkpoint: {done:?}");
    }

    #[test]
    fn missing_inputs_are_told_and_another_state_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let bad = folder.path().join("bad.mcap");
        let mut provenance = Recording::open(&golden()).unwrap().provenance().clone();
        let copy = |provenance: &Provenance, change: &dyn Fn(Item) -> Option<Item>| {
            let mut writer = Writer::create(&bad, provenance).unwrap();
            for item in items(&golden(), &TOPICS).into_iter().filter_map(change) {
                writer.write(1, &item).unwrap();
            }
            writer.finish().unwrap();
        };
        copy(&provenance, &|item| Some(item).filter(|i| !matches!(i, Item::Poses(p) if p.frame == 40)));
        let done = resimulated(&bad).0;
        let all = items(&golden(), &["steps"]).len() as u64;
        assert!(done.undone > 0 && done.steps > 30 && done.steps + done.undone == all, "{done:?}");
        let another = |item| match item {
            Item::Step(s) if s.step == 30 => Some(Item::Step(StepRecord { state_hash: !s.state_hash, ..s })),
            other => Some(other),
        };
        copy(&provenance, &another);
        assert_eq!(resimulated(&bad).0.differs_at, Some(30));
        // Hashes of another version say nothing about the states.
        provenance.versions.insert(STATE_HASH.into(), "7".into());
        copy(&provenance, &another);
        let done = resimulated(&bad).0;
        assert_eq!((done.differs_at, done.other_state_hash_version), (None, Some(7)));
    }
}
