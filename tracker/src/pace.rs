//! What of the tracker follows from the period of the cameras.
//!
//! Windows of time are counted in periods, and are as long at every faster rate as at 50 Hz: what a body does
//! within them does not depend on the cameras. Decisions that take some fields, and gains of running means, take
//! the same time at a faster rate, and as many fields at a slower one. At 50 Hz all are what they were tuned to be.

use crate::constants as k;
use protocol::limits::FIELD_PERIOD_NS;
use rig::Rig;

/// Windows and counts at a rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// From field to field of a camera, ns.
    pub period_ns: u64,
    /// Camera-fields this close belong to one update, ns.
    pub group_ns: u64,
    /// Greatest age of a field used for acquisition, ns.
    pub acquisition_ns: u64,
    /// Time without two cameras after which a body is searched, ns.
    pub acquire_after_ns: u64,
    /// Time after its last blob for which a camera counts as seeing a body, ns.
    pub seen_ns: u64,
    /// Time after two cameras saw a body for which one camera alone still measures it, ns.
    pub one_camera_ns: u64,
    /// Time within which jumps of two cameras show a wrong prediction and not a moved camera, ns.
    pub together_ns: u64,
    /// Time without a field after which a camera does not count as sending, ns.
    pub silent_ns: u64,
}

impl Pace {
    /// At the rate of a rig.
    pub fn new(rig: &Rig) -> Self {
        Self::of_period(rig.field_period_ns())
    }

    fn of_period(period_ns: u64) -> Self {
        let longer = period_ns.max(FIELD_PERIOD_NS);
        let window = |quarters: u64| longer / 4 * quarters;
        Pace {
            period_ns,
            group_ns: k::GROUP_NS.min(period_ns / 4),
            acquisition_ns: window(k::ACQUISITION_QUARTERS),
            acquire_after_ns: window(k::ACQUIRE_AFTER_QUARTERS),
            seen_ns: window(k::SEEN_QUARTERS),
            one_camera_ns: window(k::ONE_CAMERA_QUARTERS),
            together_ns: window(k::KNOCK_TOGETHER_QUARTERS),
            silent_ns: window(k::SILENT_QUARTERS),
        }
    }

    /// True if what follows the rig itself takes the field exposed at `time_ns`: one every 20 ms is enough where
    /// cameras are faster.
    pub fn looks_at_rig(&self, time_ns: u64) -> bool {
        self.period_ns >= FIELD_PERIOD_NS
            || time_ns / FIELD_PERIOD_NS != time_ns.saturating_sub(self.period_ns) / FIELD_PERIOD_NS
    }

    /// Fields that take as long as so many do at 50 Hz; no fewer than those.
    pub fn fields(&self, at_50_hz: u64) -> u64 {
        at_50_hz.max((at_50_hz * FIELD_PERIOD_NS + self.period_ns / 2) / self.period_ns.max(1))
    }

    /// Gain of a running mean over fields that remembers as long as one of `at_50_hz` does at 50 Hz; no larger
    /// than that.
    pub fn gain(&self, at_50_hz: f64) -> f64 {
        if self.period_ns >= FIELD_PERIOD_NS {
            return at_50_hz;
        }
        1.0 - libm::pow(1.0 - at_50_hz, self.period_ns as f64 / FIELD_PERIOD_NS as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_50_hz_all_is_as_tuned() {
        let pace = Pace::of_period(FIELD_PERIOD_NS);
        let ms = [pace.acquisition_ns, pace.acquire_after_ns, pace.seen_ns, pace.one_camera_ns]
            .map(|ns| ns as f64 * 1e-6);
        assert_eq!(ms, [25.0, 30.0, 30.0, 45.0]);
        assert_eq!([pace.group_ns, pace.together_ns, pace.silent_ns], [1_000_000, 25_000_000, 50_000_000]);
        assert_eq!((pace.fields(5), pace.gain(0.05)), (5, 0.05));
    }

    #[test]
    fn decisions_take_as_long_at_every_faster_rate() {
        for hz in [60, 100, 200, 500] {
            let pace = Pace::of_period(1_000_000_000 / hz);
            assert_eq!(pace.seen_ns, 30_000_000);
            assert_eq!(pace.fields(5), hz / 10);
            let kept = libm::pow(1.0 - pace.gain(0.05), hz as f64);
            assert!((kept - libm::pow(0.95, 50.0)).abs() < 1e-6, "{hz} Hz: {kept}");
            assert!(4 * pace.group_ns <= pace.period_ns, "a group never spans two fields of a camera");
        }
        let fast = Pace::of_period(5_000_000);
        let looked = (0..400).filter(|n| fast.looks_at_rig(47_000_000 + n * 5_000_000)).count();
        assert_eq!(looked, 100);
        let slow = Pace::of_period(40_000_000);
        assert_eq!((slow.seen_ns, slow.fields(5), slow.gain(0.05)), (60_000_000, 5, 0.05));
    }
}
