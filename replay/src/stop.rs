//! Ctrl-C, SIGTERM and SIGHUP: the first ends a replay in order, one that comes half a second or more
//! after it ends the program at once.

use outputs::exit::INTERRUPTED;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Signals this soon after the first say the same thing: `timeout` signals its program and then the
/// program's whole group.
const SAME_REQUEST: Duration = Duration::from_millis(500);

/// Raised once by a signal.
#[derive(Debug, Clone, Default)]
pub struct StopSignal(Arc<(Mutex<bool>, Condvar)>);

impl StopSignal {
    /// Takes the signals over from now on.
    ///
    /// # Errors
    /// Where the system refuses a handler.
    pub fn install() -> io::Result<Self> {
        let (stop, mut signals) = (StopSignal::default(), Signals::new([SIGINT, SIGTERM, SIGHUP])?);
        let raise = stop.clone();
        std::thread::Builder::new().name("signals".into()).spawn(move || {
            let mut first = None;
            for _ in signals.forever() {
                if first.get_or_insert_with(Instant::now).elapsed() >= SAME_REQUEST {
                    std::process::exit(INTERRUPTED.into());
                }
                raise.raise();
            }
        })?;
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
