//! The stereo microscope: two channels whose axes meet in the target, or in the picture of it that
//! a lens makes.

use crate::layout::ViewUniform;
use crate::optics::{image_from_world, target_in_image};
use glam::dcamera::rh::proj::directx::perspective;
use glam::dcamera::rh::view::look_at_mat4;
use glam::{DMat3, DMat4, DVec3};
use protocol::scene::Microscope;

/// Channels: left, right.
pub const CHANNELS: usize = 2;
/// The round field fills this share of the picture's height.
pub const FIELD_FILL: f64 = 0.98;
/// Width of the field's soft border, share of its radius.
const BORDER: f64 = 0.03;
/// Distance of the near plane from the target towards the objective, mm.
const NEAR_SIDE_MM: f64 = 60.0;
/// Distance of the far plane beyond the target, mm.
const FAR_SIDE_MM: f64 = 30.0;

/// Up in the picture, world frame: the surgeon sits at +y.
const UP_IN_WORLD: DVec3 = DVec3::NEG_Y;
/// Right in the picture, world frame.
const RIGHT_IN_WORLD: DVec3 = DVec3::NEG_X;

/// Objective of `channel` (0 left, 1 right), where the lens's picture lies as it lies in the world,
/// mm. The inverter exchanges the channels: turned by itself, each channel's picture would show
/// what is near as far.
pub fn objective_in_image(microscope: &Microscope, channel: usize) -> DVec3 {
    let left = (channel == 0) != (microscope.inverter != 0);
    let side = if left { -0.5 } else { 0.5 };
    let height = DVec3::Z * microscope.working_distance_mm.max(1.0);
    target_in_image(microscope) + height + RIGHT_IN_WORLD * (side * microscope.stereo_base_mm)
}

/// Nearest and farthest distance along a channel's axis that is drawn, mm of the picture looked at.
pub fn depth_range_mm(microscope: &Microscope) -> [f64; 2] {
    let distance = objective_in_image(microscope, 0).distance(target_in_image(microscope));
    [(distance - NEAR_SIDE_MM).max(1.0), distance + FAR_SIDE_MM]
}

/// What is in focus, for a pass that knows depths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocusPlane {
    /// A and B: what has the depth z on the picture has the distance B / (A − z) from the objective
    /// along the channel's axis, mm of the picture looked at.
    pub distance_of_depth: [f64; 2],
    /// Distance of the plane in focus, mm.
    pub distance_mm: f64,
    /// A channel's beam at the objective, mm.
    pub aperture_mm: f64,
}

/// The plane of focus of both channels. Depths are those of a perspective: (1 − near / d) far /
/// (far − near).
pub fn focus_plane(microscope: &Microscope) -> FocusPlane {
    let [near, far] = depth_range_mm(microscope);
    let target = objective_in_image(microscope, 0).distance(target_in_image(microscope));
    let a = far / (far - near);
    FocusPlane {
        distance_of_depth: [a, a * near],
        distance_mm: (target - microscope.focus_mm).max(1.0),
        aperture_mm: microscope.aperture_mm.max(0.0),
    }
}

/// Projection of `channel` on a picture of `aspect` (width by height): lens, microscope, inverter.
fn clip_from_world(microscope: &Microscope, channel: usize, aspect: f64) -> DMat4 {
    let target = target_in_image(microscope);
    let objective = objective_in_image(microscope, channel);
    let half_height = 0.5 * microscope.field_mm.max(0.1) / FIELD_FILL;
    let fov_y = 2.0 * (half_height / objective.distance(target)).atan();
    let [near, far] = depth_range_mm(microscope);
    let clip_from_camera = perspective(fov_y, aspect, near, far);
    let camera_from_image = look_at_mat4(objective, target, UP_IN_WORLD);
    let turned = if microscope.inverter != 0 { DVec3::new(-1.0, -1.0, 1.0) } else { DVec3::ONE };
    DMat4::from_scale(turned) * clip_from_camera * camera_from_image * image_from_world(microscope)
}

/// The view of `channel` on a picture of `aspect` (width by height).
pub fn view_uniform(
    microscope: &Microscope,
    channel: usize,
    aspect: f64,
    eye_from_world: &DMat4,
) -> ViewUniform {
    let clip_from_eye = clip_from_world(microscope, channel, aspect) * eye_from_world.inverse();
    // The rays that a projection shows as points: those of NDC (x, y) run from one point along
    // `rays` times (x, y, 1). Behind a lens that point is not the objective but the objective's
    // image in the eye.
    let [x, y, w] = [0, 1, 3].map(|row| clip_from_eye.row(row));
    let rays = DMat3::from_cols(x.truncate(), y.truncate(), w.truncate()).transpose().inverse();
    let from = rays * DVec3::new(-x.w, -y.w, -w.w);
    let target = eye_from_world.transform_point3(DVec3::from(microscope.target_in_world_mm));
    // One unit of w along each ray ends in a plane; `units` of them end in the plane through the
    // target.
    let units = (clip_from_eye * target.extend(1.0)).w;
    let vec4 = |v: DVec3| v.extend(0.0).as_vec4().to_array();
    let inner = (1.0 - BORDER) * (1.0 - BORDER);
    let field = [aspect / FIELD_FILL, 1.0 / FIELD_FILL, inner, 1.0 / (1.0 - inner)];
    ViewUniform {
        clip_from_eye: clip_from_eye.as_mat4().to_cols_array_2d(),
        camera: vec4(from),
        plane_origin: vec4(from + rays.z_axis * units),
        plane_x: vec4(rays.x_axis * units),
        plane_y: vec4(rays.y_axis * units),
        field: field.map(|x| x as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use glam::{Mat4, Vec3};
    use protocol::optics::Lens;

    fn microscope() -> Microscope {
        Microscope {
            target_in_world_mm: [0.0, 0.0, -11.0],
            working_distance_mm: 200.0,
            stereo_base_mm: 22.0,
            field_mm: 16.0,
            lens_focal_mm: 12.0,
            lens_height_mm: 21.5,
            ..Microscope::zeroed()
        }
    }

    fn through(lens: Lens, inverter: bool) -> Microscope {
        Microscope { lens: lens as u32, inverter: u32::from(inverter), ..microscope() }
    }

    fn ndc_of(m: &Microscope, channel: usize, p: [f32; 3]) -> Vec3 {
        let v = view_uniform(m, channel, 1.25, &DMat4::IDENTITY);
        Mat4::from_cols_array_2d(&v.clip_from_eye).project_point3(Vec3::from(p))
    }

    fn ndc(channel: usize, p: [f32; 3]) -> Vec3 {
        ndc_of(&microscope(), channel, p)
    }

    #[test]
    fn picture_is_upright_for_a_surgeon_at_plus_y() {
        assert!(ndc(0, [0.0, -3.0, -11.0]).y > 0.2, "up is −y");
        assert!(ndc(0, [-3.0, 0.0, -11.0]).x > 0.2, "right is −x");
        assert!(ndc(1, [0.0, 0.0, -11.0]).truncate().length() < 1e-5, "the target is in the middle");
    }

    #[test]
    fn nearer_points_have_crossed_disparity() {
        let near = [0.0, 0.0, -5.0];
        assert!(ndc(0, near).x > ndc(1, near).x, "the left eye sees near things farther right");
        let angle = (0.5f64 * 22.0 / 200.0).atan() * 2.0;
        assert!((angle.to_degrees() - 6.3).abs() < 0.05, "6.3° between the axes");
    }

    #[test]
    fn field_fits_the_round_picture() {
        let r = (ndc(0, [0.0, -8.0, -11.0]).y / FIELD_FILL as f32 - 1.0).abs();
        assert!(r < 0.01, "8 mm lie on the border of a field of 16 mm: {r}");
    }

    const EVERY: [(Lens, bool); 6] = [
        (Lens::None, false),
        (Lens::None, true),
        (Lens::Flat, false),
        (Lens::Flat, true),
        (Lens::WideAngle, false),
        (Lens::WideAngle, true),
    ];

    #[test]
    fn a_wide_angle_lens_inverts_and_the_inverter_sets_upright() {
        for (lens, inverter) in EVERY {
            let upright = (lens == Lens::WideAngle) == inverter;
            let sense = if upright { 1.0 } else { -1.0 };
            let m = through(lens, inverter);
            assert!(sense * ndc_of(&m, 0, [0.0, -3.0, -11.0]).y > 0.1, "{lens:?}, {inverter}: up");
            assert!(sense * ndc_of(&m, 1, [-3.0, 0.0, -11.0]).x > 0.1, "{lens:?}, {inverter}: right");
        }
    }

    #[test]
    fn what_is_nearer_is_seen_nearer_through_every_lens() {
        for (lens, inverter) in EVERY {
            let m = through(lens, inverter);
            for z in [-10.5, -8.0, -3.0, 2.0] {
                let crossed = ndc_of(&m, 0, [0.0, 0.0, z]).x - ndc_of(&m, 1, [0.0, 0.0, z]).x;
                assert!(crossed > 0.0, "{lens:?}, {inverter}, {z}: disparity {crossed}");
                assert!(
                    ndc_of(&m, 0, [0.0, 0.0, z]).z < ndc_of(&m, 0, [0.0, 0.0, -11.0]).z,
                    "{lens:?}: depth"
                );
            }
        }
    }

    #[test]
    fn depths_lead_back_to_distances() {
        for (lens, inverter) in EVERY {
            let m = Microscope { focus_mm: 3.0, aperture_mm: 4.0, ..through(lens, inverter) };
            let plane = focus_plane(&m);
            let [a, b] = plane.distance_of_depth;
            let objective = objective_in_image(&m, 0);
            let axis = (target_in_image(&m) - objective).normalize();
            for p in [[0.0, 0.0, -11.0], [1.0, -2.0, -9.0], [-3.0, 1.0, -4.0]] {
                let depth = f64::from(ndc_of(&m, 0, p.map(|c| c as f32)).z);
                let seen = image_from_world(&m).project_point3(DVec3::from(p));
                let expected = (seen - objective).dot(axis);
                assert!((b / (a - depth) - expected).abs() < 2e-3, "{lens:?}: {p:?}");
            }
            assert!((plane.distance_mm - (200.0f64.hypot(11.0) - 3.0)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_wide_angle_lens_sees_from_the_pupil() {
        let v = view_uniform(&through(Lens::WideAngle, true), 0, 1.25, &DMat4::IDENTITY);
        // The objectives' images: 8.8 mm over the centre, 1.3 mm apart.
        assert!(
            (v.camera[2] - 8.8).abs() < 0.05 && (v.camera[0].abs() - 0.64).abs() < 0.02,
            "{:?}",
            v.camera
        );
    }

    #[test]
    fn plane_and_projection_agree() {
        let eye_from_world = DMat4::from_rotation_x(0.1) * DMat4::from_rotation_y(-0.07);
        for (lens, inverter) in EVERY {
            let v = view_uniform(&through(lens, inverter), 0, 1.25, &eye_from_world);
            let (x, y) = (0.4f32, -0.6f32);
            let along = Vec3::from_slice(&v.plane_origin)
                + Vec3::from_slice(&v.plane_x) * x
                + Vec3::from_slice(&v.plane_y) * y;
            let from = Vec3::from_slice(&v.camera);
            for share in [0.8, 1.0, 1.1] {
                let p = from + (along - from) * share;
                let back = Mat4::from_cols_array_2d(&v.clip_from_eye).project_point3(p);
                assert!((back.x - x).abs() < 1e-4 && (back.y - y).abs() < 1e-4, "{lens:?}: {back}");
            }
        }
    }
}
