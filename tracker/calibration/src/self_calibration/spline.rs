//! Motion of a body as a spline: a uniform cubic B-spline of its place and of its rotation vector.

use crate::lens::EXTRINSICS;
use crate::observations::MovingPose;
use nalgebra::{Isometry3, Matrix3, SMatrix, Translation3, UnitQuaternion, Vector3};
use tracker::pose_math::{exp, propagated};

/// Motion of a body over a stretch.
#[derive(Debug, Clone)]
pub struct Path {
    /// The rotation from which rotation vectors count.
    turned: UnitQuaternion<f64>,
    /// Control points: rotation vector (world, rad), place (mm).
    pub points: Vec<[Vector3<f64>; 2]>,
}

/// A body at an instant.
pub struct Moving {
    /// `world_from_body`.
    pub pose: Isometry3<f64>,
    /// Velocity (mm/s) and angular velocity (rad/s).
    pub motion: [Vector3<f64>; 2],
    /// The first control point that counts.
    pub first: usize,
    /// Of four control points.
    pub weights: [f64; 4],
    /// A small turn of the body by its rotation vector.
    pub by_vector: Matrix3<f64>,
}

impl Path {
    /// The path of so many intervals through the nearest of some poses, each carried to the middle of a control point's
    /// reach. Poses come with their instants, s since the path's begin.
    pub fn through(poses: &[(f64, MovingPose)], intervals: usize, interval_s: f64) -> Option<Self> {
        let turned = poses.get(poses.len() / 2)?.1.pose.rotation;
        let point = |at: usize| {
            let t_s = (at as f64 - 1.0) * interval_s;
            let apart = |pose: &(f64, MovingPose)| (t_s - pose.0).abs();
            let (at_s, near) = poses.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
            let pose = propagated(&near.pose, &near.motion, t_s - at_s);
            Some([(pose.rotation * turned.inverse()).scaled_axis(), pose.translation.vector])
        };
        let points: Option<Vec<_>> = (0..intervals + 3).map(point).collect();
        Some(Path { turned, points: points? })
    }

    /// The body at a time after the stretch's start; beyond its ends the last intervals go on.
    pub fn at(&self, t_s: f64, interval_s: f64) -> Moving {
        let along = t_s / interval_s;
        let first = (along.floor().max(0.0) as usize).min(self.points.len() - 4);
        let u = along - first as f64;
        let (weights, slopes) = basis(u);
        let sum = |weights: &[f64; 4], i: usize| {
            (0..4).map(|j| self.points[first + j][i] * weights[j]).sum::<Vector3<f64>>()
        };
        let vector = sum(&weights, 0);
        let by_vector = left_jacobian(&vector);
        let pose = Isometry3::from_parts(Translation3::from(sum(&weights, 1)), exp(vector) * self.turned);
        let motion = [sum(&slopes, 1) / interval_s, by_vector * sum(&slopes, 0) / interval_s];
        Moving { pose, motion, first, weights, by_vector }
    }
}

/// Weights of four control points between the second and the third, and their slopes.
fn basis(u: f64) -> ([f64; 4], [f64; 4]) {
    let (v, u2) = (1.0 - u, u * u);
    let u3 = u2 * u;
    let weights = [v * v * v, 3.0 * u3 - 6.0 * u2 + 4.0, -3.0 * u3 + 3.0 * u2 + 3.0 * u + 1.0, u3];
    let slopes = [-v * v, 3.0 * u2 - 4.0 * u, -3.0 * u2 + 2.0 * u + 1.0, u2];
    (weights.map(|w| w / 6.0), slopes.map(|s| s / 2.0))
}

/// The small turn that a change of a rotation vector makes (the left Jacobian of SO(3)).
fn left_jacobian(vector: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (vector.norm(), vector.cross_matrix());
    let (a, b) = match angle {
        small if small < 1e-4 => (0.5, 1.0 / 6.0),
        _ => ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / angle.powi(3)),
    };
    Matrix3::identity() + cross * a + cross * cross * b
}

/// Derivative by a control point of weight 1: its rotation vector and its place.
pub fn by_control_point(
    by_pose: &SMatrix<f64, 2, EXTRINSICS>,
    by_vector: &Matrix3<f64>,
) -> SMatrix<f64, 2, EXTRINSICS> {
    let mut out = *by_pose;
    let turned = by_pose.fixed_columns::<3>(0) * by_vector;
    out.fixed_columns_mut::<3>(0).copy_from(&turned);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_S: f64 = 0.015;

    /// A body on a steady screw.
    fn steady() -> Path {
        let motion = [Vector3::new(3.0, -2.0, 1.0), Vector3::new(0.4, 0.0, 0.0)];
        let at = |t_s: f64| {
            let pose = Isometry3::new(motion[0] * t_s, motion[1] * t_s);
            (t_s, MovingPose { pose, motion })
        };
        let poses: Vec<_> = (0..8).map(|i| at(0.02 * f64::from(i))).collect();
        Path::through(&poses, 11, INTERVAL_S).unwrap()
    }

    #[test]
    fn a_steady_motion_is_followed_exactly_and_beyond_the_ends() {
        let path = steady();
        for t_s in [-0.004, 0.0, 0.0149, 0.0151, 0.1, 0.164, 0.17] {
            let moving = path.at(t_s, INTERVAL_S);
            assert!((moving.pose.translation.vector - Vector3::new(3.0, -2.0, 1.0) * t_s).norm() < 1e-12);
            assert!((moving.pose.rotation.scaled_axis() - Vector3::new(0.4, 0.0, 0.0) * t_s).norm() < 1e-12);
            assert!((moving.motion[0] - Vector3::new(3.0, -2.0, 1.0)).norm() < 1e-9);
            assert!((moving.motion[1] - Vector3::new(0.4, 0.0, 0.0)).norm() < 1e-9);
        }
    }

    #[test]
    fn velocities_and_slopes_are_those_of_differences() {
        let mut path = steady();
        for (i, point) in path.points.iter_mut().enumerate() {
            let k = i as f64;
            point[0] += Vector3::new((1.3 * k).sin(), (0.7 * k).cos(), (2.1 * k).sin()) * 0.2;
            point[1] += Vector3::new((0.9 * k).cos(), (1.7 * k).sin(), (0.4 * k).cos());
        }
        let (t_s, h) = (0.071, 1e-6);
        let there = path.at(t_s, INTERVAL_S);
        let [before, after] = [-h, h].map(|by| path.at(t_s + by, INTERVAL_S).pose);
        let turning = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
        let speed = (after.translation.vector - before.translation.vector) / (2.0 * h);
        assert!((turning - there.motion[1]).norm() < 1e-5 * turning.norm(), "{turning} {:?}", there.motion);
        assert!((speed - there.motion[0]).norm() < 1e-5 * speed.norm());
        for axis in 0..3 {
            let mut moved = path.clone();
            moved.points[there.first + 1][0][axis] += h;
            let turn = moved.at(t_s, INTERVAL_S).pose.rotation * there.pose.rotation.inverse();
            let expected = there.by_vector.column(axis) * there.weights[1];
            assert!((turn.scaled_axis() / h - expected).norm() < 1e-4);
        }
    }
}
