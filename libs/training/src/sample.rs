//! What task and score see of one step: the tips in the eye with their uncertainty, and the step's
//! events. Made from the tracker's frame alone, so that a recording gives the same samples as the
//! live run, to the bit.

use nalgebra::{Matrix3, Vector3};
use protocol::events::Event;
use protocol::geometry::Validity;
use protocol::limits::INSTRUMENTS;
use protocol::poses::{BodyState, EYE, TrackerFrame};
use protocol::time::Nanos;

/// One instrument at the step's exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    /// Tip in the eye frame, mm.
    pub tip_in_eye_mm: Vector3<f64>,
    /// Unit vector from the tip along the shaft to the handle, eye frame.
    pub to_handle: Vector3<f64>,
    /// Covariance of the tip in the eye frame, mm².
    pub covariance_mm2: Matrix3<f64>,
}

impl Tip {
    /// Deviation of the tip along a unit vector, mm.
    pub fn sigma_along_mm(&self, unit: &Vector3<f64>) -> f64 {
        let variance = unit.dot(&(self.covariance_mm2 * unit));
        if variance > 0.0 { libm::sqrt(variance) } else { 0.0 }
    }
}

/// One step.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Exposure of the step.
    pub exposed_ns: Nanos,
    /// Instruments that are tracked.
    pub tips: [Option<Tip>; INSTRUMENTS],
    /// What happened in the step.
    pub events: &'a [Event],
}

impl<'a> Sample<'a> {
    /// Of a tracker frame and the events of the step that consumed it.
    pub fn new(frame: &TrackerFrame, events: &'a [Event]) -> Self {
        Sample { exposed_ns: frame.instants.exposed, tips: tips(frame), events }
    }
}

fn tracked(body: &BodyState) -> bool {
    body.validity() != Validity::Lost && body.world_from_body.is_valid()
}

/// The instruments of a frame in its eye; none where the eye is lost.
pub fn tips(frame: &TrackerFrame) -> [Option<Tip>; INSTRUMENTS] {
    let eye = &frame.bodies[EYE];
    if !tracked(eye) {
        return [None; INSTRUMENTS];
    }
    let eye_from_world = eye.world_from_body.isometry().inverse();
    let turn = eye_from_world.rotation.to_rotation_matrix().into_inner();
    std::array::from_fn(|i| {
        let body = &frame.bodies[i];
        if !tracked(body) {
            return None;
        }
        let pose = eye_from_world * body.world_from_body.isometry();
        Some(Tip {
            tip_in_eye_mm: pose.translation.vector,
            to_handle: pose.rotation * Vector3::z(),
            covariance_mm2: turn * position_covariance(body) * turn.transpose(),
        })
    })
}

/// The position's part of the 6×6 covariance, whose upper triangle is stored row by row.
fn position_covariance(body: &BodyState) -> Matrix3<f64> {
    let c = &body.covariance;
    let (xx, xy, xz, yy, yz, zz) = (c[0], c[1], c[2], c[6], c[7], c[11]);
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use nalgebra::{Isometry3, UnitQuaternion};
    use protocol::geometry::Pose;

    #[test]
    fn tips_and_their_covariance_turn_with_the_eye() {
        let mut frame = TrackerFrame::zeroed();
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let eye = Isometry3::from_parts(Vector3::zeros().into(), quarter);
        frame.bodies.iter_mut().for_each(|b| b.world_from_body = Pose::IDENTITY);
        frame.bodies[EYE].world_from_body = Pose::from_isometry(&eye);
        frame.bodies[EYE].validity = 2;
        frame.bodies[0].validity = 2;
        frame.bodies[0].world_from_body.position_mm = [1.0, 2.0, -5.0];
        frame.bodies[0].covariance[0] = 4e-6;
        let [first, second] = tips(&frame);
        let first = first.unwrap();
        assert!((first.tip_in_eye_mm - Vector3::new(2.0, -1.0, -5.0)).norm() < 1e-12);
        assert!((first.sigma_along_mm(&Vector3::y()) - 0.002).abs() < 1e-12, "the world's x is the eye's −y");
        assert!(first.sigma_along_mm(&Vector3::x()) < 1e-12);
        assert!(second.is_none(), "an instrument that is lost has no tip");
        frame.bodies[EYE].validity = 0;
        assert!(tips(&frame)[0].is_none(), "without the eye nothing is known");
    }
}
