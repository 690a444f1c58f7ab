//! Physiological tremor: noise limited to a band about its centre, as a function of time.

use nalgebra::Vector3;
use rand::Rng;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Sinusoids per axis: enough that they do not repeat within an operation.
const TONES: usize = 12;
/// Half width of the band as a share of its centre: 6 to 12 Hz about 9 Hz.
const HALF_BAND: f64 = 1.0 / 3.0;

/// Tremor of one tip.
#[derive(Debug, Clone)]
pub struct Tremor {
    amplitude_mm: f64,
    /// Angular frequency (rad/s) and phase (rad) of each tone of each axis.
    tones: [[(f64, f64); TONES]; 3],
}

/// Uniform in 0 to 1, from the upper 53 bits.
pub fn uniform(random: &mut ChaCha8Rng) -> f64 {
    (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

impl Tremor {
    /// Tremor of `rms_mm` (all axes together) about `centre_hz`, drawn from `seed` and `stream`.
    pub fn new(rms_mm: f64, centre_hz: f64, seed: u64, stream: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        // One tone in each equal part of the band keeps the band evenly filled.
        let mut tone = |i: usize| {
            let place = (i as f64 + uniform(&mut random)) / TONES as f64;
            let hz = centre_hz * (1.0 + HALF_BAND * (2.0 * place - 1.0));
            (TAU * hz, TAU * uniform(&mut random))
        };
        let tones = std::array::from_fn(|_| std::array::from_fn(&mut tone));
        // A sine has half its squared amplitude; three axes share the power.
        let amplitude_mm = rms_mm * (2.0 / (3.0 * TONES as f64)).sqrt();
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
        let tremor = Tremor::new(0.05, 9.0, 1, 0);
        let n = 20_000;
        let samples: Vec<_> = (0..n).map(|i| tremor.at(f64::from(i) * 0.005)).collect();
        let rms = (samples.iter().map(|v| v.norm_squared()).sum::<f64>() / f64::from(n)).sqrt();
        assert!((rms - 0.05).abs() < 0.005, "{rms}");
        for tone in tremor.tones.iter().flatten() {
            assert!((6.0..=12.0).contains(&(tone.0 / TAU)), "{} Hz", tone.0 / TAU);
        }
    }

    #[test]
    fn seeds_and_streams_differ_and_repeat() {
        let at = |seed, stream| Tremor::new(0.05, 9.0, seed, stream).at(1.234);
        assert_eq!(at(1, 0), at(1, 0));
        assert!(at(1, 0) != at(1, 1) && at(1, 0) != at(2, 0));
    }
}
