//! The optics of the stereo microscope: two channels whose axes meet in the target.

use crate::layout::ViewUniform;
use glam::dcamera::rh::proj::directx::perspective;
use glam::dcamera::rh::view::look_at_mat4;
use glam::{DMat4, DVec3};
use protocol::scene::Microscope;

/// Channels: left, right.
pub const CHANNELS: usize = 2;
/// The round field fills this share of the picture's height.
pub const FIELD_FILL: f64 = 0.98;
/// Width of the field's soft border, share of its radius.
const BORDER: f64 = 0.03;
/// What lies nearer to the objective than the target by more than this is not drawn, mm.
const NEAR_SIDE_MM: f64 = 60.0;
/// What lies beyond the target by more than this is not drawn, mm.
const FAR_SIDE_MM: f64 = 30.0;

/// Up in the picture, world frame: the surgeon sits at +y.
const UP_IN_WORLD: DVec3 = DVec3::NEG_Y;
/// Right in the picture, world frame.
const RIGHT_IN_WORLD: DVec3 = DVec3::NEG_X;

/// Objective of `channel` (0 left, 1 right) in the world, mm.
pub fn objective_in_world(microscope: &Microscope, channel: usize) -> DVec3 {
    let side = if channel == 0 { -0.5 } else { 0.5 };
    let height = DVec3::Z * microscope.working_distance_mm.max(1.0);
    DVec3::from(microscope.target_in_world_mm) + height + RIGHT_IN_WORLD * (side * microscope.stereo_base_mm)
}

/// The view of `channel` on a picture of `aspect` (width by height).
pub fn view(microscope: &Microscope, channel: usize, aspect: f64, eye_from_world: &DMat4) -> ViewUniform {
    let target = DVec3::from(microscope.target_in_world_mm);
    let objective = objective_in_world(microscope, channel);
    let forward = (target - objective).normalize();
    let right = forward.cross(UP_IN_WORLD).normalize();
    let up = right.cross(forward);
    let distance = objective.distance(target);
    let half_height = 0.5 * microscope.field_mm.max(0.1) / FIELD_FILL;

    let fov_y = 2.0 * (half_height / distance).atan();
    let near = (distance - NEAR_SIDE_MM).max(1.0);
    let camera_from_world = look_at_mat4(objective, target, UP_IN_WORLD);
    let clip_from_camera = perspective(fov_y, aspect, near, distance + FAR_SIDE_MM);
    let world_from_eye = eye_from_world.inverse();

    let point = |p: DVec3| eye_from_world.transform_point3(p).extend(0.0).as_vec4().to_array();
    let vector = |v: DVec3| eye_from_world.transform_vector3(v).extend(0.0).as_vec4().to_array();
    let inner = (1.0 - BORDER) * (1.0 - BORDER);
    let field = [aspect / FIELD_FILL, 1.0 / FIELD_FILL, inner, 0.0];
    ViewUniform {
        clip_from_eye: (clip_from_camera * camera_from_world * world_from_eye).as_mat4().to_cols_array_2d(),
        camera: point(objective),
        plane_origin: point(target),
        plane_x: vector(right * (half_height * aspect)),
        plane_y: vector(up * half_height),
        field: field.map(|x| x as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat4, Vec3};

    fn microscope() -> Microscope {
        Microscope {
            target_in_world_mm: [0.0, 0.0, -11.0],
            working_distance_mm: 200.0,
            stereo_base_mm: 22.0,
            field_mm: 16.0,
            focus_mm: 0.0,
        }
    }

    fn ndc(channel: usize, p: [f32; 3]) -> Vec3 {
        let v = view(&microscope(), channel, 1.25, &DMat4::IDENTITY);
        Mat4::from_cols_array_2d(&v.clip_from_eye).project_point3(Vec3::from(p))
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

    #[test]
    fn plane_and_projection_agree() {
        let eye_from_world = DMat4::from_rotation_x(0.1) * DMat4::from_rotation_y(-0.07);
        let v = view(&microscope(), 0, 1.25, &eye_from_world);
        let (x, y) = (0.4f32, -0.6f32);
        let p = Vec3::from_slice(&v.plane_origin)
            + Vec3::from_slice(&v.plane_x) * x
            + Vec3::from_slice(&v.plane_y) * y;
        let back = Mat4::from_cols_array_2d(&v.clip_from_eye).project_point3(p);
        assert!((back.x - x).abs() < 1e-4 && (back.y - y).abs() < 1e-4, "{back}");
    }
}
