//! Copies of a recorded run in memory, from which it goes on as if nothing had been in between: tracker,
//! world, what waits for its turn, and the reader's place in the file.

use crate::engine::Recorded;
use crate::frames::Frames;
use crate::steps::{Resimulated, SavedState, Waiting};
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::poses::TrackerFrame;
use recording::{Place, RecordingError};
use simcore::checkpoint::CheckpointError;
use simcore::world::WorldSnapshot;
use std::collections::VecDeque;
use std::sync::Arc;
use tracker::TrackerSnapshot;
use tracker::report::Report;

/// A recorded run at an instant between two steps.
#[derive(Clone)]
pub struct Snapshot {
    place: Place,
    tracker: Option<(TrackerSnapshot, Report)>,
    frames: Frames,
    world: WorldSnapshot,
    waiting: Waiting,
    done: Resimulated,
    lost: Option<String>,
    damage: Option<Arc<RecordingError>>,
    made: VecDeque<Arc<TrackerFrame>>,
    begins_with: Option<(TrackerCheckpointHeader, SavedState)>,
}

impl Snapshot {
    /// Steps that the world had done.
    pub fn step(&self) -> u64 {
        self.world.state().step
    }
}

impl Recorded {
    /// A copy of the run, to be taken between two calls of [`Recorded::run`].
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            place: self.items.place(),
            tracker: self.tracker.as_ref().map(|(tracker, report)| (tracker.snapshot(), report.clone())),
            frames: self.frames.clone(),
            world: self.steps.world.snapshot(),
            waiting: self.steps.waiting.clone(),
            done: self.steps.done.clone(),
            lost: self.steps.lost.clone(),
            damage: self.damage.clone(),
            made: self.made.clone(),
            begins_with: self.begins_with.clone(),
        }
    }

    /// Goes back, or ahead, to a copy of this run or of another one of the same recording.
    ///
    /// # Errors
    /// [`CheckpointError`] for a copy of a run of another scene; nothing changes then.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<(), CheckpointError> {
        self.steps.world.restore_snapshot(&snapshot.world)?;
        self.items.go_to(&snapshot.place);
        if let (Some((tracker, report)), Some((copy, had_reported))) = (&mut self.tracker, &snapshot.tracker)
        {
            tracker.restore_snapshot(copy);
            report.clone_from(had_reported);
        }
        self.frames.clone_from(&snapshot.frames);
        self.steps.waiting.clone_from(&snapshot.waiting);
        self.steps.done.clone_from(&snapshot.done);
        self.steps.lost.clone_from(&snapshot.lost);
        self.damage.clone_from(&snapshot.damage);
        self.made.clone_from(&snapshot.made);
        self.begins_with.clone_from(&snapshot.begins_with);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
