//! Components while they grow: integer moments, and what becomes of them when they are complete.

use crate::colours::{ColourTable, FULL_WEIGHT, SATURATED};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, Blob};

/// Widest line the registers are laid out for.
pub const MAX_WIDTH: usize = 8192;
/// Most lines of a field.
pub const MAX_LINES: usize = 4096;
/// How far beside a pixel its lit surface is looked for, px: across the blurred edge.
const LIT_REACH: usize = 3;
/// Least area of a blob, px: 6 px is an eighth of the smallest marker of the shipped rig.
const LEAST_AREA: u64 = 6;
/// Noise of a weight on the rim (σ): 3 grey levels of noise, times the slope of the ramp, which is between
/// 0.7 (yellow) and 1.8 (blue) per grey level.
const WEIGHT_NOISE: u64 = 5;
/// Variance that remains without noise, because lines sample the outline coarsely: (0.02 px)² in 2⁻²⁴ px².
const FLOOR_Q24: u64 = (1 << 24) / 2500;
/// Fixed point of centres.
const CENTRE_BITS: u32 = 16;
/// A disc has `area² = 16 π² · det(second moments)`. Below this share of it, in 1/64, a blob is two discs.
const FILL_64: u128 = 58;

const _: () = assert!((FULL_WEIGHT as usize) < 128, "weights have 7 bits");
// 7 + 13 + 12 bits of weight, 13 more for a first and 26 for a second moment: 58 bits at most.
const _: () = assert!((127 * MAX_WIDTH * MAX_LINES) as u128 * (MAX_WIDTH * MAX_WIDTH) as u128 <= 1 << 58);

/// Sums over a component. Weights are in 1/[`FULL_WEIGHT`] px.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Part {
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
    /// Pixels on the ramp: the outline, where noise counts.
    pub rim: u32,
    /// Pixels at peak white.
    pub saturated: u32,
    /// Bounding box of pixels with at least half the weight: columns, then lines; inclusive.
    pub box_px: [u16; 4],
    /// Bounding box of all pixels.
    pub reach_px: [u16; 4],
    /// Colour class.
    pub class: u8,
    /// Line of the newest run.
    pub last_line: u16,
}

/// A box that holds nothing.
const EMPTY: [u16; 4] = [u16::MAX, 0, u16::MAX, 0];

fn unite(a: [u16; 4], b: [u16; 4]) -> [u16; 4] {
    [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])]
}

impl Part {
    /// The sums of a run in line `y` that starts at column `x`; `luma` are its pixels.
    pub fn of_run(table: &ColourTable, luma: &[u8], x: u16, y: u16, class: u8) -> Self {
        let last = x + luma.len() as u16 - 1;
        let mut part =
            Part { class, last_line: y, box_px: EMPTY, reach_px: [x, last, y, y], ..Part::default() };
        let least_lit = table.least_lit(class);
        for (i, (column, &value)) in (x..).zip(luma).enumerate() {
            let beside = &luma[i.saturating_sub(LIT_REACH)..luma.len().min(i + LIT_REACH + 1)];
            let lit = beside.iter().fold(least_lit, |m, &v| m.max(v));
            let weight = table.weight(value, lit);
            let (w, c) = (u64::from(weight), u64::from(column));
            part.w += w;
            part.wx += w * c;
            part.wxx += w * c * c;
            part.rim += u32::from(weight > 0 && weight < FULL_WEIGHT);
            part.saturated += u32::from(value >= SATURATED);
            if weight >= FULL_WEIGHT / 2 {
                part.box_px = unite(part.box_px, [column, column, y, y]);
            }
        }
        let line = u64::from(y);
        part.wy = part.w * line;
        part.wxy = part.wx * line;
        part.wyy = part.wy * line;
        part
    }

    /// Takes another part of the same component in.
    pub fn add(&mut self, other: &Part) {
        self.w += other.w;
        self.wx += other.wx;
        self.wy += other.wy;
        self.wxx += other.wxx;
        self.wxy += other.wxy;
        self.wyy += other.wyy;
        self.rim += other.rim;
        self.saturated += other.saturated;
        self.box_px = unite(self.box_px, other.box_px);
        self.reach_px = unite(self.reach_px, other.reach_px);
        self.last_line = self.last_line.max(other.last_line);
    }

    /// The complete component as a blob of a field of `size_px`; `None` for a speck.
    pub fn blob(&self, size_px: [u16; 2]) -> Option<Blob> {
        let full = u64::from(FULL_WEIGHT);
        if self.w < LEAST_AREA * full || self.box_px[0] > self.box_px[1] || self.box_px[2] == self.box_px[3] {
            return None;
        }
        let centre = |sum: u64| ((sum as u128) << CENTRE_BITS) / u128::from(self.w);
        let [width, height] = [1, 3].map(|i| u64::from(self.box_px[i] - self.box_px[i - 1]) + 1);
        let flags = self.flags(size_px);
        // A frame line is half a field line: four times the variance.
        let [var_x, var_y] = [self.variance_q24(width, flags), 4 * self.variance_q24(height, flags)];
        let to_px = |q: u128, bits: u32| q as f64 / (1u64 << bits) as f64;
        Some(Blob {
            x_px: to_px(centre(self.wx), CENTRE_BITS),
            y_field_px: to_px(centre(self.wy), CENTRE_BITS),
            area_px: to_px(u128::from(self.w), FULL_WEIGHT.trailing_zeros()),
            width_px: width as f64,
            height_px: height as f64,
            var_x_px2: to_px(u128::from(var_x), 24),
            var_y_px2: to_px(u128::from(var_y), 24),
            cov_xy_px2: 0.0,
            colour: u32::from(self.class),
            flags,
        })
    }

    /// Variance of the centre along a side of length `side` px. Noise acts on the rim only, whose
    /// pixels lie about `side²/8` (mean square) from the centre: σ² · rim · side²/8 / (Σ w)². Where
    /// something is hidden or grown together, the centre may be off by a part of the side.
    fn variance_q24(&self, side: u64, flags: u32) -> u64 {
        let spread = u128::from(WEIGHT_NOISE * WEIGHT_NOISE * u64::from(self.rim) * side * side / 8);
        let noise = ((spread << 24) / (u128::from(self.w) * u128::from(self.w))) as u64;
        let doubt = if flags & (BLOB_CLIPPED | BLOB_MERGED) != 0 { ((side * side) << 24) / 64 } else { 0 };
        noise + FLOOR_Q24 + doubt
    }

    fn flags(&self, size_px: [u16; 2]) -> u32 {
        let [left, right, top, bottom] = self.reach_px;
        let at_border = left == 0 || top == 0 || right + 1 == size_px[0] || bottom + 1 == size_px[1];
        let set = |holds: bool, bit: u32| if holds { bit } else { 0 };
        set(at_border, BLOB_CLIPPED)
            | set(self.saturated > 0, BLOB_SATURATED)
            | set(self.is_double(), BLOB_MERGED)
    }

    /// True if the component fills its own ellipse of inertia too badly for a single disc.
    fn is_double(&self) -> bool {
        // Central second moments times w, in units of w·px² · 2⁸: exact products need 116 bits.
        let w = i128::from(self.w);
        let central =
            |ab: u64, a: u64, b: u64| ((i128::from(ab) * w - i128::from(a) * i128::from(b)) << 4) / (w * w);
        let xx = central(self.wxx, self.wx, self.wx);
        let xy = central(self.wxy, self.wx, self.wy);
        let yy = central(self.wyy, self.wy, self.wy);
        let det_q8 = (xx * yy - xy * xy).max(0) as u128;
        // area² < share · 16 π² det, with 16 π² ≈ 158 and the weight's 1/64 px.
        let area2_q8 = ((u128::from(self.w) * u128::from(self.w)) << 8) / (64 * 64);
        area2_q8 * 64 < det_q8 * 158 * FILL_64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A white shape, one run a line.
    fn shape(inside: impl Fn(i32, i32) -> bool) -> Part {
        let table = ColourTable::default();
        let mut sum: Option<Part> = None;
        for y in 0..100 {
            let mut bright = (0..100).filter(|&x| inside(x, i32::from(y)));
            let Some(first) = bright.next() else { continue };
            let last = bright.next_back().unwrap_or(first);
            let line: Vec<u8> =
                (first..=last).map(|x| if inside(x, i32::from(y)) { 200 } else { 0 }).collect();
            let part = Part::of_run(&table, &line, first as u16, y, 7);
            match &mut sum {
                Some(sum) => sum.add(&part),
                None => sum = Some(part),
            }
        }
        sum.unwrap()
    }

    #[test]
    fn rectangle_has_its_centre_area_and_box() {
        let part = shape(|x, y| (20..30).contains(&x) && (40..44).contains(&y));
        let blob = part.blob([720, 288]).unwrap();
        assert_eq!((blob.x_px, blob.y_field_px), (24.5, 41.5));
        assert_eq!((blob.area_px, blob.width_px, blob.height_px), (40.0, 10.0, 4.0));
    }

    #[test]
    fn one_disc_is_single_and_two_touching_discs_are_double() {
        let disc = |x: i32, y: i32, cx: i32, cy: i32| {
            let (dx, dy) = (f64::from(x - cx) / 12.0, f64::from(y - cy) / 6.5);
            dx * dx + dy * dy <= 1.0
        };
        assert!(!shape(|x, y| disc(x, y, 50, 50)).is_double());
        assert!(shape(|x, y| disc(x, y, 40, 50) || disc(x, y, 63, 50)).is_double());
        assert!(shape(|x, y| disc(x, y, 42, 46) || disc(x, y, 58, 55)).is_double());
    }

    #[test]
    fn specks_are_no_blobs_and_borders_are_flagged() {
        assert!(shape(|x, y| x == 50 && y < 3).blob([720, 288]).is_none());
        let part = shape(|x, y| (5..15).contains(&x) && y > 90);
        assert_eq!(part.blob([720, 100]).unwrap().flags & BLOB_CLIPPED, BLOB_CLIPPED);
        assert_eq!(part.blob([720, 288]).unwrap().flags & BLOB_CLIPPED, 0);
    }

    #[test]
    fn a_full_field_of_the_largest_size_overflows_nothing() {
        let white = vec![255u8; MAX_WIDTH];
        let table = ColourTable::default();
        let mut sum = Part::of_run(&table, &white, 0, 0, 7);
        for y in 1..MAX_LINES as u16 {
            sum.add(&Part::of_run(&table, &white, 0, y, 7));
        }
        let blob = sum.blob([MAX_WIDTH as u16, MAX_LINES as u16]).unwrap();
        assert_eq!(blob.area_px, (MAX_WIDTH * MAX_LINES) as f64);
        assert!((blob.x_px - (MAX_WIDTH as f64 - 1.0) / 2.0).abs() < 1e-3);
        assert_eq!(blob.flags & BLOB_SATURATED, BLOB_SATURATED);
    }
}
