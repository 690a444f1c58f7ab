//! The camera model shared by the virtual cameras and the tracker: pinhole with Brown–Conrady
//! distortion, as in OpenCV (Brown 1971; coefficients [k1, k2, p1, p2, k3]).

use nalgebra::{Matrix2, Matrix3, Point3, Vector2, Vector3};
use protocol::blobs::{Blob, Colour, DEFAULT_VARIANCE_PX2, WHOLE_FRAME, field_line};

/// Residual of the undistortion at which it has converged, in normalised image units (1e-12 of a
/// focal length is far below any rounding of pixel coordinates).
const UNDISTORT_TOLERANCE: f64 = 1e-13;
const UNDISTORT_ITERATIONS: usize = 50;

/// A camera of the rig, ready for computation.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Id in the rig.
    pub id: u32,
    /// Size of the frame, px.
    pub size_px: [u32; 2],
    /// Focal lengths, px.
    pub focal_px: Vector2<f64>,
    /// Principal point, px of the frame.
    pub centre_px: Vector2<f64>,
    /// [k1, k2, p1, p2, k3].
    pub distortion: [f64; 5],
    /// Rotation `camera_from_world`.
    pub camera_from_world: Matrix3<f64>,
    /// Translation of `camera_from_world`, mm.
    pub translation_mm: Vector3<f64>,
}

impl Camera {
    /// Image of a ball at `centre` (world frame, mm) in a field of `parity`, without noise; the
    /// outline is that of an undistorted ellipse. `None` behind the camera.
    pub fn blob_of_ball(
        &self,
        centre: &Point3<f64>,
        radius_mm: f64,
        colour: Colour,
        parity: u32,
    ) -> Option<Blob> {
        let pixel = self.project(centre)?;
        let radii = self.focal_px * (radius_mm / self.in_camera(centre).z);
        // Lines of a field that is no whole frame lie two lines of the frame apart.
        let squeeze = if parity == WHOLE_FRAME { 1.0 } else { 0.5 };
        Some(Blob {
            x_px: pixel.x,
            y_field_px: field_line(pixel.y, parity),
            area_px: squeeze * std::f64::consts::PI * radii.x * radii.y,
            width_px: 2.0 * radii.x,
            height_px: 2.0 * squeeze * radii.y,
            var_x_px2: DEFAULT_VARIANCE_PX2,
            var_y_px2: DEFAULT_VARIANCE_PX2,
            cov_xy_px2: 0.0,
            colour: colour as u32,
            flags: 0,
        })
    }

    /// A point of the world in the camera frame, mm.
    pub fn in_camera(&self, p_in_world: &Point3<f64>) -> Vector3<f64> {
        self.camera_from_world * p_in_world.coords + self.translation_mm
    }

    /// Centre of projection in the world, mm.
    pub fn centre_in_world(&self) -> Point3<f64> {
        Point3::from(-(self.camera_from_world.transpose() * self.translation_mm))
    }

    /// Image of a point of the world, px of the frame; `None` behind the camera.
    pub fn project(&self, p_in_world: &Point3<f64>) -> Option<Vector2<f64>> {
        let p = self.in_camera(p_in_world);
        (p.z > 1e-6).then(|| self.pixel_from_normalised(Vector2::new(p.x / p.z, p.y / p.z)))
    }

    /// Pixel of an undistorted, normalised image point.
    pub fn pixel_from_normalised(&self, n: Vector2<f64>) -> Vector2<f64> {
        self.focal_px.component_mul(&self.distort(n).0) + self.centre_px
    }

    /// Distorts a normalised image point; also the Jacobian of the distorted by the undistorted
    /// point.
    pub fn distort(&self, n: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let distorted = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (distorted, jacobian)
    }

    /// Undistorted, normalised image point of a pixel, by Newton's method; `None` where it does
    /// not converge (outside the valid range of the distortion).
    pub fn normalised_from_pixel(&self, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
        let target = (pixel - self.centre_px).component_div(&self.focal_px);
        let mut n = target;
        for _ in 0..UNDISTORT_ITERATIONS {
            let (distorted, jacobian) = self.distort(n);
            let error = distorted - target;
            if error.norm() < UNDISTORT_TOLERANCE {
                return Some(n);
            }
            n -= jacobian.try_inverse()? * error;
        }
        let (distorted, _) = self.distort(n);
        ((distorted - target).norm() < 1e-9).then_some(n)
    }

    /// Direction in the world of the ray through a pixel, unit length.
    pub fn ray_in_world(&self, pixel: Vector2<f64>) -> Option<Vector3<f64>> {
        let n = self.normalised_from_pixel(pixel)?;
        Some((self.camera_from_world.transpose() * Vector3::new(n.x, n.y, 1.0)).normalize())
    }

    /// Jacobian of the pixel by the point in the world, px/mm; `None` behind the camera.
    pub fn projection_jacobian(&self, p_in_world: &Point3<f64>) -> Option<nalgebra::Matrix2x3<f64>> {
        let p = self.in_camera(p_in_world);
        if p.z <= 1e-6 {
            return None;
        }
        let n = Vector2::new(p.x / p.z, p.y / p.z);
        let perspective = nalgebra::Matrix2x3::new(1.0 / p.z, 0.0, -n.x / p.z, 0.0, 1.0 / p.z, -n.y / p.z);
        let focal = Matrix2::from_diagonal(&self.focal_px);
        Some(focal * self.distort(n).1 * perspective * self.camera_from_world)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn camera() -> Camera {
        Camera {
            id: 0,
            size_px: [720, 576],
            focal_px: Vector2::new(1600.0, 1748.0),
            centre_px: Vector2::new(363.7, 282.0),
            distortion: [-0.25, 0.1, 0.0005, -0.0003, 0.0],
            camera_from_world: *nalgebra::Rotation3::from_euler_angles(0.8, 0.3, -0.5).matrix(),
            translation_mm: Vector3::new(0.1, -2.0, 80.0),
        }
    }

    proptest! {
        #[test]
        fn undistortion_inverts_distortion(x in -200.0..920.0f64, y in -200.0..776.0f64) {
            let camera = camera();
            let n = camera.normalised_from_pixel(Vector2::new(x, y)).unwrap();
            let back = camera.pixel_from_normalised(n);
            prop_assert!((back - Vector2::new(x, y)).norm() < 1e-8);
        }

        #[test]
        fn jacobian_agrees_with_differences(x in -12.0..12.0f64, y in -12.0..12.0f64, z in -12.0..12.0f64) {
            let camera = camera();
            let p = Point3::new(x, y, z);
            let jacobian = camera.projection_jacobian(&p).unwrap();
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-4;
                let slope = (camera.project(&(p + step)).unwrap() - camera.project(&(p - step)).unwrap()) / 2e-4;
                prop_assert!((slope - jacobian.column(axis)).norm() < 1e-5);
            }
        }
    }
}
