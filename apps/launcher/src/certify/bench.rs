//! Sends one stream of blobs through a tracker: starts the tracker as a process, the feeder and the
//! subscriber as threads.

use super::feeder::{Fed, Feed, Pace};
use super::progress::Progress;
use super::stream::Triples;
use super::subscriber::{Read, Subscriber};
use super::tally::Tally;
use crate::children::{Child, Surroundings, end_all, wait_until_running};
use crate::runtime::StopSignal;
use anyhow::{Context, bail};
use ipc::clock::now;
use ipc::logging::inform;
use ipc::{Instance, Queue, Receiver, Sender};
use protocol::control::Request;
use protocol::health::{Health, Process};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::{JoinHandle, spawn_blocking};
use tokio::time::sleep;

/// Timeout for the start of the tracker.
const START: Duration = Duration::from_secs(20);
/// Period of the checks for progress.
const LOOK: Duration = Duration::from_secs(1);

/// Everything that streams of one measurement have in common.
pub struct Bench<'a> {
    /// Instance in which the tracker runs.
    pub instance: &'a Instance,
    /// Path of the rig file, for the tracker.
    pub rig: String,
    /// True if tracker, feeder and subscriber run under the real-time scheduler.
    pub realtime: bool,
    /// Raised when the command is asked to stop.
    pub stop: &'a StopSignal,
}

/// A stream of triples to send.
pub struct Stream {
    /// The blobs of the cameras.
    pub triples: Triples,
    /// Triples before the counted ones.
    pub warm_up: u64,
    /// Counted triples.
    pub count: u64,
    /// True to send as fast as the tracker processes, false to send at the rig's rate.
    pub at_speed: bool,
}

/// Results of a stream.
pub struct Measured {
    /// Results of the feeder.
    pub fed: Fed,
    /// Results of the subscriber.
    pub read: Read,
    /// Time that the feeder took for the whole stream, s.
    pub seconds: f64,
}

/// Raises a flag on drop, which ends the threads that share it.
pub struct Ending(pub Arc<AtomicBool>);

impl Drop for Ending {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Bench<'_> {
    /// Sends a stream through a new tracker. If the command is asked to stop, the stream ends early, and the
    /// results cover the triples that were sent.
    ///
    /// # Errors
    /// If the tracker does not start or ends early, a thread fails, or the command is asked to stop before
    /// the stream has begun.
    pub async fn measure(&self, stream: Stream) -> anyhow::Result<Measured> {
        let mut health: Receiver<Health> = self.instance.receiver(Queue::InOrder)?;
        let mut requests: Sender<Request> = self.instance.sender()?;
        let surroundings = Surroundings { realtime: self.realtime, ..Surroundings::default() };
        let args = ["--rig".into(), self.rig.clone()];
        let tracker = [Child::spawn(Process::Tracker, self.instance.name(), &args, &surroundings)?];
        wait_until_running(&mut health, &tracker, &surroundings.ended, START, self.stop).await?;
        let measured = tokio::select! {
            measured = self.send(stream) => measured?,
            () = tracker[0].ended() => bail!("{}", tracker[0].exit_report()),
        };
        let seq = requests.sent();
        end_all(&tracker, &mut requests, seq).await;
        Ok(measured)
    }

    async fn send(&self, stream: Stream) -> anyhow::Result<Measured> {
        let Stream { triples, warm_up, count, at_speed } = stream;
        // The subscriber continues to read after the last triple has been sent, so it has its own flag.
        let [stop, enough] = [(); 2].map(|()| Arc::<AtomicBool>::default());
        let _endings = [&stop, &enough].map(|flag| Ending(Arc::clone(flag)));
        let [sent, done_ns] = [(); 2].map(|()| Arc::<AtomicU64>::default());
        let (credits, poses) = mpsc::channel();
        let total = warm_up + count;
        let first_ns = now().saturating_sub((total + 1) * triples.period_ns()).max(1);
        let pace = if at_speed { Pace::AtSpeed(poses, first_ns) } else { Pace::RealTime };
        let subscriber = Subscriber {
            instance: self.instance.name().into(),
            triples: triples.clone(),
            tally: Tally::of(warm_up, count),
            credits: at_speed.then_some(credits),
            realtime: self.realtime,
            stop,
            done_ns: Arc::clone(&done_ns),
        };
        let instance = self.instance.name().to_owned();
        let feed = Feed {
            instance,
            triples,
            count: total,
            pace,
            realtime: self.realtime,
            stop: Arc::clone(&enough),
            sent: Arc::clone(&sent),
            done_ns,
        };
        let (ready, listens) = oneshot::channel();
        let reading = spawn_blocking(move || subscriber.run(ready));
        if listens.await.is_err() {
            reading.await??;
            bail!("the subscriber ended before it was connected");
        }
        let begun = now();
        let feeding = spawn_blocking(move || feed.run());
        let fed = self.accompany(feeding, &sent, &enough, total).await.context("the feeder")?;
        let seconds = (now() - begun) as f64 * 1e-9;
        let mut read = reading.await?.context("the subscriber")?;
        read.tally.end_with(sent.load(Ordering::Relaxed));
        Ok(Measured { fed, read, seconds })
    }

    /// Waits for the feeder and reports its progress. Ends the feeder early if the command is asked to stop.
    async fn accompany(
        &self,
        mut feeding: JoinHandle<anyhow::Result<Fed>>,
        sent: &AtomicU64,
        enough: &AtomicBool,
        total: u64,
    ) -> anyhow::Result<Fed> {
        let mut progress = Progress::of(total);
        loop {
            tokio::select! {
                fed = &mut feeding => return fed?,
                () = self.stop.raised(), if !enough.load(Ordering::Relaxed) => enough.store(true, Ordering::Relaxed),
                () = sleep(LOOK) => {
                    if let Some(line) = progress.line(sent.load(Ordering::Relaxed)) {
                        inform(&line);
                    }
                }
            }
        }
    }
}
