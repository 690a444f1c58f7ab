//! Kinematic playback of a scene's script: exact poses, no noise, no clock, tremor only on request.
//! For tests, timing and tuning of scenes; the virtual rig plays scripts live.

use crate::script::{Gesture, Perception, Script};
use crate::tremor::Tremor;
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use protocol::geometry::{Pose, Validity};
use protocol::handles::{HandleState, PedalState};
use protocol::limits::INSTRUMENTS;
use protocol::poses::{EYE, TrackerFrame};
use protocol::steps::StepInputs;
use rig::Rig;
use scene::{SceneFile, ScriptScene};

/// Exposure of field 0, ns; instants of 0 mean "not yet".
const FIRST_NS: u64 = 1_000_000_000;

/// A script ready to be played.
#[derive(Debug, Clone)]
pub struct Rehearsal {
    written: ScriptScene,
    script: Script,
    /// Where the shafts pass the eye's wall, eye frame, mm.
    trocars: [Vector3<f64>; INSTRUMENTS],
    /// Tremor of the tips, if any.
    tremor: Option<[Tremor; INSTRUMENTS]>,
    /// From one field to the next, ns.
    period_ns: u64,
}

impl Rehearsal {
    /// The script of `scene` on the shipped rig.
    ///
    /// # Panics
    /// If the rig that is built in does not parse.
    pub fn shipped(scene: &SceneFile) -> Self {
        Self::new(scene, &Rig::load_or_shipped(None).expect("the shipped rig is tested"))
    }

    /// The script of `scene` with the trocars of `rig` and at its rate.
    pub fn new(scene: &SceneFile, rig: &Rig) -> Self {
        let trocar = |i: usize| {
            let place = rig.trocars.get(i).map_or([0.0, 0.0, 10.0], |t| t.p_eye);
            Vector3::from(place)
        };
        let trocars = std::array::from_fn(trocar);
        let written = scene.script_or_rest().into_owned();
        Rehearsal {
            written,
            script: Script::new(scene),
            trocars,
            tremor: None,
            period_ns: rig.field_period_ns(),
        }
    }

    /// By cameras of another period than the rig's, ns.
    pub fn with_period(mut self, period_ns: u64) -> Self {
        self.period_ns = period_ns;
        self
    }

    /// With the tremor that the scene's script has, drawn from a seed.
    pub fn with_tremor(mut self, seed: u64) -> Self {
        let (um, hz) = (self.written.tremor_um, self.written.tremor_hz);
        self.tremor = Some(std::array::from_fn(|i| Tremor::new(um, hz, seed, i as u64)));
        self
    }

    /// Fields in a round of the script, retries so far included.
    pub fn fields(&self) -> u64 {
        (self.script.period_s() * 1e9) as u64 / self.period_ns
    }

    fn world_from_eye(&self, at_s: f64) -> Isometry3<f64> {
        let phase = at_s / self.written.period_s * std::f64::consts::TAU;
        let [about_x, about_y] = self.written.eye_turn_rad;
        let turn = Vector3::new(about_x * libm::sin(phase), about_y * libm::sin(2.0 * phase), 0.0);
        Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_scaled_axis(turn))
    }

    /// Tracker frame and handles of a field.
    pub fn field(&self, field: u64) -> (TrackerFrame, [HandleState; INSTRUMENTS]) {
        let at_s = (field * self.period_ns) as f64 * 1e-9;
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.frame) = (field, field);
        frame.instants.exposed = FIRST_NS + field * self.period_ns;
        let world_from_eye = self.world_from_eye(at_s);
        let mut gestures: [Gesture; INSTRUMENTS] = std::array::from_fn(|i| self.script.at(i, at_s));
        for (gesture, tremor) in gestures.iter_mut().zip(self.tremor.iter().flatten()) {
            gesture.tip_in_eye_mm += tremor.at(at_s);
        }
        for (i, gesture) in gestures.iter().enumerate() {
            let pose = world_from_eye * gesture.eye_from_instrument(self.trocars[i]);
            frame.bodies[i].world_from_body = Pose::from_isometry(&pose);
        }
        frame.bodies[EYE].world_from_body = Pose::from_isometry(&world_from_eye);
        frame.bodies.iter_mut().for_each(|b| b.validity = Validity::Measured as u32);
        let handle = |i: usize| HandleState {
            seq: field * INSTRUMENTS as u64 + i as u64,
            field,
            instant_ns: frame.instants.exposed,
            instrument: i as u32,
            tool: gestures[i].tool as u32,
            jaw_rad: gestures[i].jaw_rad,
        };
        (frame, std::array::from_fn(handle))
    }

    /// Pedal state of a field.
    pub fn pedal(&self, field: u64) -> PedalState {
        let at_ns = field * self.period_ns;
        self.script.pedal_at(at_ns as f64 * 1e-9, field, FIRST_NS + at_ns)
    }

    /// Inputs of the simulation's step of a field.
    pub fn inputs(&self, field: u64) -> StepInputs {
        let (frame, handles) = self.field(field);
        StepInputs { frame: Box::new(frame), handles: handles.to_vec(), pedals: vec![self.pedal(field)] }
    }

    /// Feeds back the scene after a field, where the script reacts to it then.
    pub fn see(&mut self, field: u64, perception: &dyn Perception) {
        let at_s = (field * self.period_ns) as f64 * 1e-9;
        if self.script.perceives_now(at_s) {
            self.script.see(at_s, perception);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::Message;

    #[test]
    fn what_tracker_and_hands_say_is_valid() {
        let scene = SceneFile::load("peel").unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        for field in 0..rehearsal.fields() {
            let (frame, handles) = rehearsal.field(field);
            frame.validate().unwrap();
            handles.iter().for_each(|h| h.validate().unwrap());
            rehearsal.pedal(field).validate().unwrap();
        }
    }
}
