//! Random numbers by counter: a pure function of seed, kind of fault, camera and field.

use super::FaultKind;
use protocol::random::{nth, unit_interval};

/// Counter-based generator of the faults' random numbers.
#[derive(Debug, Clone, Copy)]
pub struct FaultSampler {
    seed: u64,
}

/// Random numbers of one field, addressed by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draw {
    key: u64,
}

/// A fault that lasts several fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Episode {
    /// First field.
    pub start: u64,
    /// Random numbers of the episode.
    pub draw: Draw,
}

impl FaultSampler {
    /// A sampler of `seed`.
    pub fn new(seed: u64) -> Self {
        // One round more than every other generator of the same seed.
        FaultSampler { seed: nth(seed ^ 0xfa17, 0) }
    }

    /// Random numbers of a fault of `kind` in `field` of `camera`.
    pub fn draw(&self, kind: FaultKind, camera: u32, field: u64) -> Draw {
        let stream = (kind as u64) << 8 | u64::from(camera);
        Draw { key: nth(nth(self.seed ^ stream, 0) ^ field, 0) }
    }

    /// Newest episode that contains `field`. An episode begins in a field with probability `rate`;
    /// its length is uniform in 1 to `longest` fields.
    pub fn episode(
        &self,
        kind: FaultKind,
        camera: u32,
        field: u64,
        rate: f64,
        longest: u32,
    ) -> Option<Episode> {
        for back in 0..u64::from(longest).min(field + 1) {
            let draw = self.draw(kind, camera, field - back);
            if draw.uniform(0) < rate && back <= draw.below(1, u64::from(longest)) {
                return Some(Episode { start: field - back, draw });
            }
        }
        None
    }
}

impl Draw {
    /// Number `i`, uniform in all 64 bits.
    pub fn number(&self, i: u64) -> u64 {
        nth(self.key, i)
    }

    /// Number `i`, uniform in 0 to 1 (exclusive).
    pub fn uniform(&self, i: u64) -> f64 {
        unit_interval(self.number(i))
    }

    /// Number `i`, uniform in 0 to `n` (exclusive); 0 for `n` = 0.
    pub fn below(&self, i: u64, n: u64) -> u64 {
        ((u128::from(self.number(i)) * u128::from(n)) >> 64) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_uniform_and_independent_of_one_another() {
        let sampler = FaultSampler::new(1);
        let n = 20_000u64;
        let mut mean = [0.0; 3];
        for field in 0..n {
            let (a, b) = (sampler.draw(FaultKind::Late, 0, field), sampler.draw(FaultKind::Late, 1, field));
            assert_ne!(a, b);
            let values = [a.uniform(0), a.uniform(1), b.uniform(0)].map(|v| v - 0.5);
            mean[0] += values[0] / n as f64;
            mean[1] += values[0] * values[1] / n as f64;
            mean[2] += values[0] * values[2] / n as f64;
        }
        assert!(mean.iter().all(|m| m.abs() < 0.01), "{mean:?}");
        let counts = (0..9000).fold([0; 9], |mut counts, field| {
            counts[sampler.draw(FaultKind::Torn, 2, field).below(4, 9) as usize] += 1;
            counts
        });
        assert!(counts.iter().all(|&c| (850..1150).contains(&c)), "{counts:?}");
    }

    #[test]
    fn episodes_begin_at_their_rate_and_last_as_long_as_they_may() {
        let sampler = FaultSampler::new(2);
        let (rate, longest, fields) = (0.002, 20, 100_000);
        let mut starts = std::collections::BTreeMap::new();
        for field in 0..fields {
            if let Some(episode) = sampler.episode(FaultKind::Occlusion, 0, field, rate, longest) {
                let last = starts.entry(episode.start).or_insert(field);
                assert!(field >= episode.start && field == (*last).max(field), "no gap, no return");
                *last = field;
            }
        }
        let expected = rate * fields as f64;
        assert!((starts.len() as f64 - expected).abs() < 4.0 * expected.sqrt(), "{} episodes", starts.len());
        let lengths: Vec<u64> = starts.iter().map(|(start, last)| last - start + 1).collect();
        let mean = lengths.iter().sum::<u64>() as f64 / lengths.len() as f64;
        // 1 to 20 evenly: 10.5, a little less where the next one takes over.
        assert!((9.5..11.2).contains(&mean) && lengths.iter().all(|l| (1..=20).contains(l)), "{mean}");
    }
}
