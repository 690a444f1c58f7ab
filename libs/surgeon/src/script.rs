//! Motion of the scripted surgeon: key frames joined by minimum-jerk movements, tool changes,
//! pedal.
//!
//! The virtual rig plays it live, a rehearsal without cameras. Both feed back what the surgeon
//! perceives ([`Script::see`]).

mod perception;

pub use perception::{LOOK_AHEAD_S, PerceivedBody, Perception};

use nalgebra::{Isometry3, Vector3};
use perception::Reactions;
use protocol::geometry::shaft_pose;
use protocol::handles::{PedalMode, PedalState, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;
use scene::{PedalKey, SceneFile, ScriptKey};
use serde::{Deserialize, Serialize};

/// Commanded state of one instrument at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gesture {
    /// Tip in the eye frame, mm.
    #[serde(with = "as_array")]
    pub tip_in_eye_mm: Vector3<f64>,
    /// Turn about the shaft, rad.
    pub roll_rad: f64,
    /// Jaw opening, rad.
    pub jaw_rad: f64,
    /// Tool of the instrument.
    pub tool: Tool,
}

impl Gesture {
    fn of(key: &ScriptKey, tool: Tool) -> Self {
        Gesture {
            tip_in_eye_mm: Vector3::from(key.tip_in_eye_mm),
            roll_rad: key.roll_rad,
            jaw_rad: key.jaw_rad,
            tool,
        }
    }

    /// The share `share` of the way to another; the tool stays until the way is done.
    fn towards(&self, to: &Gesture, share: f64) -> Gesture {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        Gesture {
            tip_in_eye_mm: self.tip_in_eye_mm.lerp(&to.tip_in_eye_mm, share),
            roll_rad: mix(self.roll_rad, to.roll_rad),
            jaw_rad: mix(self.jaw_rad, to.jaw_rad),
            tool: self.tool,
        }
    }

    /// `eye_from_instrument` of the shaft through its trocar.
    pub fn eye_from_instrument(&self, trocar_in_eye_mm: Vector3<f64>) -> Isometry3<f64> {
        shaft_pose(&self.tip_in_eye_mm, &trocar_in_eye_mm, self.roll_rad)
    }
}

/// The movements of all instruments; a round is repeated without a jump. Written to a file and read
/// again it goes on as it stood, with the reactions so far.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Script {
    period_s: f64,
    /// Sorted by instant; never empty for a checked scene.
    keys: [Vec<(f64, Gesture)>; INSTRUMENTS],
    /// Sorted by instant.
    pedal: Vec<PedalKey>,
    /// Reactions to perception; they change later keys.
    reactions: Reactions,
}

impl Script {
    /// The script of a checked scene; instruments at rest where it has none.
    pub fn new(scene: &SceneFile) -> Self {
        let script = scene.script_or_rest();
        let own = |instrument: usize| {
            // A round begins with the tool of the scene.
            let tool = scene.instruments[instrument].tool;
            gestures(&script.keys, instrument, tool).collect()
        };
        let mut pedal = script.pedal.clone();
        pedal.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        Script {
            period_s: script.period_s,
            keys: std::array::from_fn(own),
            pedal,
            reactions: Reactions::of(&script),
        }
    }

    /// Length of a round, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    fn within_round(&self, t_s: f64) -> f64 {
        t_s - libm::floor(t_s / self.period_s) * self.period_s
    }

    /// Gesture of an instrument `t_s` seconds after the start.
    pub fn at(&self, instrument: usize, t_s: f64) -> Gesture {
        let keys = &self.keys[instrument];
        let t = self.within_round(t_s);
        let after = keys.partition_point(|(at, _)| *at <= t);
        let (from_s, from) = match after {
            0 => (keys[keys.len() - 1].0 - self.period_s, &keys[keys.len() - 1].1),
            i => (keys[i - 1].0, &keys[i - 1].1),
        };
        let (to_s, to) = match keys.get(after) {
            Some((at, gesture)) => (*at, gesture),
            None => (keys[0].0 + self.period_s, &keys[0].1),
        };
        if to_s <= from_s {
            return *from;
        }
        from.towards(to, minimum_jerk((t - from_s) / (to_s - from_s)))
    }

    /// Pedal state `t_s` seconds after the start, as message `seq` of the instant `instant_ns`:
    /// that of the last key, at rest without keys.
    pub fn pedal_at(&self, t_s: f64, seq: u64, instant_ns: Nanos) -> PedalState {
        let after = self.pedal.partition_point(|k| k.at_s <= self.within_round(t_s));
        let last = if after > 0 { self.pedal.get(after - 1) } else { self.pedal.last() };
        let (mode, axes) = last.map_or((PedalMode::Move, [0.0; 2]), |k| (k.mode, k.axes));
        let buttons = last.map_or(0, |k| k.buttons.iter().fold(0, |bits, &b| bits | b as u32));
        PedalState { seq, instant_ns, axes, buttons, mode: mode as u32 }
    }

    /// Mean of an instrument's key positions, mm in the eye frame.
    pub fn mean_tip_in_eye_mm(&self, instrument: usize) -> Vector3<f64> {
        let keys = &self.keys[instrument];
        keys.iter().map(|(_, g)| g.tip_in_eye_mm).sum::<Vector3<f64>>() / keys.len() as f64
    }
}

/// A place as three numbers, in files.
mod as_array {
    use super::{Deserialize, Serialize, Vector3};
    use serde::{Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(place: &Vector3<f64>, to: S) -> Result<S::Ok, S::Error> {
        <[f64; 3]>::from(*place).serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vector3<f64>, D::Error> {
        Ok(Vector3::from(<[f64; 3]>::deserialize(from)?))
    }
}

/// Keys of one instrument by time.
pub(crate) fn keys_of(keys: &[ScriptKey], instrument: usize) -> Vec<&ScriptKey> {
    let mut own: Vec<_> = keys.iter().filter(|k| k.instrument as usize == instrument).collect();
    own.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    own
}

/// Gestures of one instrument at the instants of its keys, with `tool` until a key names another.
fn gestures(keys: &[ScriptKey], instrument: usize, mut tool: Tool) -> impl Iterator<Item = (f64, Gesture)> {
    keys_of(keys, instrument).into_iter().map(move |key| {
        tool = key.tool.unwrap_or(tool);
        (key.at_s, Gesture::of(key, tool))
    })
}

/// Share of a reaching movement done after the share `s` of its time: the smoothest way from rest
/// to rest (Flash and Hogan 1985, J. Neurosci. 5(7), 1688).
pub fn minimum_jerk(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use protocol::optics::PedalButton;
    use scene::DEFAULT_SCENE;

    fn script() -> (Script, SceneFile) {
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
        (Script::new(&scene), scene)
    }

    #[test]
    fn keys_are_passed_in_every_round() {
        let (script, scene) = script();
        let written = scene.script.unwrap();
        for key in &written.keys {
            for round in 0..3 {
                let t = key.at_s + f64::from(round) * written.period_s;
                let gesture = script.at(key.instrument as usize, t);
                assert!((gesture.tip_in_eye_mm - Vector3::from(key.tip_in_eye_mm)).norm() < 1e-9);
                assert!((gesture.jaw_rad - key.jaw_rad).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn one_key_stands_still_and_two_keys_at_one_instant_do_no_harm() {
        let (_, mut scene) = script();
        let keys = &mut scene.script.as_mut().unwrap().keys;
        keys.retain(|k| k.instrument == 1);
        keys.truncate(1);
        keys.push(ScriptKey { instrument: 0, ..keys[0].clone() });
        keys.push(ScriptKey { instrument: 0, roll_rad: 1.0, ..keys[0].clone() });
        let script = Script::new(&scene);
        assert_eq!(script.at(1, 3.0), script.at(1, 11.0));
        assert!(script.at(0, 0.0).roll_rad.is_finite());
    }

    #[test]
    fn a_tool_stays_in_the_hand_until_a_key_names_another_and_each_round_begins_alike() {
        let (_, mut scene) = script();
        let named = |k: &&mut ScriptKey| k.instrument == 0 && k.at_s == 4.5;
        scene.script.as_mut().unwrap().keys.iter_mut().find(named).unwrap().tool = Some(Tool::Vitrector);
        let script = Script::new(&scene);
        for round in [0.0, 16.0, 32.0] {
            let tool = |at: f64| script.at(0, round + at).tool;
            assert_eq!([0.0, 4.4].map(tool), [Tool::Forceps; 2]);
            assert_eq!([4.51, 9.0, 15.9].map(tool), [Tool::Vitrector; 3]);
            assert_eq!(script.at(1, round + 9.0).tool, Tool::LightPipe);
        }
    }

    #[test]
    fn the_pedal_is_held_as_the_last_key_left_it() {
        let (_, mut scene) = script();
        assert_eq!(Script::new(&scene).pedal_at(3.0, 7, 9).mode, PedalMode::Move as u32);
        let key = |at_s: f64, mode, axes| PedalKey { at_s, mode, axes, buttons: vec![] };
        scene.script.as_mut().unwrap().pedal =
            vec![key(5.0, PedalMode::Aspirate, [0.5, 1.0]), key(2.0, PedalMode::Inject, [0.25, 0.0])];
        let scene = SceneFile::parse(&scene.to_toml(), "again").unwrap();
        let script = Script::new(&scene);
        let at = |t_s: f64| {
            let state = script.pedal_at(t_s, 7, 9);
            assert_eq!((state.seq, state.instant_ns), (7, 9));
            (state.mode, state.axes[0])
        };
        assert_eq!([1.0, 2.0, 4.9].map(at), [(2, 0.5), (3, 0.25), (3, 0.25)]);
        assert_eq!([5.0, 15.0, 17.0, 18.0].map(at), [(2, 0.5), (2, 0.5), (2, 0.5), (3, 0.25)]);
        let mut scene = scene;
        scene.script.as_mut().unwrap().pedal[1].buttons = vec![PedalButton::Lens, PedalButton::Filter];
        let script = Script::new(&SceneFile::parse(&scene.to_toml(), "again").unwrap());
        assert_eq!([1.0, 2.0, 5.0].map(|t_s| script.pedal_at(t_s, 7, 9).buttons), [0, 20, 0]);
    }

    #[test]
    fn a_shaft_passes_its_trocar_with_x_upwards() {
        let (script, _) = script();
        let trocar = Vector3::new(7.9, 4.5, 7.9);
        let gesture = script.at(0, 4.2);
        let pose = gesture.eye_from_instrument(trocar);
        let seen = pose.inverse_transform_point(&trocar.into());
        assert!(seen.x.abs() < 1e-9 && seen.y.abs() < 1e-9 && seen.z > 10.0);
        let x = pose.rotation * Vector3::x();
        assert!((pose.rotation * Vector3::y()).y.abs() < 1e-9 && x.y > 0.0, "no other roll has more of +y");
    }

    proptest! {
        #[test]
        fn movement_is_continuous(t in 0.0..100.0f64, instrument in 0usize..2) {
            let (script, _) = script();
            let step = script.at(instrument, t + 1e-4).tip_in_eye_mm - script.at(instrument, t).tip_in_eye_mm;
            prop_assert!(step.norm() < 1e-3, "10 mm/s at most, found {} in 0.1 ms", step.norm());
        }
    }
}
