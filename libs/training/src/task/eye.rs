//! Contacts with the lens, and tips that leave the field of view.

use super::Observation;
use crate::sample::Tip;
use nalgebra::{Point3, Vector3};

/// Back of the lens where a scene does not say, z in the eye frame, mm: as in the shipped
/// vitrectomy.
pub const LENS_BACK_MM: f64 = 6.5;
/// Half of the lens's diameter, mm: adults have 9 to 10 mm.
pub const LENS_RADIUS_MM: f64 = 4.6;
/// Half of its thickness, mm: adults have about 4 mm.
pub const LENS_HALF_MM: f64 = 2.0;
/// A contact with the lens has ended when the shaft is so far away, mm.
pub const LENS_CLEAR_MM: f64 = 0.1;

/// How deep a shaft is in the lens, mm; negative outside. The lens is an ellipsoid; it is scaled to
/// a ball of radius 1, and the distance of the shaft's axis from its centre is given as a share of
/// the half thickness, which is exact on the eye's axis.
pub fn lens_depth_mm(tip: &Tip, back_mm: f64) -> f64 {
    let scale = Vector3::new(1.0 / LENS_RADIUS_MM, 1.0 / LENS_RADIUS_MM, 1.0 / LENS_HALF_MM);
    let centre = Vector3::new(0.0, 0.0, back_mm + LENS_HALF_MM);
    let from = (tip.tip_in_eye_mm - centre).component_mul(&scale);
    let along = tip.to_handle.component_mul(&scale);
    let length2 = along.norm_squared();
    let nearest = if length2 > 0.0 { -from.dot(&along) / length2 } else { 0.0 };
    let nearest = if nearest > 0.0 { nearest } else { 0.0 };
    (1.0 - (from + along * nearest).norm()) * LENS_HALF_MM
}

/// How far a tip is beyond the rim of the picture, mm; negative inside. The microscope looks along
/// −z of the world.
pub fn beyond_view_mm(seen: &Observation, tip: &Tip) -> f64 {
    let at = seen.world_from_eye * Point3::from(tip.tip_in_eye_mm);
    let [x, y, _] = seen.microscope_target_mm;
    libm::hypot(at.x - x, at.y - y) - 0.5 * seen.field_mm
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    fn shaft(tip: [f64; 3], through: [f64; 3]) -> Tip {
        let tip_in_eye_mm = Vector3::from(tip);
        let to_handle = (Vector3::from(through) - tip_in_eye_mm).normalize();
        Tip { tip_in_eye_mm, to_handle, covariance_mm2: Matrix3::zeros() }
    }

    #[test]
    fn a_shaft_to_the_macula_is_clear_and_one_across_the_eye_is_not() {
        let trocar = [7.86, 4.54, 7.86];
        assert!(lens_depth_mm(&shaft([0.0, 0.0, -11.0], trocar), LENS_BACK_MM) < -1.0);
        assert!(lens_depth_mm(&shaft([-7.5, -4.3, 6.0], trocar), LENS_BACK_MM) > 0.0);
        let on_axis = shaft([0.0, 0.0, 6.2], [0.0, 0.0, -20.0]);
        assert!((lens_depth_mm(&on_axis, LENS_BACK_MM) + 0.3).abs() < 1e-9, "0.3 mm behind the lens");
    }
}
