//! How a what-if of a recording that was cut begins: with what the simulation knew at the cut, and with what the
//! tracker knew, unless something that the tracker depends on was changed. Then a new tracker starts there.
//!
//! The outcome begins with both states, as a cut does ([`crate::cut`]), and so verifies to the bit.

use super::outcome::Setting;
use super::{is_other_scene, keys::tuning_of};
use crate::engine::tracker_at_start;
use crate::steps::SavedState;
use anyhow::{Context, bail};
use outputs::exit::WrongUse;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::steps::CheckpointHeader;
use recording::{CUT, DESK, Item, Recording, Source};
use std::sync::Arc;
use tracker::Tracker;

/// What tracker and simulation begin with behind a cut; nothing of a recording that begins at the beginning.
#[derive(Debug, Clone, Default)]
pub struct Beginning {
    /// What the tracker knows, and after which frame.
    pub tracker: Option<(TrackerCheckpointHeader, SavedState)>,
    /// What the simulation knows, and after which step.
    pub world: Option<(CheckpointHeader, SavedState)>,
    /// Why a new tracker starts at the cut; `None` if it continues from its recorded state.
    pub restart_reason: Option<String>,
}

impl Beginning {
    /// Of a recording that is run again with a setting.
    ///
    /// # Errors
    /// Where the scene was changed of a recording that was cut: the eye at the cut is one of the recorded scene.
    pub fn of(recording: &Recording, setting: &Setting) -> anyhow::Result<Self> {
        let provenance = recording.provenance();
        if !provenance.config.contains_key(CUT) || provenance.source == Source::Import {
            return Ok(Beginning::default());
        }
        if is_other_scene(provenance, &setting.scene) {
            let file = recording.path().display();
            bail!(WrongUse(format!(
                "{file}: is a cut part that begins with the eye's state at the cut, which no other scene can continue; change the scene of the whole recording, then cut"
            )));
        }
        let mut beginning = Beginning { world: world_at_start(recording), ..Beginning::default() };
        if provenance.config.contains_key(DESK) {
            return Ok(beginning);
        }
        let Some((header, recorded)) = tracker_at_start(recording) else { return Ok(beginning) };
        let mut tracker = Tracker::tuned(&setting.rig, true, &setting.tuning);
        beginning.restart_reason = changed(recording, setting);
        if beginning.restart_reason.is_none()
            && let Err(problem) = tracker.restore(&recorded)
        {
            beginning.restart_reason = Some(format!("its state there is not usable: {problem}"));
        }
        let known = match beginning.restart_reason {
            None => recorded,
            Some(_) => {
                let (mut new, mut state) = (Tracker::tuned(&setting.rig, true, &setting.tuning), Vec::new());
                new.begin_at(header.frame.saturating_add(1));
                new.save(&mut state).context("what a new tracker knows")?;
                Arc::new(state)
            }
        };
        let header = TrackerCheckpointHeader { bytes: known.len() as u64, ..header };
        beginning.tracker = Some((header, known));
        Ok(beginning)
    }

    /// What the outcome holds before everything else.
    pub fn items(&self) -> Vec<Item> {
        let world = self.world.iter().map(|(header, state)| Item::Checkpoint(*header, state.to_vec()));
        let tracker =
            self.tracker.iter().map(|(header, state)| Item::TrackerCheckpoint(*header, state.to_vec()));
        world.chain(tracker).collect()
    }

    /// For people, of a recording that was cut.
    pub fn text(&self) -> Option<String> {
        self.tracker.as_ref()?;
        Some(match &self.restart_reason {
            None => "begins at the cut with the tracker's recorded state".into(),
            Some(why) => format!("a new tracker starts at the cut: {why}"),
        })
    }
}

/// What was changed that the tracker depends on.
fn changed(recording: &Recording, setting: &Setting) -> Option<String> {
    let recorded = recording.provenance();
    if recorded.rig_json != setting.provenance.rig_json {
        return Some("the rig was changed".into());
    }
    if tuning_of(recorded).ok().as_ref() != Some(&setting.tuning) {
        return Some("its constants were changed".into());
    }
    let version = recorded.other_tracker_version()?;
    Some(match version {
        0 => "the recording names no version of its tracker".into(),
        version => format!("the recording is of tracker {version}"),
    })
}

/// What the simulation knew where a recording was cut.
fn world_at_start(recording: &Recording) -> Option<(CheckpointHeader, SavedState)> {
    match recording.items_of(&["checkpoints"]).find_map(Result::ok)? {
        (_, Item::Checkpoint(header, state)) => Some((header, Arc::new(state))),
        _ => None,
    }
}
