//! Pixels to weights: how much of a pixel a marker covers, judged by its luma against the lit
//! surface beside it.
//!
//! The lit surface beside a pixel is the brightest mean of [`PLATEAU`] neighbouring pixels that
//! lies within [`REACH`] columns and [`LINES`] lines of it. A mean, because the brightest single
//! pixel is bright by its noise; near the pixel, because a marker lit from one side is brighter
//! there than at its other edge; of the lines above and below too, because the first and last line
//! that a marker touches show none of its surface at full light. Pixels of other colours are
//! ignored. The weight is the pixel's share of that contrast, from nothing at 7 % to all at 87 %:
//! between them it is linear, so that the sum over a blurred edge gives the place of the edge for
//! any sampling phase; beyond them noise of background and surface does not count. The variance of
//! that rule is within a few per cent of the least that any rule of single pixels has at an edge
//! with a Gaussian blur.

use super::limits::{FULL_WEIGHT, LEVEL_BITS, bits};
use super::runs::Run;
use protocol::blobs::Colour;
use std::ops::Range;

/// Lines above and below a pixel that are searched for its lit surface.
pub const LINES: usize = 2;
/// Pixels whose mean is a lit surface; a power of two.
pub const PLATEAU: usize = 4;
/// Columns to the left and right of a pixel in which its lit surface lies.
pub const REACH: usize = 5;
/// Pixels of a line in the window.
pub const WINDOW: usize = 2 * REACH + 1;
/// Grey levels above the background that a lit surface has at least.
const LEAST_CONTRAST: u32 = 16;
/// The ramp in 1/1024 of the contrast: it begins at 7.4 % and ends eight tenths later.
const RAMP_FROM: u32 = 76;
/// `1024 · FULL_WEIGHT / 820`, rounded: weight for each 1/1024 of contrast, in 1/1024.
const RAMP_GAIN: u32 = 80;
/// Words of the table of reciprocals: contrasts in quarters of a level.
const RECIPROCALS: usize = 1024;
/// Fixed point of a reciprocal.
const RECIPROCAL_BITS: u32 = 20;
/// Columns that the skirt and a blurred edge may take at each end of the pixels weighed.
const EDGE: usize = 5;
/// Least number of pixels whose left and right surface are compared.
const LEAST_SPAN: usize = 2 * EDGE + PLATEAU + 6;

/// Look-up tables: name, words, bits of a word.
pub const MEMORIES: [(&str, usize, u32); 1] =
    [("reciprocals of contrast", RECIPROCALS, bits(RECIPROCAL_TABLE[0] as u128))];

/// Sums of [`PLATEAU`] pixels that lie within [`REACH`] of one.
const SUMS: usize = WINDOW - PLATEAU + 1;

/// 2²⁰ over the contrast in 1/16 level, at the middle of each quarter of a level.
const RECIPROCAL_TABLE: [u16; RECIPROCALS] = {
    let mut table = [0; RECIPROCALS];
    let mut i = 0;
    while i < RECIPROCALS {
        let contrast = 4 * i as u32 + 2;
        let least = LEAST_CONTRAST << LEVEL_BITS;
        table[i] = ((1 << RECIPROCAL_BITS) / if contrast < least { least } else { contrast }) as u16;
        i += 1;
    }
    table
};

const _: () = assert!(LEVEL_BITS == 4, "contrasts are in 1/16 level");
const _: () = assert!(PLATEAU.is_power_of_two() && SUMS.is_power_of_two(), "maxima form a tree");
const _: () = assert!(PLATEAU << LEVEL_BITS == 64 && (255 << LEVEL_BITS) / 4 < RECIPROCALS);
// Above the background 12 bits, a reciprocal 12 or 13, a share 11, a ramp 18.
const _: () = assert!(
    bits(255 << LEVEL_BITS) + bits(RECIPROCAL_TABLE[0] as u128) <= 25
        && bits((1024 * RAMP_GAIN) as u128) <= 18
        && (1024 - RAMP_FROM) * RAMP_GAIN >= 1024 * FULL_WEIGHT as u32
);

/// A line and its runs.
#[derive(Debug, Clone, Copy)]
pub struct Line<'a> {
    /// Luma; at least one pixel.
    pub luma: &'a [u8],
    /// Runs, from left to right.
    pub runs: &'a [Run],
}

/// A line with the lines around it, uppermost first; where the field ends, its last line again.
pub type Around<'a> = [Line<'a>; 2 * LINES + 1];

/// How the lit surface rises from the left to the right end of a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Slope {
    /// Rise, quarters of a level.
    pub rise: i32,
    /// Distance in columns times the contrast in quarters of a level.
    pub contrast: u32,
}

/// The slope along a run with its skirt, if it is long enough: from the first to the last
/// [`PLATEAU`] pixels that no edge reaches.
pub fn slope(luma: &[u8], background_q4: u16) -> Slope {
    if luma.len() < LEAST_SPAN {
        return Slope::default();
    }
    let (first, last) = (EDGE, luma.len() - EDGE - PLATEAU);
    let [left, right] =
        [first, last].map(|i| luma[i..i + PLATEAU].iter().map(|&v| i32::from(v)).sum::<i32>());
    let above = (left + right) / 2 - i32::from(background_q4 >> 2);
    Slope { rise: right - left, contrast: above.max(0) as u32 * (last - first) as u32 }
}

/// The weighing with its scratch registers.
#[derive(Debug, Clone, Default)]
pub struct Weigher {
    /// A line without the pixels of other colours.
    seen: Vec<u8>,
    /// Brightest sum of [`PLATEAU`] pixels over the lines, by the column of its first.
    plateaus: Vec<u16>,
    /// Compare with the brightest pixel instead of the brightest mean.
    spots: bool,
    /// The weights of the pixels weighed last, 0 to [`FULL_WEIGHT`].
    pub weights: Vec<u8>,
}

impl Weigher {
    /// Room for lines of `width` px.
    pub fn new(width: usize) -> Self {
        let room = width + WINDOW;
        Weigher {
            seen: Vec::with_capacity(room),
            plateaus: Vec::with_capacity(room),
            spots: false,
            weights: Vec::with_capacity(width),
        }
    }

    /// As [`Weigher::new`], for spots of light that are too small to have a lit surface: their
    /// pixels are compared with the brightest one, so that weights follow the light up to its peak.
    pub fn for_spots(width: usize) -> Self {
        Weigher { spots: true, ..Weigher::new(width) }
    }

    /// Weighs the pixels of `range` in the middle line of `around` as those of a component of
    /// `class`; the background there is at `background_q4` in 1/16 grey level.
    pub fn weigh(&mut self, around: &Around, range: Range<usize>, class: u8, background_q4: u16) {
        self.plateaus.clear();
        self.plateaus.resize(range.len() + SUMS - 1, 0);
        for line in around {
            self.look_at(line, &range, class);
            self.find_plateaus();
        }
        self.weights.clear();
        for (i, &luma) in around[LINES].luma[range].iter().enumerate() {
            let plateau = self.plateaus[i..i + SUMS].iter().fold(0, |m, &p| m.max(p));
            self.weights.push(weight(luma, plateau, background_q4));
        }
    }

    /// Fills `seen` with the pixels of a line from [`REACH`] before to [`REACH`] behind `range`.
    fn look_at(&mut self, line: &Line, range: &Range<usize>, class: u8) {
        let last = line.luma.len() - 1;
        let (before, behind) =
            (REACH.saturating_sub(range.start), (range.end + REACH).saturating_sub(last + 1));
        let from = range.start.saturating_sub(REACH);
        let to = (range.end + REACH).min(last + 1);
        self.seen.clear();
        // Clamp to edge.
        self.seen.resize(before, line.luma[0]);
        self.seen.extend_from_slice(&line.luma[from..to]);
        self.seen.resize(before + (to - from) + behind, line.luma[last]);
        let first = line.runs.partition_point(|run| usize::from(run.end) <= from);
        for run in line.runs[first..].iter().take_while(|run| usize::from(run.start) < to) {
            if run.class != class && run.class != Colour::White as u8 {
                let [start, end] =
                    [run.start, run.end].map(|x| usize::from(x).clamp(from, to) - from + before);
                self.seen[start..end].fill(0);
            }
        }
    }

    /// Raises `plateaus` to the sums of the pixels in `seen`.
    fn find_plateaus(&mut self) {
        if self.spots {
            for (plateau, four) in self.plateaus.iter_mut().zip(self.seen.windows(PLATEAU)) {
                let peak = four.iter().fold(0, |m, &v| m.max(v));
                *plateau = (*plateau).max(u16::from(peak) * PLATEAU as u16);
            }
            return;
        }
        let (ahead, behind) = (&self.seen[PLATEAU - 1..], &self.seen);
        let mut sum = behind[..PLATEAU - 1].iter().map(|&v| u16::from(v)).sum::<u16>();
        for ((plateau, &new), &old) in self.plateaus.iter_mut().zip(ahead).zip(behind) {
            sum += u16::from(new);
            *plateau = (*plateau).max(sum);
            sum -= u16::from(old);
        }
    }
}

/// The weight of a pixel beside a surface of `plateau`, the sum of [`PLATEAU`] pixels.
#[inline]
fn weight(luma: u8, plateau: u16, background_q4: u16) -> u8 {
    let above = (u32::from(luma) << LEVEL_BITS).saturating_sub(u32::from(background_q4));
    // Four pixels in 1/16 level: times 16, over 4.
    let contrast = (u32::from(plateau) << 2).saturating_sub(u32::from(background_q4));
    let reciprocal = u32::from(RECIPROCAL_TABLE[(contrast >> 2) as usize]);
    let share = ((above * reciprocal) >> (RECIPROCAL_BITS - 10)).min(1023);
    let on_ramp = (share.saturating_sub(RAMP_FROM) * RAMP_GAIN + 512) >> 10;
    on_ramp.min(u32::from(FULL_WEIGHT)) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Weights of a line that looks the same above and below, by the definition and in floating
    /// point.
    fn by_definition(lines: &[Vec<u8>], x: usize, background: f64) -> f64 {
        let at = |line: &[u8], x: i64| f64::from(line[x.clamp(0, line.len() as i64 - 1) as usize]);
        let x = x as i64;
        let mean = |line: &[u8], from: i64| (from..from + 4).map(|i| at(line, i)).sum::<f64>() / 4.0;
        let means = lines.iter().flat_map(|line| (x - 5..=x + 2).map(move |from| mean(line, from)));
        let contrast = (means.fold(0.0, f64::max) - background).max(16.0);
        let share = (at(&lines[LINES], x) - background) / contrast;
        ((share - 76.0 / 1024.0) / 0.8).clamp(0.0, 1.0) * 64.0
    }

    fn weigh(lines: &[Vec<u8>], range: Range<usize>, background_q4: u16) -> Weigher {
        let mut weigher = Weigher::new(lines[0].len());
        let around = std::array::from_fn(|i| Line { luma: &lines[i], runs: &[] });
        weigher.weigh(&around, range, 1, background_q4);
        weigher
    }

    proptest! {
        #[test]
        fn weights_are_those_of_the_definition(
            lines in prop::collection::vec(prop::collection::vec(any::<u8>(), 30), 5),
            start in 0usize..29, length in 1usize..30, background_q4 in 0u16..2000,
        ) {
            let range = start..(start + length).min(30);
            let weigher = weigh(&lines, range.clone(), background_q4);
            for (x, &w) in range.zip(&weigher.weights) {
                let expected = by_definition(&lines, x, f64::from(background_q4) / 16.0);
                prop_assert!((f64::from(w) - expected).abs() <= 1.6, "{w} at {x}, expected {expected}");
            }
        }
    }

    /// A line with a bar of contrast 80 from `left` to `right` whose edges are `wide` px wide.
    fn bar(left: f64, right: f64, wide: f64, tilt: f64) -> Vec<u8> {
        let cover =
            |x: f64| ((x - left) / wide + 0.5).clamp(0.0, 1.0) * ((right - x) / wide + 0.5).clamp(0.0, 1.0);
        let lit = |x: f64| 80.0 * (1.0 + tilt * (x - (left + right) / 2.0));
        (0..60).map(|x| (30.0 + lit(f64::from(x)) * cover(f64::from(x))).round() as u8).collect()
    }

    fn centre(line: Vec<u8>) -> (f64, f64) {
        let weigher = weigh(&vec![line; 5], 5..55, 30 << 4);
        let sum: f64 = weigher.weights.iter().map(|&w| f64::from(w)).sum();
        let first: f64 = weigher.weights.iter().zip(5..).map(|(&w, x)| f64::from(w) * f64::from(x)).sum();
        (first / sum, sum / 64.0)
    }

    #[test]
    fn blurred_bars_have_their_centre_and_length_wherever_the_pixels_cut_them() {
        for step in 0..40 {
            let shift = f64::from(step) / 40.0;
            for wide in [2.0, 3.0, 4.0] {
                let (middle, length) = centre(bar(20.0 + shift, 38.3 + shift, wide, 0.0));
                assert!((middle - 29.15 - shift).abs() < 0.05, "{wide} px, {shift}: {middle}");
                assert!((length - 18.3).abs() < 0.4, "{wide} px, {shift}: {length}");
            }
        }
    }

    #[test]
    fn light_from_one_side_hardly_moves_a_bar() {
        // 4 % brighter at the right end, 4 % darker at the left: intensity would be off by 0.12 px.
        let (middle, _) = centre(bar(20.0, 38.0, 2.4, 0.04 / 9.0));
        assert!((middle - 29.0).abs() < 0.04, "{middle}");
        let slope = slope(&bar(20.0, 38.0, 2.4, 0.04 / 9.0)[17..42], 30 << 4);
        let found = f64::from(slope.rise) / f64::from(slope.contrast);
        assert!((found - 0.04 / 9.0).abs() < 0.001, "{found}");
    }

    #[test]
    fn first_line_of_a_marker_is_compared_with_the_lines_below() {
        let (dark, half, lit) = (vec![30; 40], vec![60; 40], vec![90; 40]);
        let top = [dark.clone(), dark, half, lit.clone(), lit].to_vec();
        assert!(weigh(&top, 10..30, 30 << 4).weights.iter().all(|&w| w.abs_diff(34) <= 1));
        let alone = vec![vec![60; 40]; 5];
        assert!(weigh(&alone, 10..30, 30 << 4).weights.iter().all(|&w| w == FULL_WEIGHT));
    }

    #[test]
    fn brighter_marker_of_another_colour_takes_no_weight_away() {
        let line: Vec<u8> = (0..40)
            .map(|x| {
                if x < 10 {
                    30
                } else if x < 20 {
                    114
                } else {
                    184
                }
            })
            .collect();
        let run = |start: u16, end: u16, class: u8| Run { start, end, class };
        let runs = [run(10, 20, 1), run(20, 40, 2)];
        let around = [Line { luma: &line, runs: &runs }; 5];
        let mut weigher = Weigher::new(40);
        weigher.weigh(&around, 10..20, 1, 30 << 4);
        assert_eq!(weigher.weights, [FULL_WEIGHT; 10]);
        weigher.weigh(&around, 20..40, 2, 30 << 4);
        assert_eq!(weigher.weights, [FULL_WEIGHT; 20]);
    }

    #[test]
    fn spots_are_weighed_by_their_light() {
        // A star over a background of 30, its centre at column 15.3.
        let star = |y: f64| -> Vec<u8> {
            let light = |x: f64| 120.0 * libm::exp(-((x - 15.3) * (x - 15.3) + y * y) / (2.0 * 1.2 * 1.2));
            (0..32).map(|x| (30.0 + light(f64::from(x))).round() as u8).collect()
        };
        let lines = [-2.0, -1.0, 0.0, 1.0, 2.0].map(star);
        let off = |mut weigher: Weigher| {
            weigher.weigh(&std::array::from_fn(|i| Line { luma: &lines[i], runs: &[] }), 8..23, 7, 30 << 4);
            let sums =
                weigher.weights.iter().zip(8..).map(|(&w, x)| (f64::from(w), f64::from(w) * f64::from(x)));
            let (w, wx) = sums.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
            (wx / w - 15.3).abs()
        };
        assert!(off(Weigher::for_spots(32)) < 0.02);
        assert!(off(Weigher::new(32)) > 0.02, "with a surface to compare with, the core counts alike");
    }

    #[test]
    fn extremes_stay_within_the_registers() {
        for (luma, background) in [(0, 0), (255, 0), (0, 4080), (255, 4080)] {
            let weigher = weigh(&vec![vec![luma; 3]; 5], 0..3, background);
            let expected = if luma == 255 && background == 0 { FULL_WEIGHT } else { 0 };
            assert_eq!(weigher.weights, [expected; 3]);
        }
    }
}
