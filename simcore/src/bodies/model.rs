//! What a rigid body is: shape, mass, inertia, friction, and the points by which it can touch the
//! retina.

use collision::rigid::{Compound, Convex};
use collision::surface::CollisionError;
use nalgebra::{Isometry3, Vector3};
use scene::{BodyScene, BodyShape};

/// What does not change about a body.
#[derive(Debug, Clone)]
pub struct BodyModel {
    shape: BodyShape,
    half_mm: Vector3<f64>,
    /// 1/g.
    pub(super) inverse_mass: f64,
    /// Along its axes, 1/(g·mm²).
    pub(super) inverse_inertia: Vector3<f64>,
    pub(super) friction: f64,
    pub(super) solid: Compound,
}

impl BodyModel {
    /// The model of a scene's body: homogeneous.
    ///
    /// # Errors
    /// [`CollisionError`] for a body without extent.
    pub fn new(scene: &BodyScene) -> Result<Self, CollisionError> {
        let [x, y, z] = scene.half_extents_mm;
        let (convex, inertia) = match scene.shape {
            BodyShape::Sphere => (Convex::Ball { radius_mm: x }, Vector3::repeat(0.4 * x * x)),
            BodyShape::Box => {
                let inertia = Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) / 3.0;
                (Convex::Cuboid { half_mm: [x, y, z] }, inertia)
            }
            BodyShape::Capsule => {
                (Convex::Capsule { half_mm: z - x, radius_mm: x }, capsule_inertia(x, z - x))
            }
        };
        Ok(BodyModel {
            shape: scene.shape,
            half_mm: Vector3::new(x, y, z),
            inverse_mass: 1.0 / scene.mass_g,
            inverse_inertia: inertia.map(|i| 1.0 / (i * scene.mass_g)),
            friction: scene.friction,
            solid: Compound::new(&[(convex, Isometry3::identity())])?,
        })
    }

    /// Mass, g.
    pub fn mass_g(&self) -> f64 {
        1.0 / self.inverse_mass
    }

    /// Its shape for contacts.
    pub fn solid(&self) -> &Compound {
        &self.solid
    }

    /// Points that can touch a sphere around it from inside, body frame, and how far its surface is
    /// from them.
    pub(super) fn corners(&self) -> ([Vector3<f64>; 8], usize, f64) {
        let h = self.half_mm;
        let mut points = [Vector3::zeros(); 8];
        match self.shape {
            BodyShape::Sphere => (points, 1, h.x),
            BodyShape::Capsule => {
                (points[0], points[1]) = (Vector3::z() * (h.z - h.x), Vector3::z() * (h.x - h.z));
                (points, 2, h.x)
            }
            BodyShape::Box => {
                let side = |i: usize, bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
                for (i, p) in points.iter_mut().enumerate() {
                    *p = Vector3::new(side(i, 0) * h.x, side(i, 1) * h.y, side(i, 2) * h.z);
                }
                (points, 8, 0.0)
            }
        }
    }
}

/// Inertia over mass of a homogeneous rod along z with round ends of radius `r`, the ends' centres
/// `half` from the middle.
fn capsule_inertia(r: f64, half: f64) -> Vector3<f64> {
    let (cylinder, ball) = (2.0 * half, 4.0 / 3.0 * r);
    let (c, b) = (cylinder / (cylinder + ball), ball / (cylinder + ball));
    let along = c * 0.5 * r * r + b * 0.4 * r * r;
    // Half balls at the ends: their centre of mass is 3/8·r beyond `half` (parallel axes).
    let across =
        c * (r * r / 4.0 + cylinder * cylinder / 12.0) + b * (0.4 * r * r + half * half + 0.75 * half * r);
    Vector3::new(across, across, along)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a sum over small cubes.
    #[test]
    fn a_rods_inertia_is_that_of_its_matter() {
        let (r, half, n) = (0.5, 0.8, 60);
        let (mut mass, mut sum) = (0.0, Vector3::zeros());
        let at = |i: i32, size: f64| (f64::from(i) + 0.5) / f64::from(n) * size;
        for (i, j, k) in (-n..n).flat_map(|i| (-n..n).flat_map(move |j| (-n..n).map(move |k| (i, j, k)))) {
            let p = Vector3::new(at(i, r), at(j, r), at(k, half + r));
            let beyond = (p.z.abs() - half).max(0.0);
            if p.x * p.x + p.y * p.y + beyond * beyond < r * r {
                mass += 1.0;
                sum += Vector3::new(p.y * p.y + p.z * p.z, p.x * p.x + p.z * p.z, p.x * p.x + p.y * p.y);
            }
        }
        let (found, expected) = (capsule_inertia(r, half), sum / mass);
        assert!((found - expected).norm() < 2e-3 * expected.norm(), "{found} {expected}");
    }
}
