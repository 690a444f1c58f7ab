//! Filters of a tip's movement: smoothing for ways and speeds, and the band of tremor. They go by ticks of
//! 20 ms ([`TICK_NS`]), at which the samples of cameras of any rate are taken, so that equal hands have
//! equal figures.

use super::table::TREMOR_BAND_HZ;
use nalgebra::Vector3;
use protocol::limits::TICK_NS;
use serde::{Deserialize, Serialize};

/// Time constant of each of the two smoothing stages, s.
const SMOOTHING_S: f64 = 0.1;
/// A sample so near to a tick is taken for it, ns: the instants of cameras tremble.
const JITTER_NS: u64 = 2_000_000;
/// A longer time between two samples resets the filters, ns: slower than 25 Hz nothing is seen.
const SLOWEST_NS: u64 = 2 * TICK_NS + JITTER_NS;
/// Ticks after which the band's filter has settled: 1 s.
const SETTLED: u32 = 50;
/// Share of white noise's power (0 to 25 Hz, which is what ticks see of it) that the band lets through.
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
        let w = std::f64::consts::TAU * hz * TICK_NS as f64 * 1e-9;
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
    /// Instant up to which the filters are, ns; 0 before the first sample.
    last_ns: u64,
    /// The sample before: its instant, ns, its distance in time from the one before it, and its place.
    before_ns: u64,
    before_gap_ns: u64,
    before_mm: Vector3<f64>,
    /// Filters begin at the first position, so that it makes no step.
    origin_mm: Vector3<f64>,
    smooth: [Vector3<f64>; 2],
    band: [Memory; 4],
    samples: u32,
}

impl Default for TipFilter {
    fn default() -> Self {
        let zero = Vector3::zeros();
        TipFilter {
            last_ns: 0,
            before_ns: 0,
            before_gap_ns: 0,
            before_mm: zero,
            origin_mm: zero,
            smooth: [zero; 2],
            band: [[zero; 2]; 4],
            samples: 0,
        }
    }
}

/// What the filters say of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filtered {
    /// Way of the smoothed tip since the last tick, mm.
    pub way_mm: f64,
    /// Its speed, mm/s.
    pub speed_mm_s: f64,
    /// Movement in the tremor's band, mm, once the filter has settled; cameras so slow that they do not
    /// see it have none.
    pub tremor_mm: Option<Vector3<f64>>,
}

impl TipFilter {
    /// Takes a tip in, and returns a result for each tick that it completes: none for most samples of fast
    /// cameras, several for slow ones, none for the first after a gap. A tick is the sample nearest to its
    /// instant where one is within [`JITTER_NS`], and interpolated between two samples elsewhere; so the same
    /// hand has the same ways, speeds and tremor at every rate.
    pub fn pass(&mut self, band: &Band, tip_mm: &Vector3<f64>, at_ns: u64, mut tell: impl FnMut(Filtered)) {
        let gap_ns = at_ns.saturating_sub(self.before_ns);
        if self.last_ns == 0 || gap_ns == 0 || self.is_gap(gap_ns) {
            let before_gap_ns = if self.last_ns == 0 { 0 } else { gap_ns };
            let begun = TipFilter { last_ns: at_ns, origin_mm: *tip_mm, ..TipFilter::default() };
            *self = TipFilter { before_ns: at_ns, before_gap_ns, before_mm: *tip_mm, ..begun };
            return;
        }
        if gap_ns > TICK_NS + JITTER_NS {
            self.samples = 0;
        }
        while let Some(tick_ns) = self.due(at_ns, gap_ns) {
            let back = at_ns.saturating_sub(tick_ns) as f64 / gap_ns as f64;
            let there = if back > 0.0 { tip_mm + (self.before_mm - tip_mm) * back } else { *tip_mm };
            tell(self.tick(band, &there, tick_ns));
        }
        (self.before_ns, self.before_gap_ns, self.before_mm) = (at_ns, gap_ns, *tip_mm);
    }

    /// True if something is missing between two samples. Cameras below 50 Hz have two long intervals in a
    /// row, others one where a field was lost.
    fn is_gap(&self, gap_ns: u64) -> bool {
        let long = |ns: u64| ns > TICK_NS + JITTER_NS;
        gap_ns > SLOWEST_NS || (long(gap_ns) && !long(self.before_gap_ns))
    }

    /// The instant of the next tick, if a sample at `at_ns` completes it.
    fn due(&self, at_ns: u64, gap_ns: u64) -> Option<u64> {
        let since_ns = at_ns.saturating_sub(self.last_ns);
        // The next sample would be farther from the tick than this one.
        let nearest = since_ns.abs_diff(TICK_NS) <= JITTER_NS && since_ns + gap_ns / 2 > TICK_NS;
        let passed = since_ns >= TICK_NS;
        if nearest { Some(at_ns) } else { passed.then_some(self.last_ns + TICK_NS) }
    }

    fn tick(&mut self, band: &Band, tip_mm: &Vector3<f64>, at_ns: u64) -> Filtered {
        let dt_s = at_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        self.last_ns = at_ns;
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
        Filtered { way_mm, speed_mm_s: way_mm / dt_s, tremor_mm }
    }

    /// Forgets everything: the tip is lost.
    pub fn lose(&mut self) {
        self.last_ns = 0;
    }

    pub(super) fn is_sound(&self) -> bool {
        let memories =
            self.band.iter().flatten().chain(&self.smooth).chain([&self.origin_mm, &self.before_mm]);
        // From there a sample completes but a few ticks.
        let ahead_ns = self.before_ns.checked_sub(self.last_ns);
        let in_order = self.last_ns == 0 || ahead_ns.is_some_and(|ns| ns <= TICK_NS);
        in_order && memories.flat_map(|v| v.iter()).all(|c| c.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const MS: u64 = 1_000_000;

    /// RMS in the band and way of a sine of amplitude 1 mm, per second, of cameras of this period, whose
    /// instants tremble by up to `tremble_ns`.
    fn of_sine_by(hz: f64, period_ns: u64, tremble_ns: u64) -> (f64, f64) {
        let (band, mut filter) = (Band::default(), TipFilter::default());
        let (mut sum, mut n, mut way) = (0.0, 0, 0.0);
        for k in 1..=60_000 * MS / period_ns {
            let at_ns = k * period_ns + k * 7_919_993 % (tremble_ns + 1);
            let tip = Vector3::new(libm::sin(TAU * hz * at_ns as f64 * 1e-9), 0.0, 5.0);
            filter.pass(&band, &tip, at_ns, |f| {
                way += f.way_mm;
                if let Some(shake) = f.tremor_mm {
                    (sum, n) = (sum + shake.norm_squared(), n + 1);
                }
            });
        }
        (if n > 0 { (sum / f64::from(n)).sqrt() } else { f64::NAN }, way / 60.0)
    }

    fn of_sine(hz: f64) -> (f64, f64) {
        of_sine_by(hz, TICK_NS, 0)
    }

    #[test]
    fn the_same_hand_has_the_same_figures_at_every_rate() {
        for (period_ns, band_within, way_within) in
            [(2 * MS, 2e-3, 0.02), (5 * MS, 2e-3, 0.02), (10 * MS, 2e-3, 0.02), (16_666_667, 0.18, 0.16)]
        {
            for hz in [0.3, 6.0, 9.0, 14.0] {
                let ([band, way], [band50, way50]) =
                    (of_sine_by(hz, period_ns, 0).into(), of_sine(hz).into());
                let off: [f64; 2] = [band / band50 - 1.0, way / way50 - 1.0];
                println!("{period_ns} ns, {hz} Hz: band {:.1e}, way {:.1e} off", off[0], off[1]);
                assert!(hz < 6.0 || off[0].abs() < band_within, "{hz} Hz at {period_ns} ns: {band} {band50}");
                assert!(off[1].abs() < way_within, "{hz} Hz at {period_ns} ns: {way} {way50}");
            }
        }
        // Instants that tremble, of which the filter takes the sample nearest to each tick.
        for period_ns in [5 * MS, 10 * MS, 20 * MS] {
            let (still, trembling) = (of_sine(9.0), of_sine_by(9.0, period_ns, MS / 2));
            assert!((trembling.0 / still.0 - 1.0).abs() < 0.02, "{period_ns}: {trembling:?} {still:?}");
        }
    }

    #[test]
    fn cameras_of_25_hz_see_ways_and_no_tremor() {
        let (band, way) = of_sine_by(0.3, 40 * MS, 0);
        assert!(band.is_nan() && (way / of_sine(0.3).1 - 1.0).abs() < 5e-3, "{band} {way}");
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
        for period_ns in [5 * MS, 10 * MS, TICK_NS, 40 * MS] {
            let (band, mut filter) = (Band::default(), TipFilter::default());
            let at = Vector3::new(1.0, 2.0, 3.0);
            let mut ways = Vec::new();
            (1..=8).for_each(|k| filter.pass(&band, &at, k * period_ns, |f| ways.push(f.way_mm)));
            assert!(!ways.is_empty() && ways.iter().all(|way| *way == 0.0), "{period_ns}: {ways:?}");
            ways.clear();
            filter.pass(&band, &(at * 2.0), 8 * period_ns + 43 * MS, |f| ways.push(f.way_mm));
            assert!(ways.is_empty(), "a jump after a gap is no way");
        }
    }

    #[test]
    fn a_lost_field_of_fast_cameras_is_bridged_and_one_of_50_hz_begins_anew() {
        let ways = |at_ms: &[u64]| {
            let (band, mut filter, mut ticks) = (Band::default(), TipFilter::default(), 0);
            let at = |ms: u64| Vector3::new(ms as f64 * 1e-3, 0.0, 0.0);
            at_ms.iter().for_each(|&ms| filter.pass(&band, &at(ms), ms * MS, |_| ticks += 1));
            ticks
        };
        assert_eq!(ways(&[5, 10, 15, 25, 30, 35, 40, 45]), 2, "15 to 25 is no gap");
        assert_eq!(ways(&[20, 40, 80, 100, 120]), 3, "40 to 80 is");
    }
}
