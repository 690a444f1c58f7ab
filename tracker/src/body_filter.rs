//! The filter of a body: an eye turns about its centre, an instrument passes a trocar.

use crate::checkpoint::{CheckpointError, Done, Loader, Saver};
use crate::eye_filter::EyeFilter;
use crate::instrument_filter::{Hand, InstrumentFilter, Pivot};
use crate::lines::MotionGivenPose;
use crate::pose_math::Matrix6;
use crate::rig_model::BodyModel;
use nalgebra::{Isometry3, Vector3};

/// The filter of one body.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "three of them exist, and none may be allocated while running")]
pub enum BodyFilter {
    /// The eye.
    Eye(EyeFilter),
    /// An instrument.
    Instrument(InstrumentFilter),
}

impl BodyFilter {
    /// The filter of a body just acquired; `hand` is what was learnt of the hand that holds it, if it was tracked before.
    pub fn new(
        model: &BodyModel,
        pose: &Isometry3<f64>,
        covariance: &Matrix6,
        pivot: Option<Pivot>,
        time_ns: u64,
        hand: Option<Hand>,
    ) -> Self {
        if model.is_eye {
            BodyFilter::Eye(EyeFilter::new(*pose, covariance, model.start, model.motion, time_ns))
        } else {
            BodyFilter::Instrument(InstrumentFilter::new(pose, covariance, pivot, time_ns, model, hand))
        }
    }

    /// Writes the filter; which of the two it is follows from the body.
    pub(crate) fn save(&self, out: &mut Saver<'_>) -> Done {
        match self {
            BodyFilter::Eye(filter) => filter.save(out),
            BodyFilter::Instrument(filter) => filter.save(out),
        }
    }

    /// The filter of a body that was saved.
    pub(crate) fn load(model: &BodyModel, from: &mut Loader<'_>) -> Result<Self, CheckpointError> {
        if model.is_eye {
            EyeFilter::load(model.motion, from).map(BodyFilter::Eye)
        } else {
            InstrumentFilter::load(model, from).map(BodyFilter::Instrument)
        }
    }

    /// `world_from_body`.
    pub fn pose(&self) -> Isometry3<f64> {
        match self {
            BodyFilter::Eye(filter) => filter.world_from_body,
            BodyFilter::Instrument(filter) => filter.pose(),
        }
    }

    /// Covariance of the pose.
    pub fn pose_covariance(&self) -> Matrix6 {
        match self {
            BodyFilter::Eye(filter) => filter.pose_covariance(),
            BodyFilter::Instrument(filter) => filter.pose_covariance(),
        }
    }

    /// What is learnt of the hand that holds an instrument.
    pub fn hand(&self) -> Option<Hand> {
        match self {
            BodyFilter::Eye(_) => None,
            BodyFilter::Instrument(filter) => Some(filter.hand()),
        }
    }

    /// True if the pose, its motion and their covariance are finite.
    pub fn is_finite(&self) -> bool {
        let [velocity, turning] = self.motion();
        let pose = self.pose();
        let state = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
        let mut all = state.chain(velocity.iter()).chain(turning.iter());
        all.all(|v| v.is_finite()) && self.pose_covariance().iter().all(|v| v.is_finite())
    }

    /// Velocity (mm/s) and angular velocity (rad/s) in the world.
    pub fn motion(&self) -> [Vector3<f64>; 2] {
        match self {
            BodyFilter::Eye(filter) => [filter.velocity, filter.angular_velocity],
            BodyFilter::Instrument(filter) => filter.motion(),
        }
    }

    /// Regression of the motion on the pose; `pose_information` is the inverse of its covariance.
    pub fn motion_given_pose(&self, pose_information: &Matrix6) -> MotionGivenPose {
        match self {
            BodyFilter::Eye(filter) => filter.motion_given_pose(pose_information),
            BodyFilter::Instrument(filter) => filter.motion_given_pose(pose_information),
        }
    }

    /// Instant of the state, ns.
    pub fn time_ns(&self) -> u64 {
        match self {
            BodyFilter::Eye(filter) => filter.time_ns,
            BodyFilter::Instrument(filter) => filter.time_ns,
        }
    }

    /// Predicts the state at `time_ns`; an instrument's shaft passes `pivot`.
    pub fn predict(&mut self, time_ns: u64, pivot: Option<Pivot>) {
        match self {
            BodyFilter::Eye(filter) => filter.predict(time_ns),
            BodyFilter::Instrument(filter) => filter.predict(time_ns, pivot),
        }
    }

    /// The predicted pose `dt` seconds from the state's instant.
    pub fn pose_after(&self, dt: f64) -> Isometry3<f64> {
        match self {
            BodyFilter::Eye(filter) => filter.pose_after(dt),
            BodyFilter::Instrument(filter) => filter.pose_after(dt),
        }
    }

    /// Updates the state with a posterior of the pose; see [`EyeFilter::update`].
    pub fn update(
        &mut self,
        posterior: &Isometry3<f64>,
        covariance: &Matrix6,
        prior_inverse: &Matrix6,
    ) -> bool {
        match self {
            BodyFilter::Eye(filter) => filter.update(posterior, covariance, prior_inverse),
            BodyFilter::Instrument(filter) => filter.update(posterior, covariance, prior_inverse),
        }
    }
}
