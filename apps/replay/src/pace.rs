//! The span of a recording that is shown, and how fast.

use crate::stop::StopSignal;
use protocol::time::Nanos;
use settings::commands::ReplayArgs;
use std::time::{Duration, Instant};

/// The user stopped the replay.
#[derive(Debug, thiserror::Error)]
#[error("stopped")]
pub struct Stopped;

/// Selects the instants of a recording that are shown, and waits until they are due.
pub struct Pace {
    from_ns: u64,
    until_ns: Option<u64>,
    /// Wall time per time of the recording; `None` for as fast as possible.
    stretch: Option<f64>,
    stop: StopSignal,
    start: Option<Nanos>,
    /// Instants of recording and clock that belong together.
    tied: Option<(Nanos, Instant)>,
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
    pub fn new(args: &ReplayArgs, stop: &StopSignal) -> Self {
        let ns = |s: f64| (s * 1e9) as u64;
        Pace {
            from_ns: ns(args.span.from),
            until_ns: args.span.until.map(ns),
            stretch: (!args.is_unpaced()).then(|| 1.0 / args.rate),
            stop: stop.clone(),
            start: None,
            tied: None,
        }
    }

    /// Begins at the first instant again.
    pub fn rewind(&mut self) {
        (self.start, self.tied) = (None, None);
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

    /// Waits until an instant of the shown part is due.
    ///
    /// # Errors
    /// Where the user stops the replay.
    pub fn await_due(&mut self, at: Nanos) -> Result<(), Stopped> {
        if let Some(stretch) = self.stretch {
            let (recorded, clock) = *self.tied.get_or_insert_with(|| (at, Instant::now()));
            let since_ns = at.saturating_sub(recorded) as f64 * stretch;
            self.stop.wait_until(clock + Duration::from_nanos(since_ns as u64));
        }
        if self.stop.is_raised() { Err(Stopped) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_span_is_counted_from_the_first_instant() {
        let stop = StopSignal::default();
        let mut pace = Pace {
            from_ns: 10,
            until_ns: Some(20),
            stretch: None,
            stop: stop.clone(),
            start: None,
            tied: None,
        };
        let parts = [1000, 1009, 1010, 1020, 1021].map(|at| pace.part(at));
        assert_eq!(parts, [Part::Before, Part::Before, Part::Shown, Part::Shown, Part::After]);
        assert!(pace.await_due(1010).is_ok());
        stop.raise();
        assert!(pace.await_due(1010).is_err());
    }
}
