//! Which triangles a straight line can meet at all: those whose corners do not all lie beyond one
//! of a few planes around it.
//!
//! Every node is compared with the planes once, many at a time; a triangle is then passed over by
//! three bytes. Nodes within [`MARGIN_MM`] of a plane, and nodes or lines that are not numbers, lie
//! beyond none.

use nalgebra::Vector3;
use std::ops::Range;

/// Far above the rounding of a place in an eye of 16 mm, twice.
const MARGIN_MM: f32 = 1e-4;

/// A line, as far as it matters.
#[derive(Debug, Clone, Copy)]
pub struct Line {
    /// Where it begins, eye frame, mm.
    pub from_mm: Vector3<f64>,
    /// Where it goes, of length 1.
    pub along: Vector3<f64>,
    /// How far, mm.
    pub reach_mm: f64,
}

/// Where each node lies to a line.
#[derive(Debug)]
pub struct Sides {
    simd: pulp::Arch,
    /// A bit for each plane that the node is beyond.
    beyond: Vec<u8>,
}

impl Sides {
    /// Room for `nodes`.
    pub fn new(nodes: usize) -> Self {
        Sides { simd: pulp::Arch::new(), beyond: vec![0; nodes] }
    }

    /// Compares `nodes` with the planes around a line; the others lie beyond none.
    pub fn compare(&mut self, line: &Line, position_mm: &[Vec<f32>; 3], nodes: Range<usize>) {
        let least = line.along.iamin();
        let across = line.along.cross(&Vector3::ith(least, 1.0)).normalize();
        let axes = [across, line.along.cross(&across), line.along].map(|a| a.map(|c| c as f32));
        let (from, reach) = (line.from_mm.map(|c| c as f32), line.reach_mm as f32);
        self.beyond.fill(0);
        let position_mm = position_mm.each_ref().map(|axis| &axis[nodes.clone()]);
        self.simd.dispatch(Compare { axes, from, reach, position_mm, beyond: &mut self.beyond[nodes] });
    }

    /// False for a triangle that the line cannot meet.
    pub fn may_meet(&self, nodes: &[u32; 3]) -> bool {
        let [a, b, c] = nodes.map(|n| self.beyond[n as usize]);
        a & b & c == 0
    }
}

/// A plain loop over the nodes, so that the compiler takes many at a time.
struct Compare<'a> {
    /// Two across the line, and the line.
    axes: [Vector3<f32>; 3],
    from: Vector3<f32>,
    reach: f32,
    position_mm: [&'a [f32]; 3],
    beyond: &'a mut [u8],
}

impl pulp::NullaryFnOnce for Compare<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Compare { axes: [u, v, w], from, reach, position_mm: [x, y, z], beyond } = self;
        let n = beyond.len();
        let (x, y, z) = (&x[..n], &y[..n], &z[..n]);
        for i in 0..n {
            let (dx, dy, dz) = (x[i] - from.x, y[i] - from.y, z[i] - from.z);
            let at = |axis: &Vector3<f32>| dx * axis.x + dy * axis.y + dz * axis.z;
            let (a, b, c) = (at(&u), at(&v), at(&w));
            let bits = [a > MARGIN_MM, a < -MARGIN_MM, b > MARGIN_MM, b < -MARGIN_MM, c < -MARGIN_MM];
            let sides = bits.iter().enumerate().fold(0, |sum, (k, &bit)| sum | u32::from(bit) << k);
            beyond[i] = (sides | u32::from(c > reach + MARGIN_MM) << 5) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn corners() -> impl Strategy<Value = [Vec<f32>; 3]> {
        prop::array::uniform3(prop::collection::vec(-12.0f32..12.0, 3))
    }

    proptest! {
        /// A line through a point of a triangle may meet it, from wherever it begins and wherever
        /// it ends beyond it.
        #[test]
        fn no_triangle_is_passed_over_that_the_line_meets(
            corners in corners(), u in 0.0f64..1.0, v in 0.0f64..1.0,
            from in prop::array::uniform3(-12.0f64..12.0), further in 0.0f64..3.0,
        ) {
            let corner = |i: usize| Vector3::from(corners.each_ref().map(|axis| f64::from(axis[i])));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let at = corner(0) * (1.0 - u - v) + corner(1) * u + corner(2) * v;
            let from_mm = Vector3::from(from);
            let way = at - from_mm;
            prop_assume!(way.norm() > 1e-3);
            let line = Line { from_mm, along: way.normalize(), reach_mm: way.norm() + further };
            let mut sides = Sides::new(3);
            sides.compare(&line, &corners, 0..3);
            prop_assert!(sides.may_meet(&[0, 1, 2]));
            let mut plain = Sides { simd: pulp::Arch::Scalar, ..Sides::new(3) };
            plain.compare(&line, &corners, 0..3);
            prop_assert_eq!(&plain.beyond, &sides.beyond, "without lanes");
            sides.compare(&line, &corners, 1..2);
            prop_assert!(sides.may_meet(&[0, 1, 2]), "what is not compared may be met");
        }
    }

    #[test]
    fn what_lies_beside_before_or_beyond_is_passed_over() {
        let corners = |x: f32, z: f32| [vec![x, x + 1.0, x], vec![-0.5, -0.5, 0.5], vec![z; 3]];
        let mut sides = Sides::new(3);
        for reach_mm in [2.0, f64::INFINITY] {
            let line = Line { from_mm: Vector3::zeros(), along: Vector3::z(), reach_mm };
            let mut meets = |x: f32, z: f32| {
                sides.compare(&line, &corners(x, z), 0..3);
                sides.may_meet(&[0, 1, 2])
            };
            assert!(meets(-0.2, 1.0) && meets(f32::NAN, 1.0));
            assert!(!meets(0.1, 1.0) && !meets(-1.2, 1.0) && !meets(-0.2, -0.1));
            assert_eq!(meets(-0.2, 2.1), reach_mm > 2.1);
        }
    }
}
