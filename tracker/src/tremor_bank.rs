//! The tremor of one coordinate: bands whose displacements add up, each white noise through an all-pole band-pass
//! filter of Chebyshev's first kind.
//!
//! A band of n pole pairs has a flat spectrum but for its ripple and a factor of 1/f², and falls above as f⁻²⁽ⁿ⁺¹⁾: a
//! bank of single oscillators falls as f⁻⁴, which lets noise through where no tremor is and predicts worse. The filter H(s) = s^(n−1)/Π(s − λ)(s − λ*) is kept in modal form: each pole pair λ = σ + iω has a
//! complex state z with z' = λz + βw, β the residue 2·λ^(n−1)/Π(λ − μ) over all other poles μ, and the displacement is
//! the sum of Re z. So a transition turns and shrinks each z by e^(λt), and the stationary covariances follow from
//! E[z_i z_j*] = −β_i β_j*/(λ_i + λ_j*) and E[z_i z_j] = −β_i β_j/(λ_i + λ_j).
//!
//! Poles: those of the low-pass prototype, −sinh μ sin θ + i cosh μ cos θ with sinh μ from the ripple, brought to the
//! band by s → (s² + ω₀²)/(s·B) (Oppenheim and Schafer, Discrete-Time Signal Processing, appendix B).

use crate::constants as k;
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Number of bands.
pub const BANDS: usize = k::TREMOR_BANDS.len();
/// Number of pole pairs of all bands.
pub const PAIRS: usize = {
    let (mut pairs, mut band) = (0, 0);
    while band < BANDS {
        pairs += k::TREMOR_BANDS[band].pairs;
        band += 1;
    }
    pairs
};

/// A band of the tremor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Lower end, Hz.
    pub low_hz: f64,
    /// Upper end, Hz.
    pub high_hz: f64,
    /// Number of pole pairs.
    pub pairs: usize,
    /// Initial standard deviation of its displacement, an axis, mm.
    pub start_mm: f64,
}

/// A 2×2 block: rows and columns are real and imaginary part.
pub type Block = [[f64; 2]; 2];

/// The bands, for a displacement of variance 1 each.
#[derive(Debug, Clone, PartialEq)]
pub struct TremorBank {
    /// σ and ω of every pole pair, 1/s and rad/s.
    poles: [[f64; 2]; PAIRS],
    /// Stationary covariances of the states of two pole pairs; zero where they are of different bands.
    stationary: [[Block; PAIRS]; PAIRS],
}

impl TremorBank {
    /// Bands of that ripple, dB.
    pub fn new(ripple_db: f64) -> Self {
        let mut bank = TremorBank { poles: [[0.0; 2]; PAIRS], stationary: [[[[0.0; 2]; 2]; PAIRS]; PAIRS] };
        for (band, range) in k::TREMOR_BANDS.iter().zip(ranges()) {
            bank.set_band(band, range, ripple_db);
        }
        bank
    }

    fn set_band(&mut self, band: &Band, range: Range<usize>, ripple_db: f64) {
        let first = range.start;
        for i in range.clone() {
            let pole = pole(band, i - first, ripple_db);
            self.poles[i] = [pole.re, pole.im];
        }
        let poles = &self.poles[range.clone()];
        let residues: [Complex<f64>; PAIRS] =
            std::array::from_fn(|i| if i < band.pairs { residue(poles, i) } else { Complex::new(0.0, 0.0) });
        let mut variance = 0.0;
        for i in range.clone() {
            for j in range.clone() {
                let [a, b] = [i, j].map(|n| Complex::new(self.poles[n][0], self.poles[n][1]));
                let block = covariance(a, b, residues[i - first], residues[j - first]);
                variance += block[0][0];
                self.stationary[i][j] = block;
            }
        }
        for i in range.clone() {
            for j in range.clone() {
                self.stationary[i][j] = self.stationary[i][j].map(|row| row.map(|v| v / variance));
            }
        }
    }

    /// Transition of every pole pair over `dt` seconds (either way).
    pub fn transition(&self, dt: f64) -> [Block; PAIRS] {
        self.poles.map(|[sigma, omega]| {
            let decay = libm::exp(sigma * dt);
            let (sin, cos) = (decay * libm::sin(omega * dt), decay * libm::cos(omega * dt));
            [[cos, -sin], [sin, cos]]
        })
    }

    /// Stationary covariance of the states of two pole pairs of a band of variance 1.
    pub fn stationary(&self, i: usize, j: usize) -> &Block {
        &self.stationary[i][j]
    }

    /// Covariance of the process noise over the transition `f` between two pole pairs of a band of variance 1:
    /// Σ − F·Σ·Fᵀ.
    pub fn noise(&self, f: &[Block; PAIRS], i: usize, j: usize) -> Block {
        let s = &self.stationary[i][j];
        let half: Block =
            std::array::from_fn(|r| std::array::from_fn(|c| f[i][r][0] * s[0][c] + f[i][r][1] * s[1][c]));
        std::array::from_fn(|r| {
            std::array::from_fn(|c| s[r][c] - (half[r][0] * f[j][c][0] + half[r][1] * f[j][c][1]))
        })
    }

    /// Share of real and imaginary part of a pole pair's state in the velocity: Re λz = σ·Re z − ω·Im z.
    pub fn velocity(&self, pair: usize) -> [f64; 2] {
        let [sigma, omega] = self.poles[pair];
        [sigma, -omega]
    }
}

/// Pole pairs of each band.
pub fn ranges() -> impl Iterator<Item = Range<usize>> {
    k::TREMOR_BANDS.iter().scan(0, |begin, band| {
        let range = *begin..*begin + band.pairs;
        *begin = range.end;
        Some(range)
    })
}

/// Pole `n` of a band, that of positive frequency.
fn pole(band: &Band, n: usize, ripple_db: f64) -> Complex<f64> {
    let order = band.pairs as f64;
    let ripple = libm::sqrt(libm::pow(10.0, 0.1 * ripple_db) - 1.0);
    let mu = libm::asinh(1.0 / ripple) / order;
    let theta = PI * (2.0 * n as f64 + 1.0) / (2.0 * order);
    let prototype = Complex::new(-libm::sinh(mu) * libm::sin(theta), libm::cosh(mu) * libm::cos(theta));
    let (low, high) = (TAU * band.low_hz, TAU * band.high_hz);
    let half = prototype * (0.5 * (high - low));
    // √(half² − ω₀²): its root of positive imaginary part.
    let square = half * half - low * high;
    let length = libm::sqrt(libm::hypot(square.re, square.im));
    let angle = 0.5 * libm::atan2(square.im, square.re);
    let root = Complex::new(length * libm::cos(angle), length * libm::sin(angle));
    half + if root.im < 0.0 { -root } else { root }
}

/// β of pole pair `i`.
fn residue(poles: &[[f64; 2]], i: usize) -> Complex<f64> {
    let at = |n: usize| Complex::new(poles[n][0], poles[n][1]);
    let pole = at(i);
    (0..poles.len()).filter(|n| *n != i).fold(Complex::new(2.0, 0.0) / (pole - pole.conj()), |product, n| {
        product * pole / ((pole - at(n)) * (pole - at(n).conj()))
    })
}

/// Covariance of real and imaginary parts of the states of two pole pairs.
fn covariance(a: Complex<f64>, b: Complex<f64>, beta_a: Complex<f64>, beta_b: Complex<f64>) -> Block {
    let hermitian = -(beta_a * beta_b.conj()) / (a + b.conj());
    let plain = -(beta_a * beta_b) / (a + b);
    [
        [0.5 * (plain.re + hermitian.re), 0.5 * (plain.im - hermitian.im)],
        [0.5 * (plain.im + hermitian.im), 0.5 * (hermitian.re - plain.re)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Gain of a band at a frequency, up to a factor, from its poles alone.
    fn gain(poles: &[[f64; 2]], hz: f64) -> f64 {
        let s = Complex::<f64>::new(0.0, TAU * hz);
        let pairs = poles.iter().map(|[sigma, omega]| {
            let pole = Complex::new(*sigma, *omega);
            s / ((s - pole) * (s - pole.conj()))
        });
        pairs.fold(1.0 / s, |product, pair| product * pair).norm()
    }

    #[test]
    fn a_band_is_flat_within_its_ripple_and_falls_outside() {
        let bank = TremorBank::new(1.0);
        for (band, range) in k::TREMOR_BANDS.iter().zip(ranges()) {
            let poles = &bank.poles[range];
            let inside: Vec<f64> = (0..=100)
                .map(|n| band.low_hz + (band.high_hz - band.low_hz) * f64::from(n) / 100.0)
                .map(|hz| hz * gain(poles, hz))
                .collect();
            let (least, most) = inside.iter().fold((f64::MAX, 0.0f64), |(l, m), g| (l.min(*g), m.max(*g)));
            let ripple_db = 20.0 * libm::log10(most / least);
            assert!((0.9..1.05).contains(&ripple_db), "{band:?}: {ripple_db} dB");
            let outside = [0.7 * band.low_hz, 1.4 * band.high_hz].map(|hz| hz * gain(poles, hz));
            assert!(outside.iter().all(|g| *g < 0.2 * least), "{band:?}: {outside:?} {least}");
        }
    }

    /// The spectrum of the states, integrated, against their stationary covariances.
    #[test]
    fn stationary_covariances_are_those_of_the_spectrum() {
        let bank = TremorBank::new(1.0);
        for range in ranges() {
            let poles = &bank.poles[range.clone()];
            let mut sum: f64 = 0.0;
            for i in range.clone() {
                for j in range.clone() {
                    sum += bank.stationary[i][j][0][0];
                }
            }
            assert!((sum - 1.0).abs() < 1e-12, "{sum}");
            // Autocorrelation after a time, by the states and by the spectrum.
            let dt = 0.013;
            let f = bank.transition(dt);
            let by_states: f64 = range
                .clone()
                .flat_map(|i| range.clone().map(move |j| (i, j)))
                .map(|(i, j)| {
                    f[i][0][0] * bank.stationary[i][j][0][0] + f[i][0][1] * bank.stationary[i][j][1][0]
                })
                .sum();
            let (mut power, mut shifted) = (0.0, 0.0);
            for n in 1..400_000 {
                let hz = f64::from(n) * 5e-4;
                let spectrum = gain(poles, hz) * gain(poles, hz);
                power += spectrum;
                shifted += spectrum * libm::cos(TAU * hz * dt);
            }
            assert!((by_states - shifted / power).abs() < 1e-4, "{by_states} {}", shifted / power);
        }
    }

    proptest! {
        #[test]
        fn process_noise_adds_up(dt in 0.0005..0.03f64, ripple_db in 0.1..3.0f64) {
            let bank = TremorBank::new(ripple_db);
            let (once, twice) = (bank.transition(dt), bank.transition(2.0 * dt));
            for range in ranges() {
                for i in range.clone() {
                    for j in range.clone() {
                        let (q, whole) = (bank.noise(&once, i, j), bank.noise(&twice, i, j));
                        for r in 0..2 {
                            for c in 0..2 {
                                let mut sum = q[r][c];
                                for (m, row) in q.iter().enumerate() {
                                    for (n, v) in row.iter().enumerate() {
                                        sum += once[i][r][m] * v * once[j][c][n];
                                    }
                                }
                                prop_assert!((sum - whole[r][c]).abs() < 1e-12, "{} {}", sum, whole[r][c]);
                            }
                        }
                    }
                }
            }
        }

        #[test]
        fn transitions_follow_one_another(a in -0.05..0.05f64, b in -0.05..0.05f64) {
            let bank = TremorBank::new(1.0);
            let (a_, b_, both) = (bank.transition(a), bank.transition(b), bank.transition(a + b));
            for pair in 0..PAIRS {
                let product = a_[pair][0][0] * b_[pair][0][1] + a_[pair][0][1] * b_[pair][1][1];
                prop_assert!((product - both[pair][0][1]).abs() < 1e-12);
            }
        }
    }
}
