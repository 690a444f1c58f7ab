//! A limit to how long it may take to open a part of shared memory: iceoryx2 waits for what another
//! process seems to be making, and a process that waits says nothing.

use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

/// How long opening a node or a port may take; usually it takes milliseconds.
const LIMIT: Duration = Duration::from_secs(5);
/// It is counted in so many parts: a time for which the process was stopped is one of them.
const TICKS: u32 = 10;
/// Exit code of a process that cannot open its channels.
const FAILED: i32 = 1;

/// Ends the process with an error where it is not dropped in time.
pub(super) struct OpenLimit {
    _done: mpsc::Sender<()>,
}

impl OpenLimit {
    /// From now on; `channel` is what is opened.
    pub fn start(channel: &'static str, directory: &Path) -> Self {
        let directory = directory.display().to_string();
        Self::of(LIMIT, move || {
            tracing::error!(
                "channel {channel}: not open after {} s; something holds the shared memory of {directory}: \
                 end it, or choose another --instance NAME",
                LIMIT.as_secs()
            );
            std::process::exit(FAILED);
        })
    }

    /// Calls `late` where it is not dropped within `limit`.
    fn of(limit: Duration, late: impl FnOnce() + Send + 'static) -> Self {
        let (done, waits) = mpsc::channel::<()>();
        let watch = move || {
            if (0..TICKS).all(|_| waits.recv_timeout(limit / TICKS) == Err(RecvTimeoutError::Timeout)) {
                late();
            }
        };
        // Without a thread there is no limit, and most likely nothing that is late.
        let _ = thread::Builder::new().name("open-limit".into()).spawn(watch);
        OpenLimit { _done: done }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_open_in_time_is_left_alone_and_the_rest_is_told() {
        let (told, hears) = mpsc::channel();
        let late = told.clone();
        drop(OpenLimit::of(LIMIT, move || _ = told.send("in time")));
        let limit = OpenLimit::of(Duration::ZERO, move || _ = late.send("late"));
        assert_eq!(hears.recv().as_deref(), Ok("late"));
        drop(limit);
        assert!(hears.recv().is_err(), "neither is notified any more");
    }
}
