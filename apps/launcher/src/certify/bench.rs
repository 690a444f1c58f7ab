//! One stream through a tracker: starts it, feeds it and reads its poses, each in a thread or process of its own.

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

/// How long the tracker may take to start.
const START: Duration = Duration::from_secs(20);
/// From one look at how far a stream is to the next.
const LOOK: Duration = Duration::from_secs(1);

/// What streams are sent through.
pub struct Bench<'a> {
    /// The simulator of the measurement.
    pub instance: &'a Instance,
    /// The rig file, as the tracker finds it.
    pub rig: String,
    /// Whether all are under the real-time scheduler.
    pub realtime: bool,
    /// Raised where the command is to end.
    pub stop: &'a StopSignal,
}

/// A stream.
pub struct Stream {
    /// What the cameras see.
    pub triples: Triples,
    /// Triples before those that count.
    pub warm_up: u64,
    /// Triples that count.
    pub count: u64,
    /// As fast as it is tracked, not at the rig's rate.
    pub at_speed: bool,
}

/// What was measured of a stream.
pub struct Measured {
    /// By the feeder.
    pub fed: Fed,
    /// By the subscriber.
    pub read: Read,
    /// How long it took to send it, s.
    pub seconds: f64,
}

/// Threads that end when this is dropped.
pub struct Ending(pub Arc<AtomicBool>);

impl Drop for Ending {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Bench<'_> {
    /// Sends a stream through a new tracker. Where the command is to end, the stream ends early, and what was measured
    /// of it is given: the triples that were sent.
    ///
    /// # Errors
    /// Where the tracker does not start or ends, a thread fails, or the command is to end before the stream began.
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
        // The subscriber reads on after the last triple was sent.
        let [stop, enough] = [(); 2].map(|()| Arc::<AtomicBool>::default());
        let _endings = [&stop, &enough].map(|flag| Ending(Arc::clone(flag)));
        let [sent, done_ns] = [(); 2].map(|()| Arc::<AtomicU64>::default());
        let (credits, told) = mpsc::channel();
        let total = warm_up + count;
        let first_ns = now().saturating_sub((total + 1) * triples.period_ns()).max(1);
        let pace = if at_speed { Pace::AtSpeed(told, first_ns) } else { Pace::RealTime };
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

    /// Waits for the feeder, says how far it is, and has it end where the command is to end.
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
