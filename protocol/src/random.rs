//! Seeded random numbers, the same on every machine: SplitMix64 (Steele, Lea and Flood 2014,
//! OOPSLA).

use nalgebra::Vector3;

/// Increment of the state: 2⁶⁴ over the golden ratio, odd.
const INCREMENT: u64 = 0x9e37_79b9_7f4a_7c15;

/// Number `i` of the sequence of `seed`, counted from 0, without drawing those before it; with
/// `i` = 0 it is a hash of `seed`.
pub const fn nth(seed: u64, i: u64) -> u64 {
    let mut z = seed.wrapping_add(INCREMENT).wrapping_add(i.wrapping_mul(INCREMENT));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The number uniform from 0 up to 1 that the upper 53 of 64 random bits make.
pub fn unit_interval(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// From a seed and a stream of it.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut random = Random(seed ^ stream.wrapping_mul(0xd1b5_4a32_d192_ed03));
        random.bits();
        random
    }

    /// The published sequence of a seed.
    pub fn from_seed(seed: u64) -> Self {
        Random(seed)
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        let bits = nth(self.0, 0);
        self.0 = self.0.wrapping_add(INCREMENT);
        bits
    }

    /// Uniform from 0 up to 1.
    pub fn uniform(&mut self) -> f64 {
        unit_interval(self.bits())
    }

    /// Uniform from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// A whole number below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// One of several.
    pub fn one_of<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// True once in `n` times.
    pub fn once_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// A factor from 1/`most` to `most`, uniform in its logarithm.
    pub fn factor(&mut self, most: f64) -> f64 {
        libm::pow(most, self.between(-1.0, 1.0))
    }

    /// Normal with mean 0 and deviation 1 (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    /// A vector with three such coordinates.
    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }

    /// True with a probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values that the published generator gives for the seed 1234567 (as in Rosetta Code's list).
    #[test]
    fn the_generator_is_the_published_one() {
        let mut random = Random(1_234_567);
        let first = [6457827717110365317u64, 3203168211198807973, 9817491932198370423];
        assert_eq!([random.bits(), random.bits(), random.bits()], first);
        assert_eq!([0, 1, 2].map(|i| nth(1_234_567, i)), first);
    }

    #[test]
    fn normals_have_mean_0_and_deviation_1_and_streams_differ() {
        let mut random = Random::new(1, 0);
        let n = 20_000;
        let values: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        assert!(Random::new(1, 0).uniform() != Random::new(1, 1).uniform());
    }
}
