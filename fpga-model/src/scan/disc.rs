//! A complete component as blobs: centre, variance, flags; two blobs where two markers touch.
//!
//! Everything is computed in integers; only the finished numbers become floating point.

use super::limits::FULL_WEIGHT;
use super::moments::{BITS, Moments, ONE};
use super::split::{Shape, shape};
use super::sums::Sums;
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BLOB_SATURATED, Blob};

/// Shift of a centre towards the bright side per relative slope of the illumination, px²:
/// a pixel's lit surface is found some 5 px from it, over an edge of about 1 px.
const SHADE_PX2: i64 = 5;
/// Added to the span: regularises the slope where little of the surface is visible.
const LEAST_SPAN: u64 = 8192;
/// Largest correction of that shift, px in units of 2⁻¹⁶.
const SHADE_MOST: i128 = ONE / 8;
/// Least variance of a pixel's noise, levels²: of a clean camera, and where too little of the
/// surface is seen.
const LEAST_NOISE: u64 = 1;
/// Fewest differences of neighbours from which noise is estimated.
const LEAST_GRAINS: u32 = 16;
/// Noise variance where it is not estimated, levels².
const USUAL_NOISE: u64 = 6;
/// Variance that remains without noise, because lines and columns sample the outline: (0.008 px)²
/// along the line and (0.005 lines)² across, in 2⁻²⁴ px².
const FLOOR_Q24: [u128; 2] = [1074, 419];
/// Variance of the start of a line: (1/16 px)², 5 ns of a PAL signal's time base, in 2⁻²⁴ px².
const LINE_JITTER_Q24: u128 = (1 << 24) / 256;
/// Fixed point of variances.
const VARIANCE_BITS: u32 = 24;
/// Variance of a centre from its touching neighbour: (1/20 px)², in 2⁻²⁴ px².
const TOUCH_Q24: u128 = (1 << 24) / 400;
/// Variance of a centre from a saturated peak: (1/16 px)², in 2⁻²⁴ px².
const SATURATION_Q24: u128 = (1 << 24) / 256;
/// Columns that are as long as the distance of two lines of a PAL field, in units of 2⁻¹⁶: pixels
/// are 59 wide and 54 high in the frame (ITU-R BT.601, 4 : 3).
const PAL_ASPECT: i128 = ONE * 2 * 54 / 59;

/// Size and line structure of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldShape {
    /// Columns and lines of the field.
    pub size_px: [u16; 2],
    /// Lines of the frame per line of the field: 2 where interlaced, 1 where progressive.
    pub frame_lines: u8,
}

impl FieldShape {
    /// Distance of two lines in columns, in units of 2⁻¹⁶: PAL if interlaced, otherwise square
    /// pixels.
    fn aspect(&self) -> i128 {
        if self.frame_lines == 2 { PAL_ASPECT } else { ONE }
    }
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

/// True if a component is two markers that touch.
pub fn is_pair(sums: &Sums, field: &FieldShape) -> bool {
    let shape_of = |moments| shape(&moments, area(sums), field.aspect());
    matches!(Moments::of(sums).map(shape_of), Some(Shape::Pair(_)))
}

/// Area in px, in units of 2⁻¹⁶.
fn area(sums: &Sums) -> i128 {
    i128::from(sums.w) << (BITS - FULL_WEIGHT.trailing_zeros())
}

/// The blobs of a component; none without weight.
pub fn discs(sums: &Sums, field: &FieldShape) -> Discs {
    let Some(moments) = Moments::of(sums) else { return Discs { blobs: [None, None] } };
    let area = area(sums);
    let size = [1, 3].map(|i| i128::from(sums.half_box_px[i].saturating_sub(sums.half_box_px[i - 1])) + 1);
    let [x, y] = moments.centre;
    let whole = Part { sums, centre: [x - shade(sums), y], area, size };
    let flags = flags(sums, field.size_px);
    let blobs = match shape(&moments, area, field.aspect()) {
        Shape::Single => [Some(whole.blob(flags, 0, field)), None],
        Shape::Merged => [Some(whole.blob(flags | BLOB_MERGED, 0, field)), None],
        Shape::Pair(halves) => halves.map(|half| {
            let centre = [0, 1].map(|i| whole.centre[i] + half.offset[i]);
            // The width of each is that of both less the distance of the centres.
            let apart = |i: usize| (halves[1].offset[i] - halves[0].offset[i]).abs();
            let size = [0, 1].map(|i| (size[i] - ((apart(i) + ONE / 2) >> BITS)).max(1));
            let part = Part { sums, centre, area: (area * half.share) >> BITS, size };
            Some(part.blob(flags | BLOB_MERGED, TOUCH_Q24, field))
        }),
    };
    Discs { blobs }
}

/// Shift of the centre towards the bright side, px in units of 2⁻¹⁶.
fn shade(sums: &Sums) -> i128 {
    let drawn = (i128::from(SHADE_PX2 * sums.rise) << BITS) / i128::from(sums.span + LEAST_SPAN);
    drawn.clamp(-SHADE_MOST, SHADE_MOST)
}

/// A component or the half of one; lengths and areas in units of 2⁻¹⁶.
struct Part<'a> {
    sums: &'a Sums,
    centre: [i128; 2],
    area: i128,
    /// Columns and lines.
    size: [i128; 2],
}

impl Part<'_> {
    /// The blob. `split_q24` is the variance added by a split, 0 without one.
    fn blob(&self, flags: u32, split_q24: u128, field: &FieldShape) -> Blob {
        let [width, height] = self.size.map(|side| side as f64);
        let to_px = |q: i128| q.max(0) as f64 / ONE as f64;
        let [var_x, var_y] = [0, 1]
            .map(|axis| self.variance_q24(axis, flags, split_q24) as f64 / (1u64 << VARIANCE_BITS) as f64);
        let lines = f64::from(field.frame_lines);
        Blob {
            x_px: to_px(self.centre[0]),
            y_field_px: to_px(self.centre[1]),
            area_px: to_px(self.area),
            width_px: width,
            height_px: height,
            var_x_px2: var_x,
            var_y_px2: var_y * lines * lines,
            cov_xy_px2: 0.0,
            colour: u32::from(self.sums.class),
            flags,
        }
    }

    /// Variance of the centre along an axis, px² of the field. Noise acts on the rim only, whose
    /// pixels lie about `side²/8` (mean square) from the centre; a weight has `FULL_WEIGHT/0.8` of
    /// the noise over the contrast: `σ² · (80/contrast)² · rim · side²/8 / (Σ w)²`. Where something
    /// is hidden or grown together unresolved, the centre may be off by a part of the side.
    fn variance_q24(&self, axis: usize, flags: u32, split_q24: u128) -> u128 {
        let side2 = (self.size[axis] * self.size[axis]) as u128;
        let contrast = u128::from(self.sums.contrast.max(1));
        let gain = 80 * 80 * u128::from(noise_q8(self.sums)) * u128::from(self.sums.rim) * side2 / 8;
        let w = u128::from(self.sums.w.max(1));
        let noise = (gain << (VARIANCE_BITS - 8)) / (w * w * contrast * contrast).max(1);
        let side = |bit: u32| if flags & bit != 0 { (side2 << VARIANCE_BITS) / 64 } else { 0 };
        let merged = match split_q24 {
            0 => side(BLOB_MERGED),
            // Both share the rim and the weight, so that one half has about four times the noise.
            touch => 3 * noise + touch,
        };
        let saturated = if flags & BLOB_SATURATED != 0 { SATURATION_Q24 } else { 0 };
        // Every line of an interlaced field is read from a signal; its jitter moves columns only.
        let jitter = if axis == 0 { LINE_JITTER_Q24 / self.size[1].max(1) as u128 } else { 0 };
        noise + FLOOR_Q24[axis] + jitter + merged + side(BLOB_CLIPPED) + saturated
    }
}

/// Variance of a pixel's noise, levels² in 1/256, from the grain of the surface: a difference of
/// two pixels has twice the variance of one.
fn noise_q8(sums: &Sums) -> u64 {
    if sums.grains < LEAST_GRAINS {
        return USUAL_NOISE << 8;
    }
    ((sums.grain << 7) / u64::from(sums.grains)).max(LEAST_NOISE << 8)
}

fn flags(sums: &Sums, size_px: [u16; 2]) -> u32 {
    let [left, right, top, bottom] = sums.box_px;
    let at_border = left == 0 || top == 0 || right + 1 == size_px[0] || bottom + 1 == size_px[1];
    let set = |holds: bool, bit: u32| if holds { bit } else { 0 };
    set(at_border, BLOB_CLIPPED) | set(sums.saturated > 0, BLOB_SATURATED)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAL: FieldShape = FieldShape { size_px: [720, 288], frame_lines: 2 };

    /// A shape from the share of each pixel that it covers.
    fn drawn(cover: impl Fn(f64, f64) -> f64) -> Sums {
        let mut sums: Option<Sums> = None;
        for y in 0..100u16 {
            let shares: Vec<f64> = (0..120).map(|x| cover(f64::from(x), f64::from(y))).collect();
            let luma: Vec<u8> = shares.iter().map(|s| (30.0 + 80.0 * s) as u8).collect();
            let weights: Vec<u8> = shares.iter().map(|s| (64.0 * s).round() as u8).collect();
            let Some(first) = weights.iter().position(|&w| w > 0) else { continue };
            let last = weights.iter().rposition(|&w| w > 0).unwrap();
            let mut line = Sums::of_run(&luma[first..=last], first as u16, y, 7, 30);
            line.weigh(&luma[first..=last], &weights[first..=last], first as u16, y, None);
            match &mut sums {
                Some(sums) => sums.add(&line),
                None => sums = Some(line),
            }
        }
        sums.unwrap()
    }

    /// Share of a pixel inside discs (column, line, radius in columns) as PAL sees them, by 16 × 16
    /// points.
    fn discs_at(all: &[(f64, f64, f64)]) -> Sums {
        let aspect = 2.0 * 54.0 / 59.0;
        let inside = |x: f64, y: f64| {
            all.iter().any(|(cx, cy, r)| (x - cx).powi(2) + ((y - cy) * aspect).powi(2) <= r * r)
        };
        drawn(|x, y| {
            let point = |i: usize| (i as f64 + 0.5) / 16.0 - 0.5;
            let hits = (0..256).filter(|i| inside(x + point(i % 16), y + point(i / 16))).count();
            hits as f64 / 256.0
        })
    }

    fn blobs(sums: &Sums) -> Vec<Blob> {
        let mut all: Vec<_> = discs(sums, &PAL).collect();
        all.sort_by(|a, b| a.x_px.total_cmp(&b.x_px));
        all
    }

    #[test]
    fn rectangle_has_its_centre_area_and_box() {
        let sums = drawn(|x, y| f64::from((20.0..30.0).contains(&x) && (40.0..44.0).contains(&y)));
        let blob = blobs(&sums)[0];
        assert_eq!((blob.x_px, blob.y_field_px), (24.5, 41.5));
        assert_eq!((blob.area_px, blob.width_px, blob.height_px), (40.0, 10.0, 4.0));
    }

    #[test]
    fn single_discs_stay_single() {
        for (r, x) in [(5.0, 50.3), (7.0, 50.0), (10.0, 50.7), (25.0, 51.1)] {
            let all = blobs(&discs_at(&[(x, 50.4, r)]));
            assert_eq!((all.len(), all[0].flags), (1, 0), "radius {r}");
            assert!(
                (all[0].x_px - x).abs() < 0.01 && (all[0].y_field_px - 50.4).abs() < 0.01,
                "{:?}",
                all[0]
            );
        }
    }

    #[test]
    fn touching_discs_are_told_apart_in_every_direction() {
        for degrees in (0..180).step_by(10) {
            for (r1, r2, gap) in
                [(10.0, 10.0, 0.0), (10.6, 9.8, 0.5), (10.0, 10.0, -1.0), (7.0, 6.6, 1.0), (14.0, 13.0, -2.0)]
            {
                let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
                let d: f64 = r1 + r2 + gap;
                let expected = [
                    (60.2 - cos * d / 2.0, 50.1 - sin * d / 3.66, r1),
                    (60.2 + cos * d / 2.0, 50.1 + sin * d / 3.66, r2),
                ];
                let found = discs(&discs_at(&expected), &PAL).collect::<Vec<_>>();
                assert_eq!(found.len(), 2, "{degrees}°, {r1} {r2} {gap}");
                let distance =
                    |b: &Blob, e: &(f64, f64, f64)| (b.x_px - e.0).hypot((b.y_field_px - e.1) * 1.83);
                for e in &expected {
                    let near = found.iter().min_by(|a, b| distance(a, e).total_cmp(&distance(b, e))).unwrap();
                    assert!(distance(near, e) < 0.12, "{degrees}°, {r1} {r2} {gap}: {}", distance(near, e));
                    assert_eq!(near.flags, BLOB_MERGED);
                    let area = std::f64::consts::PI * e.2 * e.2 / 1.83;
                    assert!((near.area_px - area).abs() < 0.08 * area, "{} of {area}", near.area_px);
                    assert!(
                        (near.width_px - 2.0 * e.2).abs() < 3.0 && (near.height_px - e.2).abs() < 4.0,
                        "{near:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_no_pair_is_not_told_apart() {
        // Far overlap, three in a row, half a disc.
        let overlap = blobs(&discs_at(&[(50.0, 50.0, 10.0), (67.6, 50.0, 10.0)]));
        assert_eq!((overlap.len(), overlap[0].flags), (1, BLOB_MERGED));
        let row = blobs(&discs_at(&[(30.0, 50.0, 10.0), (50.0, 50.0, 10.0), (70.0, 50.0, 10.0)]));
        assert_eq!((row.len(), row[0].flags), (1, BLOB_MERGED));
        let half =
            drawn(|x, y| f64::from((x - 50.0).powi(2) + ((y - 50.0) * 1.83).powi(2) <= 144.0 && x > 50.0));
        assert_eq!(blobs(&half).len(), 1);
    }

    #[test]
    fn flags_come_with_a_larger_variance() {
        let plain = discs_at(&[(50.0, 50.0, 10.0)]);
        let [usual, saturated, clipped] =
            [plain, Sums { saturated: 3, ..plain }, Sums { box_px: [0, 9, 9, 30], ..plain }]
                .map(|sums| blobs(&sums)[0]);
        assert_eq!([usual.flags, saturated.flags, clipped.flags], [0, BLOB_SATURATED, BLOB_CLIPPED]);
        assert!(saturated.var_x_px2 > 5.0 * usual.var_x_px2 && clipped.var_y_px2 > saturated.var_y_px2);
        let pair = blobs(&discs_at(&[(50.0, 50.0, 10.0), (69.5, 50.0, 10.0)]));
        assert!(pair.iter().all(|b| b.var_x_px2 > 5.0 * usual.var_x_px2), "{pair:?}");
    }
}
