//! The power of a difference in bands of frequency: Welch's method (1967) with Hann windows that overlap by
//! half.

use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Bands and their borders, Hz: drift and pursuit, voluntary motion, physiological tremor, what is above.
pub const BANDS: [(&str, f64, f64); 4] =
    [("< 2 Hz", 0.0, 2.0), ("2–8 Hz", 2.0, 8.0), ("8–14 Hz", 8.0, 14.0), ("> 14 Hz", 14.0, f64::MAX)];
/// A window of frames, s: 256 at 50 Hz.
const WINDOW_S: f64 = 5.12;

/// Root mean square in each band of stretches of displacements, sampled at `rate_hz`.
pub fn band_rms(stretches: &[Vec<Vector3<f64>>], rate_hz: f64) -> [f64; BANDS.len()] {
    let longest = stretches.iter().map(Vec::len).max().unwrap_or(0);
    let length = longest.min((WINDOW_S * rate_hz).round() as usize);
    let (mut power, mut windows) = ([0.0; BANDS.len()], 0u32);
    if length == 0 {
        return power;
    }
    let table = Table::new(length);
    for stretch in stretches {
        for window in stretch.windows(length).step_by((length / 2).max(1)) {
            windows += 1;
            for axis in 0..3 {
                let samples: Vec<f64> = window.iter().map(|v| v[axis]).collect();
                table.add_power(&samples, rate_hz, &mut power);
            }
        }
    }
    power.map(|p| (p / f64::from(windows)).sqrt())
}

/// Window and waves of a length.
struct Table {
    hann: Vec<f64>,
    /// Sum of the squares of the window.
    weight: f64,
    waves: Vec<[f64; 2]>,
}

impl Table {
    fn new(length: usize) -> Self {
        let turn = |k: usize| TAU * k as f64 / length as f64;
        // A single sample has no window that is not 0.
        let hann: Vec<f64> = match length {
            1 | 2 => vec![1.0; length],
            _ => (0..length).map(|k| 0.5 - 0.5 * libm::cos(turn(k))).collect(),
        };
        let weight = hann.iter().map(|w| w * w).sum();
        let waves = (0..length).map(|k| [libm::cos(turn(k)), libm::sin(turn(k))]).collect();
        Table { hann, weight, waves }
    }

    /// Adds the mean square of the samples in each band (Parseval). The mean stands in the lowest band as
    /// it is; windows are of what is left.
    fn add_power(&self, samples: &[f64], rate_hz: f64, power: &mut [f64; BANDS.len()]) {
        let length = samples.len();
        let mean = samples.iter().sum::<f64>() / length as f64;
        power[0] += mean * mean;
        for bin in 1..=length / 2 {
            let (mut re, mut im) = (0.0, 0.0);
            for (k, sample) in samples.iter().enumerate() {
                let [c, s] = self.waves[bin * k % length];
                let value = (sample - mean) * self.hann[k];
                (re, im) = (re + value * c, im - value * s);
            }
            let sides = if 2 * bin == length { 1.0 } else { 2.0 };
            let hz = rate_hz * bin as f64 / length as f64;
            let band = BANDS.iter().position(|(_, from, to)| (*from..*to).contains(&hz));
            power[band.unwrap_or(BANDS.len() - 1)] +=
                sides * (re * re + im * im) / (self.weight * length as f64);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tone_lies_in_its_band_and_an_offset_in_the_lowest() {
        for (hz, band) in [(0.7, 0), (5.0, 1), (11.0, 2), (19.0, 3)] {
            let tone = |k: usize| 3.0 + 4.0 * libm::sin(TAU * hz * k as f64 / 50.0);
            let stretch: Vec<_> = (0..1000).map(|k| Vector3::new(0.0, tone(k), 0.0)).collect();
            let found = band_rms(&[stretch], 50.0);
            let expected: [f64; 4] = std::array::from_fn(|i| {
                let (offset, tone) = (if i == 0 { 9.0 } else { 0.0 }, if i == band { 8.0 } else { 0.0 });
                f64::sqrt(offset + tone)
            });
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 0.25, "{hz} Hz: {found} instead of {expected}");
            }
        }
    }

    #[test]
    fn short_and_empty_stretches_have_a_spectrum() {
        assert_eq!(band_rms(&[], 50.0), [0.0; 4]);
        assert_eq!(band_rms(&[vec![Vector3::new(2.0, 0.0, 0.0)]], 50.0), [2.0, 0.0, 0.0, 0.0]);
    }
}
