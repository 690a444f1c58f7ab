//! Filters of a tip's movement: smoothing for ways and speeds, and the band of tremor.

use super::table::TREMOR_BAND_HZ;
use nalgebra::Vector3;
use protocol::limits::FIELD_PERIOD_NS;
use serde::{Deserialize, Serialize};

/// Time constant of each of the two smoothing stages, s.
const SMOOTHING_S: f64 = 0.1;
/// A gap that differs from the field's period by more than this begins the filters anew, ns.
const JITTER_NS: u64 = 2_000_000;
/// Samples after which the band's filter has settled: 1 s.
const SETTLED: u32 = 50;
/// Share of white noise's power (0 to 25 Hz) that the band lets through.
pub const NOISE_SHARE: f64 = (TREMOR_BAND_HZ[1] - TREMOR_BAND_HZ[0]) / 25.0;

/// Coefficients of a second-order section, a0 = 1.
#[derive(Debug, Clone, Copy)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
}

/// Two values kept for each axis of a section.
type Memory = [Vector3<f64>; 2];

impl Section {
    /// A section of a Butterworth low or high pass at `hz` (bilinear transform, as in
    /// Bristow-Johnson's cookbook).
    fn new(hz: f64, q: f64, high: bool) -> Self {
        let w = std::f64::consts::TAU * hz * FIELD_PERIOD_NS as f64 * 1e-9;
        let (cos, alpha) = (libm::cos(w), libm::sin(w) / (2.0 * q));
        let (edge, middle) =
            if high { (0.5 * (1.0 + cos), -(1.0 + cos)) } else { (0.5 * (1.0 - cos), 1.0 - cos) };
        let a0 = 1.0 + alpha;
        Section { b: [edge / a0, middle / a0, edge / a0], a: [-2.0 * cos / a0, (1.0 - alpha) / a0] }
    }

    fn pass(&self, x: Vector3<f64>, memory: &mut Memory) -> Vector3<f64> {
        let y = x * self.b[0] + memory[0];
        memory[0] = x * self.b[1] - y * self.a[0] + memory[1];
        memory[1] = x * self.b[2] - y * self.a[1];
        y
    }
}

/// Quality of the two sections of a Butterworth filter with four poles.
const FOUR_POLES: [f64; 2] = [0.541_196_100_146_197, 1.306_562_964_876_376_4];

/// The band's four sections.
#[derive(Debug, Clone)]
pub struct Band([Section; 4]);

impl Default for Band {
    fn default() -> Self {
        let [low, high] = TREMOR_BAND_HZ;
        let [first, second] = FOUR_POLES;
        Band([
            Section::new(low, first, true),
            Section::new(low, second, true),
            Section::new(high, first, false),
            Section::new(high, second, false),
        ])
    }
}

/// A tip as the filters keep it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TipFilter {
    last_ns: u64,
    /// Filters begin at the first position, so that it makes no step.
    origin_mm: Vector3<f64>,
    smooth: [Vector3<f64>; 2],
    band: [Memory; 4],
    samples: u32,
}

impl Default for TipFilter {
    fn default() -> Self {
        let zero = Vector3::zeros();
        TipFilter { last_ns: 0, origin_mm: zero, smooth: [zero; 2], band: [[zero; 2]; 4], samples: 0 }
    }
}

/// What the filters say of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filtered {
    /// Way of the smoothed tip since the last sample, mm.
    pub way_mm: f64,
    /// Its speed, mm/s.
    pub speed_mm_s: f64,
    /// Movement in the tremor's band, mm, once the filter has settled.
    pub tremor_mm: Option<Vector3<f64>>,
}

impl TipFilter {
    /// Takes a tip in; `None` for the first after a gap.
    pub fn pass(&mut self, band: &Band, tip_mm: &Vector3<f64>, at_ns: u64) -> Option<Filtered> {
        let dt_ns = at_ns.saturating_sub(self.last_ns);
        if self.last_ns == 0 || dt_ns.abs_diff(FIELD_PERIOD_NS) > JITTER_NS {
            *self = TipFilter { last_ns: at_ns, origin_mm: *tip_mm, ..TipFilter::default() };
            return None;
        }
        self.last_ns = at_ns;
        let dt_s = dt_ns as f64 * 1e-9;
        let share = 1.0 - libm::exp(-dt_s / SMOOTHING_S);
        let from_origin = tip_mm - self.origin_mm;
        self.smooth[0] += (from_origin - self.smooth[0]) * share;
        let step = (self.smooth[0] - self.smooth[1]) * share;
        self.smooth[1] += step;
        let mut shake = from_origin;
        for (section, memory) in band.0.iter().zip(&mut self.band) {
            shake = section.pass(shake, memory);
        }
        self.samples = self.samples.saturating_add(1);
        let way_mm = step.norm();
        let tremor_mm = (self.samples > SETTLED).then_some(shake);
        Some(Filtered { way_mm, speed_mm_s: way_mm / dt_s, tremor_mm })
    }

    /// Forgets everything: the tip is lost.
    pub fn lose(&mut self) {
        self.last_ns = 0;
    }

    pub(super) fn is_sound(&self) -> bool {
        let memories = self.band.iter().flatten().chain(&self.smooth).chain([&self.origin_mm]);
        memories.flat_map(|v| v.iter()).all(|c| c.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// RMS in the band and way of a sine of amplitude 1 mm, per second.
    fn of_sine(hz: f64) -> (f64, f64) {
        let (band, mut filter) = (Band::default(), TipFilter::default());
        let (mut sum, mut n, mut way) = (0.0, 0, 0.0);
        for k in 1..=3000u64 {
            let tip = Vector3::new(libm::sin(TAU * hz * k as f64 * 0.02), 0.0, 5.0);
            let Some(f) = filter.pass(&band, &tip, k * FIELD_PERIOD_NS) else { continue };
            way += f.way_mm;
            if let Some(shake) = f.tremor_mm {
                (sum, n) = (sum + shake.norm_squared(), n + 1);
            }
        }
        ((sum / f64::from(n)).sqrt(), way / 60.0)
    }

    #[test]
    fn the_band_passes_tremor_and_stops_reaching() {
        let full = 0.5f64.sqrt();
        assert!((of_sine(9.0).0 / full - 1.0).abs() < 0.05, "{}", of_sine(9.0).0);
        for hz in [6.0, 14.0] {
            assert!((of_sine(hz).0 / full - 0.5f64.sqrt()).abs() < 0.05, "half the power at {hz} Hz");
        }
        assert!(of_sine(1.0).0 < 1.5e-3 && of_sine(2.0).0 < 0.02 && of_sine(22.0).0 < 0.05);
    }

    #[test]
    fn smoothing_keeps_reaching_and_drops_tremor() {
        // A sine of 1 mm goes 4 mm a period.
        let (slow, fast) = (of_sine(0.3).1 / 1.2, of_sine(9.0).1 / 36.0);
        assert!((0.93..1.0).contains(&slow) && fast < 0.05, "{slow} {fast}");
    }

    #[test]
    fn a_gap_begins_anew() {
        let (band, mut filter) = (Band::default(), TipFilter::default());
        let at = Vector3::new(1.0, 2.0, 3.0);
        assert!(filter.pass(&band, &at, FIELD_PERIOD_NS).is_none());
        assert_eq!(filter.pass(&band, &at, 2 * FIELD_PERIOD_NS).unwrap().way_mm, 0.0);
        assert!(
            filter.pass(&band, &(at * 2.0), 9 * FIELD_PERIOD_NS).is_none(),
            "a jump after a gap is no way"
        );
    }
}
