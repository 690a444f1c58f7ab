//! Whether the user has asked a replay to end.

use outputs::exit::INTERRUPTED;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Instant;

/// Raised once by a signal.
#[derive(Debug, Clone, Default)]
pub struct StopSignal(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    raised: AtomicBool,
    /// Held while the flag is raised, so that no thread that is about to wait misses it.
    waiting: Mutex<()>,
    changed: Condvar,
}

impl StopSignal {
    /// Takes the signals over from now on.
    ///
    /// # Errors
    /// Where the system refuses a handler.
    pub fn install() -> io::Result<Self> {
        let stop = StopSignal::default();
        let raise = stop.clone();
        ipc::signals::listen(INTERRUPTED, move || raise.raise())?;
        Ok(stop)
    }

    /// Raises it.
    pub fn raise(&self) {
        let held = self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        self.flag().store(true, Ordering::Relaxed);
        drop(held);
        self.0.changed.notify_all();
    }

    /// True once a signal has come.
    pub fn is_raised(&self) -> bool {
        self.flag().load(Ordering::Relaxed)
    }

    /// What is raised, for work on threads, which may raise it too.
    pub fn flag(&self) -> &AtomicBool {
        &self.0.raised
    }

    /// Waits until an instant or a signal.
    pub fn wait_until(&self, until: Instant) {
        let held = self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let left = until.saturating_duration_since(Instant::now());
        let waited = self.0.changed.wait_timeout_while(held, left, |()| !self.is_raised());
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}
