//! What the lens does before the microscope looks: a map of the eye into its picture in the air.
//! Pure.
//!
//! A thin lens maps straight lines to straight lines (it is a collineation), and so does a plane of
//! glass for rays near its normal. So each is a 4×4 matrix beside those of the camera, and every
//! pass draws through it as it is. World frame, mm.

use glam::{DMat4, DVec3, DVec4};
use protocol::optics::Lens;
use protocol::scene::Microscope;

/// Refractive index of vitreous, and of the contact lens as far as it matters.
pub const VITREOUS_INDEX: f64 = 1.336;
/// Height of the contact lens's flat face over the eye's centre, mm: the cornea's 12 and its
/// thickness.
pub const FLAT_FACE_MM: f64 = 14.0;
/// A point nearer than this to the wide-angle lens's focus has no picture, mm.
const MIN_BEYOND_FOCUS_MM: f64 = 0.5;

/// Takes points of the eye (world frame) to where the microscope sees them.
pub fn image_from_world(microscope: &Microscope) -> DMat4 {
    match Lens::from_wire(microscope.lens) {
        Lens::None => DMat4::IDENTITY,
        Lens::Flat => {
            // Apparent depth under a plane: 1/n of the true one.
            let share = 1.0 / VITREOUS_INDEX;
            let lifted = DMat4::from_translation(DVec3::Z * (FLAT_FACE_MM * (1.0 - share)));
            lifted * DMat4::from_scale(DVec3::new(1.0, 1.0, share))
        }
        Lens::WideAngle => thin_lens(microscope),
    }
}

/// Gauss' formula: a point `s` below the lens appears `f s / (s − f)` above it, its distance from
/// the axis times `−f / (s − f)`. Multiplied by `s − f`, all of it is linear in the point.
fn thin_lens(microscope: &Microscope) -> DMat4 {
    let [x0, y0, target_z] = microscope.target_in_world_mm;
    let f = microscope.lens_focal_mm.max(1.0);
    let lens = microscope.lens_height_mm.max(target_z + f + MIN_BEYOND_FOCUS_MM);
    // w = s − f = (lens − z) − f
    let w = DVec4::new(0.0, 0.0, -1.0, lens - f);
    let x = DVec4::new(-f, 0.0, 0.0, f * x0) + w * x0;
    let y = DVec4::new(0.0, -f, 0.0, f * y0) + w * y0;
    let z = DVec4::new(0.0, 0.0, -f, f * lens) + w * lens;
    DMat4::from_cols(x, y, z, w).transpose()
}

/// The target as the microscope sees it.
pub fn target_in_image(microscope: &Microscope) -> DVec3 {
    image_from_world(microscope).project_point3(DVec3::from(microscope.target_in_world_mm))
}

/// Length in the picture of one millimetre across the axis at the target.
pub fn magnification(microscope: &Microscope) -> f64 {
    let aside = DVec3::from(microscope.target_in_world_mm) + DVec3::X * 1e-3;
    let image = image_from_world(microscope).project_point3(aside);
    image.distance(target_in_image(microscope)) * 1e3
}

/// Diameter of the field of view at the target, in the eye, mm.
pub fn field_in_eye_mm(microscope: &Microscope) -> f64 {
    microscope.field_mm.max(0.1) / magnification(microscope)
}

/// Diameter in the plane of focus of the patch of light that a point makes, mm of the microscope's
/// picture; `distance_mm` is that of the point's image from the objective. Similar triangles: the
/// beam is as wide as the aperture at the objective and narrows to the point.
pub fn blur_mm(microscope: &Microscope, distance_mm: f64) -> f64 {
    let focus = microscope.working_distance_mm - microscope.focus_mm;
    microscope.aperture_mm.max(0.0) * (focus - distance_mm).abs() / distance_mm.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    fn microscope(lens: Lens) -> Microscope {
        Microscope {
            target_in_world_mm: [1.0, -2.0, -11.0],
            working_distance_mm: 200.0,
            stereo_base_mm: 22.0,
            field_mm: 16.0,
            aperture_mm: 4.0,
            lens_focal_mm: 12.0,
            lens_height_mm: 21.5,
            lens: lens as u32,
            ..Microscope::zeroed()
        }
    }

    proptest! {
        /// The image lies where two rays meet: the one through the lens's centre, which goes
        /// straight on, and the one parallel to the axis, which goes through the focus beyond.
        #[test]
        fn rays_meet_in_the_image(x in -9.0..9.0f64, y in -9.0..9.0f64, z in -11.5..6.0f64) {
            let m = microscope(Lens::WideAngle);
            let centre = DVec3::new(1.0, -2.0, 21.5);
            let p = DVec3::new(x, y, z);
            let through_centre = centre - p;
            let at_lens = DVec3::new(x, y, 21.5);
            let through_focus = centre + DVec3::Z * 12.0 - at_lens;
            let image = image_from_world(&m).project_point3(p);
            let on = |from: DVec3, ray: DVec3| (image - from).cross(ray).length() / ray.length();
            prop_assert!(on(p, through_centre) < 1e-9 && on(at_lens, through_focus) < 1e-9, "{image}");
            prop_assert!(image.z > 21.5);
        }

        #[test]
        fn what_is_higher_in_the_eye_is_higher_in_the_image(low in -11.5..6.0f64, above in 1e-3..1.0f64) {
            for lens in [Lens::None, Lens::Flat, Lens::WideAngle] {
                let map = image_from_world(&microscope(lens));
                let at = |z: f64| map.project_point3(DVec3::new(3.0, 1.0, z)).z;
                prop_assert!(at(low + above) > at(low), "{lens:?}");
            }
        }
    }

    #[test]
    fn fields_and_depths_are_those_of_the_formulas() {
        let wide = microscope(Lens::WideAngle);
        assert!((magnification(&wide) - 12.0 / 20.5).abs() < 1e-9);
        assert!((field_in_eye_mm(&wide) - 16.0 * 20.5 / 12.0).abs() < 1e-6);
        let flat = image_from_world(&microscope(Lens::Flat));
        let depth = |z: f64| FLAT_FACE_MM - flat.project_point3(DVec3::new(0.0, 0.0, z)).z;
        assert!((depth(-11.0) - 25.0 / 1.336).abs() < 1e-9 && depth(FLAT_FACE_MM).abs() < 1e-9);
    }

    #[test]
    fn blur_grows_on_both_sides_of_the_focus() {
        let m = Microscope { focus_mm: 2.0, ..microscope(Lens::None) };
        assert_eq!(blur_mm(&m, 198.0), 0.0);
        assert!((blur_mm(&m, 200.0) - 4.0 * 2.0 / 200.0).abs() < 1e-12);
        assert!((blur_mm(&m, 190.0) - 4.0 * 8.0 / 190.0).abs() < 1e-12);
    }
}
