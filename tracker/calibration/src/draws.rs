//! Random numbers that are the same on every machine: Knuth's MMIX generator.

/// A sequence of draws.
pub struct Draws(u64);

impl Draws {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        let mut draws = Draws(seed);
        // The first numbers of neighbouring seeds are alike.
        for _ in 0..8 {
            draws.below(2);
        }
        draws
    }

    /// A whole number from 0 and below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n
    }

    /// The numbers below `n` in an order by a shuffle (Fisher–Yates).
    pub fn order(&mut self, n: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..n).collect();
        (1..n).rev().for_each(|i| order.swap(i, self.below(i + 1)));
        order
    }

    /// `N` different numbers below `n`, which is at least `N`.
    pub fn distinct<const N: usize>(&mut self, n: usize) -> [usize; N] {
        let mut chosen = [usize::MAX; N];
        for slot in 0..N {
            let mut draw = self.below(n);
            while chosen[..slot].contains(&draw) {
                draw = self.below(n);
            }
            chosen[slot] = draw;
        }
        chosen
    }
}
