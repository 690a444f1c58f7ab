//! Cameras whose places are known to each other only, laid over where a rig has them.

use calibration::target_problem::{camera_pose, set_camera_pose};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rig::camera::Camera;

/// At this distance a turned camera counts as much as one that was moved, mm.
const ARM_MM: f64 = 80.0;

/// How a camera lies beside where it was expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beside {
    /// Distance of the centres, mm.
    pub mm: f64,
    /// Angle between both, rad.
    pub rad: f64,
}

impl Beside {
    /// One number for both, mm.
    pub fn size_mm(&self) -> f64 {
        self.mm.hypot(ARM_MM * self.rad)
    }
}

fn world_from_camera(camera: &Camera) -> Isometry3<f64> {
    camera_pose(camera).inverse()
}

/// `found` moved as a whole to lie over `expected`, camera by camera: centres and axes by least squares.
pub fn laid_over(found: &[Camera], expected: &[Camera]) -> Vec<Camera> {
    let places = |cameras: &[Camera]| cameras.iter().map(world_from_camera).collect::<Vec<_>>();
    let (own, other) = (places(found), places(expected));
    let mean = |all: &[Isometry3<f64>]| {
        all.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / all.len().max(1) as f64
    };
    let (from, to) = (mean(&own), mean(&other));
    let mut cross = Matrix3::zeros();
    for (a, b) in own.iter().zip(&other) {
        let [r, s] = [a, b].map(|p| *p.rotation.to_rotation_matrix().matrix());
        cross += s * r.transpose() * (ARM_MM * ARM_MM);
        cross += (b.translation.vector - to) * (a.translation.vector - from).transpose();
    }
    let turn = nearest_rotation(&cross);
    let moved = Translation3::from(to - turn * from);
    let whole = Isometry3::from_parts(moved, UnitQuaternion::from_rotation_matrix(&turn));
    let place = |(camera, own): (&Camera, &Isometry3<f64>)| {
        let mut camera = camera.clone();
        set_camera_pose(&mut camera, &(whole * own).inverse());
        camera
    };
    found.iter().zip(&own).map(place).collect()
}

/// The rotation nearest to a matrix (Kabsch 1976).
fn nearest_rotation(cross: &Matrix3<f64>) -> Rotation3<f64> {
    let svd = cross.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    let hand = (u * v).determinant().signum();
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, hand)) * v)
}

/// Each camera beside its expected place.
pub fn beside(found: &[Camera], expected: &[Camera]) -> Vec<Beside> {
    let one = |(a, b): (&Camera, &Camera)| {
        let [p, q] = [a, b].map(world_from_camera);
        Beside {
            mm: (p.translation.vector - q.translation.vector).norm(),
            rad: p.rotation.angle_to(&q.rotation),
        }
    };
    found.iter().zip(expected).map(one).collect()
}

/// The largest deviation of any camera.
pub fn worst_mm(found: &[Camera], expected: &[Camera]) -> f64 {
    beside(found, expected).iter().map(Beside::size_mm).fold(0.0, f64::max)
}

/// Mean distance between two cameras, mm.
pub fn spread_mm(cameras: &[Camera]) -> f64 {
    let centres: Vec<Point3<f64>> = cameras.iter().map(Camera::centre_in_world).collect();
    let pairs =
        centres.iter().enumerate().flat_map(|(i, a)| centres[i + 1..].iter().map(move |b| (a - b).norm()));
    let (sum, n) = pairs.fold((0.0, 0), |(sum, n), d| (sum + d, n + 1));
    sum / f64::from(n.max(1))
}

/// Two cameras that lie where the other one is expected, if exchanging them explains most of the deviation.
pub fn exchanged(found: &[Camera], expected: &[Camera]) -> Option<(usize, usize)> {
    let as_is = worst_mm(&laid_over(found, expected), expected);
    let pairs = (0..found.len()).flat_map(|i| (i + 1..found.len()).map(move |j| (i, j)));
    let swapped = pairs.map(|(i, j)| {
        let mut other = expected.to_vec();
        other.swap(i, j);
        ((i, j), worst_mm(&laid_over(found, &other), &other))
    });
    swapped.min_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, left)| *left < as_is / 3.0).map(|(pair, _)| pair)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig::Rig;

    fn moved(cameras: &[Camera]) -> Vec<Camera> {
        let whole = Isometry3::new(Vector3::new(30.0, -20.0, 55.0), Vector3::new(0.3, -1.2, 0.7));
        let place = |camera: &Camera| {
            let mut camera = camera.clone();
            let pose = camera_pose(&camera) * whole;
            set_camera_pose(&mut camera, &pose);
            camera
        };
        cameras.iter().map(place).collect()
    }

    #[test]
    fn what_was_moved_as_a_whole_lies_over_again() {
        let expected = Rig::load_or_shipped(None).unwrap().cameras();
        let found = moved(&expected);
        assert!(worst_mm(&found, &expected) > 30.0);
        let laid = laid_over(&found, &expected);
        assert!(worst_mm(&laid, &expected) < 1e-9, "{:?}", beside(&laid, &expected));
        assert!((spread_mm(&laid) - spread_mm(&expected)).abs() < 1e-9);
        assert_eq!(exchanged(&found, &expected), None);
    }

    #[test]
    fn cameras_that_were_exchanged_are_named() {
        let expected = Rig::load_or_shipped(None).unwrap().cameras();
        let mut found = moved(&expected);
        found.swap(0, 2);
        assert_eq!(exchanged(&found, &expected), Some((0, 2)));
    }
}
