//! Whether the user has asked a replay to end.

use outputs::exit::INTERRUPTED;
use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Instant;

/// Raised once by a signal.
#[derive(Debug, Clone, Default)]
pub struct StopSignal(Arc<(Mutex<bool>, Condvar)>);

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
        let (raised, changed) = &*self.0;
        *raised.lock().unwrap_or_else(PoisonError::into_inner) = true;
        changed.notify_all();
    }

    /// True once a signal has come.
    pub fn is_raised(&self) -> bool {
        *self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until an instant or a signal.
    pub fn wait_until(&self, until: Instant) {
        let (raised, changed) = &*self.0;
        let guard = raised.lock().unwrap_or_else(PoisonError::into_inner);
        let left = until.saturating_duration_since(Instant::now());
        let waited = changed.wait_timeout_while(guard, left, |raised| !*raised);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}
