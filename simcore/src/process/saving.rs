//! Checkpoints: when they are due, and how they leave.

use crate::world::World;
use anyhow::Context;
use ipc::Instance;
use ipc::checkpoints::CheckpointSender;
use protocol::checkpoints::CheckpointTimes;
use protocol::limits::{CHECKPOINT_LEAST_NS, CHECKPOINT_WORK_NS};
use protocol::steps::CheckpointHeader;
use protocol::time::Nanos;

/// Room for a state that grows, as a multiple of that at the start, and bytes besides: what grows
/// (dye, freed nodes, marks) is less than what a scene begins with.
const ROOM: usize = 2;
const ROOM_BYTES: usize = 256 << 10;

/// The channel of the checkpoints, and what was done since the last one.
pub(super) struct Saving {
    checkpoints: CheckpointSender<CheckpointHeader>,
    due: Due,
}

/// When a checkpoint is due. Pure.
#[derive(Debug, Default)]
struct Due {
    /// Frames after which the tracker makes one too.
    times: CheckpointTimes,
    /// When the last one was made.
    last_ns: Nanos,
    /// Time spent on steps since.
    work_ns: u64,
}

impl Due {
    /// Takes a step with the frame of this exposure that began and ended at these instants; true if a
    /// checkpoint is due after it.
    fn after_step(&mut self, exposed_ns: Nanos, [begun, ended]: [Nanos; 2]) -> bool {
        self.work_ns += ended.saturating_sub(begun);
        let since_ns = ended.saturating_sub(self.last_ns);
        let heavy = self.work_ns >= CHECKPOINT_WORK_NS && since_ns >= CHECKPOINT_LEAST_NS;
        let due = self.times.after_frame(exposed_ns) || heavy;
        if due {
            (self.last_ns, self.work_ns) = (ended, 0);
        }
        due
    }
}

impl Saving {
    pub(super) fn open(instance: &Instance, world: &World) -> anyhow::Result<Self> {
        let mut saved = Vec::with_capacity(1 << 16);
        world.save(&mut saved).context("checkpoint")?;
        let checkpoints = CheckpointSender::open(instance, saved, ROOM, ROOM_BYTES)?;
        Ok(Saving { checkpoints, due: Due::default() })
    }

    /// The next step is followed by a checkpoint.
    pub(super) fn now(&mut self) {
        self.due = Due::default();
    }

    /// Sends a checkpoint after the first step, after the frames after which the tracker does, and before it
    /// would take long to make the steps since the last one again. `step` is when this one began and ended. True
    /// where it sent one.
    pub(super) fn save_if_due(
        &mut self,
        world: &World,
        state_hash: u64,
        step: [Nanos; 2],
    ) -> anyhow::Result<bool> {
        let state = world.state();
        if !self.due.after_step(state.exposed_ns, step) {
            return Ok(false);
        }
        let header = |bytes| CheckpointHeader {
            step: state.step,
            field: state.field,
            handles_below: state.handles_below,
            pedals_below: state.pedals_below,
            state_hash,
            bytes,
        };
        self.checkpoints.send(|saved| world.save(saved).context("checkpoint"), header)?;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of `step_ns` every 20 ms for 20 s: when checkpoints are due, ms.
    fn due(step_ns: u64) -> Vec<u64> {
        let mut due = Due::default();
        let at = |k: u64| 10_000_000_000 + k * 20_000_000;
        let all =
            (0..1000).filter(|&k| due.after_step(at(k), [at(k) + 4_000_000, at(k) + 4_000_000 + step_ns]));
        all.map(|k| k * 20).collect()
    }

    #[test]
    fn light_steps_are_saved_every_two_seconds() {
        assert_eq!(due(400_000), (0..10).map(|k| 2000 * k).collect::<Vec<_>>());
    }

    #[test]
    fn heavy_steps_are_saved_before_it_takes_long_to_make_them_again() {
        assert_eq!(due(2_000_000)[..6], [0, 1000, 2000, 3000, 4000, 5000]);
        assert_eq!(due(19_000_000)[..5], [0, 500, 1000, 1500, 2000], "and not all the time");
    }

    #[test]
    fn every_checkpoint_of_the_tracker_has_one_of_the_simulation() {
        for step_ns in [400_000, 1_300_000, 3_700_000, 18_000_000] {
            let found = due(step_ns);
            assert!((0..10).all(|k| found.contains(&(2000 * k))), "{step_ns}: {found:?}");
        }
    }
}
