//! The level of the background: a fixed one, or one tracked block by block.
//!
//! Tracking keeps one level per block of 64 × 32 px. Every 16th pixel moves the level of its block
//! by 1/16 grey level towards itself, which settles at the median of the block (sigma–delta
//! estimation, Manzanera and Richefeu 2007): a marker, which covers a small part of a block, does
//! not move it. Between the centres of blocks the level is interpolated, linearly along the line
//! and every eighth line.

use super::limits::LEVEL_BITS;

/// Sides of a block, px and lines; powers of two.
const BLOCK: [usize; 2] = [64, 32];
/// Lines that share one row of levels.
const ROW_LINES: usize = 8;
/// Distance of the samples along a line, px; the lines' samples cover all columns of a block.
const SAMPLE: usize = 16;
/// Shift of the samples from line to line, px; coprime with [`SAMPLE`].
const SHIFT: usize = 5;
/// Bits of a level: 8 of luma and the fraction.
pub const LEVEL_WIDTH: u32 = 8 + LEVEL_BITS;
const LEVEL_MAX: u16 = 255 << LEVEL_BITS;

/// Source of the background level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// This luma everywhere.
    Fixed(u8),
    /// Tracked, with this luma at first.
    Tracked(u8),
}

/// The background of one camera.
#[derive(Debug, Clone)]
pub struct Background {
    level: Level,
    low: u8,
    blocks: [usize; 2],
    /// Level of each block, 1/16 grey level, row by row.
    levels: Vec<u16>,
    /// Level under each column of the current line.
    row: Vec<u16>,
    /// Least luma of a pixel that stands out.
    foreground: Vec<u8>,
}

/// Blocks along a side of `n` pixels.
pub const fn blocks_along(n: usize, axis: usize) -> usize {
    n.div_ceil(BLOCK[axis])
}

impl Background {
    /// For fields of `width` × `height` px; a pixel stands out if it is `low` grey levels above the
    /// level.
    pub fn new(level: Level, low: u8, width: usize, height: usize) -> Self {
        let blocks = [blocks_along(width, 0), blocks_along(height, 1)];
        let (Level::Fixed(start) | Level::Tracked(start)) = level;
        let start = u16::from(start) << LEVEL_BITS;
        let mut background = Background {
            level,
            low,
            blocks,
            levels: vec![start; blocks[0] * blocks[1]],
            row: vec![start; width],
            foreground: vec![0; width],
        };
        background.lay_row(0);
        background
    }

    /// Level under a column of the current line, 1/16 grey level.
    pub fn at(&self, x: usize) -> u16 {
        self.row[x]
    }

    /// Least luma that stands out, one a column.
    pub fn foreground(&self) -> &[u8] {
        &self.foreground
    }

    /// Makes line `y` the current line.
    pub fn begin_line(&mut self, y: usize) {
        if matches!(self.level, Level::Tracked(_)) && y.is_multiple_of(ROW_LINES) {
            self.lay_row(y);
        }
    }

    /// Tracks the background with the samples of line `y`.
    pub fn watch(&mut self, y: usize, luma: &[u8]) {
        if !matches!(self.level, Level::Tracked(_)) {
            return;
        }
        let row = &mut self.levels[y / BLOCK[1] * self.blocks[0]..][..self.blocks[0]];
        for x in (y * SHIFT % SAMPLE..luma.len()).step_by(SAMPLE) {
            let level = &mut row[x / BLOCK[0]];
            let seen = u16::from(luma[x]) << LEVEL_BITS;
            *level = (*level + u16::from(seen > *level) - u16::from(seen < *level)).min(LEVEL_MAX);
        }
    }

    /// Interpolates the levels for the lines from `y` on.
    fn lay_row(&mut self, y: usize) {
        let (above, below, fy) = between(y + ROW_LINES / 2, 1, self.blocks[1]);
        let column = |bx: usize| {
            let [a, b] = [above, below].map(|by| u32::from(self.levels[by * self.blocks[0] + bx]));
            (a * (BLOCK[1] as u32 - fy) + b * fy) / BLOCK[1] as u32
        };
        for x in 0..self.row.len() {
            let (left, right, fx) = between(x, 0, self.blocks[0]);
            let sum = column(left) * (BLOCK[0] as u32 - fx) + column(right) * fx;
            let level = (sum / BLOCK[0] as u32) as u16;
            self.row[x] = level;
            let rounded = (level + (1 << (LEVEL_BITS - 1))) >> LEVEL_BITS;
            self.foreground[x] = (rounded + u16::from(self.low)).clamp(1, 255) as u8;
        }
    }
}

/// The two blocks between whose centres `at` lies, and its distance from the first centre.
fn between(at: usize, axis: usize, blocks: usize) -> (usize, usize, u32) {
    let from_first_centre = at.saturating_sub(BLOCK[axis] / 2);
    let block = from_first_centre / BLOCK[axis];
    let fraction = (from_first_centre % BLOCK[axis]) as u32;
    (block.min(blocks - 1), (block + 1).min(blocks - 1), fraction)
}

const _: () = assert!(BLOCK[0].is_power_of_two() && BLOCK[1].is_power_of_two());
const _: () = assert!(SAMPLE.is_power_of_two() && SHIFT % 2 == 1, "every column of a block gets its turn");

#[cfg(test)]
mod tests {
    use super::*;

    /// Shows `picture` `times` times.
    fn settle(picture: &[Vec<u8>], times: usize) -> Background {
        let mut background = Background::new(Level::Tracked(30), 16, picture[0].len(), picture.len());
        for _ in 0..times {
            for (y, line) in picture.iter().enumerate() {
                background.begin_line(y);
                background.watch(y, line);
            }
        }
        background
    }

    #[test]
    fn median_of_a_slope_is_followed_and_a_marker_ignored() {
        let ground = |x: usize, y: usize| 40 + x / 8 + y / 8;
        let marker = |x: usize, y: usize| (90..112).contains(&x) && (40..52).contains(&y);
        let pixel = |x, y| if marker(x, y) { 200 } else { ground(x, y) as u8 };
        let picture: Vec<Vec<u8>> = (0..96).map(|y| (0..256).map(|x| pixel(x, y)).collect()).collect();
        let mut background = settle(&picture, 60);
        for y in [20, 44, 70] {
            background.begin_line(y / ROW_LINES * ROW_LINES);
            for x in [40, 100, 200] {
                let level = f64::from(background.at(x)) / 16.0;
                assert!((level - ground(x, y) as f64).abs() < 3.0, "{level} at {x}, {y}");
            }
        }
    }

    #[test]
    fn fixed_level_stays_and_threshold_saturates() {
        let mut background = Background::new(Level::Fixed(30), 16, 40, 40);
        background.watch(0, &[200; 40]);
        background.begin_line(0);
        assert_eq!((background.at(0), background.foreground()[39]), (30 << 4, 46));
        assert_eq!(Background::new(Level::Fixed(250), 16, 8, 8).foreground()[0], 255);
        assert_eq!(Background::new(Level::Fixed(0), 0, 8, 8).foreground()[0], 1);
    }

    #[test]
    fn white_fields_reach_the_top_and_stop_there() {
        let mut background = settle(&vec![vec![255; 64]; 64], 60);
        background.begin_line(0);
        assert_eq!(background.at(5), LEVEL_MAX);
    }
}
