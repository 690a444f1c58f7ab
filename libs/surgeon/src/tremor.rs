//! Physiological tremor: noise limited to a band about its centre, as a function of time.

use nalgebra::Vector3;
use protocol::random::Random;
use std::f64::consts::TAU;

/// Sinusoids per axis: enough that they do not repeat within an operation.
const TONES: usize = 10;
/// First stream of random numbers that tremors draw from; those before it belong to the skills.
const FIRST_STREAM: u64 = 16;

/// Tremor of one tip: on each axis a sum of sines with random frequencies and phases.
#[derive(Debug, Clone)]
pub struct Tremor {
    amplitude_mm: f64,
    /// Angular frequency (rad/s) and phase (rad) of each tone of each axis.
    tones: [[(f64, f64); TONES]; 3],
}

impl Tremor {
    /// Tremor of `rms_um` (all axes together), drawn from `seed` and `stream`. The band is a third
    /// of `centre_hz` wide on either side: 6 to 12 Hz about 9 Hz.
    pub fn new(rms_um: f64, centre_hz: f64, seed: u64, stream: u64) -> Self {
        let mut random = Random::new(seed, FIRST_STREAM + stream);
        // One tone in each equal part of the band keeps the band evenly filled.
        let mut tone = |i: usize| {
            let place = (i as f64 + random.uniform()) / TONES as f64;
            (TAU * centre_hz * (2.0 + 2.0 * place) / 3.0, TAU * random.uniform())
        };
        let tones = std::array::from_fn(|_| std::array::from_fn(&mut tone));
        // A sine has half its squared amplitude; three axes share the power.
        let amplitude_mm = rms_um * 1e-3 * (2.0 / (3.0 * TONES as f64)).sqrt();
        Tremor { amplitude_mm, tones }
    }

    /// Displacement `t_s` seconds after the start, mm.
    pub fn at(&self, t_s: f64) -> Vector3<f64> {
        let axis = |tones: &[(f64, f64); TONES]| {
            self.amplitude_mm * tones.iter().map(|(w, phase)| libm::sin(w * t_s + phase)).sum::<f64>()
        };
        Vector3::new(axis(&self.tones[0]), axis(&self.tones[1]), axis(&self.tones[2]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn has_the_rms_and_the_band_asked_for() {
        let tremor = Tremor::new(50.0, 9.0, 1, 0);
        let n = 20_000;
        let sum: f64 = (0..n).map(|k| tremor.at(f64::from(k) * 0.005).norm_squared()).sum();
        let rms = (sum / f64::from(n)).sqrt();
        assert!((rms - 0.05).abs() < 0.005, "{rms}");
        for tone in tremor.tones.iter().flatten() {
            assert!((6.0..=12.0).contains(&(tone.0 / TAU)), "{} Hz", tone.0 / TAU);
        }
    }

    #[test]
    fn seeds_and_streams_differ_and_repeat() {
        let at = |seed, stream| Tremor::new(50.0, 9.0, seed, stream).at(1.234);
        assert_eq!(at(1, 0), at(1, 0));
        assert!(at(1, 0) != at(1, 1) && at(1, 0) != at(2, 0));
    }
}
