//! A recording is resimulated, in one go and without the other processes: every step from the
//! recorded poses, handles and pedal ([`steps`]), for a film or written as a recording of poses,
//! steps and events that is read once ([`run`]). Pure but for the files; the same bits as in the
//! live run.
//!
//! Over a gap it goes on from the next checkpoint, as `vitreo replay --verify` does.

use anyhow::Context;
use outputs::GrowingFile;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, STATE_HASH_VERSION, StepRecord};
use recording::{Item, Recording, STATE_HASH, Writer};
use scene::SceneFile;
use simcore::resume::InputHistory;
use simcore::world::World;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::path::Path;

/// What a step consumes, what tells that it was made, and where it can go on after a gap.
const TOPICS: [&str; 5] = ["poses", "handles", "pedal", "steps", "checkpoints"];
/// Checkpoints that are kept. What is missing when this many further ones have come does not come any
/// more.
const CHECKPOINTS: usize = 2;

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Resimulated {
    /// Steps done.
    pub steps: u64,
    /// Gaps over which a checkpoint led.
    pub gaps: u64,
    /// Recorded steps that could not be done, because inputs are missing.
    pub undone: u64,
    /// What is wrong with the file first, if something is.
    pub damage: Option<String>,
    /// The first of them whose state is not the recorded one.
    pub differs_at: Option<u64>,
    /// Version of the recording's state hashes where it is not this build's: states are not
    /// compared.
    pub other_state_hash_version: Option<u32>,
}

impl Resimulated {
    /// True where a part of the recording is missing.
    pub fn has_gaps(&self) -> bool {
        self.undone > 0 || self.gaps > 0 || self.damage.is_some()
    }
}

/// A step that was done again.
pub struct StepAgain<'a> {
    /// The world after it.
    pub world: &'a World,
    /// The recorded poses that it consumed.
    pub poses: Box<TrackerFrame>,
    /// What was recorded of it; the state's hash is that of `world`.
    pub step: StepRecord,
}

/// Resimulates `file` into `out`. Where inputs are missing it goes on from the next checkpoint.
///
/// # Errors
/// Where the file is no recording, its scene cannot be simulated, or `out` cannot be written.
pub fn run(file: &Path, out: &GrowingFile) -> anyhow::Result<Resimulated> {
    let recording = Recording::open(file)?;
    let (scene, mut own) = (scene_of(&recording)?, recording.provenance().clone());
    own.versions.insert(STATE_HASH.into(), STATE_HASH_VERSION.to_string());
    let mut writer = Writer::temporary(out.handle()?, out.path(), &own)?;
    let world = World::new(&scene).context("scene")?.unseen();
    let done = steps(&recording, world, |again| {
        let at = again.poses.instants.exposed;
        writer.write(at, &Item::Poses(again.poses))?;
        writer.write(at, &Item::Step(again.step))?;
        for event in again.world.events() {
            writer.write(at, &Item::Event(*event))?;
        }
        Ok(ControlFlow::Continue(()))
    })?;
    writer.finish()?;
    Ok(done)
}

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
/// Those of `each`, and for a checkpoint that does not fit the scene.
pub fn steps(
    recording: &Recording,
    world: World,
    each: impl FnMut(StepAgain<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Resimulated> {
    let other_state_hash_version = recording.provenance().other_state_hash_version();
    let done = Resimulated { other_state_hash_version, ..Resimulated::default() };
    let (past, checkpoints) = (InputHistory::default(), VecDeque::new());
    let mut run = Run { world, each, ended: false, past, checkpoints, done };
    for item in recording.items_of(&TOPICS) {
        match item {
            Ok((_, Item::Checkpoint(header, state))) => run.take_checkpoint(header, state)?,
            Ok((_, item)) => {
                run.past.note(item.into_entry().expect("only topics of the journal are asked for"));
                run.advance()?;
            }
            Err(problem) => run.done.damage = run.done.damage.take().or(Some(problem.to_string())),
        }
        if run.ended {
            return Ok(run.done);
        }
    }
    while run.past.waiting().is_some() && !run.ended && run.go_on()? {}
    if !run.ended {
        run.done.undone += run.past.waiting_steps();
    }
    Ok(run.done)
}

/// A resimulation under way.
struct Run<F> {
    world: World,
    each: F,
    /// `each` has enough.
    ended: bool,
    past: InputHistory,
    checkpoints: VecDeque<(CheckpointHeader, Vec<u8>)>,
    done: Resimulated,
}

impl<F: FnMut(StepAgain<'_>) -> anyhow::Result<ControlFlow<()>>> Run<F> {
    /// Does the steps whose inputs are there.
    fn advance(&mut self) -> anyhow::Result<()> {
        while let Some((poses, recorded, state_hash)) = self.past.advance(&mut self.world) {
            self.done.steps += 1;
            let comparable = self.done.other_state_hash_version.is_none();
            let differs = comparable && state_hash != recorded.state_hash;
            self.done.differs_at = self.done.differs_at.or(differs.then_some(recorded.step));
            let step = StepRecord { state_hash, ..recorded };
            if (self.each)(StepAgain { world: &self.world, poses, step })?.is_break() {
                self.ended = true;
                break;
            }
        }
        Ok(())
    }

    /// Keeps a checkpoint; where steps have been waiting since the one before the last, their inputs
    /// are missing.
    fn take_checkpoint(&mut self, header: CheckpointHeader, state: Vec<u8>) -> anyhow::Result<()> {
        if self.checkpoints.len() == CHECKPOINTS {
            let oldest = self.checkpoints.front().expect("two are kept").0.step;
            match self.past.waiting() {
                Some(waiting) if waiting.step <= oldest => drop(self.go_on()?),
                _ => drop(self.checkpoints.pop_front()),
            }
        }
        self.checkpoints.push_back((header, state));
        Ok(())
    }

    /// Goes on from the first checkpoint behind the step that is waiting; false if there is none.
    fn go_on(&mut self) -> anyhow::Result<bool> {
        let Some(waiting) = self.past.waiting().map(|s| s.step) else { return Ok(false) };
        while let Some((header, state)) = self.checkpoints.pop_front() {
            if header.step >= waiting {
                let jumped = self.past.jump(&mut self.world, &header, &state);
                self.done.undone += jumped.context("a checkpoint of the recording")?;
                self.done.gaps += 1;
                self.advance()?;
                return Ok(true);
            }
        }
        Ok(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use outputs::Outputs;
    use recording::Provenance;
    use std::path::PathBuf;

    fn resimulated(file: &Path, out: &Path) -> anyhow::Result<Resimulated> {
        let mut out = Outputs::new(true).grow(out)?;
        let done = run(file, &out)?;
        out.appear()?;
        Ok(done)
    }

    fn golden() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap")
    }

    fn items(file: &Path, topics: &[&'static str]) -> Vec<Item> {
        Recording::open(file).unwrap().items_of(topics).map(|i| i.unwrap().1).collect()
    }

    #[test]
    fn a_live_run_comes_out_to_the_bit() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("again.mcap");
        let done = resimulated(&golden(), &out).unwrap();
        assert_eq!(done.differs_at, None);
        let hashes = |file: &Path| -> Vec<(u64, u64)> {
            let of = |item| {
                if let Item::Step(s) = item { (s.step, s.state_hash) } else { unreachable!("steps only") }
            };
            items(file, &["steps"]).into_iter().map(of).collect()
        };
        assert!(done.steps > 50 && hashes(&out) == hashes(&golden()));
        let events = |file: &Path| -> Vec<_> {
            let of =
                |item| if let Item::Event(e) = item { bytemuck::bytes_of(&e).to_vec() } else { Vec::new() };
            items(file, &["events"]).into_iter().map(of).collect()
        };
        assert_eq!(events(&out), events(&golden()));
    }

    #[test]
    fn over_a_gap_it_goes_on_from_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let (bad, out) = (folder.path().join("bad.mcap"), folder.path().join("again.mcap"));
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
            while let Some((_, step, state_hash)) = past.advance(&mut world) {
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
        let done = resimulated(&bad, &out).unwrap();
        let all = items(&golden(), &["steps"]).len() as u64;
        assert_eq!((done.gaps, done.differs_at, done.steps + done.undone), (1, None, all), "{done:?}");
        assert!(done.undone > 0 && done.undone <= 22, "from the lost pose to the checkpoint: {done:?}");
    }

    #[test]
    fn missing_inputs_are_told_and_another_state_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let (bad, out) = (folder.path().join("bad.mcap"), folder.path().join("again.mcap"));
        let mut provenance = Recording::open(&golden()).unwrap().provenance().clone();
        let copy = |provenance: &Provenance, change: &dyn Fn(Item) -> Option<Item>| {
            let mut writer = Writer::create(&bad, provenance).unwrap();
            for item in items(&golden(), &TOPICS).into_iter().filter_map(change) {
                writer.write(1, &item).unwrap();
            }
            writer.finish().unwrap();
        };
        copy(&provenance, &|item| Some(item).filter(|i| !matches!(i, Item::Poses(p) if p.frame == 40)));
        let done = resimulated(&bad, &out).unwrap();
        let all = items(&golden(), &["steps"]).len() as u64;
        assert!(done.undone > 0 && done.steps > 30 && done.steps + done.undone == all, "{done:?}");
        let another = |item| match item {
            Item::Step(s) if s.step == 30 => Some(Item::Step(StepRecord { state_hash: !s.state_hash, ..s })),
            other => Some(other),
        };
        copy(&provenance, &another);
        assert_eq!(resimulated(&bad, &out).unwrap().differs_at, Some(30));
        // Hashes of another version say nothing about the states.
        provenance.versions.insert(STATE_HASH.into(), "7".into());
        copy(&provenance, &another);
        let done = resimulated(&bad, &out).unwrap();
        assert_eq!((done.differs_at, done.other_state_hash_version), (None, Some(7)));
        let own = Recording::open(&out).unwrap().provenance().other_state_hash_version();
        assert_eq!(own, None, "what was simulated here is of this version");
    }
}
