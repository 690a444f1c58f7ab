//! Checkpoints of simulation and tracker that belong together, found in a file and read one at a time.
//!
//! Which belongs to which is decided here alone: the tracker's newest one at or before the field of the
//! simulation's.

use crate::frames::AHEAD_NS;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::steps::CheckpointHeader;
use protocol::time::Nanos;
use recording::{CheckpointHead, ChunkIndex, Item, Recording, RecordingError};
use std::sync::Arc;

/// Checkpoints of the tracker that are looked at for one of the simulation.
const LOOKED_AT: usize = 4;

/// The checkpoints of a file.
#[derive(Debug)]
pub struct Pairs {
    file: Recording,
    chunks: ChunkIndex,
    /// Of the simulation, in the order of the file, with their chunks.
    heads: Vec<(usize, CheckpointHead)>,
    /// Chunks with checkpoints of the tracker.
    of_tracker: Vec<usize>,
}

/// What simulation and tracker knew.
#[derive(Debug, Clone)]
pub struct Known {
    /// The simulation's checkpoint.
    pub world: (CheckpointHeader, Arc<Vec<u8>>),
    /// The tracker's; `None` at a desk.
    pub tracker: Option<(TrackerCheckpointHeader, Vec<u8>)>,
    /// Log time of the older one, ns.
    pub from_ns: Nanos,
}

impl Pairs {
    /// Those of a file.
    ///
    /// # Errors
    /// Where it cannot be read.
    pub fn of(file: Recording, chunks: ChunkIndex) -> Result<Self, RecordingError> {
        let heads = file.checkpoint_heads(&chunks)?;
        let of_tracker = chunks.holding("tracker-checkpoints").collect();
        Ok(Pairs { file, chunks, heads, of_tracker })
    }

    /// Headers of the simulation's checkpoints, in the order of the file.
    pub fn heads(&self) -> impl ExactSizeIterator<Item = &CheckpointHead> + Clone {
        self.heads.iter().map(|(_, head)| head)
    }

    /// True if there are checkpoints of the simulation, and of the tracker where that is wanted.
    pub fn are_complete(&self, with_tracker: bool) -> bool {
        let of_world = !self.heads.is_empty();
        if with_tracker { of_world && !self.of_tracker.is_empty() } else { of_world }
    }

    /// Reads a checkpoint of the simulation, and the tracker's that belongs to it where that is wanted;
    /// `None` where one of them is damaged or missing.
    pub fn read(&self, number: usize, with_tracker: bool) -> Option<Known> {
        let (chunk, head) = self.heads.get(number)?;
        let items = self.items(*chunk, "checkpoints");
        let (header, state) = items.into_iter().find_map(|(at, item)| match item {
            Item::Checkpoint(header, state) if at == head.log_time_ns && header.step == head.header.step => {
                Some((header, state))
            }
            _ => None,
        })?;
        let mut from_ns = head.log_time_ns;
        let mut tracker = None;
        if with_tracker {
            let (at, header, state) = self.tracker_of(head)?;
            from_ns = from_ns.min(at);
            tracker = Some((header, state));
        }
        Some(Known { world: (header, Arc::new(state)), tracker, from_ns })
    }

    /// The tracker's checkpoint that belongs to one of the simulation, and its log time.
    fn tracker_of(&self, head: &CheckpointHead) -> Option<(Nanos, TrackerCheckpointHeader, Vec<u8>)> {
        // It may stand a little behind the simulation's.
        let end = self.chunks.first_with(head.log_time_ns.saturating_add(AHEAD_NS));
        let before = self.of_tracker.partition_point(|chunk| *chunk <= end);
        for chunk in self.of_tracker[..before].iter().rev().take(LOOKED_AT) {
            let items = self.items(*chunk, "tracker-checkpoints");
            let its = items.into_iter().rev().find_map(|(at, item)| match item {
                Item::TrackerCheckpoint(header, state) if header.field <= head.header.field => {
                    Some((at, header, state))
                }
                _ => None,
            });
            if its.is_some() {
                return its;
            }
        }
        None
    }

    fn items(&self, chunk: usize, topic: &'static str) -> Vec<(Nanos, Item)> {
        let read = self.file.items_of_chunk(&self.chunks, chunk, &[topic]);
        read.unwrap_or_else(|problem| {
            tracing::warn!("a checkpoint cannot be used: {problem}");
            Vec::new()
        })
    }
}
