//! Noise that is the same whenever the same field is drawn: a long tile, drawn once from the seed,
//! of which each field takes another stretch.

use protocol::random;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Fixed point of noise: 1/64 grey level.
pub(super) const STEP_BITS: u32 = 6;
/// Steps of a grey level.
pub(super) const STEPS: f64 = (1 << STEP_BITS) as f64;
/// How far the stretch can be shifted, samples.
const SHIFTS: usize = 1 << 16;

/// A tile of noise about 0, in 1/64 grey levels.
pub(super) struct Noise {
    tile: Vec<i16>,
}

impl Noise {
    /// White Gaussian noise of `sigma` grey levels for pictures of `n` samples.
    pub(super) fn white(seed: u64, stream: u64, n: usize, sigma: f64) -> Self {
        let unit = white(seed, stream, n + SHIFTS);
        let tile = unit.iter().map(|&v| (f64::from(v) * sigma * STEPS).round() as i16).collect();
        Noise { tile }
    }

    /// The same, limited to half the band of its samples, as chroma is.
    pub(super) fn narrow(seed: u64, stream: u64, n: usize, sigma: f64) -> Self {
        let unit = white(seed, stream, n + SHIFTS + 2);
        // 1:2:1 has the variance (1 + 4 + 1)/16.
        let scale = sigma * STEPS / (6.0f64.sqrt() / 4.0);
        let smooth = |w: &[f32]| f64::from(w[0] + 2.0 * w[1] + w[2]) / 4.0;
        Noise { tile: unit.windows(3).map(|w| (smooth(w) * scale).round() as i16).collect() }
    }

    /// The stretch of `n` samples that belongs to `key`.
    pub(super) fn stretch(&self, key: u64, n: usize) -> &[i16] {
        let from = random::nth(key, 0) as usize % SHIFTS;
        &self.tile[from..from + n]
    }
}

/// Gaussian noise of unit variance as the sum of twelve uniform bytes (Irwin–Hall), which is fast
/// and bounded.
fn white(seed: u64, stream: u64, n: usize) -> Vec<f32> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream);
    let one = |_| {
        let sum: u32 =
            (0..3).map(|_| random.next_u32().to_le_bytes().map(u32::from).iter().sum::<u32>()).sum();
        // Twelve uniform bytes have variance 12·(256² − 1)/12.
        (sum as f32 - 12.0 * 127.5) / 255.998
    };
    (0..n).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_sigma_asked_for_and_the_band() {
        let n = 50_000;
        for (noise, next) in [(Noise::white(3, 0, n, 2.4), 0.0), (Noise::narrow(3, 1, n, 1.5), 2.0 / 3.0)] {
            let sigma = if next == 0.0 { 2.4 } else { 1.5 };
            let values: Vec<f64> = noise.stretch(7, n).iter().map(|&v| f64::from(v) / STEPS).collect();
            let mean = values.iter().sum::<f64>() / n as f64;
            let product = |lag: usize| {
                values.iter().zip(&values[lag..]).map(|(a, b)| a * b).sum::<f64>() / (n - lag) as f64
            };
            assert!(mean.abs() < 0.05 && (product(0).sqrt() - sigma).abs() < 0.03, "{mean} {}", product(0));
            assert!((product(1) / product(0) - next).abs() < 0.03, "correlation of neighbours");
        }
    }
}
