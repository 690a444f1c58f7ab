//! A recording is resimulated, in one go and without the other processes: every step from the
//! recorded poses, handles and pedal, written as a recording of poses, steps and events that is
//! read once. Pure but for the two files; the same bits as in the live run.

use anyhow::{Context, bail};
use outputs::GrowingFile;
use protocol::steps::{STATE_HASH_VERSION, StepRecord};
use recording::{Item, Recording, STATE_HASH, Writer};
use scene::SceneFile;
use simcore::resume::InputHistory;
use simcore::world::World;
use std::path::Path;

/// What a step consumes, and what tells that it was made.
const TOPICS: [&str; 4] = ["poses", "handles", "pedal", "steps"];

/// What came of it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Resimulated {
    /// Steps done.
    pub steps: u64,
    /// The first of them whose state is not the recorded one.
    pub differs_at: Option<u64>,
    /// Version of the recording's state hashes where it is not this build's: states are not
    /// compared.
    pub other_state_hash_version: Option<u32>,
}

/// Resimulates `file` into `out`. A damaged recording is done up to its damage; one whose inputs
/// are missing is refused.
pub fn run(file: &Path, out: &GrowingFile) -> anyhow::Result<Resimulated> {
    let recording = Recording::open(file)?;
    let provenance = recording.provenance();
    let other_state_hash_version = provenance.other_state_hash_version();
    let scene = SceneFile::parse(&provenance.scene_toml, &file.display().to_string()).context("its scene")?;
    let mut world = World::new(&scene).context("scene")?.unseen();
    let mut own = provenance.clone();
    own.versions.insert(STATE_HASH.into(), STATE_HASH_VERSION.to_string());
    let mut writer = Writer::temporary(out.handle()?, out.path(), &own)?;
    let mut past = InputHistory::default();
    let mut done = Resimulated { other_state_hash_version, ..Resimulated::default() };
    for item in recording.items_of(&TOPICS) {
        let Ok((_, item)) = item else { break };
        past.note(item.into_entry().expect("only topics of the journal are asked for"));
        while let Some((frame, recorded, state_hash)) = past.advance(&mut world) {
            done.steps += 1;
            let differs = other_state_hash_version.is_none() && state_hash != recorded.state_hash;
            done.differs_at = done.differs_at.or(differs.then_some(recorded.step));
            let at = frame.instants.exposed;
            writer.write(at, &Item::Poses(frame))?;
            writer.write(at, &Item::Step(StepRecord { state_hash, ..recorded }))?;
            for event in world.events() {
                writer.write(at, &Item::Event(*event))?;
            }
        }
    }
    if let Some(step) = past.waiting() {
        bail!("{}: inputs of step {} (field {}) are missing", file.display(), step.step, step.field);
    }
    writer.finish()?;
    Ok(done)
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
        let problem = resimulated(&bad, &out).unwrap_err().to_string();
        assert!(problem.contains("bad.mcap") && problem.contains("inputs of step"), "{problem}");
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
