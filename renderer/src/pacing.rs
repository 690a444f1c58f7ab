//! When a frame will be seen: pure estimates from instants that are passed in.

use protocol::time::Nanos;

/// Share by which a new measurement moves an estimate.
const GAIN: f64 = 0.1;

/// Estimates how long it takes from the latch until the picture is seen.
#[derive(Debug, Clone, Copy)]
pub struct Pacing {
    latch_to_seen_ns: f64,
    /// Period of the display; `None` without one.
    refresh_ns: Option<u64>,
}

impl Pacing {
    /// For a display with a refresh period, or none; begins with a guess of half the budget.
    pub fn new(refresh_ns: Option<u64>, budget_ns: u64) -> Self {
        Self { latch_to_seen_ns: budget_ns as f64 * 0.5, refresh_ns }
    }

    /// Instant at which a picture latched at `latched` will be seen, as far as one can tell;
    /// `refreshed` is an instant at which the display was last refreshed.
    pub fn expected(&self, latched: Nanos, refreshed: Nanos) -> Nanos {
        let drawn = latched + self.latch_to_seen_ns as u64;
        self.seen(drawn, refreshed)
    }

    /// First refresh after `drawn`; without a display `drawn` itself.
    pub fn seen(&self, drawn: Nanos, refreshed: Nanos) -> Nanos {
        match self.refresh_ns {
            Some(period) if period > 0 && drawn >= refreshed => {
                refreshed + (drawn - refreshed).div_ceil(period).max(1) * period
            }
            _ => drawn,
        }
    }

    /// Learns from a frame.
    pub fn note(&mut self, latched: Nanos, drawn: Nanos) {
        let took = drawn.saturating_sub(latched) as f64;
        self.latch_to_seen_ns += GAIN * (took - self.latch_to_seen_ns);
    }
}

/// Instants k / rate of an output at a constant rate.
#[derive(Debug, Clone, Copy)]
pub struct Ticks {
    period_ns: u64,
    next_ns: Option<Nanos>,
}

impl Ticks {
    /// `hz` times a second; 0 means never.
    pub fn new(hz: f64) -> Self {
        let period_ns = if hz > 0.0 { (1e9 / hz) as u64 } else { 0 };
        Self { period_ns, next_ns: None }
    }

    /// How many ticks have passed up to `at`; the first call is the first tick.
    pub fn due(&mut self, at: Nanos) -> u64 {
        if self.period_ns == 0 {
            return 0;
        }
        let next = self.next_ns.unwrap_or(at);
        if at < next {
            return 0;
        }
        let ticks = (at - next) / self.period_ns + 1;
        self.next_ns = Some(next + ticks * self.period_ns);
        ticks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headless_pictures_are_seen_when_drawn() {
        let mut pacing = Pacing::new(None, 15_000_000);
        (0..200).for_each(|_| pacing.note(1_000, 9_001_000));
        let expected = pacing.expected(50_000_000, 0);
        assert!((expected as i64 - 59_000_000).abs() < 10_000, "{expected}");
        assert_eq!(pacing.seen(7, 0), 7);
    }

    #[test]
    fn displays_show_at_their_refresh() {
        let pacing = Pacing::new(Some(10), 0);
        assert_eq!(pacing.seen(101, 100), 110);
        assert_eq!(pacing.seen(110, 100), 110);
        assert_eq!(pacing.seen(100, 100), 110, "the refresh at which it was begun is over");
        assert_eq!(pacing.seen(125, 100), 130);
    }

    #[test]
    fn ticks_keep_their_mean_rate() {
        let mut ticks = Ticks::new(25.0);
        let total: u64 = (0..=50).map(|i| ticks.due(1_000 + i * 20_000_000)).sum();
        assert_eq!(total, 26, "one second holds 25 periods");
        assert_eq!(ticks.due(1_000 + 2_000_000_000), 25, "a gap is caught up with");
        assert_eq!(Ticks::new(0.0).due(1), 0);
    }
}
