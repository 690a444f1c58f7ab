//! Estimates of when a frame will be displayed. Pure: instants are arguments.

use protocol::time::Nanos;

/// Share by which a new measurement moves an estimate.
const GAIN: f64 = 0.1;

/// Mean deviations of a frame's time by which it begins earlier than its mean requires.
const SPREADS: f64 = 3.0;
/// Time by which it begins earlier still, ns: a wake-up on a quiet machine.
const WAKE_NS: f64 = 500_000.0;

/// Most refreshes by which a display is believed to show pictures later (or earlier) than estimated.
const MOST_KEPT: f64 = 4.0;

/// Estimator of the time from latch to display, and of the latest begin of a frame.
#[derive(Debug, Clone, Copy)]
pub struct Pacing {
    latch_to_seen_ns: f64,
    start_to_seen_ns: f64,
    /// Mean deviation of the latter.
    spread_ns: f64,
    /// Period of the display; `None` without one.
    refresh_ns: Option<u64>,
    /// By how much later than at the first refresh after it is drawn a picture is shown: a compositor may keep it for
    /// a refresh.
    kept_ns: f64,
}

impl Pacing {
    /// For a display with a refresh period, or none; begins with a guess of half the budget.
    pub fn new(refresh_ns: Option<u64>, budget_ns: u64) -> Self {
        let guess = budget_ns as f64 * 0.5;
        Self {
            latch_to_seen_ns: guess,
            start_to_seen_ns: guess,
            spread_ns: 0.1 * guess,
            refresh_ns,
            kept_ns: 0.0,
        }
    }

    /// Estimated display of a picture latched at `latched`; `refreshed` is an instant at which the
    /// display was refreshed.
    pub fn expected(&self, latched: Nanos, refreshed: Nanos) -> Nanos {
        let drawn = latched + self.latch_to_seen_ns as u64;
        self.shown_after(self.next_refresh(drawn, refreshed))
    }

    /// When a picture is shown that is ready for the refresh at `refresh`.
    pub fn shown_after(&self, refresh: Nanos) -> Nanos {
        refresh.saturating_add_signed(self.kept_ns as i64)
    }

    /// Learns from the display's word: a picture was shown by so much later than estimated, ns.
    pub fn note_shown(&mut self, later_ns: i64) {
        let most = self.refresh_ns.map_or(0.0, |period| MOST_KEPT * period as f64);
        self.kept_ns = (self.kept_ns + GAIN * later_ns as f64).clamp(-most, most);
    }

    /// First refresh after `drawn`; without a display `drawn` itself.
    pub fn next_refresh(&self, drawn: Nanos, refreshed: Nanos) -> Nanos {
        match self.refresh_ns {
            Some(period) if period > 0 && drawn >= refreshed => {
                refreshed + (drawn - refreshed).div_ceil(period).max(1) * period
            }
            _ => drawn,
        }
    }

    /// The latest instant from `earliest` on at which a frame may begin and still be seen at a
    /// refresh as early as if it began at once: so the pose it takes is the newest possible.
    /// `earliest` itself without a display.
    pub fn start_at(&self, earliest: Nanos, refreshed: Nanos) -> Nanos {
        let Some(period) = self.refresh_ns.filter(|&p| p > 0) else { return earliest };
        let lead = (self.start_to_seen_ns + SPREADS * self.spread_ns + WAKE_NS) as u64;
        let seen = self.next_refresh(earliest + lead, refreshed);
        // Nothing is gained by waiting longer than for one refresh, whatever was handed in.
        seen.saturating_sub(lead).clamp(earliest, earliest + period)
    }

    /// Refreshes that showed nothing new because a picture begun after the refresh at `refreshed`
    /// came at `displayed` only.
    pub fn missed(&self, refreshed: Nanos, displayed: Nanos) -> u64 {
        let period = self.refresh_ns.filter(|&p| p > 0);
        period.map_or(0, |p| (displayed.saturating_sub(refreshed) / p).saturating_sub(1))
    }

    /// Updates the estimates with a frame.
    pub fn record_frame(&mut self, start: Nanos, latched: Nanos, seen: Nanos) {
        let took = seen.saturating_sub(latched) as f64;
        self.latch_to_seen_ns += GAIN * (took - self.latch_to_seen_ns);
        let off = seen.saturating_sub(start) as f64 - self.start_to_seen_ns;
        self.start_to_seen_ns += GAIN * off;
        self.spread_ns += GAIN * (off.abs() - self.spread_ns);
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
        (0..200).for_each(|_| pacing.record_frame(0, 1_000, 9_001_000));
        let expected = pacing.expected(50_000_000, 0);
        assert!((expected as i64 - 59_000_000).abs() < 10_000, "{expected}");
        assert_eq!(pacing.next_refresh(7, 0), 7);
    }

    #[test]
    fn displays_show_at_their_refresh() {
        let pacing = Pacing::new(Some(10), 0);
        assert_eq!(pacing.next_refresh(101, 100), 110);
        assert_eq!(pacing.next_refresh(110, 100), 110);
        assert_eq!(pacing.next_refresh(100, 100), 110, "the refresh at which it was begun is over");
        assert_eq!(pacing.next_refresh(125, 100), 130);
    }

    #[test]
    fn a_frame_begins_as_late_as_its_refresh_allows() {
        const PERIOD: u64 = 11_764_706;
        let mut pacing = Pacing::new(Some(PERIOD), 15_000_000);
        (0..300).for_each(|_| pacing.record_frame(0, 100_000, 4_000_000));
        // 4 ms of work and 0.5 for waking: it begins 7.26 ms after the refresh, and is seen at the
        // next.
        let begin = pacing.start_at(1_000, 1_000);
        assert!((begin as i64 - (1_000 + PERIOD as i64 - 4_500_000)).abs() < 10_000, "{begin}");
        assert_eq!(pacing.next_refresh(begin + 4_000_000, 1_000), 1_000 + PERIOD);
        // With a spread of 1 ms it begins earlier; where only the refresh after can be met, later.
        (0..300).for_each(|i| pacing.record_frame(0, 100_000, 4_000_000 + 2_000_000 * (i % 2) - 1_000_000));
        assert!(pacing.start_at(1_000, 1_000) < begin - 2_000_000);
        let late = pacing.start_at(1_000 + PERIOD - 1_000_000, 1_000);
        assert!(late > 1_000 + PERIOD && late + 4_000_000 < 1_000 + 2 * PERIOD);
        assert_eq!(Pacing::new(None, 15_000_000).start_at(77, 0), 77, "no display, no waiting");
    }

    #[test]
    fn a_refresh_without_a_new_picture_is_missed_and_nothing_is_caught_up() {
        let pacing = Pacing::new(Some(10), 0);
        // Frames of 8, 27 and 8: seen at 10, 40 and 50. The refreshes at 20 and 30 showed nothing
        // new.
        let (mut refreshed, mut missed, mut seen) = (0, 0, Vec::new());
        for took in [8, 27, 8] {
            let displayed = pacing.next_refresh(refreshed + took, refreshed);
            missed += pacing.missed(refreshed, displayed);
            seen.push(displayed);
            refreshed = displayed;
        }
        assert_eq!((seen, missed), (vec![10, 40, 50], 2));
        assert_eq!(Pacing::new(None, 0).missed(0, 1_000), 0);
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
