//! Workspace of a tip: inside the eye's wall and below its trocar.

use nalgebra::Vector3;

/// Depth to which a tip can enter the wall, mm: retina and choroid give way, the sclera does not.
pub const WALL_MM: f64 = 0.3;
/// Distance that a tip keeps below its trocar, mm.
pub const BELOW_TROCAR_MM: f64 = 2.0;

/// Workspace of one tip, eye frame: a ball with its front cut off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workspace {
    /// Radius of the ball, mm.
    radius_mm: f64,
    /// Highest z, mm.
    front_mm: f64,
}

impl Workspace {
    /// For a retina of this radius and a shaft through this trocar (eye frame, mm).
    pub fn new(retina_radius_mm: f64, trocar_in_eye_mm: &Vector3<f64>) -> Self {
        let front = trocar_in_eye_mm.z - BELOW_TROCAR_MM;
        // The eye's centre is always inside, so that shrinking towards it ends inside.
        Workspace { radius_mm: retina_radius_mm + WALL_MM, front_mm: if front > 0.0 { front } else { 0.0 } }
    }

    /// The point of the workspace for `p`, drawn towards the eye's centre; the centre if `p` is not
    /// finite.
    pub fn clamp_point(&self, p: &Vector3<f64>) -> Vector3<f64> {
        if !p.iter().all(|c| c.is_finite()) {
            return Vector3::zeros();
        }
        let p = Vector3::new(p.x, p.y, p.z.min(self.front_mm));
        let norm = p.norm();
        if norm > self.radius_mm { p * (self.radius_mm / norm) } else { p }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_point_ends_in_the_room_and_those_inside_stay(p in prop::array::uniform3(prop::num::f64::ANY)) {
            let trocar = Vector3::new(7.9, 4.5, 7.9);
            let workspace = Workspace::new(11.5, &trocar);
            let held = workspace.clamp_point(&Vector3::from(p));
            prop_assert!(held.norm() <= 11.5 + WALL_MM + 1e-9 && held.z <= trocar.z - BELOW_TROCAR_MM + 1e-9);
            prop_assert!((workspace.clamp_point(&held) - held).norm() < 1e-9);
        }
    }

    #[test]
    fn the_retina_can_be_touched_and_the_sclera_stops() {
        let workspace = Workspace::new(11.5, &Vector3::new(0.0, 7.0, 8.0));
        let on = Vector3::new(0.0, 0.0, -11.6);
        assert_eq!(workspace.clamp_point(&on), on);
        assert_eq!(workspace.clamp_point(&(on * 3.0)).z, -11.8);
    }
}
