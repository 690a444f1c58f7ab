//! The mechanical eye: the shafts turn it, springs on each axis turn it back.
//!
//! Each axis is a damped spring, `θ'' = ω²(load − θ) − 2ζω θ'`, where `load` is the angle at which
//! the shafts' torque and the spring balance. It is integrated on a fixed grid from the start on,
//! so that the angle at an instant does not depend on when it was asked for.

use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// Natural frequency of the eye on its springs, Hz.
const NATURAL_HZ: f64 = 3.0;
/// Damping ratio: swings back with a little overshoot.
const DAMPING: f64 = 0.6;
/// Step of the integration, ns; 1 ms is 1/330 of a swing.
const STEP_NS: u64 = 1_000_000;
/// Newest steps that are kept: three fields, since free-running cameras ask a little out of order
/// and a torn field shows what was before.
const KEPT: usize = 64;

/// Angles about x, y and z, rad, and their speeds, rad/s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Swing {
    angle: Vector3<f64>,
    speed: Vector3<f64>,
}

/// The turning eye.
#[derive(Debug, Clone)]
pub struct EyeSpring {
    /// Steps done; the state after step `n` is in `kept[n % KEPT]`.
    steps: u64,
    kept: [Swing; KEPT],
}

impl EyeSpring {
    /// At rest under the load of the start.
    pub fn new(load_at_start: Vector3<f64>) -> Self {
        Self::at_rest(0, load_at_start)
    }

    /// At rest under the load of `t_ns` after the start. What came before is forgotten.
    pub fn at_rest(t_ns: u64, load: Vector3<f64>) -> Self {
        let rest = Swing { angle: load, speed: Vector3::zeros() };
        EyeSpring { steps: t_ns / STEP_NS, kept: [rest; KEPT] }
    }

    /// Rotation `world_from_eye` at `t_ns` after the start, under `load` (rad about x, y, z, as a
    /// function of seconds). Instants may be asked for in any order; going back more than 60 ms
    /// integrates from the start again.
    pub fn world_from_eye(&mut self, t_ns: u64, load: impl Fn(f64) -> Vector3<f64>) -> UnitQuaternion<f64> {
        let whole = t_ns / STEP_NS;
        let kept = |step: u64| step as usize % KEPT;
        if whole + (KEPT as u64) <= self.steps {
            *self = EyeSpring::new(load(0.0));
        }
        while self.steps < whole + 1 {
            let now = self.kept[kept(self.steps)];
            let next = step(now, load(self.steps as f64 * STEP_NS as f64 * 1e-9));
            self.steps += 1;
            self.kept[kept(self.steps)] = next;
        }
        let share = (t_ns % STEP_NS) as f64 / STEP_NS as f64;
        let [before, after] = [whole, whole + 1].map(|step| self.kept[kept(step)].angle);
        UnitQuaternion::from_scaled_axis(before.lerp(&after, share))
    }
}

/// Semi-implicit Euler.
fn step(swing: Swing, load: Vector3<f64>) -> Swing {
    let (w, dt) = (TAU * NATURAL_HZ, STEP_NS as f64 * 1e-9);
    let acceleration = (load - swing.angle) * (w * w) - swing.speed * (2.0 * DAMPING * w);
    let speed = swing.speed + acceleration * dt;
    Swing { angle: swing.angle + speed * dt, speed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn follows_a_lasting_load_and_springs_back() {
        let load = |t: f64| if t < 2.0 { Vector3::new(0.04, -0.02, 0.01) } else { Vector3::zeros() };
        let mut eye = EyeSpring::new(Vector3::zeros());
        let early = eye.world_from_eye(20_000_000, load).angle();
        let pushed = eye.world_from_eye(1_900_000_000, load).scaled_axis();
        let back = eye.world_from_eye(4_000_000_000, load).angle();
        assert!(early < 0.01, "a spring does not jump: {early}");
        assert!((pushed - Vector3::new(0.04, -0.02, 0.01)).norm() < 1e-4, "{pushed}");
        assert!(back < 1e-4, "{back}");
    }

    #[test]
    fn angle_does_not_depend_on_the_instants_asked_for() {
        let load = |t: f64| Vector3::new(0.05 * libm::sin(9.0 * t), 0.03 * libm::cos(5.0 * t), 0.0);
        let mut often = EyeSpring::new(load(0.0));
        for t in 0..70 {
            often.world_from_eye(t * 10_123_457, load);
        }
        let t = 712_345_678;
        let mut once = EyeSpring::new(load(0.0));
        let angle = once.world_from_eye(t, load);
        assert_eq!(often.world_from_eye(t, load), angle);
        for later in [t + 61_000_000, 2 * t] {
            once.world_from_eye(later, load);
            assert_eq!(once.world_from_eye(t, load), angle, "after {later}");
        }
        once.world_from_eye(2 * t, load);
        assert_eq!(once.world_from_eye(t, load), angle);
    }
}
