//! The filter of the eye: a Kalman filter of position and rotation, each with a Singer
//! acceleration.
//!
//! Per axis the chain (x, v, a) obeys x' = v, v' = a, a' = −a/τ + noise of standard deviation σ
//! (Singer 1970, the model of `protocol::predict`); the rotation does the same with (θ, ω, α), θ
//! being the error of the rotation as a vector in the world, R = exp(θ)·R̂. A measurement is a
//! pose with its 6×6 covariance *after* the prior went in (see `fit`), so the rest of the state
//! follows by its regression on the pose: x_r += K·δ, K = P_rp·P_pp⁻¹.

use crate::checkpoint::{CheckpointError, Done, Loader, Saver};
use crate::constants as k;
use crate::lines::MotionGivenPose;
use crate::motion_models::Singer;
use crate::pose_math::{Matrix6, box_minus, exp};
use nalgebra::{Isometry3, SMatrix, Translation3, Vector3};

type Matrix18 = SMatrix<f64, 18, 18>;

/// First rows of the two chains (x, v, a): position, rotation.
const CHAINS: [usize; 2] = [0, 9];

/// State of the eye.
#[derive(Debug, Clone, PartialEq)]
pub struct EyeFilter {
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
    /// Motion models of position and rotation.
    pub models: [Singer; 2],
    /// Instant of the state, ns.
    pub time_ns: u64,
    /// Factor on the models' accelerations: above 1 after a large NIS.
    boost: f64,
    covariance: Matrix18,
}

/// Standard deviations of velocity, acceleration, angular velocity and angular acceleration.
pub type StartSigmas = [f64; 4];

impl EyeFilter {
    /// An eye just acquired.
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
        let mut filter = EyeFilter {
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
        filter.set_pose_covariance(pose_covariance);
        filter
    }

    /// Writes all but the models, which are the rig's.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        let EyeFilter { world_from_body, velocity, acceleration, angular_velocity, .. } = self;
        let EyeFilter { angular_acceleration, models: _, time_ns, boost, covariance, .. } = self;
        out.pose(world_from_body)?;
        for vector in [velocity, acceleration, angular_velocity, angular_acceleration] {
            out.numbers(vector.as_slice())?;
        }
        out.put(time_ns)?;
        out.numbers([boost])?;
        out.square(covariance.nrows(), |r, c| covariance[(r, c)])
    }

    /// The filter that was saved.
    pub(crate) fn load(models: [Singer; 2], from: &mut Loader<'_>) -> Result<Self, CheckpointError> {
        let pose = from.pose()?;
        let mut filter = EyeFilter::new(pose, &Matrix6::zeros(), [0.0; 4], models, 0);
        let EyeFilter { velocity, acceleration, angular_velocity, angular_acceleration, .. } = &mut filter;
        for vector in [velocity, acceleration, angular_velocity, angular_acceleration] {
            from.numbers(vector.as_mut_slice())?;
        }
        filter.time_ns = from.count()?;
        from.numbers([&mut filter.boost])?;
        from.square(filter.covariance.nrows(), |r, c, number| filter.covariance[(r, c)] = number)?;
        Ok(filter)
    }

    /// Covariance of the pose.
    pub fn pose_covariance(&self) -> Matrix6 {
        let p = &self.covariance;
        Matrix6::from_fn(|r, c| p[(pose_row(r), pose_row(c))])
    }

    /// Regression of the motion on the pose; `pose_information` is the inverse of [`EyeFilter::pose_covariance`].
    pub fn motion_given_pose(&self, pose_information: &Matrix6) -> MotionGivenPose {
        let p = &self.covariance;
        let rate = |r: usize| pose_row(r) + 3;
        let with_pose = Matrix6::from_fn(|r, c| p[(rate(r), pose_row(c))]);
        let covariance = Matrix6::from_fn(|r, c| p[(rate(r), rate(c))]);
        MotionGivenPose::new(&with_pose, &covariance, pose_information)
    }

    fn set_pose_covariance(&mut self, m: &Matrix6) {
        for r in 0..6 {
            for c in 0..6 {
                self.covariance[(pose_row(r), pose_row(c))] = 0.5 * (m[(r, c)] + m[(c, r)]);
            }
        }
    }

    /// The predicted pose `dt` seconds after (or before) the state's instant.
    pub fn pose_after(&self, dt: f64) -> Isometry3<f64> {
        let [position, rotation] = self.models.map(|m| m.transition(dt)[0][2]);
        let shift = self.velocity * dt + self.acceleration * position;
        let angle = self.angular_velocity * dt + self.angular_acceleration * rotation;
        let moved = self.world_from_body.translation.vector + shift;
        let turned = exp(angle) * self.world_from_body.rotation;
        Isometry3::from_parts(Translation3::from(moved), turned)
    }

    /// Predicts the state at `time_ns`; an earlier instant changes nothing.
    pub fn predict(&mut self, time_ns: u64) {
        let dt = time_ns.saturating_sub(self.time_ns) as f64 * 1e-9;
        if dt <= 0.0 {
            return;
        }
        self.world_from_body = self.pose_after(dt);
        let [position, rotation] = self.models.map(|m| m.transition(dt));
        self.velocity += self.acceleration * position[1][2];
        self.acceleration *= position[2][2];
        self.angular_velocity += self.angular_acceleration * rotation[1][2];
        self.angular_acceleration *= rotation[2][2];
        for ((chain, transition), model) in CHAINS.into_iter().zip([&position, &rotation]).zip(self.models) {
            self.transform(chain, transition);
            self.add_noise(chain, &Singer { sigma: model.sigma * self.boost, ..model }.noise(dt));
        }
        self.boost = 1.0 + (self.boost - 1.0) * libm::exp(-dt / k::EYE_BOOST.1);
        self.time_ns = time_ns;
    }

    /// P ← Φ·P·Φᵀ for one chain: rows, then columns.
    fn transform(&mut self, chain: usize, transition: &[[f64; 3]; 3]) {
        let [[_, dt, h], [_, _, g], [_, _, e]] = *transition;
        let p = &mut self.covariance;
        for axis in chain..chain + 3 {
            for k in 0..18 {
                let (x, v, a) = (p[(axis, k)], p[(axis + 3, k)], p[(axis + 6, k)]);
                p[(axis, k)] = x + dt * v + h * a;
                p[(axis + 3, k)] = v + g * a;
                p[(axis + 6, k)] = e * a;
            }
            for k in 0..18 {
                let (x, v, a) = (p[(k, axis)], p[(k, axis + 3)], p[(k, axis + 6)]);
                p[(k, axis)] = x + dt * v + h * a;
                p[(k, axis + 3)] = v + g * a;
                p[(k, axis + 6)] = e * a;
            }
        }
    }

    fn add_noise(&mut self, chain: usize, noise: &[[f64; 3]; 3]) {
        for axis in chain..chain + 3 {
            for (r, row) in noise.iter().enumerate() {
                for (c, q) in row.iter().enumerate() {
                    self.covariance[(axis + 3 * r, axis + 3 * c)] += q;
                }
            }
        }
    }

    /// Updates the state with the pose of maximum posterior and its covariance. `prior_inverse` is
    /// the inverse of [`EyeFilter::pose_covariance`]. False, with nothing changed, where the result
    /// would not be finite.
    pub fn update(
        &mut self,
        posterior: &Isometry3<f64>,
        posterior_covariance: &Matrix6,
        prior_inverse: &Matrix6,
    ) -> bool {
        let delta = box_minus(posterior, &self.world_from_body);
        let p = &self.covariance;
        let cross = SMatrix::<f64, 18, 6>::from_fn(|r, c| p[(r, pose_row(c))]);
        let gain = cross * prior_inverse;
        let shrink = self.pose_covariance() - posterior_covariance;
        let change = gain * delta;
        let after = p - gain * shrink * gain.transpose();
        if !change.iter().chain(after.iter()).all(|v| v.is_finite()) || after.diagonal().min() < 0.0 {
            return false;
        }
        let nis = delta.dot(&(prior_inverse * delta));
        if nis > k::NIS_LIMIT {
            self.boost = (self.boost * (nis / k::NIS_LIMIT)).clamp(3.0, k::EYE_BOOST.0);
        }
        self.covariance = (after + after.transpose()) * 0.5;
        self.set_pose_covariance(posterior_covariance);
        self.world_from_body = *posterior;
        self.velocity += change.fixed_rows::<3>(3);
        self.acceleration += change.fixed_rows::<3>(6);
        self.angular_velocity += change.fixed_rows::<3>(12);
        self.angular_acceleration += change.fixed_rows::<3>(15);
        true
    }
}

/// Row of the state that is row `r` of the pose.
fn pose_row(r: usize) -> usize {
    if r < 3 { r } else { r + 6 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adverse::{Adverse, STEPS, Seen};
    use proptest::prelude::*;

    const MODELS: [Singer; 2] = [Singer { sigma: 200.0, tau_s: 0.05 }, Singer { sigma: 30.0, tau_s: 0.05 }];

    fn filter() -> EyeFilter {
        EyeFilter::new(
            Isometry3::identity(),
            &(Matrix6::identity() * 1e-4),
            [10.0, 200.0, 1.0, 30.0],
            MODELS,
            0,
        )
    }

    #[test]
    fn velocity_is_learnt_from_poses() {
        let mut f = filter();
        let velocity = Vector3::new(4.0, -2.0, 1.0);
        for k in 1..50u64 {
            f.predict(k * 20_000_000);
            let prior_inverse = f.pose_covariance().try_inverse().unwrap();
            let pose =
                Isometry3::translation(0.0, 0.0, 0.0) * Translation3::from(velocity * (k as f64 * 0.02));
            let noise = Matrix6::identity() * 1e-6;
            let posterior = (prior_inverse + noise.try_inverse().unwrap()).try_inverse().unwrap();
            assert!(f.update(&pose, &posterior, &prior_inverse));
        }
        assert!((f.velocity - velocity).norm() < 0.05, "{}", f.velocity);
    }

    #[test]
    fn a_million_adverse_steps_leave_it_sound() {
        for movement in Adverse::ALL {
            let mut f = filter();
            for n in 1..STEPS {
                let (turn, seen) = movement.at(n);
                f.predict(n * 20_000_000);
                let prior = f.pose_covariance();
                let prior_inverse = prior.cholesky().expect("positive definite").inverse();
                let mut information = prior_inverse;
                if seen != Seen::Nothing {
                    information += Matrix6::identity() * 1e6;
                    information[(5, 5)] -= if seen == Seen::OneCamera { 1e6 } else { 0.0 };
                    let pose = Isometry3::new(Vector3::zeros(), turn * 0.02);
                    f.update(&pose, &information.try_inverse().unwrap(), &prior_inverse);
                }
                let p = &f.covariance;
                assert!(p.diagonal().iter().all(|v| *v >= 0.0 && *v < 1e12), "{movement:?}, step {n}: {p}");
                assert!((p - p.transpose()).amax() <= 1e-12 * p.amax(), "{movement:?}, step {n}");
                assert!(f.boost.is_finite() && f.velocity.norm() < 1e6, "{movement:?}, step {n}");
            }
            println!("{movement:?}: {STEPS} steps");
        }
    }

    proptest! {
        #[test]
        fn covariance_stays_positive(steps in prop::collection::vec(1u64..200_000_000, 1..40)) {
            let mut f = filter();
            for dt in steps {
                f.predict(f.time_ns + dt);
                let prior = f.pose_covariance();
                let prior_inverse = prior.try_inverse().unwrap();
                let information = prior_inverse + Matrix6::identity() * 1e5;
                let pose = f.world_from_body;
                prop_assert!(f.update(&pose, &information.try_inverse().unwrap(), &prior_inverse));
                prop_assert!(f.pose_covariance().cholesky().is_some());
            }
        }
    }
}
