//! The tokio runtime of a command: signals, and waiting for channels.
//!
//! The command runs on the calling thread, because the ports of a channel must not change threads. One worker
//! thread serves the output of children and the timers, another thread the signals ([`ipc::signals`]), so
//! that a second Ctrl-C ends the program even while the command is busy.

use anyhow::Context;
use ipc::Wakes;
use std::future::{Future, pending, poll_fn};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::task::Poll;
use std::time::Duration;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::runtime::Builder;
use tokio::sync::watch;

pub use outputs::exit::INTERRUPTED;

/// Runs a command to its end.
///
/// # Errors
/// The errors of the command, and an error if the worker thread cannot be started.
pub fn block_on<T>(command: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build();
    runtime.context("start the runtime")?.block_on(command)
}

/// Raised by Ctrl-C, SIGTERM and SIGHUP. A signal half a second or more after the first one ends the program
/// at once.
#[derive(Debug, Clone)]
pub struct StopSignal(watch::Receiver<bool>);

impl StopSignal {
    /// Installs the signal handlers.
    ///
    /// # Errors
    /// If the system refuses a handler.
    pub fn install() -> anyhow::Result<Self> {
        let (raise, raised) = watch::channel(false);
        let asked = move || {
            raise.send_replace(true);
        };
        ipc::signals::listen(INTERRUPTED, asked).context("signals")?;
        Ok(Self(raised))
    }

    /// A signal that the test raises itself.
    #[cfg(test)]
    pub fn manual() -> (watch::Sender<bool>, Self) {
        let (raise, raised) = watch::channel(false);
        (raise, Self(raised))
    }

    /// True once a signal has arrived.
    pub fn is_raised(&self) -> bool {
        *self.0.borrow()
    }

    /// Waits for a signal; returns at once if one has arrived.
    pub async fn raised(&self) {
        if self.0.clone().wait_for(|raised| *raised).await.is_err() {
            pending().await
        }
    }
}

/// Wakes a task when one of several channels has new data.
pub struct Wakeups(Vec<AsyncFd<OwnedFd>>);

impl Wakeups {
    /// Listens to `sources`, as long as they are open.
    ///
    /// # Errors
    /// If no further descriptor can be opened.
    pub fn of(sources: &[&dyn Wakes]) -> io::Result<Self> {
        #[expect(deprecated, reason = "the successor is unsafe; this descriptor is owned and stays open")]
        let listen = |source: &&dyn Wakes| {
            let descriptor = source.listener().as_fd().try_clone_to_owned()?;
            AsyncFd::with_interest(descriptor, Interest::READABLE)
        };
        sources.iter().map(listen).collect::<io::Result<_>>().map(Self)
    }

    /// Waits for a notification, for at most `limit`, because a notification can be lost (data cannot).
    /// Afterwards the caller must consume the notifications (with [`ipc::wait`] and a timeout of 0) and drain
    /// every source.
    pub async fn wait(&self, limit: Duration) {
        let any = poll_fn(|context| {
            let mut woken = false;
            for descriptor in &self.0 {
                if let Poll::Ready(Ok(mut ready)) = descriptor.poll_read_ready(context) {
                    // Cleared before the caller drains, so that data that arrives later wakes it again.
                    ready.clear_ready();
                    woken = true;
                }
            }
            if woken { Poll::Ready(()) } else { Poll::Pending }
        });
        let _ = tokio::time::timeout(limit, any).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ipc::{Instance, Queue};
    use protocol::control::Request;
    use std::time::Instant;

    #[test]
    fn a_notification_wakes_and_silence_ends_with_the_limit() {
        let instance = Instance::own(&format!("rt-{}", std::process::id() % 1_000_000)).unwrap();
        let mut sender = instance.sender::<Request>().unwrap();
        let mut receiver = instance.receiver::<Request>(Queue::InOrder).unwrap();
        let work = async {
            let wakeups = Wakeups::of(&[&receiver])?;
            let (short, long) = (Duration::from_millis(20), Duration::from_secs(60));
            for seq in 0..3 {
                let begun = Instant::now();
                wakeups.wait(short).await;
                assert!(begun.elapsed() >= short, "nothing was sent");
                sender.send(&Request { seq, argument: 0, target: 0, command: 0 })?;
                let begun = Instant::now();
                wakeups.wait(long).await;
                assert!(begun.elapsed() < long / 2, "woken, not timed out");
                ipc::wait(&[&receiver], 0);
                assert_eq!(receiver.next_valid()?.map(|r| r.seq), Some(seq));
            }
            Ok(())
        };
        block_on(work).unwrap();
    }

    #[test]
    fn a_raised_signal_stays_raised() {
        let (raise, stop) = StopSignal::manual();
        assert!(!stop.is_raised());
        raise.send_replace(true);
        let work = async {
            stop.raised().await;
            stop.raised().await;
            Ok(stop.is_raised())
        };
        assert!(block_on(work).unwrap());
    }
}
