//! Checkpoints of what the tracker knows: when they are due, and how they leave.

use crate::tracker::Tracker;
use anyhow::Context;
use ipc::{BlockSender, Instance, IpcError};
use protocol::checkpoints::{CheckpointTimes, TrackerCheckpointHeader};
use protocol::limits::MAX_CHECKPOINT_BYTES;
use protocol::poses::TrackerFrame;

/// Room for what a tracker learns, as a multiple of what it begins with, and bytes besides: matrices that
/// are no longer symmetric to the bit are twice as long, and cameras that are resected keep what was seen
/// of them.
const ROOM: usize = 3;
const ROOM_BYTES: usize = 512 << 10;

/// The channel of the checkpoints.
pub(super) struct Saving {
    checkpoints: BlockSender<TrackerCheckpointHeader>,
    saved: Vec<u8>,
    times: CheckpointTimes,
    too_large: bool,
}

impl Saving {
    pub(super) fn open(instance: &Instance, tracker: &Tracker) -> anyhow::Result<Self> {
        let mut saved = Vec::new();
        tracker.save(&mut saved).context("checkpoint")?;
        let capacity = (ROOM * saved.len() + ROOM_BYTES).min(MAX_CHECKPOINT_BYTES);
        saved.reserve_exact(capacity.saturating_sub(saved.len()));
        let checkpoints = instance.block_sender(capacity)?;
        Ok(Saving { checkpoints, saved, times: CheckpointTimes::default(), too_large: false })
    }

    /// The next frame is followed by a checkpoint.
    pub(super) fn now(&mut self) {
        self.times = CheckpointTimes::default();
    }

    /// Sends a checkpoint where one is due after `frame`, which has been sent: nobody waits for it.
    pub(super) fn save_if_due(&mut self, tracker: &Tracker, frame: &TrackerFrame) -> anyhow::Result<()> {
        if !self.times.after_frame(frame.instants.exposed) {
            return Ok(());
        }
        tracker.save(&mut self.saved).context("checkpoint")?;
        let (saved, exposed_ns) = (&self.saved, frame.instants.exposed);
        let bytes = saved.len() as u64;
        let header = TrackerCheckpointHeader { frame: frame.frame, field: frame.field, exposed_ns, bytes };
        let sent = self.checkpoints.send(saved.len(), |payload| {
            payload[..saved.len()].copy_from_slice(saved);
            header
        });
        match sent {
            Err(problem @ IpcError::TooLarge { .. }) => {
                if !std::mem::replace(&mut self.too_large, true) {
                    tracing::warn!("no further checkpoints: {problem}");
                }
                Ok(())
            }
            other => Ok(other?),
        }
    }
}
