//! Needle: a sharp tip that goes into a surface, moves in it, and injects.
//!
//! A surface is the retina's sphere or a triangle mesh. The needle is **in** it where the straight
//! piece of shaft behind the tip crosses it; depth is measured along the shaft from there to the
//! tip. How fast the needle moves along the surface decides whether it tears.

use collision::surface::Surface;
use nalgebra::{UnitVector3, Vector3};

/// A needle during a substep, eye frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Needle {
    /// Tip, mm.
    pub tip_in_eye_mm: Vector3<f64>,
    /// From the tip to the handle.
    pub axis_in_eye: UnitVector3<f64>,
    /// Velocity of the tip, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Outer radius, mm.
    pub radius_mm: f64,
    /// Pressure of the injection at the tip, Pa; 0 while the foot does not press.
    pub pressure_pa: f64,
}

/// Where a needle has gone into a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Penetration {
    /// Where the shaft crosses the surface, eye frame, mm.
    pub at_in_eye_mm: Vector3<f64>,
    /// Normal of the surface there, on the side of the handle.
    pub normal_in_eye: UnitVector3<f64>,
    /// From there to the tip along the shaft, mm; above 0.
    pub depth_mm: f64,
    /// Speed of the tip along the surface, mm/s; the surface is taken to rest.
    pub tangential_mm_s: f64,
    /// Triangle of a mesh and the weights of its corners there; `None` for the sphere.
    pub place: Option<Place>,
}

/// A point of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The triangle.
    pub triangle: u32,
    /// Weights of its corners; they add up to 1.
    pub weights: [f64; 3],
}

impl Needle {
    /// Penetration into the retina, a sphere of radius `radius_mm` about the eye's centre, from its
    /// inside.
    pub fn in_sphere(&self, radius_mm: f64) -> Option<Penetration> {
        let (tip, axis) = (self.tip_in_eye_mm, self.axis_in_eye.into_inner());
        let outside = tip.norm_squared() - radius_mm * radius_mm;
        if outside <= 0.0 {
            return None;
        }
        // |tip + s·axis| = radius for the smallest s > 0.
        let half = tip.dot(&axis);
        let under = half * half - outside;
        if half >= 0.0 || under < 0.0 {
            return None;
        }
        let depth_mm = -half - libm::sqrt(under);
        let at = tip + axis * depth_mm;
        Some(self.penetration(at, -at, depth_mm, None))
    }

    /// Penetration into a mesh, looked for up to `length_mm` behind the tip; the crossing nearest
    /// to the tip.
    pub fn in_mesh(&self, surface: &Surface, length_mm: f64) -> Option<Penetration> {
        self.in_triangles(surface, 0..surface.triangles.len() as u32, length_mm)
    }

    /// Penetration into those triangles of a mesh.
    pub fn in_triangles(
        &self,
        surface: &Surface,
        triangles: impl Iterator<Item = u32>,
        length_mm: f64,
    ) -> Option<Penetration> {
        let corner = |v: u32| Vector3::from(surface.position_mm.map(|axis| f64::from(axis[v as usize])));
        let mut nearest: Option<(f64, u32, [f64; 3], Vector3<f64>)> = None;
        for t in triangles {
            let (triangle, t) = (t, t as usize);
            if surface.alive[t] == 0 {
                continue;
            }
            let corners = surface.triangles[t].map(corner);
            let Some((s, weights)) = self.crossing(&corners) else { continue };
            if s <= length_mm && nearest.is_none_or(|n| s < n.0) {
                let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
                nearest = Some((s, triangle, weights, normal));
            }
        }
        let (depth_mm, triangle, weights, normal) = nearest?;
        let at = self.tip_in_eye_mm + self.axis_in_eye.into_inner() * depth_mm;
        Some(self.penetration(at, normal, depth_mm, Some(Place { triangle, weights })))
    }

    /// Where the line behind the tip meets a triangle: distance from the tip (above 0) and weights
    /// of the corners (Möller and Trumbore 1997).
    fn crossing(&self, [a, b, c]: &[Vector3<f64>; 3]) -> Option<(f64, [f64; 3])> {
        let (ab, ac) = (b - a, c - a);
        let across = self.axis_in_eye.cross(&ac);
        let determinant = ab.dot(&across);
        if determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let from = self.tip_in_eye_mm - a;
        let u = from.dot(&across) / determinant;
        // Most triangles are passed over here.
        if !(0.0..=1.0).contains(&u) {
            return None;
        }
        let along = from.cross(&ab);
        let v = self.axis_in_eye.dot(&along) / determinant;
        let s = ac.dot(&along) / determinant;
        (v >= 0.0 && u + v <= 1.0 && s > 0.0).then_some((s, [1.0 - u - v, u, v]))
    }

    fn penetration(
        &self,
        at: Vector3<f64>,
        normal: Vector3<f64>,
        depth_mm: f64,
        place: Option<Place>,
    ) -> Penetration {
        let facing = if normal.dot(&self.axis_in_eye) < 0.0 { -normal } else { normal };
        let normal = UnitVector3::try_new(facing, 0.0).unwrap_or(self.axis_in_eye);
        let along = self.velocity_mm_s - normal.into_inner() * self.velocity_mm_s.dot(&normal);
        Penetration {
            at_in_eye_mm: at,
            normal_in_eye: normal,
            depth_mm,
            tangential_mm_s: along.norm(),
            place,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn needle(tip: [f64; 3], axis: [f64; 3]) -> Needle {
        Needle {
            tip_in_eye_mm: tip.into(),
            axis_in_eye: UnitVector3::new_normalize(axis.into()),
            velocity_mm_s: Vector3::new(3.0, 4.0, 5.0),
            radius_mm: 0.05,
            pressure_pa: 0.0,
        }
    }

    #[test]
    fn upright_into_the_pole() {
        let found = needle([0.0, 0.0, -11.7], [0.0, 0.0, 1.0]).in_sphere(11.5).unwrap();
        assert!((found.depth_mm - 0.2).abs() < 1e-12);
        assert!((found.normal_in_eye.z - 1.0).abs() < 1e-12, "the normal points to the handle");
        assert!((found.tangential_mm_s - 5.0).abs() < 1e-12, "3 and 4 mm/s along the retina");
        assert_eq!(needle([0.0, 0.0, -11.4], [0.0, 0.0, 1.0]).in_sphere(11.5), None);
        assert_eq!(needle([0.0, 0.0, -11.7], [0.0, 0.0, -1.0]).in_sphere(11.5), None, "from the outside");
    }

    proptest! {
        /// The crossing lies on the sphere and on the shaft.
        #[test]
        fn the_entry_lies_on_sphere_and_shaft(x in -4.0f64..4.0, y in -4.0f64..4.0, over in 0.01f64..1.0, lean in -0.6f64..0.6) {
            let tip = Vector3::new(x, y, -9.0).normalize() * (11.5 + over);
            let found = needle(tip.into(), [lean, 0.2, 1.0]).in_sphere(11.5);
            if let Some(found) = found {
                prop_assert!((found.at_in_eye_mm.norm() - 11.5).abs() < 1e-9);
                let axis = Vector3::new(lean, 0.2, 1.0).normalize();
                prop_assert!((found.at_in_eye_mm - tip - axis * found.depth_mm).norm() < 1e-9);
            }
        }

        /// Weights of the corners give the point back; a needle that stops short has no
        /// penetration.
        #[test]
        fn the_place_in_a_mesh_is_the_crossing(u in 0.05f64..0.9, part in 0.05f64..0.95, depth in -0.5f64..0.5, lean in -0.5f64..0.5) {
            let v = part * (1.0 - u);
            let axes = [vec![0.0f32, 1.0, 0.2], vec![0.0, 0.1, 1.0], vec![0.0, 0.3, -0.2]];
            let surface = Surface {
                position_mm: axes.each_ref().map(Vec::as_slice), triangles: &[[0, 1, 2]], alive: &[1],
            };
            let corner = |i: usize| Vector3::from(axes.each_ref().map(|a| f64::from(a[i])));
            let at = corner(0) * (1.0 - u - v) + corner(1) * u + corner(2) * v;
            let axis = Vector3::new(lean, -0.3, 1.0).normalize();
            let found = needle((at - axis * depth).into(), axis.into()).in_mesh(&surface, 2.0);
            prop_assert_eq!(found.is_some(), depth > 0.0);
            if let Some(found) = found {
                prop_assert!((found.depth_mm - depth).abs() < 1e-9);
                let place = found.place.unwrap();
                prop_assert!((place.weights[1] - u).abs() < 1e-9 && (place.weights[2] - v).abs() < 1e-9);
                prop_assert!((found.at_in_eye_mm - at).norm() < 1e-9);
            }
        }
    }
}
