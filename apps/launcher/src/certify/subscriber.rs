//! Subscriber thread: waits for poses as any reader of the channel does, and timestamps them on receipt with
//! its own clock.

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

/// Maximum time between two checks whether to end, ns.
const LOOK_NS: u64 = 20_000_000;
/// Timeout for poses after the last blobs were sent, ns.
const LAST_NS: u64 = 1_000_000_000;

/// Parameters of the subscriber.
pub struct Subscriber {
    /// Name of the instance to join.
    pub instance: String,
    /// Generator of the blobs, for the true poses.
    pub triples: Triples,
    /// Statistics to fill.
    pub tally: Tally,
    /// Signalled for each received pose, if the feeder waits for poses.
    pub credits: Option<Credits<()>>,
    /// True to run under the real-time scheduler.
    pub realtime: bool,
    /// Raised to end the subscriber early.
    pub stop: Arc<AtomicBool>,
    /// Time at which the last blobs were sent, ns of `CLOCK_MONOTONIC`; 0 before.
    pub done_ns: Arc<AtomicU64>,
}

/// Results of the subscriber.
#[derive(Debug)]
pub struct Read {
    /// Statistics of the received poses.
    pub tally: Tally,
    /// Block counts of the receiver's queue.
    pub counts: Counts,
    /// Fields that the tracker refused.
    pub fields_refused: u32,
}

impl Subscriber {
    /// Reads until all poses have arrived or the timeout has passed. Signals `ready` once its channel is
    /// open.
    ///
    /// # Errors
    /// If the instance or the channel cannot be opened or fails, or the real-time scheduler refuses the
    /// thread.
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
