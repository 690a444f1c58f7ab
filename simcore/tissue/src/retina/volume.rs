//! Volume between a piece of retina and the choroid, and how it changes when nodes move.
//!
//! Seen from the eye's centre, the fluid under a triangle (a, b, c) of the retina is the cone over
//! its projection onto the choroid (the sphere of radius R) less the cone over the triangle itself.
//! With nodes counter-clockwise seen from the inside:
//!
//! ```text
//! V = (det(a, b, c) − R³ det(a/|a|, b/|b|, c/|c|)) / 6          mm³
//! ∂V/∂a = (b × c)/6 + what the moving foot of a adds
//! ```
//!
//! A triangle that lies on the choroid holds exactly nothing wherever it lies, so a retina that was
//! turned and lies on again holds no fluid either. Summed around a node, (b × c)/6 is a third of
//! the area vector of its triangles: pressure times that is the force of the fluid on the node. The
//! foot's part belongs to the polyhedron in place of the sphere, vanishes with the square of the
//! mesh width, and is left out of the force, not out of the volume. Sums are in f64 and in the
//! order of the triangles.

use crate::sheet::state::SheetState;
use nalgebra::Vector3;

/// Six times the signed volume of the cone from the origin over a triangle.
fn det(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> f64 {
    a.dot(&b.cross(c))
}

/// Position of a node, eye frame, mm.
pub fn at(state: &SheetState, node: u32) -> Vector3<f64> {
    state.position(node as usize).map(f64::from)
}

/// Volume under one triangle, mm³; 0 where a node lies in the eye's centre.
pub fn under_triangle(corners: &[Vector3<f64>; 3], radius_mm: f64) -> f64 {
    let [a, b, c] = corners;
    let lengths = a.norm() * b.norm() * c.norm();
    let whole = det(a, b, c);
    if lengths > 0.0 { whole * (1.0 - radius_mm * radius_mm * radius_mm / lengths) / 6.0 } else { 0.0 }
}

/// Triangles that are computed together.
const TOGETHER: usize = 8;

/// Some triangles side by side: corners, then axes, mm; and of each the volume under it, as
/// [`under_triangle`] has it to the bit, and what a pressure of 1 Pa does to its corners, µN: a
/// third of the area vector, seen from the eye's centre.
#[derive(Debug, Default)]
pub struct Block {
    count: usize,
    nodes: [[u32; 3]; TOGETHER],
    corner: [[[f64; TOGETHER]; 3]; 3],
    radius_mm: f64,
    under: [f64; TOGETHER],
    push: [[[f64; TOGETHER]; 3]; 3],
}

impl Block {
    /// Goes through `triangles`: adds to `push`, and returns the volume under them, mm³. Both in
    /// the order of the triangles.
    pub fn gather<'a>(
        simd: pulp::Arch,
        state: &SheetState,
        triangles: impl Iterator<Item = &'a [u32; 3]>,
        radius_mm: f64,
        push: &mut [Vector3<f64>],
    ) -> f64 {
        let (mut block, mut volume) = (Block { radius_mm, ..Block::default() }, 0.0);
        for nodes in triangles {
            block.put(state, nodes);
            if block.count == TOGETHER {
                simd.dispatch(Gather(&mut block));
                volume = block.take(volume, push);
            }
        }
        if block.count > 0 {
            simd.dispatch(Gather(&mut block));
        }
        block.take(volume, push)
    }

    fn put(&mut self, state: &SheetState, nodes: &[u32; 3]) {
        self.nodes[self.count] = *nodes;
        for (corner, &node) in self.corner.iter_mut().zip(nodes) {
            for (to, from) in corner.iter_mut().zip(&state.position_mm) {
                to[self.count] = f64::from(from[node as usize]);
            }
        }
        self.count += 1;
    }

    /// Empties the block; returns `volume` with what it held.
    fn take(&mut self, mut volume: f64, push: &mut [Vector3<f64>]) -> f64 {
        for i in 0..std::mem::take(&mut self.count) {
            volume += self.under[i];
            for (corner, &node) in self.push.iter().zip(&self.nodes[i]) {
                push[node as usize] += Vector3::new(corner[0][i], corner[1][i], corner[2][i]);
            }
        }
        volume
    }
}

/// Plain loops over numbers, so that the compiler takes all triangles of a block at a time.
struct Gather<'a>(&'a mut Block);

impl pulp::NullaryFnOnce for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Block { corner, radius_mm, under, push, .. } = self.0;
        let whole_eye = *radius_mm * *radius_mm * *radius_mm;
        let mut lengths = [1.0; TOGETHER];
        for [x, y, z] in corner.iter() {
            for i in 0..TOGETHER {
                lengths[i] *= (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
            }
        }
        let mut whole = [0.0; TOGETHER];
        for n in 0..3 {
            let (b, c) = (&corner[(n + 1) % 3], &corner[(n + 2) % 3]);
            for axis in 0..3 {
                let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
                for i in 0..TOGETHER {
                    let across = b[j][i] * c[k][i] - b[k][i] * c[j][i];
                    push[n][axis][i] = across / 6.0;
                    whole[i] += if n == 0 { corner[0][axis][i] * across } else { 0.0 };
                }
            }
        }
        for i in 0..TOGETHER {
            let volume = whole[i] * (1.0 - whole_eye / lengths[i]) / 6.0;
            under[i] = if lengths[i] > 0.0 { volume } else { 0.0 };
        }
    }
}

/// How much the volume under a triangle grows with the way of its first corner, mm²: all of ∂V/∂a,
/// what the moving foot adds too; the other corners follow by turning them round. 0 where a node
/// lies in the eye's centre.
pub fn slope(corners: &[Vector3<f64>; 3], radius_mm: f64) -> Vector3<f64> {
    let [a, b, c] = corners;
    let lengths = a.norm() * b.norm() * c.norm();
    if lengths == 0.0 {
        return Vector3::zeros();
    }
    let foot = radius_mm * radius_mm * radius_mm / lengths;
    (b.cross(c) * (1.0 - foot) + a * (det(a, b, c) * foot / a.norm_squared())) / 6.0
}

/// A spherical cap: base radius c, height h, mm (reference: `spherical_cap` of the analytic cases).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cap {
    /// Base radius, mm.
    pub base_mm: f64,
    /// Height, mm.
    pub height_mm: f64,
}

impl Cap {
    /// π h (3c² + h²)/6, mm³.
    pub fn volume_mm3(&self) -> f64 {
        let (c, h) = (self.base_mm, self.height_mm);
        std::f64::consts::PI * h * (3.0 * c * c + h * h) / 6.0
    }

    /// Radius of the sphere, mm.
    pub fn radius_mm(&self) -> f64 {
        (self.base_mm * self.base_mm + self.height_mm * self.height_mm) / (2.0 * self.height_mm)
    }

    /// Angle between cap and base plane at the rim, rad.
    pub fn contact_angle_rad(&self) -> f64 {
        2.0 * libm::atan2(self.height_mm, self.base_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Retina;
    use super::super::mesh::hemisphere;
    use super::*;
    use proptest::prelude::*;
    use scene::SceneFile;

    const R: f64 = 11.5;

    /// A retina whose nodes within `base` of the axis lie on a cap that bulges to the centre.
    fn with_bleb(rings: u32, cap: Cap) -> (Vec<Vector3<f64>>, Vec<[u32; 3]>) {
        let (p, t) = hemisphere(R, rings);
        // The base plane lies at −√(R² − c²); the cap's centre below it.
        let plane = -(R * R - cap.base_mm * cap.base_mm).sqrt();
        let centre = plane + cap.height_mm - cap.radius_mm();
        let edge = (cap.base_mm / R).asin();
        let move_up = |p: Vector3<f64>| {
            let out = (p.x * p.x + p.y * p.y).sqrt();
            let polar = out.atan2(-p.z);
            if polar >= edge {
                return p;
            }
            // The node's share of the way to the rim, kept along the cap's arc, so that the mesh
            // stays even.
            let arc = cap.contact_angle_rad() * polar / edge;
            let (x, z) = (cap.radius_mm() * arc.sin(), centre + cap.radius_mm() * arc.cos());
            let sideways = if out > 0.0 { x / out } else { 0.0 };
            Vector3::new(p.x * sideways, p.y * sideways, z)
        };
        (p.into_iter().map(|p| move_up(Vector3::from(p).map(f64::from))).collect(), t)
    }

    /// What a pressure of 1 Pa does to the corners of a triangle, µN.
    fn add_push(push: &mut [Vector3<f64>], nodes: &[u32; 3], corners: &[Vector3<f64>; 3]) {
        for i in 0..3 {
            push[nodes[i] as usize] += corners[(i + 1) % 3].cross(&corners[(i + 2) % 3]) / 6.0;
        }
    }

    #[test]
    fn triangles_together_give_the_bits_of_each_alone() {
        let mut scene = SceneFile::load("relocation").unwrap();
        scene.retina.as_mut().unwrap().rings = 9;
        let (retina, state) = Retina::new(&scene).unwrap().unwrap();
        let (sheet, mut tissue) = (&retina.body.mesh, state.sheet);
        for (i, z) in tissue.position_mm[2].iter_mut().enumerate() {
            *z += 0.01 * (i % 13) as f32;
        }
        // A corner in the eye's centre: no volume, but a push.
        tissue.set_position(7, Vector3::zeros());
        for count in [0, 1, 7, 8, 9, sheet.triangles.len()] {
            let zeros = || vec![Vector3::zeros(); sheet.nodes()];
            let (mut push, mut alone, mut volume) = (zeros(), zeros(), 0.0);
            for nodes in &sheet.triangles[..count] {
                let corners = nodes.map(|n| at(&tissue, n));
                volume += under_triangle(&corners, R);
                add_push(&mut alone, nodes, &corners);
            }
            for simd in [pulp::Arch::new(), pulp::Arch::Scalar] {
                push.fill(Vector3::zeros());
                let found = Block::gather(simd, &tissue, sheet.triangles[..count].iter(), R, &mut push);
                assert_eq!(found.to_bits(), f64::to_bits(volume), "{count} triangles");
                assert_eq!(push, alone);
            }
        }
    }

    fn measured(rings: u32, cap: Cap) -> f64 {
        let (p, t) = with_bleb(rings, cap);
        t.iter().map(|t| under_triangle(&t.map(|n| p[n as usize]), R)).sum()
    }

    /// The figure of the analytic cases: c = 1.5, h = 0.6 gives R = 2.175 and V =
    /// 2.233672376702343.
    #[test]
    fn a_cap_has_the_figures_of_the_reference() {
        let cap = Cap { base_mm: 1.5, height_mm: 0.6 };
        assert!((cap.volume_mm3() - 2.233_672_376_702_343).abs() < 1e-12);
        assert!((cap.radius_mm() - 2.175).abs() < 1e-12);
    }

    #[test]
    fn a_bleb_of_known_shape_has_its_volume_and_the_error_falls_with_the_square_of_the_mesh_width() {
        // The fluid is the cap over the base plane and the choroid's own cap under it.
        // Base radii that fall on a ring of every mesh, so that the rim is not a staircase.
        let base_mm = R * (std::f64::consts::FRAC_PI_2 * 0.25).sin();
        let cap = Cap { base_mm, height_mm: 2.0 };
        let below = Cap { base_mm, height_mm: R - (R * R - base_mm * base_mm).sqrt() };
        let exact = cap.volume_mm3() + below.volume_mm3();
        let errors = [16, 32, 64].map(|rings| (measured(rings, cap) - exact).abs() / exact);
        assert!(errors[1] < 0.02 && errors[2] < 0.005, "{errors:?}");
        assert!(errors[0] / errors[1] > 3.5 && errors[1] / errors[2] > 3.5, "second order: {errors:?}");
    }

    #[test]
    fn what_lies_on_the_choroid_holds_nothing() {
        let (p, t) = hemisphere(R, 12);
        let at = |n: u32| Vector3::from(p[n as usize]).map(f64::from);
        let all: f64 = t.iter().map(|t| under_triangle(&t.map(at), R).abs()).sum();
        // Half a unit in the last place (2⁻²¹ mm between 8 and 16) on each axis, over the
        // hemisphere.
        let rounding = 3f64.sqrt() * 2f64.powi(-21) * std::f64::consts::TAU * R * R;
        assert!(all < rounding, "rounding of f32 positions: {all} of {rounding}");
    }

    proptest! {
        /// The push is the derivative of the volume, but for the feet: checked where feet stay,
        /// along the radius.
        #[test]
        fn push_is_the_derivative_along_the_radius(
            heights in prop::array::uniform3(0.1f64..3.0),
            corner in 0usize..3,
        ) {
            let feet = [Vector3::new(0.0, 0.0, -1.0), Vector3::new(0.05, 0.0, -1.0), Vector3::new(0.0, 0.05, -1.0)];
            let place = |h: [f64; 3]| std::array::from_fn(|i| feet[i].normalize() * (R - h[i]));
            let (mut up, mut down) = (heights, heights);
            up[corner] += 1e-4;
            down[corner] -= 1e-4;
            let slope = (under_triangle(&place(up), R) - under_triangle(&place(down), R)) / 2e-4;
            let mut push = vec![Vector3::zeros(); 3];
            add_push(&mut push, &[0, 1, 2], &place(heights));
            let inwards = -feet[corner].normalize();
            prop_assert!((push[corner].dot(&inwards) - slope).abs() < 1e-6 * (1.0 + slope.abs()));
        }

        /// The slope is the derivative in every direction, wherever the feet go.
        #[test]
        fn slope_is_the_derivative(corners in prop::array::uniform9(-3.0f64..3.0), axis in 0usize..3) {
            let place = |i: usize| Vector3::new(corners[3 * i], corners[3 * i + 1], corners[3 * i + 2] - 7.0);
            let places: [Vector3<f64>; 3] = std::array::from_fn(place);
            let (mut up, mut down) = (places, places);
            up[0][axis] += 1e-4;
            down[0][axis] -= 1e-4;
            let found = (under_triangle(&up, R) - under_triangle(&down, R)) / 2e-4;
            let expected = slope(&places, R)[axis];
            prop_assert!((found - expected).abs() < 1e-5 * (1.0 + slope(&places, R).norm()), "{found} {expected}");
        }
    }
}
