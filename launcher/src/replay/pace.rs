//! The span of a recording that is shown, and how fast.

use super::ReplayArgs;
use super::processes::Stopped;
use crate::runtime::StopSignal;
use protocol::time::Nanos;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

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
            stretch: (!args.lockstep).then(|| 1.0 / args.rate),
            stop: stop.clone(),
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

    /// Waits until an instant of the shown part is due.
    ///
    /// # Errors
    /// Where the user stops the replay.
    pub async fn await_due(&mut self, at: Nanos) -> Result<(), Stopped> {
        if let Some(stretch) = self.stretch {
            let (recorded, clock) = *self.tied.get_or_insert_with(|| (at, Instant::now()));
            let since_ns = at.saturating_sub(recorded) as f64 * stretch;
            tokio::select! {
                () = sleep_until(clock + Duration::from_nanos(since_ns as u64)) => {}
                () = self.stop.raised() => {}
            }
        }
        if self.stop.is_raised() { Err(Stopped) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_span_is_counted_from_the_first_instant() {
        let (raise, stop) = StopSignal::manual();
        let mut pace = Pace { from_ns: 10, until_ns: Some(20), stretch: None, stop, start: None, tied: None };
        let parts = [1000, 1009, 1010, 1020, 1021].map(|at| pace.part(at));
        assert_eq!(parts, [Part::Before, Part::Before, Part::Shown, Part::Shown, Part::After]);
        raise.send_replace(true);
        assert!(pace.await_due(1010).await.is_err());
    }
}
