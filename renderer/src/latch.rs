//! The late latch: the newest poses, predicted to the instant at which they will be seen.

use glam::{DMat4, DQuat, DVec3};
use protocol::geometry::{Pose, Validity};
use protocol::limits::INSTRUMENTS;
use protocol::poses::{EYE, TrackerFrame};
use protocol::predict::predict;
use protocol::scene::SceneHeader;
use protocol::time::{Instants, Nanos};

/// Age of the last frame from which every body counts as lost, ns.
const SILENT_NS: u64 = 400_000_000;

/// The poses that a frame is drawn with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latched {
    /// Field of the poses.
    pub field: u64,
    /// Instants of the poses.
    pub instants: Instants,
    /// Instant to which they were predicted; that of the exposure where they were taken as they
    /// are.
    pub predicted_to: Nanos,
    /// The eye in the world.
    pub world_from_eye: DMat4,
    /// Instruments in the world.
    pub world_from_instrument: [DMat4; INSTRUMENTS],
    /// False: lost; the pose is the last good one, to be drawn frozen and faded.
    pub tracked: [bool; INSTRUMENTS],
    /// The same for the eye.
    pub eye_tracked: bool,
}

impl Latched {
    /// Instruments in the eye.
    pub fn eye_from_instrument(&self) -> [DMat4; INSTRUMENTS] {
        let eye_from_world = self.world_from_eye.inverse();
        self.world_from_instrument.map(|m| eye_from_world * m)
    }

    /// True if everything is tracked.
    pub fn all_tracked(&self) -> bool {
        self.eye_tracked && self.tracked.iter().all(|&t| t)
    }
}

/// `pose` as a matrix.
pub fn matrix(pose: &Pose) -> DMat4 {
    let [w, x, y, z] = pose.rotation_wxyz;
    DMat4::from_rotation_translation(DQuat::from_xyzw(x, y, z, w).normalize(), DVec3::from(pose.position_mm))
}

/// `frame` carried to `at_ns`.
pub fn latch(frame: &TrackerFrame, at_ns: Nanos) -> Latched {
    let bodies = [0, 1, EYE].map(|body| predict(frame, body, at_ns));
    let pose = |i: usize| matrix(&bodies[i].world_from_body);
    let silent = at_ns.saturating_sub(frame.instants.exposed) > SILENT_NS;
    let tracked = |i: usize| !silent && bodies[i].validity != Validity::Lost;
    Latched {
        field: frame.field,
        instants: frame.instants,
        predicted_to: at_ns,
        world_from_eye: pose(EYE),
        world_from_instrument: [pose(0), pose(1)],
        tracked: [tracked(0), tracked(1)],
        eye_tracked: tracked(EYE),
    }
}

/// The poses of the simulation's step, while there is no tracker frame.
pub fn latch_scene(scene: &SceneHeader) -> Latched {
    Latched {
        field: scene.field,
        instants: scene.instants,
        predicted_to: scene.instants.exposed,
        world_from_eye: matrix(&scene.world_from_eye),
        world_from_instrument: [0, 1].map(|i| matrix(&scene.instruments[i].world_from_instrument)),
        tracked: [true; INSTRUMENTS],
        eye_tracked: true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn frame() -> TrackerFrame {
        let mut frame = TrackerFrame::zeroed();
        frame.instants.exposed = 1_000_000_000;
        for body in &mut frame.bodies {
            body.world_from_body = Pose::IDENTITY;
            body.validity = Validity::Measured as u32;
        }
        frame
    }

    #[test]
    fn tracked_bodies_move_on_and_lost_ones_freeze() {
        let mut frame = frame();
        for i in 0..2 {
            frame.bodies[i].predictor.velocity_mm_s = [10.0, 0.0, 0.0];
        }
        frame.bodies[1].validity = Validity::Lost as u32;
        let latched = latch(&frame, 1_050_000_000);
        let x = latched.world_from_instrument.map(|m| m.w_axis.x);
        assert!((x[0] - 0.5).abs() < 1e-9 && x[1] == 0.0, "{x:?}");
        assert_eq!((latched.tracked, latched.all_tracked()), ([true, false], false));
    }

    #[test]
    fn a_silent_tracker_is_lost() {
        let frame = frame();
        assert!(latch(&frame, frame.instants.exposed + SILENT_NS).all_tracked());
        let late = latch(&frame, frame.instants.exposed + SILENT_NS + 1);
        assert_eq!((late.tracked, late.eye_tracked), ([false; 2], false));
    }

    #[test]
    fn instruments_are_seen_from_the_turned_eye() {
        let mut frame = frame();
        let half = std::f64::consts::FRAC_PI_4;
        frame.bodies[EYE].world_from_body.rotation_wxyz = [half.cos(), 0.0, 0.0, half.sin()];
        frame.bodies[0].world_from_body.position_mm = [0.0, 5.0, -9.0];
        let p = latch(&frame, frame.instants.exposed).eye_from_instrument()[0].w_axis;
        assert!((p.truncate() - DVec3::new(5.0, 0.0, -9.0)).length() < 1e-9, "{p}");
    }
}
