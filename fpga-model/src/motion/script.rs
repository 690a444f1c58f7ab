//! The scripted surgeon: key frames, joined by minimum-jerk movements.

use nalgebra::Vector3;
use protocol::limits::INSTRUMENTS;
use protocol::scene_file::{ScriptKey, ScriptScene};

/// What the script asks of one instrument at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gesture {
    /// Tip in the eye frame, mm.
    pub tip_in_eye_mm: Vector3<f64>,
    /// Turn about the shaft, rad.
    pub roll_rad: f64,
    /// Jaw opening, rad.
    pub jaw_rad: f64,
}

impl Gesture {
    fn of(key: &ScriptKey) -> Self {
        Gesture {
            tip_in_eye_mm: Vector3::from(key.tip_in_eye_mm),
            roll_rad: key.roll_rad,
            jaw_rad: key.jaw_rad,
        }
    }

    fn towards(&self, to: &Gesture, share: f64) -> Gesture {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        Gesture {
            tip_in_eye_mm: self.tip_in_eye_mm.lerp(&to.tip_in_eye_mm, share),
            roll_rad: mix(self.roll_rad, to.roll_rad),
            jaw_rad: mix(self.jaw_rad, to.jaw_rad),
        }
    }
}

/// The movements of all instruments; a round is repeated without a jump.
#[derive(Debug, Clone)]
pub struct Script {
    period_s: f64,
    /// Sorted by instant; never empty for a checked scene.
    keys: [Vec<(f64, Gesture)>; INSTRUMENTS],
}

impl Script {
    /// From a checked scene's script.
    pub fn new(scene: &ScriptScene) -> Self {
        let keys_of = |instrument: usize| {
            let own = scene.keys.iter().filter(|k| k.instrument as usize == instrument);
            let mut keys: Vec<_> = own.map(|k| (k.at_s, Gesture::of(k))).collect();
            keys.sort_by(|a, b| a.0.total_cmp(&b.0));
            keys
        };
        Script { period_s: scene.period_s, keys: std::array::from_fn(keys_of) }
    }

    /// Length of a round, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Gesture of an instrument `t_s` seconds after the start.
    pub fn at(&self, instrument: usize, t_s: f64) -> Gesture {
        let keys = &self.keys[instrument];
        let t = t_s - libm::floor(t_s / self.period_s) * self.period_s;
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

    /// Mean of an instrument's key positions, mm in the eye frame.
    pub fn mean_tip_in_eye_mm(&self, instrument: usize) -> Vector3<f64> {
        let keys = &self.keys[instrument];
        keys.iter().map(|(_, g)| g.tip_in_eye_mm).sum::<Vector3<f64>>() / keys.len() as f64
    }
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
    use protocol::scene_file::{DEFAULT_SCENE, SceneFile};

    fn script() -> (Script, ScriptScene) {
        let scene = SceneFile::load(DEFAULT_SCENE).unwrap().script;
        (Script::new(&scene), scene)
    }

    #[test]
    fn keys_are_passed_in_every_round() {
        let (script, scene) = script();
        for key in &scene.keys {
            for round in 0..3 {
                let t = key.at_s + f64::from(round) * scene.period_s;
                let gesture = script.at(key.instrument as usize, t);
                assert!((gesture.tip_in_eye_mm - Vector3::from(key.tip_in_eye_mm)).norm() < 1e-9);
                assert!((gesture.jaw_rad - key.jaw_rad).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn one_key_stands_still_and_two_keys_at_one_instant_do_no_harm() {
        let (_, mut scene) = script();
        scene.keys.retain(|k| k.instrument == 1);
        scene.keys.truncate(1);
        scene.keys.push(ScriptKey { instrument: 0, ..scene.keys[0].clone() });
        scene.keys.push(ScriptKey { instrument: 0, roll_rad: 1.0, ..scene.keys[0].clone() });
        let script = Script::new(&scene);
        assert_eq!(script.at(1, 3.0), script.at(1, 11.0));
        assert!(script.at(0, 0.0).roll_rad.is_finite());
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
