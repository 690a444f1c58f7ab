//! `tracker-checkpoints`, and when tracker and simulation save what they know.
//!
//! Both follow one rule on what both see, the exposures of the tracker's frames: the first frame of all is
//! followed by a checkpoint, and then the first frame of every [`CHECKPOINT_NS`] of the cameras' clock. So
//! the checkpoints of the two belong to the same field and a reader can pair them. Where the simulation
//! makes further ones, because its steps are heavy, the newest of the tracker at or before them is theirs.

use crate::limits::CHECKPOINT_NS;
use crate::message::{Invalid, Message};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Decides after which frames a checkpoint is due, independently of the load. Pure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CheckpointTimes {
    /// Number of the present period since the clock's zero; `None` before the first frame.
    period: Option<u64>,
}

impl CheckpointTimes {
    /// Takes the exposure of the next frame; true if a checkpoint is due after it.
    pub fn after_frame(&mut self, exposed_ns: Nanos) -> bool {
        let period = Some(exposed_ns / CHECKPOINT_NS);
        std::mem::replace(&mut self.period, period) != period
    }
}

/// Header of a tracker's checkpoint; the payload is what it knew after the frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
#[wire(name = "TrackerCheckpoint")]
pub struct TrackerCheckpointHeader {
    /// [`crate::poses::TrackerFrame::frame`] of the frame after which it was made.
    #[wire(tag = 1)]
    pub frame: u64,
    /// Field of that frame.
    #[wire(tag = 2)]
    pub field: u64,
    /// Exposure of that frame, ns.
    #[wire(tag = 3)]
    pub exposed_ns: Nanos,
    /// Bytes of the payload in use.
    #[wire(tag = 4, payload = "state")]
    pub bytes: u64,
}

impl Message for TrackerCheckpointHeader {
    const CHANNEL: &'static str = "tracker-checkpoints";
    const VERSION: u32 = 1;
    const QUEUE: usize = 1;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fields of exposures every `period_ns` from `first_ns` on after which a checkpoint is due.
    fn due(first_ns: Nanos, period_ns: u64, fields: impl Iterator<Item = u64>) -> Vec<u64> {
        let mut times = CheckpointTimes::default();
        fields.filter(|field| times.after_frame(first_ns + field * period_ns)).collect()
    }

    #[test]
    fn the_first_frame_is_saved_and_then_one_every_two_seconds_at_any_rate() {
        assert_eq!(due(7_010_000_000, 20_000_000, 0..300), [0, 50, 150, 250]);
        assert_eq!(due(8_000_000_000, 2_000_000, 0..2500), [0, 1000, 2000]);
        assert_eq!(due(8_000_000_000, 40_000_000, 0..120), [0, 50, 100]);
    }

    #[test]
    fn who_begins_later_or_misses_frames_saves_after_the_same_fields() {
        let all = due(7_010_000_000, 20_000_000, 0..300);
        assert_eq!(due(7_010_000_000, 20_000_000, 30..300)[1..], all[1..]);
        let without_one = due(7_010_000_000, 20_000_000, (0..300).filter(|f| *f != 150));
        assert_eq!(without_one, [0, 50, 151, 250]);
    }

    #[test]
    fn a_clock_that_goes_back_is_saved_after() {
        let mut times = CheckpointTimes::default();
        let saved =
            [9_000_000_000, 9_020_000_000, 1_000_000_000, 1_020_000_000].map(|at| times.after_frame(at));
        assert_eq!(saved, [true, false, true, false]);
    }
}
