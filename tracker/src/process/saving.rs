//! Checkpoints of what the tracker knows: when they are due, and how they leave.

use crate::tracker::Tracker;
use anyhow::Context;
use ipc::Instance;
use ipc::checkpoints::CheckpointSender;
use protocol::checkpoints::{CheckpointTimes, TrackerCheckpointHeader};
use protocol::matches::MatchFrame;

/// Room for what a tracker learns, as a multiple of what it begins with, and bytes besides: matrices that
/// are no longer symmetric to the bit are twice as long, and cameras that are resected keep what was seen
/// of them.
const ROOM: usize = 3;
const ROOM_BYTES: usize = 512 << 10;

/// The channel of the checkpoints, and when one is due.
pub(super) struct Saving {
    checkpoints: CheckpointSender<TrackerCheckpointHeader>,
    times: CheckpointTimes,
}

impl Saving {
    pub(super) fn open(instance: &Instance, tracker: &Tracker) -> anyhow::Result<Self> {
        let mut saved = Vec::new();
        tracker.save(&mut saved).context("checkpoint")?;
        let checkpoints = CheckpointSender::open(instance, saved, ROOM, ROOM_BYTES)?;
        Ok(Saving { checkpoints, times: CheckpointTimes::default() })
    }

    /// The next frame is followed by a checkpoint.
    pub(super) fn now(&mut self) {
        self.times = CheckpointTimes::default();
    }

    /// Sends a checkpoint if one is due after the newest frame, which has been sent, so no receiver waits for it.
    /// True if one was due.
    pub(super) fn save_if_due(&mut self, tracker: &Tracker) -> anyhow::Result<bool> {
        let &MatchFrame { frame, field, exposed_ns, .. } = tracker.matches();
        if !self.times.after_frame(exposed_ns) {
            return Ok(false);
        }
        let header = |bytes| TrackerCheckpointHeader { frame, field, exposed_ns, bytes };
        self.checkpoints.send(|saved| tracker.save(saved).context("checkpoint"), header)?;
        Ok(true)
    }
}
