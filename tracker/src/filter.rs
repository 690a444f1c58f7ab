//! How a body moves: a Kalman filter on position and rotation with a Singer acceleration each.
//!
//! Per axis the chain (x, v, a) obeys x' = v, v' = a, a' = −a/τ + noise of standard deviation σ
//! (Singer 1970, the model of `protocol::predict`); the rotation does the same with (θ, ω, α), θ
//! being the error of the rotation as a vector in the world, R = exp(θ)·R̂. A measurement is a
//! pose with its 6×6 covariance *after* the prior went in (see `fit`), so that the rest of the
//! state follows by its regression on the pose: x_r += K·δ, K = P_rp·P_pp⁻¹.

use crate::constants as k;
use nalgebra::{Isometry3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// Covariance of the pose: position (world, mm), rotation vector (world, rad).
pub type Matrix6 = SMatrix<f64, 6, 6>;
/// A small change of the pose, in the same order.
pub type Vector6 = SVector<f64, 6>;
type Matrix18 = SMatrix<f64, 18, 18>;

/// First row of position, velocity, acceleration; then of the rotation's chain.
const CHAINS: [usize; 2] = [0, 9];

/// A Singer acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Singer {
    /// Standard deviation of the acceleration, mm/s² or rad/s².
    pub sigma: f64,
    /// Time constant, s.
    pub tau_s: f64,
}

/// Transition of one chain over a time: x += dt·v + h·a, v += g·a, a *= e.
pub(crate) struct Transition {
    pub(crate) dt: f64,
    pub(crate) g: f64,
    pub(crate) h: f64,
    pub(crate) e: f64,
}

impl Singer {
    pub(crate) fn transition(&self, dt: f64) -> Transition {
        let e = libm::exp(-dt / self.tau_s);
        let g = self.tau_s * (1.0 - e);
        Transition { dt, g, h: self.tau_s * (dt - g), e }
    }

    /// Process noise (q11, q12, q13, q22, q23, q33) gathered in `dt`. Below a twentieth of τ the
    /// leading terms are used, where the closed form cancels.
    pub(crate) fn noise(&self, dt: f64) -> [f64; 6] {
        let (s2, b) = (self.sigma * self.sigma, 1.0 / self.tau_s);
        let t = b * dt;
        if t < 0.05 {
            let q = 2.0 * b * s2 * dt;
            let d2 = dt * dt;
            return [q * d2 * d2 / 20.0, q * d2 * dt / 8.0, q * d2 / 6.0, q * d2 / 3.0, q * dt / 2.0, q];
        }
        let (e1, e2) = (libm::exp(-t), libm::exp(-2.0 * t));
        let q11 = 1.0 - e2 + 2.0 * t + 2.0 * t * t * t / 3.0 - 2.0 * t * t - 4.0 * t * e1;
        let q12 = e2 + 1.0 - 2.0 * e1 + 2.0 * t * e1 - 2.0 * t + t * t;
        let q13 = 1.0 - e2 - 2.0 * t * e1;
        let q22 = 4.0 * e1 - 3.0 - e2 + 2.0 * t;
        let q23 = e2 + 1.0 - 2.0 * e1;
        let q33 = 1.0 - e2;
        let (b2, b3) = (b * b, b * b * b);
        [q11 * s2 / (b2 * b2), q12 * s2 / b3, q13 * s2 / b2, q22 * s2 / b2, q23 * s2 / b, q33 * s2]
    }
}

/// State of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    /// `world_from_body`.
    pub world_from_body: Isometry3<f64>,
    /// mm/s, world.
    pub velocity: Vector3<f64>,
    /// mm/s², world.
    pub acceleration: Vector3<f64>,
    /// rad/s, world.
    pub angular_velocity: Vector3<f64>,
    /// rad/s², world.
    pub angular_acceleration: Vector3<f64>,
    /// Models of position and rotation.
    pub models: [Singer; 2],
    /// Instant of the state, ns.
    pub time_ns: u64,
    /// Factor on the models' accelerations: above 1 after a surprise.
    boost: f64,
    covariance: Matrix18,
}

/// Standard deviations of velocity, acceleration, angular velocity and angular acceleration.
pub type StartSigmas = [f64; 4];

impl Filter {
    /// A body just found.
    pub fn new(
        pose: Isometry3<f64>,
        pose_covariance: &Matrix6,
        sigmas: StartSigmas,
        models: [Singer; 2],
        time_ns: u64,
    ) -> Self {
        let mut covariance = Matrix18::zeros();
        for (row, sigma) in [3, 6, 12, 15].into_iter().zip(sigmas) {
            for axis in row..row + 3 {
                covariance[(axis, axis)] = sigma * sigma;
            }
        }
        let zero = Vector3::zeros();
        let mut filter = Filter {
            world_from_body: pose,
            velocity: zero,
            acceleration: zero,
            angular_velocity: zero,
            angular_acceleration: zero,
            models,
            time_ns,
            boost: 1.0,
            covariance,
        };
        filter.put_pose_covariance(pose_covariance);
        filter
    }

    /// Covariance of the pose.
    pub fn pose_covariance(&self) -> Matrix6 {
        let p = &self.covariance;
        Matrix6::from_fn(|r, c| p[(pose_row(r), pose_row(c))])
    }

    fn put_pose_covariance(&mut self, m: &Matrix6) {
        for r in 0..6 {
            for c in 0..6 {
                self.covariance[(pose_row(r), pose_row(c))] = 0.5 * (m[(r, c)] + m[(c, r)]);
            }
        }
    }

    /// The pose `dt` seconds from the state's instant (either way), by the mean motion alone.
    pub fn pose_after(&self, dt: f64) -> Isometry3<f64> {
        let [tip, turn] = self.models.map(|m| m.transition(dt));
        let shift = self.velocity * dt + self.acceleration * tip.h;
        let angle = self.angular_velocity * dt + self.angular_acceleration * turn.h;
        let moved = self.world_from_body.translation.vector + shift;
        let rotation = exp(angle) * self.world_from_body.rotation;
        Isometry3::from_parts(Translation3::from(moved), rotation)
    }

    /// Carries the state to `time_ns`; an earlier instant changes nothing.
    pub fn advance(&mut self, time_ns: u64) {
        let dt = time_ns.saturating_sub(self.time_ns) as f64 * 1e-9;
        if dt <= 0.0 {
            return;
        }
        self.world_from_body = self.pose_after(dt);
        let [tip, turn] = self.models.map(|m| m.transition(dt));
        self.velocity += self.acceleration * tip.g;
        self.acceleration *= tip.e;
        self.angular_velocity += self.angular_acceleration * turn.g;
        self.angular_acceleration *= turn.e;
        for (chain, transition) in CHAINS.into_iter().zip([&tip, &turn]) {
            self.transform(chain, transition);
        }
        for (chain, model) in CHAINS.into_iter().zip(self.models) {
            self.add_noise(chain, Singer { sigma: model.sigma * self.boost, ..model }.noise(dt));
        }
        self.boost = 1.0 + (self.boost - 1.0) * libm::exp(-dt / k::EYE_BOOST.1);
        self.time_ns = time_ns;
    }

    /// P ← Φ·P·Φᵀ for one chain: rows, then columns.
    fn transform(&mut self, chain: usize, t: &Transition) {
        let p = &mut self.covariance;
        for axis in chain..chain + 3 {
            for k in 0..18 {
                let (x, v, a) = (p[(axis, k)], p[(axis + 3, k)], p[(axis + 6, k)]);
                p[(axis, k)] = x + t.dt * v + t.h * a;
                p[(axis + 3, k)] = v + t.g * a;
                p[(axis + 6, k)] = t.e * a;
            }
            for k in 0..18 {
                let (x, v, a) = (p[(k, axis)], p[(k, axis + 3)], p[(k, axis + 6)]);
                p[(k, axis)] = x + t.dt * v + t.h * a;
                p[(k, axis + 3)] = v + t.g * a;
                p[(k, axis + 6)] = t.e * a;
            }
        }
    }

    fn add_noise(&mut self, chain: usize, [q11, q12, q13, q22, q23, q33]: [f64; 6]) {
        let p = &mut self.covariance;
        for axis in chain..chain + 3 {
            let (x, v, a) = (axis, axis + 3, axis + 6);
            for (r, c, q) in [(x, x, q11), (x, v, q12), (x, a, q13), (v, v, q22), (v, a, q23), (a, a, q33)] {
                p[(r, c)] += q;
                if r != c {
                    p[(c, r)] += q;
                }
            }
        }
    }

    /// Takes the pose that maximises the posterior, and its covariance. `prior_inverse` is the
    /// inverse of [`Filter::pose_covariance`]. False, with nothing changed, where the result
    /// would not be finite.
    pub fn update(
        &mut self,
        posterior: &Isometry3<f64>,
        posterior_covariance: &Matrix6,
        prior_inverse: &Matrix6,
    ) -> bool {
        let delta = difference(posterior, &self.world_from_body);
        let p = &self.covariance;
        let cross = SMatrix::<f64, 18, 6>::from_fn(|r, c| p[(r, pose_row(c))]);
        let gain = cross * prior_inverse;
        let shrink = self.pose_covariance() - posterior_covariance;
        let change = gain * delta;
        let after = p - gain * shrink * gain.transpose();
        if !change.iter().chain(after.iter()).all(|v| v.is_finite()) || after.diagonal().min() < 0.0 {
            return false;
        }
        let surprise = delta.dot(&(prior_inverse * delta));
        if surprise > k::SURPRISE {
            self.boost = (self.boost * (surprise / k::SURPRISE)).clamp(3.0, k::EYE_BOOST.0);
        }
        self.covariance = (after + after.transpose()) * 0.5;
        self.put_pose_covariance(posterior_covariance);
        self.world_from_body = *posterior;
        self.velocity += change.fixed_rows::<3>(3);
        self.acceleration += change.fixed_rows::<3>(6);
        self.angular_velocity += change.fixed_rows::<3>(12);
        self.angular_acceleration += change.fixed_rows::<3>(15);
        true
    }
}

/// Row of the state that holds row `r` of the pose.
fn pose_row(r: usize) -> usize {
    if r < 3 { r } else { r + 6 }
}

/// exp of a rotation vector.
pub fn exp(v: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(v)
}

/// The small change that leads from `from` to `to`: shift, and rotation vector in the world.
pub fn difference(to: &Isometry3<f64>, from: &Isometry3<f64>) -> Vector6 {
    let shift = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// `pose` changed by `delta`.
pub fn changed(pose: &Isometry3<f64>, delta: &Vector6) -> Isometry3<f64> {
    let shift: Vector3<f64> = delta.fixed_rows::<3>(0).into();
    let turn: Vector3<f64> = delta.fixed_rows::<3>(3).into();
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::new_normalize((exp(turn) * pose.rotation).into_inner()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MODELS: [Singer; 2] = [Singer { sigma: 200.0, tau_s: 0.05 }, Singer { sigma: 30.0, tau_s: 0.05 }];

    fn filter() -> Filter {
        Filter::new(Isometry3::identity(), &(Matrix6::identity() * 1e-4), [10.0, 200.0, 1.0, 30.0], MODELS, 0)
    }

    #[test]
    fn short_noise_joins_the_closed_form() {
        let (below, above) = (MODELS[0].noise(0.002_499_99), MODELS[0].noise(0.002_500_01));
        for (a, b) in below.into_iter().zip(above) {
            assert!((a / b - 1.0).abs() < 0.06, "{a} {b}");
        }
    }

    #[test]
    fn velocity_is_learnt_from_poses() {
        let mut f = filter();
        let velocity = Vector3::new(4.0, -2.0, 1.0);
        for k in 1..50u64 {
            f.advance(k * 20_000_000);
            let prior_inverse = f.pose_covariance().try_inverse().unwrap();
            let pose =
                Isometry3::translation(0.0, 0.0, 0.0) * Translation3::from(velocity * (k as f64 * 0.02));
            let noise = Matrix6::identity() * 1e-6;
            let posterior = (prior_inverse + noise.try_inverse().unwrap()).try_inverse().unwrap();
            assert!(f.update(&pose, &posterior, &prior_inverse));
        }
        assert!((f.velocity - velocity).norm() < 0.05, "{}", f.velocity);
    }

    proptest! {
        #[test]
        fn covariance_stays_positive(steps in prop::collection::vec(1u64..200_000_000, 1..40)) {
            let mut f = filter();
            for dt in steps {
                f.advance(f.time_ns + dt);
                let prior = f.pose_covariance();
                let prior_inverse = prior.try_inverse().unwrap();
                let information = prior_inverse + Matrix6::identity() * 1e5;
                let pose = f.world_from_body;
                prop_assert!(f.update(&pose, &information.try_inverse().unwrap(), &prior_inverse));
                prop_assert!(f.pose_covariance().cholesky().is_some());
            }
        }

        #[test]
        fn change_and_difference_are_inverse(d in prop::array::uniform6(-1.0..1.0f64)) {
            let pose = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.3, -0.4, 0.5));
            let delta = Vector6::from(d);
            prop_assert!((difference(&changed(&pose, &delta), &pose) - delta).norm() < 1e-9);
        }
    }
}
