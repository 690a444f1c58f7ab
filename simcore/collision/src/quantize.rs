//! Vertices into whole numbers, sixteen at a time: the instrument's frame, a scale per axis, and
//! the planes of a box that each vertex lies beyond. ZCOLL's images, the port's camera and the
//! exact pairs of `validation` begin here.

use super::raster::{XY_LIMIT, Z_LIMIT};
use super::surface::{BLOCK, Frame, Surface};

/// A vertex in whole steps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct QuantizedVertex {
    /// Where it lies; what is beyond a limit is put on it.
    pub at: [i32; 3],
    /// Planes of the box beyond which it lies ([`PLANES`]), and [`REFUSED`].
    pub code: i32,
}

/// Bits of the planes: below the minimum along x, above the maximum, then y, then z.
pub const PLANES: i32 = 0x3f;
/// Bit of a vertex beyond a limit, or of one that is not a number. The latter lies beyond no plane,
/// so that it is never passed over in silence.
pub const REFUSED: i32 = 0x40;

/// How vertices are placed in a query.
#[derive(Debug, Clone, Copy)]
pub struct Quantizer {
    /// Eye frame to instrument frame.
    pub frame: Frame,
    /// From mm to steps, by axis.
    pub format: [FixedFormat; 3],
    /// Limit of each axis, exclusive.
    pub limit: [i32; 3],
    /// Lower corner of the box, steps.
    pub low: [i32; 3],
    /// Upper corner of the box, steps.
    pub high: [i32; 3],
}

/// 2²³: in `f32`, from here to twice as much, steps are one.
const WHOLE: f32 = 8_388_608.0;

const _: () = assert!(2 * XY_LIMIT < 1 << 22 && 2 * Z_LIMIT < 1 << 22, "a limit twice is far below 2²³");

/// How a length becomes whole steps: steps = mm · scale + offset.
#[derive(Debug, Clone, Copy)]
pub struct FixedFormat {
    /// Steps of a mm.
    pub scale: f32,
    /// Steps of 0 mm.
    pub offset: f32,
}

impl FixedFormat {
    /// Rounds to whole steps; what lies outside is put on the limit, where the caller refuses it,
    /// and what is not a number on the negative one. Halves go up: the integer part of value +
    /// limit + 1/2, less the limit.
    #[inline(always)]
    pub fn to_fixed(self, value: f32, limit: i32) -> i32 {
        let bound = limit as f32;
        let step = value * self.scale + self.offset;
        let step = if step > -bound { step } else { -bound };
        let step = if step < bound { step } else { bound };
        let above = step + bound + 0.5;
        // The integer part of `above`, which is within 0 and 2²², without a conversion: that would
        // keep the loops around it from becoming vector code.
        let nearest = above + WHOLE;
        let whole = nearest.to_bits() as i32 - WHOLE.to_bits() as i32;
        let up = if nearest - WHOLE > above { 1 } else { 0 };
        whole - up - limit
    }
}

impl Quantizer {
    /// Places a block of a surface's vertices; `placed` is for all of its vertices.
    pub fn block(&self, simd: pulp::Arch, surface: &Surface, block: usize, placed: &mut [QuantizedVertex]) {
        let [x, y, z] = surface.position_mm;
        let vertices = block * BLOCK..(block * BLOCK + BLOCK).min(x.len());
        let [x, y, z] = [&x[vertices.clone()], &y[vertices.clone()], &z[vertices.clone()]];
        let placed = &mut placed[vertices];
        if let (Some(x), Some(y), Some(z)) = (x.first_chunk(), y.first_chunk(), z.first_chunk()) {
            simd.dispatch(PlaceBlock { placing: self, position: [x, y, z], placed });
            return;
        }
        // The last block is filled up with its last vertex.
        let fill = |part: &[f32]| -> [f32; BLOCK] { std::array::from_fn(|i| part[i.min(part.len() - 1)]) };
        let position = [&fill(x), &fill(y), &fill(z)];
        simd.dispatch(PlaceBlock { placing: self, position, placed });
    }
}

struct PlaceBlock<'a> {
    placing: &'a Quantizer,
    position: [&'a [f32; BLOCK]; 3],
    placed: &'a mut [QuantizedVertex],
}

impl pulp::NullaryFnOnce for PlaceBlock<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Quantizer { frame, format, limit, low, high } = *self.placing;
        let [x, y, z] = self.position;
        let (mut at, mut code) = ([[0i32; BLOCK]; 3], [0i32; BLOCK]);
        for axis in 0..3 {
            let [below, above] = [1 << (2 * axis), 2 << (2 * axis)];
            for i in 0..BLOCK {
                let value = frame.along(axis, x[i], y[i], z[i]);
                let step = format[axis].to_fixed(value, limit[axis]);
                let mut bits = if step < low[axis] { below } else { 0 };
                bits |= if step > high[axis] { above } else { 0 };
                bits = if value.is_nan() { 0 } else { bits };
                bits |= if step <= -limit[axis] { REFUSED } else { 0 };
                bits |= if step >= limit[axis] { REFUSED } else { 0 };
                code[i] |= bits;
                at[axis][i] = step;
            }
        }
        for (i, placed) in self.placed.iter_mut().enumerate() {
            *placed = QuantizedVertex { at: [at[0][i], at[1][i], at[2][i]], code: code[i] };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};
    use proptest::prelude::*;

    proptest! {
        /// The same as the conversion that it avoids.
        #[test]
        fn rounding_is_that_of_a_conversion(value in -3e6f32..3e6, scale in 0.001f32..3.0, offset in -9.0f32..9.0) {
            for limit in [XY_LIMIT, Z_LIMIT, 2000] {
                let bound = limit as f32;
                let plain = ((value * scale + offset).clamp(-bound, bound) + bound + 0.5) as i32 - limit;
                prop_assert_eq!(FixedFormat { scale, offset }.to_fixed(value, limit), plain);
            }
        }

        /// Every path gives the same bits, an f64 of our own the same steps but for their rounding,
        /// and what is not a number is refused and beyond no plane.
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
            let placing = Quantizer {
                frame: Frame::new(&pose), format: [FixedFormat { scale: 1000.0, offset: 5.0 }; 3],
                limit: [2000; 3], low: [-500; 3], high: [600; 3],
            };
            let mut placed = vec![QuantizedVertex::default(); n];
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
