//! Where the scripted surgeon looks: keys `script.aims` and `script.looks`. Without them the hands are blind.

use super::{ScriptKey, ScriptScene};
use protocol::limits::INSTRUMENTS;
use serde::{Deserialize, Serialize};

/// Two instants of a script that lie so near to each other are one, s: below a field's time, above rounding.
pub const SAME_INSTANT_S: f64 = 1e-4;

/// Before a movement the surgeon looks where a thing is, and moves by how far it is from where the plan has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AimScene {
    /// When he looks, s in the round.
    pub at_s: f64,
    /// The keys of the instrument after `at_s` and up to here are moved, s in the round.
    pub until_s: f64,
    /// 0 or 1.
    pub instrument: u32,
    /// Number of a rigid body; without it the tissue that is nearest to the place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<u32>,
    /// Where the plan has it, eye frame, mm.
    pub place_in_eye_mm: [f64; 3],
    /// Along which direction of the eye the plan has a body's longest axis; without it the hand is not turned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub along_in_eye: Option<[f64; 3]>,
    /// The jaws hold the thing, which shall come to the place; else the tip shall come to the thing.
    #[serde(default)]
    pub carries: bool,
}

/// After a stretch of the script the surgeon looks whether a goal is reached, and does the stretch again if not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LookScene {
    /// When he looks, s in the round.
    pub at_s: f64,
    /// What is done again begins here, s in the round.
    pub from_s: f64,
    /// Number of the goal.
    pub goal: u32,
    /// How the hands do it again, the first time, the second, …: as often as there are takes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub takes: Vec<TakeScene>,
}

/// A stretch of the script, done again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TakeScene {
    /// In the place of the keys after `from_s` and up to `at_s`, at their instants.
    pub keys: Vec<ScriptKey>,
}

impl ScriptScene {
    /// What is wrong with aims and looks, if anything: key, what was expected, what was found. A task with so many goals, a scene
    /// with so many bodies.
    pub(super) fn defect_of_looks(&self, goals: usize, bodies: usize) -> Option<(String, String, String)> {
        let stretch = |from: f64, to: f64| from >= 0.0 && from < to && to < self.period_s;
        for (i, aim) in self.aims.iter().enumerate() {
            let there = aim.body.is_none_or(|b| (b as usize) < bodies);
            let along = aim.along_in_eye.iter().flatten();
            let numbers = aim.place_in_eye_mm.iter().chain(along).all(|c| c.abs() <= 30.0);
            if !stretch(aim.at_s, aim.until_s) || aim.instrument as usize >= INSTRUMENTS || !there || !numbers
            {
                let expected = "at_s before until_s inside the period, instrument 0 or 1, a body of the scene, \
                                coordinates within 30 mm";
                return Some((format!("script.aims[{i}]"), expected.into(), format!("{aim:?}")));
            }
        }
        for (i, look) in self.looks.iter().enumerate() {
            let field = || format!("script.looks[{i}]");
            if !stretch(look.from_s, look.at_s) || look.goal as usize >= goals {
                let expected = format!("from_s before at_s inside the period, one of {goals} goals");
                return Some((field(), expected, format!("{look:?}")));
            }
            let rests = |hand: u32| {
                let at = |t: f64| {
                    self.keys.iter().any(|k| k.instrument == hand && (k.at_s - t).abs() < SAME_INSTANT_S)
                };
                at(look.from_s) && at(look.at_s)
            };
            if !(0..INSTRUMENTS as u32).all(rests) {
                let expected = "both instruments with a key at from_s and at at_s: hands rest where he looks";
                return Some((field(), expected.into(), format!("{} s, {} s", look.from_s, look.at_s)));
            }
            let within = |k: &ScriptKey| {
                k.at_s > look.from_s + SAME_INSTANT_S && k.at_s < look.at_s + SAME_INSTANT_S && k.is_sound()
            };
            if let Some(key) = look.takes.iter().flat_map(|t| &t.keys).find(|k| !within(k)) {
                let expected = "keys after from_s and up to at_s, tip within 30 mm, jaw 0 to 3.2";
                return Some((format!("{}.takes", field()), expected.into(), format!("{key:?}")));
            }
        }
        None
    }
}

impl ScriptKey {
    /// Whether its numbers make sense.
    pub(super) fn is_sound(&self) -> bool {
        let numbers = self.tip_in_eye_mm.iter().all(|c| c.abs() <= 30.0) && self.roll_rad.abs() < 100.0;
        numbers && (self.instrument as usize) < INSTRUMENTS && (0.0..=3.2).contains(&self.jaw_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::super::SceneFile;
    use super::*;

    #[test]
    fn odd_aims_and_looks_are_refused_by_name() {
        let mut scene = SceneFile::load("bodies").unwrap();
        let aim = AimScene {
            at_s: 0.5,
            until_s: 1.0,
            instrument: 0,
            body: Some(0),
            place_in_eye_mm: [0.0, 0.0, -11.0],
            along_in_eye: None,
            carries: false,
        };
        scene.script.aims = vec![aim.clone()];
        let problem = |scene: &SceneFile| SceneFile::parse(&scene.to_toml(), "s").unwrap_err().to_string();
        assert_eq!(SceneFile::parse(&scene.to_toml(), "s").unwrap(), scene);
        scene.script.aims[0].body = Some(99);
        assert!(problem(&scene).contains("script.aims[0]"));
        scene.script.aims[0] = AimScene { until_s: 0.4, ..aim };
        assert!(problem(&scene).contains("script.aims[0]"));
        scene.script.aims.clear();
        scene.script.looks = vec![LookScene { at_s: 1.0, from_s: 0.0, goal: 0, takes: vec![] }];
        assert!(problem(&scene).contains("script.looks[0]"), "no task, no goals");
    }
}
