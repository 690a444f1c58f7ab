//! The tracker's constants at the rate of the cameras.
//!
//! Windows of time are counted in periods, and are as long at every faster rate as at 50 Hz: what a body does
//! within them does not depend on the cameras. Decisions that take some fields, and gains of running means, take
//! the same time at a faster rate, and as many fields at a slower one. At 50 Hz all are what they were tuned to be.
//!
//! Where cameras have different rates, frames come at that of the fastest; a window of time is one in which the
//! slowest sends too, and fields of a camera are counted at its own rate.

use crate::constants as k;
use protocol::limits::{FIELD_PERIOD_NS, MAX_CAMERAS};
use rig::Rig;

/// Windows, counts and gains at a rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateConstants {
    /// From frame to frame, ns: from field to field of the fastest camera.
    pub period_ns: u64,
    /// From field to field of each camera, ns, by id.
    camera_periods_ns: [u64; MAX_CAMERAS],
    /// The slowest camera, where not all have one rate.
    pub slowest: Option<usize>,
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
    /// Gain of the running reduced χ² of a body.
    pub chi2_gain: f64,
    /// Step of the running scale of a camera's areas.
    pub area_scale_step: f64,
    /// Gain of the running ratio of the NIS to its expectation.
    pub nis_ratio_gain: f64,
    /// Updates without the eye after which it is searched without each of the cameras.
    pub without_eye_updates: u32,
    /// Updates without the eye, though two cameras see its markers, after which the cameras disagree.
    pub disagree_updates: u32,
}

impl RateConstants {
    /// At the rate of a rig.
    pub fn new(rig: &Rig) -> Self {
        let mut camera_periods_ns = [rig.field_period_ns(); MAX_CAMERAS];
        for sensor in rig.sensors() {
            if let Some(period_ns) = camera_periods_ns.get_mut(sensor.camera as usize) {
                *period_ns = sensor.period_ns;
            }
        }
        Self::of_periods(rig.field_period_ns(), camera_periods_ns)
    }

    fn of_periods(period_ns: u64, camera_periods_ns: [u64; MAX_CAMERAS]) -> Self {
        let longest_ns = camera_periods_ns.into_iter().fold(period_ns, u64::max);
        let longer = longest_ns.max(FIELD_PERIOD_NS);
        let window = |quarters: u64| longer / 4 * quarters;
        RateConstants {
            period_ns,
            camera_periods_ns,
            slowest: camera_periods_ns.iter().position(|ns| *ns == longest_ns && longest_ns > period_ns),
            group_ns: k::GROUP_NS.min(period_ns / 4),
            acquisition_ns: window(k::ACQUISITION_QUARTERS),
            acquire_after_ns: window(k::ACQUIRE_AFTER_QUARTERS),
            seen_ns: window(k::SEEN_QUARTERS),
            one_camera_ns: window(k::ONE_CAMERA_QUARTERS),
            together_ns: window(k::KNOCK_TOGETHER_QUARTERS),
            silent_ns: window(k::SILENT_QUARTERS),
            chi2_gain: gain(period_ns, k::CHI2_STEP),
            area_scale_step: gain(period_ns, k::AREA_SCALE_STEP),
            nis_ratio_gain: gain(period_ns, k::NIS_RATIO_GAIN),
            without_eye_updates: fields(period_ns, k::WITHOUT_EYE_UPDATES),
            disagree_updates: fields(period_ns, k::DISAGREE_UPDATES),
        }
    }

    /// Fields of a camera that jump in a row after which it is left out.
    pub fn jumping_fields(&self, camera: usize) -> u32 {
        fields(self.camera_periods_ns[camera], k::KNOCK_FIELDS)
    }

    /// Fields without a jump after which a suspected camera is trusted.
    pub fn calm_fields(&self, camera: usize) -> u32 {
        fields(self.camera_periods_ns[camera], k::KNOCK_CALM_FIELDS)
    }

    /// True if what follows the rig itself takes the frame of `time_ns`: one every 20 ms is enough where cameras are
    /// faster.
    pub fn looks_at_rig(&self, time_ns: u64) -> bool {
        is_one_of_50_hz(self.period_ns, time_ns)
    }

    /// The same of a field of one camera.
    pub fn looks_at_camera(&self, camera: usize, time_ns: u64) -> bool {
        is_one_of_50_hz(self.camera_periods_ns[camera], time_ns)
    }
}

/// True for one instant in 20 ms of those that come every `period_ns`.
fn is_one_of_50_hz(period_ns: u64, time_ns: u64) -> bool {
    period_ns >= FIELD_PERIOD_NS
        || time_ns / FIELD_PERIOD_NS != time_ns.saturating_sub(period_ns) / FIELD_PERIOD_NS
}

/// Fields that take as long as so many do at 50 Hz; no fewer than those.
fn fields(period_ns: u64, at_50_hz: u32) -> u32 {
    let as_long = (u64::from(at_50_hz) * FIELD_PERIOD_NS + period_ns / 2) / period_ns.max(1);
    at_50_hz.max(u32::try_from(as_long).unwrap_or(u32::MAX))
}

/// Gain of a running mean over fields that remembers as long as one of `at_50_hz` does at 50 Hz; no larger than
/// that.
fn gain(period_ns: u64, at_50_hz: f64) -> f64 {
    if period_ns >= FIELD_PERIOD_NS {
        return at_50_hz;
    }
    1.0 - libm::pow(1.0 - at_50_hz, period_ns as f64 / FIELD_PERIOD_NS as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_period(period_ns: u64) -> RateConstants {
        RateConstants::of_periods(period_ns, [period_ns; MAX_CAMERAS])
    }

    #[test]
    fn at_50_hz_all_is_as_tuned() {
        let at_rate = of_period(FIELD_PERIOD_NS);
        let ms = [at_rate.acquisition_ns, at_rate.acquire_after_ns, at_rate.seen_ns, at_rate.one_camera_ns]
            .map(|ns| ns as f64 * 1e-6);
        assert_eq!(ms, [25.0, 30.0, 30.0, 45.0]);
        assert_eq!(
            [at_rate.group_ns, at_rate.together_ns, at_rate.silent_ns],
            [1_000_000, 25_000_000, 50_000_000]
        );
        assert_eq!(
            [at_rate.jumping_fields(0), at_rate.calm_fields(0)],
            [k::KNOCK_FIELDS, k::KNOCK_CALM_FIELDS]
        );
        assert_eq!([at_rate.chi2_gain, at_rate.nis_ratio_gain], [k::CHI2_STEP, k::NIS_RATIO_GAIN]);
    }

    #[test]
    fn decisions_take_as_long_at_every_faster_rate() {
        for hz in [60, 100, 200, 500] {
            let at_rate = of_period(1_000_000_000 / hz);
            assert_eq!(at_rate.seen_ns, 30_000_000);
            assert_eq!(u64::from(at_rate.jumping_fields(0)), hz / 10);
            let kept = libm::pow(1.0 - at_rate.chi2_gain, hz as f64);
            assert!((kept - libm::pow(0.95, 50.0)).abs() < 1e-6, "{hz} Hz: {kept}");
            assert!(4 * at_rate.group_ns <= at_rate.period_ns, "a group never spans two fields of a camera");
        }
        let fast = of_period(5_000_000);
        let looked = (0..400).filter(|n| fast.looks_at_rig(47_000_000 + n * 5_000_000)).count();
        assert_eq!(looked, 100);
        let slow = of_period(40_000_000);
        assert_eq!((slow.seen_ns, slow.jumping_fields(0), slow.chi2_gain), (60_000_000, 5, k::CHI2_STEP));
        assert!(slow.acquire_after_ns < k::LOST_AFTER_NS, "a body is searched before it is lost");
    }

    #[test]
    fn windows_hold_a_field_of_the_slowest_camera_and_counts_are_each_cameras_own() {
        let mut periods_ns = [5_000_000; MAX_CAMERAS];
        (periods_ns[1], periods_ns[2]) = (10_000_000, 40_000_000);
        let mixed = RateConstants::of_periods(5_000_000, periods_ns);
        assert_eq!((mixed.slowest, of_period(5_000_000).slowest), (Some(2), None));
        assert_eq!((mixed.seen_ns, mixed.silent_ns), (60_000_000, 100_000_000));
        assert_eq!([0, 1, 2].map(|camera| mixed.jumping_fields(camera)), [20, 10, 5]);
        assert_eq!((mixed.period_ns, mixed.group_ns), (5_000_000, 1_000_000));
        // Whatever its phase, a camera is looked at once in 20 ms or with each of its fields.
        for phase_ns in (0..20).map(|ms| 47_000_000 + ms * 1_000_000) {
            let looked = |camera: usize| {
                let at = |n: u64| phase_ns + n * periods_ns[camera];
                (0..40).filter(|&n| mixed.looks_at_camera(camera, at(n))).count()
            };
            assert_eq!([0, 1, 2].map(looked), [10, 20, 40]);
        }
    }
}
