//! What every thread that reads a source has: its channel for what it reads, its spare pictures, and how it learns
//! that the process ends.

use super::reader::Told;
use anyhow::{Result, anyhow};
use fpga_model::input::Picture;
use ipc::BellRope;
use ipc::clock::now;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};

/// Longest wait without looking whether the process ends, ms.
pub(super) const LOOK_MS: i64 = 50;
/// Rounds of [`LOOK_MS`] between a refused source and the next try: a writer that continues
/// meanwhile notices that the pipe has no reader.
const ROUNDS_REFUSED: u32 = 6;

/// From a reader to its process.
pub(super) struct Line {
    pub(super) outbox: SyncSender<Told>,
    /// Pictures that are done with, to be filled again.
    pub(super) spare: Receiver<Picture>,
    pub(super) rope: BellRope,
    pub(super) stop: Arc<AtomicBool>,
}

impl Line {
    /// The process ends.
    pub(super) fn stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// A picture to be filled.
    pub(super) fn picture(&self) -> Picture {
        self.spare.try_recv().unwrap_or_default()
    }

    /// Waits where the process is not ready for more; an error where it is gone.
    pub(super) fn tell(&self, report: Told) -> Result<()> {
        self.outbox.send(report).map_err(|_| anyhow!("the receiver has ended"))?;
        self.rope.ring();
        Ok(())
    }

    /// Waits before a source is tried again, unless the process ends.
    pub(super) fn pause(&self) {
        let looks = (0..ROUNDS_REFUSED).filter(|_| !self.stopping());
        looks.for_each(|_| ipc::clock::sleep_until(now() + LOOK_MS as u64 * 1_000_000));
    }
}
