//! Instruments between two poses. A step's substeps see the tip on its way, so that a fast one
//! cannot jump through a membrane; after a loss, a jump or a pause there is no way, and nothing is
//! swept.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// The way of a body over a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sweep {
    /// Pose at the last exposure.
    pub from: Isometry3<f64>,
    /// Pose at this exposure.
    pub to: Isometry3<f64>,
}

impl Sweep {
    /// A body that is only at the end of its way.
    pub fn at(pose: Isometry3<f64>) -> Self {
        Sweep { from: pose, to: pose }
    }

    /// The pose at share `s` of the way, 0 to 1: straight for the position, along the shortest
    /// turn.
    pub fn pose(&self, s: f64) -> Isometry3<f64> {
        let (p, q) = (self.from.translation.vector, self.to.translation.vector);
        let position = p + (q - p) * s;
        Isometry3::from_parts(Translation3::from(position), slerp(&self.from.rotation, &self.to.rotation, s))
    }

    /// Length of the tip's way, mm.
    pub fn length_mm(&self) -> f64 {
        (self.to.translation.vector - self.from.translation.vector).norm()
    }
}

/// Turns below this angle (rad) are interpolated linearly: the error is below 1e-13.
const LINEAR_BELOW_RAD: f64 = 1e-4;

/// Spherical interpolation (Shoemake 1985), with `libm` and so the same on every processor.
pub fn slerp(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, s: f64) -> UnitQuaternion<f64> {
    let (a, mut b) = (*a.quaternion(), *b.quaternion());
    let mut dot = a.coords.dot(&b.coords);
    if dot < 0.0 {
        (b, dot) = (-b, -dot);
    }
    let angle = libm::acos(if dot < 1.0 { dot } else { 1.0 });
    let (wa, wb) = if angle < LINEAR_BELOW_RAD {
        (1.0 - s, s)
    } else {
        let sin = libm::sin(angle);
        (libm::sin((1.0 - s) * angle) / sin, libm::sin(s * angle) / sin)
    };
    let mixed = a.coords * wa + b.coords * wb;
    UnitQuaternion::from_quaternion(Quaternion::from(mixed))
}

/// Share of the way at the end of substep `k` (from 1): the substeps lag behind the last exposure
/// by `remainder_ns`, and `advance_ns` lies between the two exposures.
pub fn share(k: u64, substep_ns: u64, remainder_ns: u64, advance_ns: u64) -> f64 {
    let since = (k * substep_ns).saturating_sub(remainder_ns);
    if advance_ns == 0 { 1.0 } else { (since as f64 / advance_ns as f64).min(1.0) }
}

/// Velocity between two positions, mm/s.
pub fn velocity(from_mm: &Vector3<f64>, to_mm: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
    (to_mm - from_mm) / dt_s
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn half_of_a_quarter_turn_is_an_eighth() {
        let a = UnitQuaternion::identity();
        let b = UnitQuaternion::from_euler_angles(0.0, 0.0, 1.0);
        let half = slerp(&a, &b, 0.5);
        assert!(half.angle_to(&UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5)) < 1e-12);
    }

    #[test]
    fn shares_begin_after_the_remainder_and_end_at_the_exposure() {
        assert_eq!(share(20, 1_000_000, 0, 20_000_000), 1.0);
        assert_eq!(share(1, 1_000_000, 400_000, 20_000_000), 0.03);
        assert_eq!(share(1, 1_000_000, 0, 0), 1.0);
    }

    proptest! {
        #[test]
        fn the_way_is_constant_in_angle(x in -3.0f64..3.0, y in -1.0f64..1.0, s in 0.0f64..1.0) {
            let a = UnitQuaternion::from_euler_angles(x, y, 0.1);
            let b = UnitQuaternion::from_euler_angles(y, 0.3, x);
            let m = slerp(&a, &b, s);
            prop_assert!((m.norm() - 1.0).abs() < 1e-12);
            prop_assert!((a.angle_to(&m) - s * a.angle_to(&b)).abs() < 1e-6);
        }
    }
}
