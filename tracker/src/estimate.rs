//! The filter of a body, whichever it is: the eye turns about its centre, an instrument is led by
//! a hand.

use crate::filter::{Filter, Matrix6};
use crate::hand::{HandFilter, Pivot};
use crate::model::BodyModel;
use nalgebra::{Isometry3, Vector3};

/// State of one body over time.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "three of them exist, and none may be allocated while running")]
pub enum Estimate {
    /// The eye.
    Eye(Filter),
    /// An instrument.
    Hand(HandFilter),
}

impl Estimate {
    /// A body just found.
    pub fn new(
        model: &BodyModel,
        pose: &Isometry3<f64>,
        covariance: &Matrix6,
        pivot: Option<Pivot>,
        time_ns: u64,
    ) -> Self {
        if model.is_eye {
            Estimate::Eye(Filter::new(*pose, covariance, model.start, model.motion, time_ns))
        } else {
            Estimate::Hand(HandFilter::new(pose, covariance, pivot, time_ns))
        }
    }

    /// `world_from_body`.
    pub fn pose(&self) -> Isometry3<f64> {
        match self {
            Estimate::Eye(filter) => filter.world_from_body,
            Estimate::Hand(filter) => filter.pose(),
        }
    }

    /// Covariance of the pose.
    pub fn pose_covariance(&self) -> Matrix6 {
        match self {
            Estimate::Eye(filter) => filter.pose_covariance(),
            Estimate::Hand(filter) => filter.pose_covariance(),
        }
    }

    /// Velocity (mm/s) and angular velocity (rad/s) in the world.
    pub fn motion(&self) -> [Vector3<f64>; 2] {
        match self {
            Estimate::Eye(filter) => [filter.velocity, filter.angular_velocity],
            Estimate::Hand(filter) => filter.motion(),
        }
    }

    /// Instant of the state, ns.
    pub fn time_ns(&self) -> u64 {
        match self {
            Estimate::Eye(filter) => filter.time_ns,
            Estimate::Hand(filter) => filter.time_ns,
        }
    }

    /// Carries the state to `time_ns`; an instrument's shaft goes through `pivot`.
    pub fn advance(&mut self, time_ns: u64, pivot: Option<Pivot>) {
        match self {
            Estimate::Eye(filter) => filter.advance(time_ns),
            Estimate::Hand(filter) => filter.advance(time_ns, pivot),
        }
    }

    /// The pose `dt` seconds from the state's instant, by the mean motion alone.
    pub fn pose_after(&self, dt: f64) -> Isometry3<f64> {
        match self {
            Estimate::Eye(filter) => filter.pose_after(dt),
            Estimate::Hand(filter) => filter.pose_after(dt),
        }
    }

    /// Takes a posterior; see [`Filter::update`].
    pub fn update(
        &mut self,
        posterior: &Isometry3<f64>,
        covariance: &Matrix6,
        prior_inverse: &Matrix6,
    ) -> bool {
        match self {
            Estimate::Eye(filter) => filter.update(posterior, covariance, prior_inverse),
            Estimate::Hand(filter) => filter.update(posterior, covariance, prior_inverse),
        }
    }
}
