//! The thread that stands for whoever uses the poses: it waits for them as any program does that reads them, and
//! stamps each by its own clock as soon as it has it.

use super::stream::Triples;
use super::tally::Tally;
use crate::children::raise_this_thread;
use ipc::clock::now;
use ipc::{Counts, Instance, Queue, Receiver, wait};
use protocol::poses::TrackerFrame;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Sender as Credits;
use tokio::sync::oneshot;

/// Longest wait without a look whether to end, ns.
const LOOK_NS: u64 = 20_000_000;
/// Longest wait for poses after the last blobs were sent, ns.
const LAST_NS: u64 = 1_000_000_000;

/// What the subscriber needs.
pub struct Subscriber {
    /// The simulator that it joins.
    pub instance: String,
    /// What the cameras see, and where everything is.
    pub triples: Triples,
    /// What it counts into.
    pub tally: Tally,
    /// Signalled for each pose, if the sender waits for it.
    pub credits: Option<Credits<()>>,
    /// Whether it runs under the real-time scheduler.
    pub realtime: bool,
    /// Raised to end it early.
    pub stop: Arc<AtomicBool>,
    /// When the last blobs were sent, ns; 0 before.
    pub done_ns: Arc<AtomicU64>,
}

/// Its result.
#[derive(Debug)]
pub struct Read {
    /// What was counted.
    pub tally: Tally,
    /// Blocks of its own queue.
    pub counts: Counts,
    /// Fields that the tracker refused.
    pub fields_refused: u32,
}

impl Subscriber {
    /// Reads until everything has come, or will not come any more. Says through `ready` that it listens.
    ///
    /// # Errors
    /// Where the channel or the scheduler is refused.
    pub fn run(mut self, ready: oneshot::Sender<()>) -> anyhow::Result<Read> {
        if self.realtime {
            raise_this_thread()?;
        }
        let instance = Instance::join(&self.instance)?;
        let mut poses: Receiver<TrackerFrame> = instance.receiver(Queue::InOrder)?;
        let mut fields_refused = 0;
        let _ = ready.send(());
        while !self.stop.load(Ordering::Relaxed) && !self.tally.is_full() {
            wait(&[&poses], LOOK_NS);
            while let Some(frame) = poses.next_sample()? {
                let read_ns = now();
                if let Some(credits) = &self.credits {
                    let _ = credits.send(());
                }
                self.tally.note(&frame, read_ns, &self.triples);
                fields_refused = frame.fields_refused;
            }
            let done_ns = self.done_ns.load(Ordering::Acquire);
            if done_ns > 0 && now() > done_ns + LAST_NS {
                break;
            }
        }
        Ok(Read { tally: self.tally, counts: poses.counts(), fields_refused })
    }
}
