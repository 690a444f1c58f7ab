//! Relative cost of the tiers, measured on this adapter at the start.
//!
//! How much dearer full shading is differs widely: about four times on a graphics card, twenty
//! times and more on a processor that draws. So the renderer measures every tier it has room for
//! while it warms up, and takes the shortest of a few frames, which other processes disturbed
//! least.

use crate::governor::TIERS;

/// Number of tiers.
const TIERS_LEN: usize = TIERS.len();
/// Ratio of the costs of a fully shaded and a lean frame of equal size: the largest, and that where
/// nothing was measured.
const FULL_AT_MOST: f64 = 40.0;
const FULL_UNMEASURED: f64 = 20.0;

/// Costs of the tiers; only their ratios have a meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct Costs([f64; TIERS_LEN]);

impl Costs {
    /// From the shortest frame that was seen at each tier, ns; `None` where none was drawn.
    ///
    /// A frame has a part that every pixel costs and one that every frame costs. So between tiers
    /// of one shading the ratio lies between 1 and that of their pixels, and what a disturbed
    /// measurement says beyond that is not believed.
    pub fn measured(shortest_ns: &[Option<u64>; TIERS_LEN]) -> Self {
        let mut costs = [1.0; TIERS_LEN];
        for tier in (1..TIERS_LEN).rev() {
            let (better, worse) = (&TIERS[tier - 1], &TIERS[tier]);
            let pixels = [better, worse].map(|t| f64::from(t.width_px * t.height_px));
            let same = better.shading == worse.shading;
            let most = pixels[0] / pixels[1] * if same { 1.0 } else { FULL_AT_MOST };
            let unmeasured = pixels[0] / pixels[1] * if same { 1.0 } else { FULL_UNMEASURED };
            let ratio = match (shortest_ns[tier - 1], shortest_ns[tier]) {
                (Some(a), Some(b)) if b > 0 => a as f64 / b as f64,
                _ => unmeasured,
            };
            costs[tier - 1] = costs[tier] * ratio.clamp(1.0, most);
        }
        Self(costs)
    }

    /// How many times dearer a frame of tier `to` is than one of tier `from`.
    pub fn ratio(&self, from: usize, to: usize) -> f64 {
        self.0[to] / self.0[from]
    }
}

impl Default for Costs {
    /// Of an adapter of which nothing is known.
    fn default() -> Self {
        Self::measured(&[None; TIERS_LEN])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::governor::Shading;
    use proptest::prelude::*;

    const FIRST_LEAN: usize = 3;

    #[test]
    fn ratios_are_those_that_were_measured() {
        assert_eq!([TIERS[FIRST_LEAN - 1].shading, TIERS[FIRST_LEAN].shading], Shading::ALL);
        // The software driver's, ms: docs/gpu.md.
        let ms = [3600, 1400, 360, 22, 14, 10, 7, 5, 3];
        let costs = Costs::measured(&ms.map(|t| Some(t * 1_000_000)));
        assert!((costs.ratio(5, 4) - 1.4).abs() < 1e-9 && (costs.ratio(4, 6) - 0.5).abs() < 1e-9);
        assert!((costs.ratio(3, 2) - 360.0 / 22.0).abs() < 1e-9);
        assert!((costs.ratio(0, 0) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_disturbed_measurement_is_not_believed() {
        let calm = [None, None, None, Some(22), Some(14), Some(10), Some(7), Some(5), Some(3)];
        let mut disturbed = calm;
        (disturbed[5], disturbed[7]) = (Some(90), Some(400));
        for (from, to) in [(6, 5), (5, 4), (7, 6), (8, 7)] {
            let ratio = Costs::measured(&disturbed).ratio(from, to);
            let pixels = f64::from(TIERS[to].width_px * TIERS[to].height_px)
                / f64::from(TIERS[from].width_px * TIERS[from].height_px);
            assert!((1.0..=pixels).contains(&ratio), "{from} to {to}: {ratio}");
        }
    }

    proptest! {
        #[test]
        fn better_tiers_are_never_cheaper(ns in prop::array::uniform9(prop::option::of(any::<u64>()))) {
            let costs = Costs::measured(&ns);
            for tier in 1..TIERS_LEN {
                let up = costs.ratio(tier, tier - 1);
                prop_assert!(up.is_finite() && up >= 1.0);
                prop_assert!((up * costs.ratio(tier - 1, tier) - 1.0).abs() < 1e-9);
            }
        }
    }
}
