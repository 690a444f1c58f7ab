//! What is summed over a component while it grows: weighted moments, area, boxes, peak, saturation.
//!
//! Integers only; the widths that the hardware needs are in [`super::limits::Widths`].

use super::limits::FULL_WEIGHT;

/// Luma from which a pixel counts as saturated: peak white of BT.601.
pub const SATURATED: u8 = 235;

/// Sums over the pixels of a component. Weights w are in 1/[`FULL_WEIGHT`] px; x is the column, y the line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sums {
    /// Σ w.
    pub w: u64,
    /// Σ w·x.
    pub wx: u64,
    /// Σ w·y.
    pub wy: u64,
    /// Σ w·x².
    pub wxx: u64,
    /// Σ w·x·y.
    pub wxy: u64,
    /// Σ w·y².
    pub wyy: u64,
    /// Σ w·x³.
    pub wxxx: u128,
    /// Σ w·x²·y.
    pub wxxy: u128,
    /// Σ w·x·y².
    pub wxyy: u128,
    /// Σ w·y³.
    pub wyyy: u128,
    /// Pixels.
    pub area: u32,
    /// Pixels with a weight between none and all: the outline, where noise counts.
    pub rim: u32,
    /// Pixels at [`SATURATED`] or above.
    pub saturated: u32,
    /// Brightest luma.
    pub peak: u8,
    /// Largest luma above the background of its run, grey levels.
    pub contrast: u8,
    /// Colour class.
    pub class: u8,
    /// Bounding box of pixels with at least half the weight: first and last column, first and last line.
    pub half_box_px: [u16; 4],
    /// Bounding box of all pixels, in the same order.
    pub box_px: [u16; 4],
    /// Last column of the last line: where the component's last pixel was read.
    pub last_x: u16,
}

/// A box that holds nothing.
pub const EMPTY_BOX: [u16; 4] = [u16::MAX, 0, u16::MAX, 0];

/// The smallest box around two.
fn around(a: [u16; 4], b: [u16; 4]) -> [u16; 4] {
    [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])]
}

impl Sums {
    /// The sums of a run in line `y` that starts at column `x`: its pixels' luma and weights, and the
    /// level of the background there, grey levels.
    pub fn of_run(luma: &[u8], weights: &[u8], x: u16, y: u16, class: u8, background: u8) -> Self {
        let last = x + luma.len() as u16 - 1;
        let mut sums = Sums {
            class,
            area: luma.len() as u32,
            half_box_px: EMPTY_BOX,
            box_px: [x, last, y, y],
            last_x: last,
            ..Sums::default()
        };
        for ((column, &value), &weight) in (x..).zip(luma).zip(weights) {
            let (w, c) = (u64::from(weight), u64::from(column));
            sums.w += w;
            sums.wx += w * c;
            sums.wxx += w * c * c;
            sums.wxxx += u128::from(w * c * c * c);
            sums.rim += u32::from(weight > 0 && weight < FULL_WEIGHT);
            sums.saturated += u32::from(value >= SATURATED);
            sums.peak = sums.peak.max(value);
            if weight >= FULL_WEIGHT / 2 {
                sums.half_box_px = around(sums.half_box_px, [column, column, y, y]);
            }
        }
        sums.contrast = sums.peak.saturating_sub(background);
        let line = u64::from(y);
        (sums.wy, sums.wxy, sums.wyy) = (sums.w * line, sums.wx * line, sums.w * line * line);
        let line = u128::from(y);
        sums.wxxy = u128::from(sums.wxx) * line;
        sums.wxyy = u128::from(sums.wxy) * line;
        sums.wyyy = u128::from(sums.wyy) * line;
        sums
    }

    /// Takes another part of the same component in.
    pub fn add(&mut self, other: &Sums) {
        self.w += other.w;
        self.wx += other.wx;
        self.wy += other.wy;
        self.wxx += other.wxx;
        self.wxy += other.wxy;
        self.wyy += other.wyy;
        self.wxxx += other.wxxx;
        self.wxxy += other.wxxy;
        self.wxyy += other.wxyy;
        self.wyyy += other.wyyy;
        self.area += other.area;
        self.rim += other.rim;
        self.saturated += other.saturated;
        self.peak = self.peak.max(other.peak);
        self.contrast = self.contrast.max(other.contrast);
        self.half_box_px = around(self.half_box_px, other.half_box_px);
        self.last_x = match self.last_line().cmp(&other.last_line()) {
            std::cmp::Ordering::Less => other.last_x,
            std::cmp::Ordering::Equal => self.last_x.max(other.last_x),
            std::cmp::Ordering::Greater => self.last_x,
        };
        self.box_px = around(self.box_px, other.box_px);
    }

    /// Last line of the component.
    pub fn last_line(&self) -> u16 {
        self.box_px[3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::limits::PICTURE;
    use proptest::prelude::*;

    /// The sums of single pixels, by their definition.
    fn by_definition(pixels: &[(u16, u16, u8, u8)]) -> [u128; 10] {
        let mut sums = [0u128; 10];
        for &(x, y, _, w) in pixels {
            let [x, y, w] = [u128::from(x), u128::from(y), u128::from(w)];
            let powers = [1, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y];
            sums.iter_mut().zip(powers).for_each(|(sum, power)| *sum += w * power);
        }
        sums
    }

    fn moments(s: &Sums) -> [u128; 10] {
        let low = [s.w, s.wx, s.wy, s.wxx, s.wxy, s.wyy].map(u128::from);
        [low[0], low[1], low[2], low[3], low[4], low[5], s.wxxx, s.wxxy, s.wxyy, s.wyyy]
    }

    proptest! {
        #[test]
        fn moments_are_those_of_the_definition_in_any_order(
            lines in prop::collection::vec((0u16..8192, 0u16..100, prop::collection::vec((any::<u8>(), 0u8..=64), 1..40)), 1..8),
        ) {
            let mut pixels = Vec::new();
            let mut forward: Option<Sums> = None;
            let mut parts = Vec::new();
            for (y, x, run) in &lines {
                let (luma, weights): (Vec<u8>, Vec<u8>) = run.iter().copied().unzip();
                pixels.extend(run.iter().zip(*x..).map(|(&(v, w), x)| (x, *y, v, w)));
                let part = Sums::of_run(&luma, &weights, *x, *y, 1, 30);
                parts.push(part);
                match &mut forward {
                    Some(sums) => sums.add(&part),
                    None => forward = Some(part),
                }
            }
            let sums = forward.unwrap();
            prop_assert_eq!(moments(&sums), by_definition(&pixels));
            prop_assert_eq!(sums.area as usize, pixels.len());
            prop_assert_eq!(sums.peak, pixels.iter().map(|p| p.2).max().unwrap());
            let last = pixels.iter().map(|p| (p.1, p.0)).max().unwrap();
            prop_assert_eq!((sums.last_line(), sums.last_x), last);
            let mut backward = *parts.last().unwrap();
            parts.iter().rev().skip(1).for_each(|part| backward.add(part));
            prop_assert_eq!(backward, sums);
        }
    }

    #[test]
    fn the_largest_picture_at_full_weight_overflows_nothing() {
        let (luma, weights) = (vec![255; PICTURE.width], vec![FULL_WEIGHT; PICTURE.width]);
        let mut sums = Sums::of_run(&luma, &weights, 0, 0, 7, 0);
        for y in 1..PICTURE.lines as u16 {
            sums.add(&Sums::of_run(&luma, &weights, 0, y, 7, 0));
        }
        let widths = PICTURE.widths();
        let expected = [widths.w, widths.wx, widths.wy, widths.wxx, widths.wxy, widths.wyy];
        let third = [widths.wxxx, widths.wxxy, widths.wxyy, widths.wyyy];
        let found = moments(&sums).map(|s| 128 - s.leading_zeros());
        assert_eq!((&found[..6], &found[6..]), (&expected[..], &third[..]));
    }
}
