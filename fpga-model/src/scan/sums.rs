//! Sums over a component while it grows: weighted moments, area, boxes, peak, saturation.
//!
//! Integers only; the widths that the hardware needs are in [`super::limits::Widths`].

use super::limits::FULL_WEIGHT;
use super::weight::Slope;

/// Luma from which a pixel counts as saturated: peak white of BT.601.
pub const SATURATED: u8 = 235;

/// Sums over the pixels of a component. Weights w are in 1/[`FULL_WEIGHT`] px; x is the column, y
/// the line.
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
    /// Σ of the rise of the lit surface from left to right, quarters of a level.
    pub rise: i64,
    /// Σ of the columns over which it rises, times their contrast in quarters of a level.
    pub span: u64,
    /// Σ of squared differences of full-weight pixels two columns apart: the grain of the surface,
    /// levels².
    pub grain: u64,
    /// Number of these differences.
    pub grains: u32,
    /// Pixels of its runs.
    pub area: u32,
    /// Pixels of partial weight: the outline, where noise counts.
    pub rim: u32,
    /// Pixels at [`SATURATED`] or above.
    pub saturated: u32,
    /// Brightest luma.
    pub peak: u8,
    /// Largest luma above the background of its run, grey levels.
    pub contrast: u8,
    /// Colour class.
    pub class: u8,
    /// Bounding box of pixels with at least half the weight: first and last column, first and last
    /// line.
    pub half_box_px: [u16; 4],
    /// Bounding box of all pixels, in the same order.
    pub box_px: [u16; 4],
    /// Last column of the last line: where the component's last pixel was read.
    pub last_x: u16,
}

/// The empty box.
pub const EMPTY_BOX: [u16; 4] = [u16::MAX, 0, u16::MAX, 0];

/// The smallest box around two.
fn around(a: [u16; 4], b: [u16; 4]) -> [u16; 4] {
    [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])]
}

impl Sums {
    /// Sums of a run of line `y` from column `x` on, without weights. `luma` are its pixels;
    /// `background` is the level there, grey levels.
    pub fn of_run(luma: &[u8], x: u16, y: u16, class: u8, background: u8) -> Self {
        let last = x + luma.len() as u16 - 1;
        let peak = luma.iter().fold(0, |m, &v| m.max(v));
        Sums {
            class,
            area: luma.len() as u32,
            saturated: luma.iter().map(|&v| u32::from(v >= SATURATED)).sum(),
            peak,
            contrast: peak.saturating_sub(background),
            half_box_px: EMPTY_BOX,
            box_px: [x, last, y, y],
            last_x: last,
            ..Sums::default()
        }
    }

    /// Adds weighed pixels of line `y` from column `x` on. `run` is the slope along a run with its
    /// skirt, whose grain then counts too.
    pub fn weigh(&mut self, luma: &[u8], weights: &[u8], x: u16, y: u16, run: Option<Slope>) {
        let mut line = Sums { half_box_px: EMPTY_BOX, box_px: EMPTY_BOX, ..Sums::default() };
        for (column, &weight) in (x..).zip(weights) {
            let (w, c) = (u64::from(weight), u64::from(column));
            line.w += w;
            line.wx += w * c;
            line.wxx += w * c * c;
            line.wxxx += u128::from(w * c * c * c);
            line.rim += u32::from(weight > 0 && weight < FULL_WEIGHT);
            if weight >= FULL_WEIGHT / 2 {
                line.half_box_px = around(line.half_box_px, [column, column, y, y]);
            }
        }
        if let Some(slope) = run {
            line.add_surface(luma, weights, slope);
        }
        let y = u64::from(y);
        (line.wy, line.wxy, line.wyy) = (line.w * y, line.wx * y, line.w * y * y);
        let y = u128::from(y);
        line.wxxy = u128::from(line.wxx) * y;
        line.wxyy = u128::from(line.wxy) * y;
        line.wyyy = u128::from(line.wyy) * y;
        line.last_x = self.last_x;
        line.box_px = self.box_px;
        self.add(&line);
    }

    /// Adds slope and grain of a run's lit surface.
    fn add_surface(&mut self, luma: &[u8], weights: &[u8], slope: Slope) {
        (self.rise, self.span) = (i64::from(slope.rise), u64::from(slope.contrast));
        for (v, w) in luma.windows(3).zip(weights.windows(3)) {
            if w[0] == FULL_WEIGHT && w[2] == FULL_WEIGHT {
                let step = u64::from(v[0].abs_diff(v[2]));
                self.grain += step * step;
                self.grains += 1;
            }
        }
    }

    /// Adds another part of the same component.
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
        self.rise += other.rise;
        self.span += other.span;
        self.grain += other.grain;
        self.grains += other.grains;
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
                let mut part = Sums::of_run(&luma, *x, *y, 1, 30);
                part.weigh(&luma, &weights, *x, *y, None);
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
        let mut sums = Sums::of_run(&luma, 0, 0, 7, 0);
        for y in 0..PICTURE.lines as u16 {
            sums.weigh(&luma, &weights, 0, y, None);
        }
        let widths = PICTURE.widths();
        let expected = [widths.w, widths.wx, widths.wy, widths.wxx, widths.wxy, widths.wyy];
        let third = [widths.wxxx, widths.wxxy, widths.wxyy, widths.wyyy];
        let found = moments(&sums).map(|s| 128 - s.leading_zeros());
        assert_eq!((&found[..6], &found[6..]), (&expected[..], &third[..]));
    }
}
