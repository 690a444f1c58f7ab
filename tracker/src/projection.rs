//! Projection of a marker into a camera: its centre, its size, and their derivatives by the pose.

use crate::rig_model::{Marker, RigModel};
use nalgebra::{Isometry3, Matrix2, Matrix2x3, Matrix3, Point3, Rotation3, SMatrix, Unit, Vector2, Vector3};
use rig::camera::Camera;

/// The image of a marker, as predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerImage {
    /// Centre, px of the frame.
    pub pixel: Vector2<f64>,
    /// Jacobian of the centre by the point in the world, px/mm.
    pub jacobian: Matrix2x3<f64>,
    /// The visible centre in the world, mm.
    pub point: Point3<f64>,
    /// Radius along a line, px.
    pub radius_px: f64,
    /// Area, px of the field.
    pub area_px: f64,
}

/// Distance of the visible half of a band from the shaft's axis, in radii: the mean of cos over a
/// half circle seen from the side.
const BAND_SHIFT: f64 = std::f64::consts::FRAC_PI_4;

/// Least depth, mm; a nearer point cannot be in focus.
const MIN_DEPTH_MM: f64 = 1.0;

/// A pose with its rotation as a matrix, for the transformation of many points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseMatrix {
    /// Rotation `world_from_body`.
    pub rotation: Matrix3<f64>,
    /// Origin of the body in the world, mm.
    pub origin: Point3<f64>,
}

impl From<&Isometry3<f64>> for PoseMatrix {
    fn from(world_from_body: &Isometry3<f64>) -> Self {
        PoseMatrix {
            rotation: *world_from_body.rotation.to_rotation_matrix().matrix(),
            origin: Point3::from(world_from_body.translation.vector),
        }
    }
}

/// Projects a marker of a body at `pose`; `None` behind the camera.
pub fn project_marker(marker: &Marker, pose: &PoseMatrix, camera: &Camera) -> Option<MarkerImage> {
    let mut point = pose.origin + pose.rotation * marker.position.coords;
    if marker.band {
        let axis: Vector3<f64> = pose.rotation.column(2).into();
        let towards = camera.centre_in_world() - point;
        let across = towards - axis * towards.dot(&axis);
        if let Some(across) = Unit::try_new(across, 1e-9) {
            point += across.into_inner() * (BAND_SHIFT * marker.radius);
        }
    }
    let PointImage { pixel, jacobian, depth_mm } = project_point(&point, camera)?;
    let radii = camera.focal_px * (marker.radius / depth_mm);
    Some(MarkerImage {
        pixel,
        jacobian,
        point,
        radius_px: radii.x,
        area_px: 0.5 * std::f64::consts::PI * radii.x * radii.y,
    })
}

/// The image of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointImage {
    /// Pixel of the frame.
    pub pixel: Vector2<f64>,
    /// Jacobian of the pixel by the point in the world, px/mm.
    pub jacobian: Matrix2x3<f64>,
    /// Depth of the point in the camera's frame, mm.
    pub depth_mm: f64,
}

/// Projects a point of the world; `None` behind the camera.
pub fn project_point(point: &Point3<f64>, camera: &Camera) -> Option<PointImage> {
    let p = camera.in_camera(point);
    let depth_mm = p.z;
    if depth_mm <= MIN_DEPTH_MM {
        return None;
    }
    // Projected and differentiated together: the distortion is the expensive part.
    let n = Vector2::new(p.x / depth_mm, p.y / depth_mm);
    let (distorted, slope) = camera.distort(n);
    let perspective = Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / depth_mm;
    let jacobian = Matrix2::from_diagonal(&camera.focal_px) * slope * perspective * camera.camera_from_world;
    let pixel = camera.focal_px.component_mul(&distorted) + camera.centre_px;
    Some(PointImage { pixel, jacobian, depth_mm })
}

/// Jacobian of a pixel by a small turn (rad) and shift (mm) of its camera, both in the camera's frame.
/// `by_point` is the Jacobian by `point` in the world.
pub fn camera_jacobian(
    camera: &Camera,
    by_point: &Matrix2x3<f64>,
    point: &Point3<f64>,
) -> SMatrix<f64, 2, 6> {
    let by_camera_point: Matrix2x3<f64> = by_point * camera.camera_from_world.transpose();
    let turning = -(by_camera_point * camera.in_camera(point).cross_matrix());
    let mut jacobian = SMatrix::<f64, 2, 6>::zeros();
    jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&turning);
    jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_camera_point);
    jacobian
}

/// A camera after a turn (rotation vector, rad) and a shift (mm) in its own frame.
pub fn moved_camera(camera: &Camera, turn: Vector3<f64>, shift_mm: Vector3<f64>) -> Camera {
    let rotation = Rotation3::new(turn);
    Camera {
        camera_from_world: rotation.matrix() * camera.camera_from_world,
        translation_mm: rotation * camera.translation_mm + shift_mm,
        ..camera.clone()
    }
}

/// True if a marker of a body at `pose` is in the frames of at least two of the `cameras` (a set of
/// ids).
pub fn in_view_of_two(rig: &RigModel, marker: &Marker, pose: &PoseMatrix, cameras: u32) -> bool {
    let inside = |camera: &&Camera| {
        let [w, h] = camera.size_px.map(f64::from);
        let image = project_marker(marker, pose, camera);
        image.is_some_and(|i| (0.0..w).contains(&i.pixel.x) && (0.0..h).contains(&i.pixel.y))
    };
    let chosen = rig.cameras.iter().flatten().filter(|c| cameras & (1 << c.id) != 0);
    chosen.filter(inside).count() >= 2
}

/// Jacobian of an image's centre by the pose (position, rotation vector in the world), px per mm
/// and rad.
pub fn pose_jacobian(image: &MarkerImage, pose: &PoseMatrix) -> SMatrix<f64, 2, 6> {
    let arm = image.point - pose.origin;
    let by_rotation: Matrix2x3<f64> = -(image.jacobian * arm.cross_matrix());
    let mut jacobian = SMatrix::<f64, 2, 6>::zeros();
    jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&image.jacobian);
    jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_rotation);
    jacobian
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rig::Rig;

    proptest! {
        #[test]
        fn images_agree_with_the_camera_model(p in prop::array::uniform3(-12.0..12.0f64)) {
            let rig = RigModel::new(&Rig::load_or_shipped(None).unwrap());
            let marker = Marker { position: Point3::origin(), radius: 0.5, colour: 1, band: false };
            for camera in rig.cameras.iter().flatten() {
                let point = Point3::from(Vector3::from(p));
                let pose = PoseMatrix { rotation: Matrix3::identity(), origin: point };
                let image = project_marker(&marker, &pose, camera).unwrap();
                prop_assert!((image.pixel - camera.project(&point).unwrap()).norm() < 1e-9);
                prop_assert!((image.jacobian - camera.projection_jacobian(&point).unwrap()).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn a_band_is_seen_before_its_axis() {
        let rig = RigModel::new(&Rig::load_or_shipped(None).unwrap());
        let camera = rig.cameras[0].as_ref().unwrap();
        let marker = Marker { position: Point3::new(0.0, 0.0, 2.0), radius: 0.4, colour: 1, band: true };
        let image = project_marker(&marker, &PoseMatrix::from(&Isometry3::identity()), camera).unwrap();
        let before = image.point - Point3::new(0.0, 0.0, 2.0);
        assert!(before.z.abs() < 1e-12 && (before.norm() - 0.1 * std::f64::consts::PI).abs() < 1e-12);
        assert!(before.dot(&(camera.centre_in_world() - Point3::new(0.0, 0.0, 2.0))) > 0.0);
    }
}
