//! A complete component as blobs: centre, variance, flags.

use super::limits::FULL_WEIGHT;
use super::sums::Sums;
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, Blob};

/// Noise of a weight on the rim (σ): 3 grey levels of noise, times the slope of the ramp, which is between
/// 0.7 (yellow) and 1.8 (blue) per grey level.
const WEIGHT_NOISE: u64 = 5;
/// Variance that remains without noise, because lines sample the outline coarsely: (0.02 px)² in 2⁻²⁴ px².
const FLOOR_Q24: u64 = (1 << 24) / 2500;
/// Fixed point of centres.
const CENTRE_BITS: u32 = 16;
/// A disc has `area² = 16 π² · det(second moments)`. Below this share of it, in 1/64, a blob is two discs.
const FILL_64: u128 = 58;

/// What a component's numbers refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldShape {
    /// Columns and lines of the field.
    pub size_px: [u16; 2],
    /// Lines of the frame per line of the field: 2 where interlaced, 1 where progressive.
    pub frame_lines: u8,
}

/// One blob, or two that touch.
#[derive(Debug, Clone, Copy)]
pub struct Discs {
    blobs: [Option<Blob>; 2],
}

impl Iterator for Discs {
    type Item = Blob;

    fn next(&mut self) -> Option<Blob> {
        let [first, second] = &mut self.blobs;
        first.take().or_else(|| second.take())
    }
}

/// The blobs that a component is.
pub fn discs(sums: &Sums, field: &FieldShape) -> Discs {
    let centre = |sum: u64| (u128::from(sum) << CENTRE_BITS) / u128::from(sums.w.max(1));
    let [width, height] =
        [1, 3].map(|i| u64::from(sums.half_box_px[i].saturating_sub(sums.half_box_px[i - 1])) + 1);
    let flags = flags(sums, field.size_px);
    let to_frame = u64::from(field.frame_lines) * u64::from(field.frame_lines);
    let [var_x, var_y] = [variance_q24(sums, width, flags), to_frame * variance_q24(sums, height, flags)];
    let to_px = |q: u128, bits: u32| q as f64 / (1u64 << bits) as f64;
    let blob = Blob {
        x_px: to_px(centre(sums.wx), CENTRE_BITS),
        y_field_px: to_px(centre(sums.wy), CENTRE_BITS),
        area_px: to_px(u128::from(sums.w), FULL_WEIGHT.trailing_zeros()),
        width_px: width as f64,
        height_px: height as f64,
        var_x_px2: to_px(u128::from(var_x), 24),
        var_y_px2: to_px(u128::from(var_y), 24),
        cov_xy_px2: 0.0,
        colour: u32::from(sums.class),
        flags,
    };
    Discs { blobs: [Some(blob), None] }
}

/// Variance of the centre along a side of length `side` px. Noise acts on the rim only, whose
/// pixels lie about `side²/8` (mean square) from the centre: σ² · rim · side²/8 / (Σ w)². Where
/// something is hidden or grown together, the centre may be off by a part of the side.
fn variance_q24(sums: &Sums, side: u64, flags: u32) -> u64 {
    let spread = u128::from(WEIGHT_NOISE * WEIGHT_NOISE * u64::from(sums.rim)) * u128::from(side * side / 8);
    let noise = ((spread << 24) / (u128::from(sums.w) * u128::from(sums.w)).max(1)) as u64;
    let doubt = if flags & (BLOB_CLIPPED | BLOB_MERGED) != 0 { ((side * side) << 24) / 64 } else { 0 };
    noise + FLOOR_Q24 + doubt
}

fn flags(sums: &Sums, size_px: [u16; 2]) -> u32 {
    let [left, right, top, bottom] = sums.box_px;
    let at_border = left == 0 || top == 0 || right + 1 == size_px[0] || bottom + 1 == size_px[1];
    let set = |holds: bool, bit: u32| if holds { bit } else { 0 };
    set(at_border, BLOB_CLIPPED) | set(sums.saturated > 0, BLOB_SATURATED) | set(is_double(sums), BLOB_MERGED)
}

/// True if the component fills its own ellipse of inertia too badly for a single disc.
fn is_double(sums: &Sums) -> bool {
    // Central second moments times w, in units of w·px² · 2⁴.
    let w = i128::from(sums.w.max(1));
    let central =
        |ab: u64, a: u64, b: u64| ((i128::from(ab) * w - i128::from(a) * i128::from(b)) << 4) / (w * w);
    let xx = central(sums.wxx, sums.wx, sums.wx);
    let xy = central(sums.wxy, sums.wx, sums.wy);
    let yy = central(sums.wyy, sums.wy, sums.wy);
    let det_q8 = (xx * yy - xy * xy).max(0) as u128;
    // area² < share · 16 π² det, with 16 π² ≈ 158 and the weight's 1/64 px.
    let area2_q8 = ((u128::from(sums.w) * u128::from(sums.w)) << 8) / (64 * 64);
    area2_q8 * 64 < det_q8 * 158 * FILL_64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colours::ColourTable;
    use crate::scan::weight;

    const PAL: FieldShape = FieldShape { size_px: [720, 288], frame_lines: 2 };

    /// A white shape, one run a line.
    fn shape(inside: impl Fn(i32, i32) -> bool) -> Sums {
        let table = ColourTable::default();
        let mut sum: Option<Sums> = None;
        let mut weights = Vec::new();
        for y in 0..100 {
            let mut bright = (0..100).filter(|&x| inside(x, i32::from(y)));
            let Some(first) = bright.next() else { continue };
            let last = bright.next_back().unwrap_or(first);
            let line: Vec<u8> =
                (first..=last).map(|x| if inside(x, i32::from(y)) { 200 } else { 0 }).collect();
            weight::weights(&table, &line, 0..line.len(), 7, 30 << 4, &mut weights);
            let part = Sums::of_run(&line, &weights, first as u16, y, 7, 30);
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
        let blob = discs(&part, &PAL).next().unwrap();
        assert_eq!((blob.x_px, blob.y_field_px), (24.5, 41.5));
        assert_eq!((blob.area_px, blob.width_px, blob.height_px), (40.0, 10.0, 4.0));
    }

    #[test]
    fn one_disc_is_single_and_two_touching_discs_are_double() {
        let disc = |x: i32, y: i32, cx: i32, cy: i32| {
            let (dx, dy) = (f64::from(x - cx) / 12.0, f64::from(y - cy) / 6.5);
            dx * dx + dy * dy <= 1.0
        };
        assert!(!is_double(&shape(|x, y| disc(x, y, 50, 50))));
        assert!(is_double(&shape(|x, y| disc(x, y, 40, 50) || disc(x, y, 63, 50))));
        assert!(is_double(&shape(|x, y| disc(x, y, 42, 46) || disc(x, y, 58, 55))));
    }

    #[test]
    fn borders_are_flagged() {
        let part = shape(|x, y| (5..15).contains(&x) && y > 90);
        let clipped = |lines| {
            let field = FieldShape { size_px: [720, lines], frame_lines: 2 };
            discs(&part, &field).next().unwrap().flags & BLOB_CLIPPED
        };
        assert_eq!((clipped(100), clipped(288)), (BLOB_CLIPPED, 0));
    }
}
