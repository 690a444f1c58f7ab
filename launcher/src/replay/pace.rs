//! The span of a recording that is shown, and how fast.

use super::ReplayArgs;
use super::stage::Stopped;
use ipc::clock::{now, sleep_until};
use protocol::time::Nanos;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Longest sleep without looking whether the user wants to stop, ns.
const LOOK_NS: u64 = 50_000_000;

/// Tells for instants of the recording whether they are shown, and waits until they are due.
pub struct Pace {
    from_ns: u64,
    until_ns: Option<u64>,
    /// Wall time per time of the recording; `None` for as fast as possible.
    stretch: Option<f64>,
    stop: Arc<AtomicBool>,
    start: Option<Nanos>,
    /// Instants of recording and clock that belong together.
    tied: Option<(Nanos, Nanos)>,
}

/// What to do with a block of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Before `--from`: computed, because what follows depends on it, but not shown.
    Before,
    /// To be shown.
    Shown,
    /// After `--until`.
    After,
}

impl Pace {
    /// From the arguments.
    pub fn new(args: &ReplayArgs, stop: &Arc<AtomicBool>) -> Self {
        let ns = |s: f64| (s * 1e9) as u64;
        Pace {
            from_ns: ns(args.from),
            until_ns: args.until.map(ns),
            stretch: (!args.lockstep).then(|| 1.0 / args.rate),
            stop: Arc::clone(stop),
            start: None,
            tied: None,
        }
    }

    /// Begins at the first instant again.
    pub fn rewind(&mut self) {
        (self.start, self.tied) = (None, None);
    }

    /// True if blocks may be sent ahead of their time.
    pub fn is_lockstep(&self) -> bool {
        self.stretch.is_none()
    }

    /// The part in which an instant lies; the first one asked for is the recording's start.
    pub fn part(&mut self, at: Nanos) -> Part {
        let since = at.saturating_sub(*self.start.get_or_insert(at));
        match self.until_ns {
            Some(until) if since > until => Part::After,
            _ if since < self.from_ns => Part::Before,
            _ => Part::Shown,
        }
    }

    /// Sleeps until an instant of the shown part is due.
    pub fn await_due(&mut self, at: Nanos) -> Result<(), Stopped> {
        if let Some(stretch) = self.stretch {
            let (recorded, clock) = *self.tied.get_or_insert((at, now()));
            let due = clock + (at.saturating_sub(recorded) as f64 * stretch) as u64;
            while now() < due && !self.stop.load(Ordering::Relaxed) {
                sleep_until(due.min(now() + LOOK_NS));
            }
        }
        if self.stop.load(Ordering::Relaxed) { Err(Stopped) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_span_is_counted_from_the_first_instant() {
        let mut pace = Pace {
            from_ns: 10,
            until_ns: Some(20),
            stretch: None,
            stop: Arc::default(),
            start: None,
            tied: None,
        };
        let parts = [1000, 1009, 1010, 1020, 1021].map(|at| pace.part(at));
        assert_eq!(parts, [Part::Before, Part::Before, Part::Shown, Part::Shown, Part::After]);
        pace.stop.store(true, Ordering::Relaxed);
        assert!(pace.await_due(1010).is_err());
    }
}
