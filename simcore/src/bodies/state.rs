//! What the next step must know about the bodies.

use crate::checkpoint::CheckpointError;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use protocol::geometry::Pose;
use protocol::limits::INSTRUMENTS;
use scene::{BodiesScene, BodyScene};
use serde::{Deserialize, Serialize};

/// All bodies of a scene, in the order of the scene file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodiesState {
    /// The bodies.
    pub body: Vec<BodyState>,
    /// What each instrument holds.
    pub grip: [Option<Grip>; INSTRUMENTS],
}

/// A body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BodyState {
    /// `eye_from_body`, mm.
    pub eye_from_body: Isometry3<f64>,
    /// Velocity of its centre, eye frame, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Angular velocity, eye frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
}

/// A body between jaws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Grip {
    /// Number of the body.
    pub body: u32,
    /// Where the jaws hold it.
    pub instrument_from_body: Isometry3<f64>,
    /// Opening at which both jaws touched it, rad; the jaws stay there.
    pub opening_rad: f64,
    /// How far it has slid in the jaws since, mm.
    pub slid_mm: f64,
}

impl BodyState {
    fn start(scene: &BodyScene) -> Self {
        let at = Vector3::from(scene.position_in_eye_mm);
        BodyState {
            eye_from_body: Isometry3::from_parts(at.into(), UnitQuaternion::identity()),
            velocity_mm_s: Vector3::zeros(),
            angular_velocity_rad_s: Vector3::zeros(),
        }
    }

    /// True if all of its numbers are finite and its pose is rigid.
    pub fn is_sound(&self) -> bool {
        let moves =
            self.velocity_mm_s.iter().chain(self.angular_velocity_rad_s.iter()).all(|c| c.is_finite());
        moves && Pose::from_isometry(&self.eye_from_body).is_valid()
    }
}

impl BodiesState {
    /// The bodies of a scene at rest in the scene's places.
    pub fn start(scene: &BodiesScene) -> Self {
        BodiesState { body: scene.body.iter().map(BodyState::start).collect(), grip: [None; INSTRUMENTS] }
    }

    /// Checks the bodies of a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError`] for bodies that are not the scene's or hold bad numbers.
    pub fn check(state: Option<&Self>, scene: Option<&BodiesScene>) -> Result<(), CheckpointError> {
        let expected = scene.map_or(0, |s| s.body.len());
        if state.is_some() != scene.is_some() || state.map_or(0, |s| s.body.len()) != expected {
            return Err(CheckpointError::Content("the bodies are not those of the scene"));
        }
        let Some(state) = state else { return Ok(()) };
        let grips = state.grip.iter().flatten().all(|g| {
            let numbers = (0.0..=std::f64::consts::PI).contains(&g.opening_rad) && g.slid_mm >= 0.0;
            numbers && (g.body as usize) < expected && Pose::from_isometry(&g.instrument_from_body).is_valid()
        });
        if !grips || !state.body.iter().all(BodyState::is_sound) {
            return Err(CheckpointError::Content("a body or a grip is out of range"));
        }
        Ok(())
    }
}
