//! Plays a scene's script kinematically: perfect poses, no tremor, no noise, no clock. For tests, timing
//! and tuning of scenes; the live script with cameras and tremor is the camera hardware's.

use crate::world::{StepInput, StepReport, World};
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use protocol::geometry::{Pose, Validity};
use protocol::handles::HandleState;
use protocol::limits::{FIELD_PERIOD_NS, INSTRUMENTS};
use protocol::poses::{EYE, TrackerFrame};
use protocol::rig::Rig;
use protocol::scene_file::{SceneFile, ScriptKey};

/// Exposure of field 0, ns; instants of 0 mean "not yet".
const FIRST_NS: u64 = 1_000_000_000;

/// A script ready to be played.
#[derive(Debug, Clone)]
pub struct Rehearsal {
    scene: SceneFile,
    /// Where the shafts pass the eye's wall, eye frame, mm.
    trocars: [Vector3<f64>; INSTRUMENTS],
    keys: [Vec<ScriptKey>; INSTRUMENTS],
}

/// An instrument at an instant.
#[derive(Debug, Clone, Copy)]
struct Held {
    tip: Vector3<f64>,
    roll_rad: f64,
    jaw_rad: f64,
}

impl Rehearsal {
    /// The script of `scene` on the shipped rig.
    ///
    /// # Panics
    /// If the rig that is built in does not parse.
    pub fn shipped(scene: &SceneFile) -> Self {
        Self::new(scene, &Rig::load_or_shipped(None).expect("the shipped rig is tested"))
    }

    /// The script of `scene` with the trocars of `rig`.
    pub fn new(scene: &SceneFile, rig: &Rig) -> Self {
        let trocar = |i: usize| {
            let place = rig.trocars.get(i).map_or([0.0, 0.0, 10.0], |t| t.p_eye);
            Vector3::from(place)
        };
        let keys = |i: usize| {
            let mine = scene.script.keys.iter().filter(|k| k.instrument as usize == i);
            let mut keys: Vec<ScriptKey> = mine.cloned().collect();
            keys.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
            keys
        };
        let (trocars, keys) = (std::array::from_fn(trocar), std::array::from_fn(keys));
        Rehearsal { scene: scene.clone(), trocars, keys }
    }

    /// Fields in a round of the script.
    pub fn fields(&self) -> u64 {
        (self.scene.script.period_s * 1e9) as u64 / FIELD_PERIOD_NS
    }

    /// Between two keys the hand moves from rest to rest with the least jerk (Flash and Hogan 1985).
    fn held(&self, instrument: usize, at_s: f64) -> Held {
        let keys = &self.keys[instrument];
        let period = self.scene.script.period_s;
        let t = at_s % period;
        let next = keys.iter().position(|k| k.at_s > t).unwrap_or(0);
        let (a, b) = (&keys[(next + keys.len() - 1) % keys.len()], &keys[next]);
        let wrap = |s: f64| if s < 0.0 { s + period } else { s };
        let span = wrap(b.at_s - a.at_s);
        let u = if span > 0.0 { wrap(t - a.at_s) / span } else { 0.0 };
        let u = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        let mix = |a: f64, b: f64| a + (b - a) * u;
        Held {
            tip: Vector3::from(a.tip_in_eye_mm) * (1.0 - u) + Vector3::from(b.tip_in_eye_mm) * u,
            roll_rad: mix(a.roll_rad, b.roll_rad),
            jaw_rad: mix(a.jaw_rad, b.jaw_rad),
        }
    }

    fn eye_from_instrument(&self, instrument: usize, held: &Held) -> Isometry3<f64> {
        let z = (self.trocars[instrument] - held.tip).normalize();
        let x = Vector3::y().cross(&z).normalize();
        let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), held.roll_rad);
        Isometry3::from_parts(
            Translation3::from(held.tip),
            UnitQuaternion::from_rotation_matrix(&axes) * roll,
        )
    }

    fn world_from_eye(&self, at_s: f64) -> Isometry3<f64> {
        let phase = at_s / self.scene.script.period_s * std::f64::consts::TAU;
        let [about_x, about_y] = self.scene.script.eye_turn_rad;
        let turn = Vector3::new(about_x * libm::sin(phase), about_y * libm::sin(2.0 * phase), 0.0);
        Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_scaled_axis(turn))
    }

    /// What tracker and handles say at a field.
    pub fn field(&self, field: u64) -> (TrackerFrame, [HandleState; INSTRUMENTS]) {
        let at_s = (field * FIELD_PERIOD_NS) as f64 * 1e-9;
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.frame) = (field, field);
        frame.instants.exposed = FIRST_NS + field * FIELD_PERIOD_NS;
        let world_from_eye = self.world_from_eye(at_s);
        let held: [Held; INSTRUMENTS] = std::array::from_fn(|i| self.held(i, at_s));
        for (i, held) in held.iter().enumerate() {
            let pose = world_from_eye * self.eye_from_instrument(i, held);
            frame.bodies[i].world_from_body = Pose::from_isometry(&pose);
        }
        frame.bodies[EYE].world_from_body = Pose::from_isometry(&world_from_eye);
        frame.bodies.iter_mut().for_each(|b| b.validity = Validity::Measured as u32);
        let handle = |i: usize| HandleState {
            seq: field * INSTRUMENTS as u64 + i as u64,
            field,
            instant_ns: frame.instants.exposed,
            instrument: i as u32,
            tool: self.scene.instruments[i].tool as u32,
            jaw_rad: held[i].jaw_rad,
        };
        (frame, std::array::from_fn(handle))
    }

    /// Steps a world by one field.
    pub fn play(&self, world: &mut World, field: u64, clock: &mut dyn FnMut() -> u64) -> StepReport {
        let (frame, handles) = self.field(field);
        world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[] }, clock)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::Message;

    #[test]
    fn keys_are_met_and_poses_are_valid() {
        let scene = SceneFile::load("peel").unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        for key in &scene.script.keys {
            let held = rehearsal.held(key.instrument as usize, key.at_s);
            assert!((held.tip - Vector3::from(key.tip_in_eye_mm)).norm() < 1e-9);
        }
        for field in 0..rehearsal.fields() {
            let (frame, handles) = rehearsal.field(field);
            frame.validate().unwrap();
            handles.iter().for_each(|h| h.validate().unwrap());
        }
    }

    #[test]
    fn shafts_pass_their_trocars() {
        let scene = SceneFile::load("peel").unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        let held = rehearsal.held(0, 4.2);
        let pose = rehearsal.eye_from_instrument(0, &held);
        let trocar = pose.inverse_transform_point(&rehearsal.trocars[0].into());
        assert!(trocar.x.abs() < 1e-9 && trocar.y.abs() < 1e-9 && trocar.z > 10.0);
    }
}
