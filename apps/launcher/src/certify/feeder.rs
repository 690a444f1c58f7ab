//! Feeder thread: sends the blobs of each triple, at the rig's rate or as fast as the tracker processes them.
//! The fields of a triple are sent together, after the longest read-out. A camera that is slower than the rig
//! has no field in some triples.

use super::stream::Triples;
use crate::children::raise_this_thread;
use crate::run::Durations;
use ipc::clock::{now, sleep_until};
use ipc::{Instance, Sender};
use protocol::blobs::BlobField;
use protocol::time::Nanos;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver as Credits, RecvTimeoutError};
use std::time::Duration;

/// Maximum number of triples in flight at full speed, smaller than the queues.
pub const ON_THEIR_WAY: u64 = 8;
/// Timeout for the poses of a triple at full speed.
const GIVEN_UP: Duration = Duration::from_secs(1);
/// Length of the pauses at full speed, in periods of the rig, and length of the bursts between them, in
/// pauses. From real-time programs that never sleep, Linux takes the processors away for 50 ms in every
/// second, to leave time to ordinary programs; the pauses prevent that. A pause longer than a period would
/// make the tracker count fields as late.
const PAUSE_PERIODS: f64 = 0.75;
const BURST_PAUSES: u64 = 9;
/// Time from the start of the feeder to the first triple, ns.
const LEAD_NS: u64 = 20_000_000;

/// Timing of the triples.
pub enum Pace {
    /// At the rig's rate, by the clock.
    RealTime,
    /// As fast as the poses arrive, each of which is signalled on this channel. The first triple has this
    /// past exposure time, ns of `CLOCK_MONOTONIC`; the others follow at the rig's period.
    AtSpeed(Credits<()>, Nanos),
}

/// Parameters of the feeder.
pub struct Feed {
    /// Name of the instance to join.
    pub instance: String,
    /// The blobs to send.
    pub triples: Triples,
    /// Number of triples.
    pub count: u64,
    /// Timing of the triples.
    pub pace: Pace,
    /// True to run under the real-time scheduler.
    pub realtime: bool,
    /// Raised to end the feeder early.
    pub stop: Arc<AtomicBool>,
    /// Number of triples sent so far.
    pub sent: Arc<AtomicU64>,
    /// Time at which the feeder ended, ns of `CLOCK_MONOTONIC`; 0 before.
    pub done_ns: Arc<AtomicU64>,
}

/// Results of the feeder.
#[derive(Debug, Default)]
pub struct Fed {
    /// Delay of the first blobs of each triple after their due time, in real time.
    pub late: Durations,
    /// Triples whose poses did not arrive within the timeout.
    pub given_up: u64,
}

impl Feed {
    /// Sends all triples.
    ///
    /// # Errors
    /// If the instance or a channel cannot be opened, or the real-time scheduler refuses the thread.
    pub fn run(mut self) -> anyhow::Result<Fed> {
        let done = Arc::clone(&self.done_ns);
        let fed = self.feed();
        done.store(now(), Ordering::Release);
        fed
    }

    fn feed(&mut self) -> anyhow::Result<Fed> {
        if self.realtime {
            raise_this_thread()?;
        }
        let instance = Instance::join(&self.instance)?;
        let mut blobs: Sender<BlobField> = instance.sender()?;
        let mut fields = Vec::with_capacity(self.triples.cameras());
        let mut fed = Fed::default();
        let begin = now() + LEAD_NS;
        let (mut on_their_way, mut burst_ns) = (0, begin);
        for number in 0..self.count {
            if self.stop.load(Ordering::Relaxed) {
                break;
            }
            let since_ns = number * self.triples.period_ns();
            match &self.pace {
                Pace::RealTime => {
                    let due = begin + since_ns;
                    self.triples.draw(number, due - self.triples.read_out_ns(), &mut fields);
                    sleep_until(due);
                    fed.late.note(now() - due, number);
                }
                Pace::AtSpeed(credits, first_ns) => {
                    self.triples.draw(number, first_ns + since_ns, &mut fields);
                    burst_ns = pause_after(burst_ns, self.triples.period_ns());
                    on_their_way = wait_for_room(credits, on_their_way, &mut fed) + 1;
                }
            }
            for field in &mut fields {
                field.blobs_out_ns = now();
                blobs.send(field)?;
            }
            self.sent.store(number + 1, Ordering::Relaxed);
        }
        Ok(fed)
    }
}

/// Pauses if the burst that began at `burst_ns` has been long enough. Returns the start of the current burst,
/// ns.
fn pause_after(burst_ns: Nanos, period_ns: u64) -> Nanos {
    let pause_ns = (PAUSE_PERIODS * period_ns as f64) as u64;
    if now() < burst_ns + BURST_PAUSES * pause_ns {
        return burst_ns;
    }
    sleep_until(now() + pause_ns);
    now()
}

/// Waits until fewer than [`ON_THEIR_WAY`] triples are in flight. Returns their number.
fn wait_for_room(credits: &Credits<()>, mut on_their_way: u64, fed: &mut Fed) -> u64 {
    on_their_way = on_their_way.saturating_sub(credits.try_iter().count() as u64);
    while on_their_way >= ON_THEIR_WAY {
        on_their_way -= 1;
        if credits.recv_timeout(GIVEN_UP) == Err(RecvTimeoutError::Timeout) {
            fed.given_up += 1;
        }
    }
    on_their_way
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn a_burst_ends_with_a_pause_and_a_short_one_goes_on() {
        let begun = now();
        assert_eq!(pause_after(begun + LEAD_NS, 4_000_000), begun + LEAD_NS, "it has yet to begin");
        assert!(pause_after(begun.saturating_sub(27_000_000), 4_000_000) >= begun + 3_000_000);
    }

    #[test]
    fn no_more_are_on_their_way_than_may_be_and_none_is_waited_for_for_ever() {
        let (poses, credits) = mpsc::channel();
        let mut fed = Fed::default();
        assert_eq!(wait_for_room(&credits, 3, &mut fed), 3, "there is room");
        (0..2).for_each(|_| poses.send(()).unwrap());
        assert_eq!(wait_for_room(&credits, ON_THEIR_WAY, &mut fed), ON_THEIR_WAY - 2);
        poses.send(()).unwrap();
        assert_eq!((wait_for_room(&credits, ON_THEIR_WAY, &mut fed), fed.given_up), (ON_THEIR_WAY - 1, 0));
        assert_eq!((wait_for_room(&credits, ON_THEIR_WAY, &mut fed), fed.given_up), (ON_THEIR_WAY - 1, 1));
    }
}
