//! Vertices into whole numbers, sixteen at a time: the instrument's frame, a scale per axis, and the planes of a box that each
//! vertex lies beyond. ZCOLL's images and the exact pairs both begin here.

use super::surface::{BLOCK, Frame, Surface};
use std::ops::Range;

/// A vertex in whole steps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Placed {
    /// Where it lies; what is beyond a limit is put on it.
    pub at: [i32; 3],
    /// Planes of the box beyond which it lies ([`PLANES`]), and [`REFUSED`].
    pub code: i32,
}

/// Bits of the planes: below the minimum along x, above the maximum, then y, then z.
pub const PLANES: i32 = 0x3f;
/// Bit of a vertex beyond a limit, or of one that is not a number. The latter lies beyond no plane, so that it is never passed
/// over in silence.
pub const REFUSED: i32 = 0x40;

/// How vertices are placed in a query.
#[derive(Debug, Clone, Copy)]
pub struct Placing {
    /// Eye frame to instrument frame.
    pub frame: Frame,
    /// Scale and offset from mm to steps, by axis.
    pub format: [(f32, f32); 3],
    /// Limit of each axis, exclusive.
    pub limit: [i32; 3],
    /// Lower corner of the box, steps.
    pub low: [i32; 3],
    /// Upper corner of the box, steps.
    pub high: [i32; 3],
}

/// Rounds to whole steps; what lies outside is put on the limit, where the caller refuses it, and what is not a number on the
/// negative one. Adding the limit before the cut makes it a rounding towards minus infinity of value + 1/2.
#[inline(always)]
pub fn to_fixed(value: f32, (scale, offset): (f32, f32), limit: i32) -> i32 {
    let bound = limit as f32;
    let shifted = (value * scale + offset).clamp(-bound, bound) + bound + 0.5;
    shifted as i32 - limit
}

impl Placing {
    /// Places a block of a surface's vertices; `placed` is for all of its vertices.
    pub fn block(&self, simd: pulp::Arch, surface: &Surface, block: usize, placed: &mut [Placed]) {
        let [x, y, z] = surface.position_mm;
        let vertices = block * BLOCK..(block * BLOCK + BLOCK).min(x.len());
        let position = [sixteen(x, &vertices), sixteen(y, &vertices), sixteen(z, &vertices)];
        simd.dispatch(PlaceBlock { placing: self, position, placed: &mut placed[vertices] });
    }
}

/// Sixteen coordinates; an incomplete block is filled up with its last one.
#[inline(always)]
fn sixteen(axis: &[f32], vertices: &Range<usize>) -> [f32; BLOCK] {
    let part = &axis[vertices.clone()];
    part.first_chunk().copied().unwrap_or_else(|| std::array::from_fn(|i| part[i.min(part.len() - 1)]))
}

struct PlaceBlock<'a> {
    placing: &'a Placing,
    position: [[f32; BLOCK]; 3],
    placed: &'a mut [Placed],
}

impl pulp::NullaryFnOnce for PlaceBlock<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Placing { frame, format, limit, low, high } = *self.placing;
        let [x, y, z] = self.position;
        let (mut at, mut code) = ([[0i32; BLOCK]; 3], [0i32; BLOCK]);
        for axis in 0..3 {
            for i in 0..BLOCK {
                let value = frame.along(axis, x[i], y[i], z[i]);
                let step = to_fixed(value, format[axis], limit[axis]);
                let beyond = i32::from(step < low[axis]) | i32::from(step > high[axis]) << 1;
                let planes = if value.is_nan() { 0 } else { beyond << (2 * axis) };
                code[i] |= planes | if step.abs() >= limit[axis] { REFUSED } else { 0 };
                at[axis][i] = step;
            }
        }
        for (i, placed) in self.placed.iter_mut().enumerate() {
            *placed = Placed { at: [at[0][i], at[1][i], at[2][i]], code: code[i] };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
    use proptest::prelude::*;

    proptest! {
        /// Every path gives the same bits, an f64 of our own the same steps but for their rounding, and what is not a
        /// number is refused and beyond no plane.
        #[test]
        fn vertices_are_where_an_f64_puts_them(
            points in prop::collection::vec(prop::array::uniform3(-2.0f32..2.0), 1..40),
            angles in prop::array::uniform3(-3.0f64..3.0), bad in 0usize..40,
        ) {
            let pose = Isometry3::from_parts(
                Translation3::new(0.1, -0.2, 0.3),
                UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
            );
            let mut axes: [Vec<f32>; 3] = std::array::from_fn(|k| points.iter().map(|p| p[k]).collect());
            let n = points.len();
            if bad < n { axes[1][bad] = f32::NAN; }
            let surface = Surface { position_mm: axes.each_ref().map(Vec::as_slice), triangles: &[], alive: &[] };
            let placing = Placing {
                frame: Frame::new(&pose), format: [(1000.0, 5.0); 3], limit: [2000; 3], low: [-500; 3], high: [600; 3],
            };
            let mut placed = vec![Placed::default(); n];
            let mut plain = placed.clone();
            for block in 0..n.div_ceil(BLOCK) {
                placing.block(pulp::Arch::new(), &surface, block, &mut placed);
                placing.block(pulp::Arch::Scalar, &surface, block, &mut plain);
            }
            prop_assert_eq!(&placed, &plain);
            for (i, seen) in placed.iter().enumerate() {
                if i == bad {
                    prop_assert_eq!(seen.code, REFUSED);
                    continue;
                }
                let p = pose * Point3::from(points[i].map(f64::from));
                for k in 0..3 {
                    let exact = (p[k] * 1000.0 + 5.0).clamp(-2000.0, 2000.0);
                    prop_assert!((f64::from(seen.at[k]) - exact).abs() <= 0.51, "{} {}", seen.at[k], exact);
                    prop_assert_eq!(seen.code >> (2 * k) & 1 == 1, seen.at[k] < -500);
                    prop_assert_eq!(seen.code >> (2 * k) & 2 == 2, seen.at[k] > 600);
                }
                prop_assert_eq!(seen.code & REFUSED != 0, seen.at.iter().any(|c| c.abs() >= 2000));
            }
        }
    }
}
