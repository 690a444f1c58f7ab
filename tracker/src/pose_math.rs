//! Small changes of poses. A change is (shift, rotation vector), both in the world, mm and rad; the
//! names are those of Hertzberg and others, Integrating generic sensor fusion algorithms (2013).

use nalgebra::{Isometry3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// Covariance of the pose: position (world, mm), rotation vector (world, rad).
pub type Matrix6 = SMatrix<f64, 6, 6>;
/// A small change of the pose, in the same order.
pub type Vector6 = SVector<f64, 6>;

/// The rotation of a rotation vector, rad.
pub fn exp(v: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(v)
}

/// `to` ⊟ `from`: the change that leads from one pose to the other.
pub fn box_minus(to: &Isometry3<f64>, from: &Isometry3<f64>) -> Vector6 {
    let shift = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// `pose` ⊞ `delta`.
pub fn box_plus(pose: &Isometry3<f64>, delta: &Vector6) -> Isometry3<f64> {
    let shift: Vector3<f64> = delta.fixed_rows::<3>(0).into();
    let turn: Vector3<f64> = delta.fixed_rows::<3>(3).into();
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::new_normalize((exp(turn) * pose.rotation).into_inner()),
    )
}

/// A pose after `dt_s` seconds of constant velocity (mm/s) and angular velocity (rad/s).
pub fn propagated(pose: &Isometry3<f64>, motion: &[Vector3<f64>; 2], dt_s: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + motion[0] * dt_s),
        exp(motion[1] * dt_s) * pose.rotation,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn box_plus_and_box_minus_are_inverse(d in prop::array::uniform6(-1.0..1.0f64)) {
            let pose = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.3, -0.4, 0.5));
            let delta = Vector6::from(d);
            prop_assert!((box_minus(&box_plus(&pose, &delta), &pose) - delta).norm() < 1e-9);
        }
    }
}
