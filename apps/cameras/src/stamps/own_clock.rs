//! The clock of a camera that knows no other one, brought to CLOCK_MONOTONIC. Pure.
//!
//! A picture comes some time after its stamp: the way from the sensor to here, and waiting on top of it, which is
//! never negative. So the least differences of arrival and stamp lie on a line, whose slope is how much faster
//! one clock runs than the other. The line is laid under the least difference of each of the last [`KEPT`]
//! stretches of time; an instant is the stamp plus the line.

use protocol::time::Nanos;
use std::collections::VecDeque;

/// Length of a stretch, ns of the camera's clock.
const STRETCH_NS: i64 = 1_000_000_000;
/// Stretches that are looked at.
const KEPT: usize = 8;
/// Stretches from which on a slope is believed.
const SLOPED: usize = 4;
/// Crystals of cameras and of computers differ by less than this share.
const STEEPEST: f64 = 2e-4;
/// A difference that is this far from the line is that of a clock that was set, not of a picture that waited, ns.
const JUMP_NS: i64 = 500_000_000;

/// The least difference of a stretch of time, and when it was, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Least {
    stretch: i64,
    stamp: i64,
    ahead: i64,
}

/// The clock of one camera.
#[derive(Debug, Clone, Default)]
pub struct OwnClock {
    least: VecDeque<Least>,
    slope: f64,
}

impl OwnClock {
    /// The instant of a stamp whose picture was there at `arrived`; `None` if the clock has been set: its
    /// offset is estimated again from this picture on.
    pub fn instant(&mut self, stamp: Nanos, arrived: Nanos) -> Option<Nanos> {
        let [stamp, arrived] = [stamp, arrived].map(|ns| i64::try_from(ns).ok());
        let (Some(stamp), Some(arrived)) = (stamp, arrived) else {
            self.least.clear();
            return None;
        };
        let ahead = arrived - stamp;
        let is_set = self.line(stamp).is_some_and(|line| ahead.abs_diff(line) > JUMP_NS as u64);
        if is_set {
            self.least.clear();
        }
        self.note(Least { stretch: stamp.div_euclid(STRETCH_NS), stamp, ahead });
        let line = self.line(stamp).unwrap_or(ahead).min(ahead);
        let instant = stamp.checked_add(line).and_then(|ns| Nanos::try_from(ns).ok());
        instant.filter(|_| !is_set)
    }

    /// Takes a difference in where it is the least of its stretch.
    fn note(&mut self, new: Least) {
        match self.least.back_mut().filter(|last| last.stretch == new.stretch) {
            Some(last) if last.ahead <= new.ahead => return,
            Some(last) => *last = new,
            None => {
                if self.least.len() == KEPT {
                    self.least.pop_front();
                }
                self.least.push_back(new);
            }
        }
        self.slope = self.fitted();
    }

    /// Slope of the line of least squares through what is kept of the stretches that are over: the least of the
    /// present one may be still to come. 0 while that is little.
    fn fitted(&self) -> f64 {
        let count = self.least.len().saturating_sub(1);
        let over = || self.least.iter().take(count);
        let Some(first) = self.least.front().filter(|_| count >= SLOPED) else { return 0.0 };
        let from = |l: &Least| ((l.stamp - first.stamp) as f64, l.ahead.saturating_sub(first.ahead) as f64);
        let mean = |of: fn((f64, f64)) -> f64| over().map(|l| of(from(l))).sum::<f64>() / count as f64;
        let (x_mean, y_mean) = (mean(|(x, _)| x), mean(|(_, y)| y));
        let sums = over().map(from).map(|(x, y)| (x - x_mean, y - y_mean));
        let (xx, xy) = sums.fold((0.0, 0.0), |(xx, xy), (x, y)| (xx + x * x, xy + x * y));
        if xx > 0.0 { (xy / xx).clamp(-STEEPEST, STEEPEST) } else { 0.0 }
    }

    /// How far CLOCK_MONOTONIC is ahead at a stamp, by the highest line of this slope that no difference is below.
    fn line(&self, stamp: i64) -> Option<i64> {
        let at = |l: &Least| l.ahead.saturating_add(((stamp - l.stamp) as f64 * self.slope) as i64);
        self.least.iter().map(at).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;
    const HOUR_NS: u64 = 3_600_000 * MS;

    /// Largest and mean error of the instants after ten seconds, ns: a camera at 200 Hz whose clock begins at
    /// `begin` and is faster by `ppm`, and whose pictures wait as `wait` says.
    fn errors(begin: u64, ppm: f64, wait: impl Fn(u64) -> u64) -> (i64, f64) {
        let mut clock = OwnClock::default();
        let mut all = Vec::new();
        for k in 0..6_000_u64 {
            let real = 77 * HOUR_NS + k * 5 * MS;
            let stamp = begin + ((k * 5 * MS) as f64 * (1.0 + ppm * 1e-6)) as u64;
            let instant = clock.instant(stamp, real + wait(k)).expect("no jump");
            assert!(instant <= real + wait(k), "a picture is never taken after it came");
            if k >= 2_000 {
                all.push(instant as i64 - real as i64);
            }
        }
        let worst = all.iter().copied().max_by_key(|e| e.abs()).unwrap();
        (worst, all.iter().sum::<i64>() as f64 / all.len() as f64)
    }

    #[test]
    fn waiting_and_drift_are_taken_out() {
        // One picture in nine waits for 0.3 ms alone; the others up to 4 ms more.
        let wait = |k: u64| 300_000 + (k * 7_919 % 9) * 500_000;
        for (begin, ppm) in [(0, 0.0), (5 * HOUR_NS, 50.0), (9 * 24 * HOUR_NS, -80.0), (3, 150.0)] {
            let (worst, mean) = errors(begin, ppm, wait);
            // The shortest wait stays: nothing here can know it.
            assert!((worst - 300_000).abs() < 60_000, "{ppm} ppm: {worst} ns");
            assert!((mean - 300_000.0).abs() < 30_000.0, "{ppm} ppm: {mean} ns");
        }
    }

    #[test]
    fn a_clock_that_is_set_is_told_once_and_learned_anew() {
        for jump in [HOUR_NS as i64, -(HOUR_NS as i64), -700 * MS as i64] {
            let mut clock = OwnClock::default();
            let mut told = Vec::new();
            for k in 0..400_u64 {
                let real = 2 * HOUR_NS + k * 20 * MS;
                let set = if k >= 200 { jump } else { 0 };
                let stamp = (5 * HOUR_NS + k * 20 * MS).saturating_add_signed(set);
                match clock.instant(stamp, real + MS) {
                    None => told.push(k),
                    Some(instant) => assert_eq!(instant, real + MS),
                }
            }
            assert_eq!(told, [200]);
        }
    }

    proptest! {
        /// Whatever stamps a camera invents: no instant is after the picture came.
        #[test]
        fn nothing_is_taken_after_it_came(pairs in prop::collection::vec((any::<u64>(), any::<u64>()), 1..80)) {
            let mut clock = OwnClock::default();
            for (stamp, arrived) in pairs {
                if let Some(instant) = clock.instant(stamp, arrived) {
                    prop_assert!(instant <= arrived);
                }
            }
        }
    }
}
