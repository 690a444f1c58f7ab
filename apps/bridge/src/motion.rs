//! Velocities from poses that come one after the other. Pure.

use nalgebra::{Isometry3, Vector3};

/// Longest time between two poses over which a velocity is measured, s; after a longer one it begins at rest.
const LONGEST_S: f64 = 0.25;
/// Shortest, s.
const SHORTEST_S: f64 = 1e-4;

/// An α–β filter of position and rotation: the velocity follows differences as fast as noise and the accelerations
/// of a hand ask for. Gains by the tracking index of Kalata (1984, IEEE Trans. AES 20:174), which are those of the
/// stationary Kalman filter.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    /// Where it was measured last.
    last: Isometry3<f64>,
    /// Where the filter had it.
    filtered: Isometry3<f64>,
    /// In the world, mm/s and rad/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Angular velocity in the world, rad/s.
    pub angular_rad_s: Vector3<f64>,
}

/// Gains (α, β) for measurements of standard deviation `noise`, `dt_s` apart, with accelerations of standard
/// deviation `acceleration`.
fn gains(noise: f64, acceleration: f64, dt_s: f64) -> [f64; 2] {
    let index = acceleration * dt_s * dt_s / noise;
    let r = (4.0 + index - (8.0 * index + index * index).sqrt()) / 4.0;
    let alpha = 1.0 - r * r;
    [alpha, 2.0 * (2.0 - alpha) - 4.0 * (1.0 - alpha).sqrt()]
}

impl Motion {
    /// At rest.
    pub fn at(world_from_body: Isometry3<f64>) -> Self {
        let zero = Vector3::zeros();
        Motion { last: world_from_body, filtered: world_from_body, velocity_mm_s: zero, angular_rad_s: zero }
    }

    /// Takes the next pose, `dt_s` after the last.
    pub fn note(
        &mut self,
        world_from_body: Isometry3<f64>,
        dt_s: f64,
        noise: [f64; 2],
        acceleration: [f64; 2],
    ) {
        if !(SHORTEST_S..=LONGEST_S).contains(&dt_s) {
            *self = Motion::at(world_from_body);
            return;
        }
        let [alpha, beta] = gains(noise[0], acceleration[0], dt_s);
        let expected = self.filtered.translation.vector + self.velocity_mm_s * dt_s;
        let off = world_from_body.translation.vector - expected;
        self.filtered.translation.vector = expected + off * alpha;
        self.velocity_mm_s += off * (beta / dt_s);

        let [alpha, beta] = gains(noise[1], acceleration[1], dt_s);
        let turned =
            nalgebra::UnitQuaternion::from_scaled_axis(self.angular_rad_s * dt_s) * self.filtered.rotation;
        let off = (world_from_body.rotation * turned.inverse()).scaled_axis();
        self.filtered.rotation = nalgebra::UnitQuaternion::from_scaled_axis(off * alpha) * turned;
        self.filtered.rotation.renormalize();
        self.angular_rad_s += off * (beta / dt_s);
        self.last = world_from_body;
    }

    /// Where it was measured last.
    pub fn last(&self) -> Isometry3<f64> {
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn gains_are_those_of_the_published_table() {
        // Kalata 1984: without movement nothing is learnt, with much everything is.
        let [alpha, beta] = gains(1.0, 1e-9, 0.01);
        assert!(alpha < 1e-4 && beta < 1e-8);
        let [alpha, beta] = gains(1.0, 1e12, 1.0);
        assert!((alpha - 1.0).abs() < 1e-6 && (beta - 2.0).abs() < 1e-3);
        // Index 1: r = (5 − 3) / 4.
        let [alpha, beta] = gains(1.0, 1.0, 1.0);
        assert!((alpha - 0.75).abs() < 1e-12 && (beta - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_steady_movement_is_learnt_and_a_gap_forgets_it() {
        let at = |t: f64| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.5 * t, 0.0));
            Isometry3::from_parts(Vector3::new(3.0 * t, 0.0, -2.0 * t).into(), turn)
        };
        let mut motion = Motion::at(at(0.0));
        for i in 1..400 {
            motion.note(at(f64::from(i) * 0.02), 0.02, [0.05, 0.002], [100.0, 5.0]);
        }
        assert!((motion.velocity_mm_s - Vector3::new(3.0, 0.0, -2.0)).norm() < 1e-6);
        assert!((motion.angular_rad_s - Vector3::new(0.0, 0.5, 0.0)).norm() < 1e-6);
        motion.note(at(9.0), 1.0, [0.05, 0.002], [100.0, 5.0]);
        assert_eq!((motion.velocity_mm_s, motion.last()), (Vector3::zeros(), at(9.0)));
    }

    #[test]
    fn a_million_noisy_poses_leave_it_bounded() {
        let mut random = protocol::random::Random::from_seed(7);
        let mut motion = Motion::at(Isometry3::identity());
        let mut largest: f64 = 0.0;
        for _ in 0..1_000_000 {
            let mut noise = |sigma: f64| Vector3::from_fn(|_, _| sigma * random.normal());
            let pose = Isometry3::new(noise(0.1), noise(0.002));
            motion.note(pose, 0.005, [0.1, 0.002], [100.0, 5.0]);
            largest = largest.max(motion.velocity_mm_s.norm());
        }
        assert!((motion.filtered.rotation.norm() - 1.0).abs() < 1e-9);
        assert!(largest < 20.0, "{largest} mm/s at rest");
    }
}
