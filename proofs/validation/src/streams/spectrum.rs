//! Spectra of movements that are known as a table only.

use super::motion::Spectrum;
use nalgebra::DMatrix;
use std::f64::consts::TAU;

/// Width of a band, Hz.
const WIDTH_HZ: f64 = 0.25;
/// Number of bands: up to 15 Hz, above which hands do not tremble.
const BANDS: usize = 60;
/// Frequencies in a band: nothing repeats within ten seconds.
const IN_BAND: usize = 5;
/// What the bands need not explain, mm or rad: a tenth of what three cameras leave of a tip.
const UNEXPLAINED: f64 = 3e-4;
/// Steps from an even spectrum; more change nothing that is above the noise of any stream.
const STEPS: usize = 20;
/// Root mean square of a band that is left out, mm or rad.
const LEAST: f64 = 3e-5;

/// The most likely powers of bands with an even spectrum each, of signals that are equally long, have a sample every
/// `step_s` and are of one spectrum; a mean counts as of the lowest band. Nothing if nothing moves.
///
/// A periodogram of a few seconds spreads the power of slow and large movement over faster ones, which would make the
/// bound too large. Here the powers v of the bands are those under which the signals y are most likely, y being
/// normal with covariance K = Σ v C + σ²: v ← v·√(yᵀK⁻¹CK⁻¹y / tr K⁻¹C) never makes them less likely (Zhou, Hu, Zhou
/// and Lange, MM algorithms for variance components models, 2019).
pub(super) fn bands(signals: &[Vec<f64>], step_s: f64) -> Vec<Spectrum> {
    let count = signals.first().map_or(0, Vec::len);
    let moved = signals.iter().flatten().zip(signals.iter().flat_map(|s| s.iter().skip(1).chain(s.last())));
    if count < 2 || moved.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < LEAST {
        return Vec::new();
    }
    let waves = waves(count, step_s);
    let signals = DMatrix::from_fn(count, signals.len(), |n, i| signals[i][n]);
    let mut powers = vec![signals.norm_squared() / (signals.len() * BANDS) as f64; BANDS];
    for _ in 0..STEPS {
        step(&mut powers, &waves, &signals);
    }
    let band = |n: usize| [n as f64 * WIDTH_HZ, (n + 1) as f64 * WIDTH_HZ];
    let all = powers.iter().enumerate().map(|(n, power)| (n, libm::sqrt(*power)));
    all.filter(|(_, rms)| *rms > LEAST).map(|(n, rms)| Spectrum { band_hz: band(n), rms }).collect()
}

/// Cosines and sines of each band one after the other, of which each band's sum of squares has a mean of 1.
fn waves(count: usize, step_s: f64) -> DMatrix<f64> {
    DMatrix::from_fn(count, 2 * IN_BAND * BANDS, |n, column| {
        let hz = (column / 2) as f64 + 0.5;
        let (sin, cos) = libm::sincos(TAU * hz * WIDTH_HZ / IN_BAND as f64 * step_s * n as f64);
        if column % 2 == 0 { cos } else { sin }
    }) / libm::sqrt(IN_BAND as f64)
}

fn step(powers: &mut [f64], waves: &DMatrix<f64>, signals: &DMatrix<f64>) {
    let band_of = |column: usize| column / (2 * IN_BAND);
    let mut weighted = waves.clone();
    for (column, mut wave) in weighted.column_iter_mut().enumerate() {
        wave *= powers[band_of(column)];
    }
    let mut covariance = weighted * waves.transpose();
    (0..covariance.nrows()).for_each(|n| covariance[(n, n)] += UNEXPLAINED * UNEXPLAINED);
    let Some(factor) = covariance.cholesky() else { return };
    let (mut whitened, mut signals) = (waves.clone(), signals.clone());
    factor.l_dirty().solve_lower_triangular_mut(&mut whitened);
    factor.l_dirty().solve_lower_triangular_mut(&mut signals);
    let explained = whitened.tr_mul(&signals);
    let mut sums = vec![[0.0; 2]; powers.len()];
    for (column, wave) in whitened.column_iter().enumerate() {
        let [found, expected] = &mut sums[band_of(column)];
        *found += explained.row(column).norm_squared() / signals.ncols() as f64;
        *expected += wave.norm_squared();
    }
    for (power, [found, expected]) in powers.iter_mut().zip(sums) {
        *power *= libm::sqrt(found / expected);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::random::Random;

    /// Slow and large movement beside small tremor: the bands hold both, and what lies between them holds nothing.
    #[test]
    fn bands_hold_the_power_of_what_moves_in_them() {
        let mut random = Random::new(1, 0);
        let mut signal = || -> Vec<f64> {
            let mut wave = |low: f64, high: f64, amplitude: f64| {
                let (hz, phase) = (random.between(low, high), TAU * random.uniform());
                move |t_s: f64| amplitude * libm::sin(TAU * hz * t_s + phase)
            };
            let slow: Vec<_> = (0..4).map(|_| wave(0.1, 0.5, 1.5)).collect();
            let tremor: Vec<_> = (0..20).map(|_| wave(8.0, 12.0, 0.01)).collect();
            let at = |t_s: f64| {
                slow.iter().map(|w| w(t_s)).sum::<f64>() + tremor.iter().map(|w| w(t_s)).sum::<f64>()
            };
            (0..200).map(|n| at(f64::from(n) * 0.03)).collect()
        };
        let signals = [signal(), signal(), signal()];
        let bands = bands(&signals, 0.03);
        let within = |low: f64, high: f64| {
            let inside = bands.iter().filter(|s| s.band_hz[0] >= low && s.band_hz[1] <= high);
            libm::sqrt(inside.map(|s| s.rms * s.rms).sum::<f64>())
        };
        // Root mean squares of the sums: 1.5·√2 and 0.01·√10.
        assert!((within(0.0, 0.5) / 2.12 - 1.0).abs() < 0.4, "{}", within(0.0, 0.5));
        assert!((within(8.0, 12.0) / 0.0316 - 1.0).abs() < 0.3, "{}", within(8.0, 12.0));
        assert!(within(0.75, 7.75) < 1e-3 && within(12.25, 15.0) < 1e-3, "{bands:?}");
        assert!(super::bands(&[vec![2.0; 200]], 0.03).is_empty());
    }
}
