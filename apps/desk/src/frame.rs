//! The instruments as the messages of a tracker and of the camera hardware. Pure.

use crate::guidance::{Guidance, MM_PER_PX};
use bytemuck::Zeroable;
use protocol::geometry::{Pose, Validity};
use protocol::handles::HandleState;
use protocol::limits::INSTRUMENTS;
use protocol::poses::{BodyStatus, COVARIANCE_ENTRIES, EYE, TrackerFrame};
use protocol::time::Nanos;

/// Variance of a tip along each axis, mm²: that of a uniform distribution over a pixel of the
/// mouse, a twelfth of its square.
pub const TIP_VARIANCE_MM2: f64 = MM_PER_PX * MM_PER_PX / 12.0;
/// Variance of an instrument's rotation about each axis, rad²: of the size that the tracker
/// reaches.
pub const ROTATION_VARIANCE_RAD2: f64 = 1e-6;
/// Indices of the diagonal in the upper triangle of a 6×6 matrix, stored row by row.
const DIAGONAL: [usize; 6] = [0, 6, 11, 15, 18, 20];
/// Time constant of a predicted velocity, s: a mouse may stop at any moment.
const VELOCITY_TAU_S: f64 = 0.08;

/// Writes the frame of a field exposed at `exposed_ns`, whatever stood there. The eye does not turn; every body
/// counts as measured.
pub fn write_poses(guidance: &Guidance, field: u64, exposed_ns: Nanos, frame: &mut TrackerFrame) {
    *frame = TrackerFrame::zeroed();
    (frame.field, frame.frame) = (field, field);
    let instants = &mut frame.instants;
    (instants.exposed, instants.read_out) = (exposed_ns, exposed_ns);
    (instants.blobs_out, instants.taken) = (exposed_ns, exposed_ns);
    for (body, instrument) in frame.bodies.iter_mut().zip(guidance.instruments()) {
        body.world_from_body = Pose::from_isometry(&instrument.pose());
        body.covariance = covariance();
        body.predictor.velocity_mm_s = instrument.velocity_mm_s.into();
        body.predictor.velocity_tau_s = VELOCITY_TAU_S;
        body.predictor.angular_velocity_rad_s = instrument.angular_velocity_rad_s.into();
    }
    frame.bodies[EYE].world_from_body = Pose::IDENTITY;
    for body in &mut frame.bodies {
        body.measured_ns = exposed_ns;
        (body.validity, body.status) = (Validity::Measured as u32, BodyStatus::Tracked as u32);
    }
}

/// Tools and jaws of both instruments; `seq` is the number of the first message.
pub fn handles(guidance: &Guidance, field: u64, instant_ns: Nanos, seq: u64) -> [HandleState; INSTRUMENTS] {
    std::array::from_fn(|i| {
        let instrument = &guidance.instruments()[i];
        let (tool, jaw_rad) = (instrument.tool as u32, instrument.jaw_rad);
        HandleState { seq: seq + i as u64, field, instant_ns, instrument: i as u32, tool, jaw_rad }
    })
}

fn covariance() -> [f64; COVARIANCE_ENTRIES] {
    let mut entries = [0.0; COVARIANCE_ENTRIES];
    DIAGONAL[..3].iter().for_each(|&i| entries[i] = TIP_VARIANCE_MM2);
    DIAGONAL[3..].iter().for_each(|&i| entries[i] = ROTATION_VARIANCE_RAD2);
    entries
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::inputs::Input;
    use protocol::message::Message;
    use protocol::predict::predict;
    use rig::Rig;
    use scene::SceneFile;

    #[test]
    fn frames_are_valid_and_their_prediction_is_where_the_hand_goes() {
        let mut guidance =
            Guidance::new(&SceneFile::load("peel").unwrap(), &Rig::load_or_shipped(None).unwrap());
        guidance.apply(Input::Move([400.0, 0.0]));
        (0..20).for_each(|_| guidance.advance(0.02));
        let mut frame = TrackerFrame::zeroed();
        write_poses(&guidance, 20, 1_000_000_000, &mut frame);
        frame.validate().unwrap();
        handles(&guidance, 20, 5, 40).iter().for_each(|h| h.validate().unwrap());
        let ahead = predict(&frame, 0, 1_020_000_000).world_from_body.isometry();
        guidance.advance(0.02);
        let there = guidance.instruments()[0].pose();
        let off = (ahead.translation.vector - there.translation.vector).norm();
        assert!(off < 0.05, "of 0.24 mm gone, {off} mm off");
        assert!(ahead.rotation.angle_to(&there.rotation) < 0.005);
    }

    #[test]
    fn the_stated_deviation_is_that_of_a_pixel() {
        let c = covariance();
        assert!((c[0].sqrt() - 0.0058).abs() < 1e-4 && c[0] == c[6] && c[6] == c[11]);
        assert_eq!(c.iter().filter(|v| **v > 0.0).count(), 6);
    }
}
