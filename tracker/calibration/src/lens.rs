//! Projection of a point of the camera frame with derivatives by the point and by the lens.

use nalgebra::{
    Isometry3, Matrix2, Matrix2x3, Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector2, Vector3,
};
use rig::camera::Camera;

/// Number of values of a lens.
pub const LENS: usize = 9;
/// Their names, in order, as in a rig file.
pub const LENS_NAMES: [&str; LENS] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];
/// Index of the first of its terms of distortion.
pub const DISTORTION: usize = 4;
/// Values of a camera's place: rotation (rad), translation (mm).
pub const EXTRINSICS: usize = 6;

/// A point nearer than this (in the unit of the points) to the plane of the lens has no image.
const MIN_DEPTH: f64 = 1e-9;

/// An image point and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// px.
    pub pixel: Vector2<f64>,
    /// By the point in the camera frame, px per unit.
    pub by_point: Matrix2x3<f64>,
    /// By the nine values of the lens.
    pub by_lens: SMatrix<f64, 2, LENS>,
}

/// Projects a point of the camera frame; `None` behind the camera.
pub fn project(camera: &Camera, p_in_camera: &Vector3<f64>) -> Option<Projection> {
    let depth = p_in_camera.z;
    if depth.is_nan() || depth <= MIN_DEPTH {
        return None;
    }
    let n = Vector2::new(p_in_camera.x / depth, p_in_camera.y / depth);
    let (distorted, slope) = camera.distort(n);
    let focal = camera.focal_px;
    let perspective = Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / depth;
    let r2 = n.norm_squared();
    let mut by_lens = SMatrix::<f64, 2, LENS>::zeros();
    by_lens[(0, 0)] = distorted.x;
    by_lens[(1, 1)] = distorted.y;
    by_lens[(0, 2)] = 1.0;
    by_lens[(1, 3)] = 1.0;
    let by_distortion = [
        n * r2,
        n * (r2 * r2),
        Vector2::new(2.0 * n.x * n.y, r2 + 2.0 * n.y * n.y),
        Vector2::new(r2 + 2.0 * n.x * n.x, 2.0 * n.x * n.y),
        n * (r2 * r2 * r2),
    ];
    for (i, column) in by_distortion.iter().enumerate() {
        by_lens.set_column(4 + i, &focal.component_mul(column));
    }
    Some(Projection {
        pixel: focal.component_mul(&distorted) + camera.centre_px,
        by_point: Matrix2::from_diagonal(&focal) * slope * perspective,
        by_lens,
    })
}

/// The values of a lens, in the order of [`LENS_NAMES`].
pub fn lens_of(camera: &Camera) -> [f64; LENS] {
    let [k1, k2, p1, p2, k3] = camera.distortion;
    let (f, c) = (camera.focal_px, camera.centre_px);
    [f.x, f.y, c.x, c.y, k1, k2, p1, p2, k3]
}

/// Sets the values of a lens.
pub fn set_lens(camera: &mut Camera, lens: &[f64; LENS]) {
    let [fx, fy, cx, cy, distortion @ ..] = *lens;
    (camera.focal_px, camera.centre_px) = (Vector2::new(fx, fy), Vector2::new(cx, cy));
    camera.distortion = distortion;
}

/// Turns and shifts a camera's place: `R ← exp(ω)·R`, `t ← t + τ`, with (ω, τ) = `step`.
pub fn move_extrinsics(camera: &mut Camera, step: &SMatrix<f64, EXTRINSICS, 1>) {
    let turned = Rotation3::new(step.fixed_rows::<3>(0).into_owned()).into_inner() * camera.camera_from_world;
    let mut turned = Rotation3::from_matrix_unchecked(turned);
    turned.renormalize();
    camera.camera_from_world = turned.into_inner();
    camera.translation_mm += step.fixed_rows::<3>(3);
}

/// Derivative of a point in the camera frame by the camera's place, for [`move_extrinsics`].
pub fn by_extrinsics(camera: &Camera, p_in_camera: &Vector3<f64>) -> SMatrix<f64, 3, EXTRINSICS> {
    let arm = p_in_camera - camera.translation_mm;
    let mut out = SMatrix::<f64, 3, EXTRINSICS>::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&-arm.cross_matrix());
    out.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    out
}

/// Derivative of the image of a point of a body by the body's pose, for [`move_pose`]: `by_world`
/// is that by the point in the world, `arm` leads from the body's origin to the point.
pub fn by_pose(by_world: &Matrix2x3<f64>, arm: &Vector3<f64>) -> SMatrix<f64, 2, EXTRINSICS> {
    let mut out = SMatrix::<f64, 2, EXTRINSICS>::zeros();
    out.fixed_columns_mut::<3>(0).copy_from(&-(by_world * arm.cross_matrix()));
    out.fixed_columns_mut::<3>(3).copy_from(by_world);
    out
}

/// Turns a body about its origin by the first three values of `step` (rad, world), and shifts it by
/// the other three if there are any (mm).
pub fn move_pose(pose: &mut Isometry3<f64>, step: &[f64]) {
    pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&step[..3])) * pose.rotation;
    if let [_, _, _, x, y, z] = *step {
        pose.translation.vector += Vector3::new(x, y, z);
    }
}

/// A camera at the origin with a lens without distortion, for a first guess.
pub fn pinhole_camera(id: u32, size_px: [u32; 2], focal_px: Vector2<f64>, centre_px: Vector2<f64>) -> Camera {
    Camera {
        id,
        size_px,
        focal_px,
        centre_px,
        distortion: [0.0; 5],
        camera_from_world: Matrix3::identity(),
        translation_mm: Vector3::zeros(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn camera() -> Camera {
        let mut camera =
            pinhole_camera(0, [720, 576], Vector2::new(1600.0, 1748.0), Vector2::new(363.7, 282.0));
        camera.distortion = [-0.25, 0.1, 0.0005, -0.0003, 0.02];
        camera.translation_mm = Vector3::new(0.1, -2.0, 80.0);
        camera.camera_from_world = *Rotation3::from_euler_angles(0.8, 0.3, -0.5).matrix();
        camera
    }

    proptest! {
        #[test]
        fn derivatives_agree_with_differences(p in prop::array::uniform3(-12.0..12.0f64)) {
            let camera = camera();
            let world = nalgebra::Point3::from(p);
            let at = project(&camera, &camera.in_camera(&world)).unwrap();
            prop_assert!((at.pixel - camera.project(&world).unwrap()).norm() < 1e-9);
            for i in 0..LENS {
                let differ = |h: f64| {
                    let (mut moved, mut lens) = (camera.clone(), lens_of(&camera));
                    lens[i] += h;
                    set_lens(&mut moved, &lens);
                    moved.project(&world).unwrap()
                };
                let slope = (differ(1e-4) - differ(-1e-4)) / 2e-4;
                prop_assert!((slope - at.by_lens.column(i)).norm() < 1e-5, "{}", LENS_NAMES[i]);
            }
            let by_extrinsics = at.by_point * by_extrinsics(&camera, &camera.in_camera(&world));
            for i in 0..EXTRINSICS {
                let differ = |h: f64| {
                    let (mut moved, mut step) = (camera.clone(), SMatrix::<f64, EXTRINSICS, 1>::zeros());
                    step[i] = h;
                    move_extrinsics(&mut moved, &step);
                    moved.project(&world).unwrap()
                };
                let slope = (differ(1e-5) - differ(-1e-5)) / 2e-5;
                prop_assert!((slope - by_extrinsics.column(i)).norm() < 2e-4 * slope.norm().max(1.0));
            }
        }
    }

    #[test]
    fn nothing_behind_a_camera_has_an_image() {
        assert_eq!(project(&camera(), &Vector3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(project(&camera(), &Vector3::new(0.0, 0.0, f64::NAN)), None);
    }
}
