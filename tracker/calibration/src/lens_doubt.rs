//! How well a lens is known: the standard deviation of the image of a direction, over the whole picture.
//!
//! Single terms say little, because they correlate: k2 and k3 may each be uncertain by more than their value although
//! their sum is known well where points were seen. Elsewhere in the picture it is not, and this is what counts.

use crate::lens::{LENS, project};
use nalgebra::{DMatrix, Matrix3, SMatrix, Vector2, Vector3};
use rig::camera::Camera;

/// Points across and down the picture at which the lens is judged.
const GRID: [u32; 2] = [13, 11];

/// Standard deviation of image points over the picture (root mean square, px) by the covariance of the values of a lens.
/// What a rotation of the camera does as well is not counted. Infinite if the lens folds the picture.
pub fn over_picture_px(camera: &Camera, covariance: &SMatrix<f64, LENS, LENS>) -> f64 {
    let points = GRID[0] * GRID[1];
    let mut by_lens = DMatrix::zeros(2 * points as usize, LENS);
    let mut by_rotation = DMatrix::zeros(2 * points as usize, 3);
    for i in 0..points {
        let share = Vector2::new(
            f64::from(i % GRID[0]) / f64::from(GRID[0] - 1),
            f64::from(i / GRID[0]) / f64::from(GRID[1] - 1),
        );
        let pixel = share.component_mul(&Vector2::from(camera.size_px.map(|n| f64::from(n.max(1) - 1))));
        let Some(n) = camera.normalised_from_pixel(pixel) else { return f64::INFINITY };
        let ray = Vector3::new(n.x, n.y, 1.0);
        let Some(image) = project(camera, &ray) else { return f64::INFINITY };
        let row = 2 * i as usize;
        by_lens.fixed_view_mut::<2, LENS>(row, 0).copy_from(&image.by_lens);
        let turned: Matrix3<f64> = -ray.cross_matrix();
        by_rotation.fixed_view_mut::<2, 3>(row, 0).copy_from(&(image.by_point * turned));
    }
    let Some(inverse) = by_rotation.tr_mul(&by_rotation).try_inverse() else { return f64::INFINITY };
    let kept = &by_lens - &by_rotation * (inverse * by_rotation.tr_mul(&by_lens));
    let variance = (&kept * covariance).component_mul(&kept).sum() / f64::from(points);
    if variance.is_finite() { variance.max(0.0).sqrt() } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::pinhole_camera;

    fn camera() -> Camera {
        let mut camera =
            pinhole_camera(0, [720, 576], Vector2::new(1600.0, 1748.0), Vector2::new(363.7, 282.0));
        camera.distortion = [-0.25, 0.1, 0.0005, -0.0003, 0.0];
        camera
    }

    #[test]
    fn a_lens_is_doubted_where_its_terms_move_the_picture() {
        let with = |term: usize, sigma: f64| {
            let mut covariance = SMatrix::<f64, LENS, LENS>::zeros();
            covariance[(term, term)] = sigma * sigma;
            over_picture_px(&camera(), &covariance)
        };
        assert_eq!(with(8, 0.0), 0.0);
        // 1 % of the focal length: some 2 px across, half a picture's width from the middle on average.
        assert!((1.0..3.0).contains(&with(0, 16.0)), "{}", with(0, 16.0));
        // The principal point moves with a rotation; only the perspective of it remains.
        assert!(with(2, 10.0) < 1.0, "{}", with(2, 10.0));
        assert!(with(8, 60.0) > 1.0, "{}", with(8, 60.0));
        let mut folded = camera();
        folded.distortion = [-5.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(over_picture_px(&folded, &SMatrix::identity()), f64::INFINITY);
    }
}
