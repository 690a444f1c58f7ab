//! How a script reacts to what the surgeon sees: keys `script.retargets` and `script.goal_checks`.
//! Without them a script is played blindly.

use super::{ScriptKey, ScriptScene};
use crate::{Defect, refuse, shown};
use protocol::limits::INSTRUMENTS;
use serde::{Deserialize, Serialize};

/// Two instants of a script closer than this are one, s: below a field's time, above rounding.
pub const SAME_INSTANT_S: f64 = 1e-4;

/// A movement that follows its target: at `at_s` its keys are shifted by the distance of the thing
/// seen from the place where the script expects it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Retarget {
    /// Instant of perception, s in the round.
    pub at_s: f64,
    /// The keys of the instrument after `at_s` and up to here are moved, s in the round.
    pub until_s: f64,
    /// 0 or 1.
    pub instrument: u32,
    /// Number of a rigid body; without it the target is the tissue nearest to the place.
    pub body: Option<u32>,
    /// Expected place, eye frame, mm.
    pub place_in_eye_mm: [f64; 3],
    /// Expected direction of a body's longest axis, eye frame; without it the instrument is not
    /// turned.
    pub along_in_eye: Option<[f64; 3]>,
    /// True if the jaws hold the thing and bring it to the place; else the tip goes to the thing.
    #[serde(default)]
    pub carries: bool,
}

/// A stretch of the script that ends with a check of its goal; missed, it is done again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalCheck {
    /// Instant of the check, s in the round.
    pub at_s: f64,
    /// Begin of the stretch, s in the round.
    pub from_s: f64,
    /// Number of the goal.
    pub goal: u32,
    /// The stretch as it is done the second time, the third, …; after the last the script goes on.
    #[serde(default, alias = "takes", skip_serializing_if = "Vec::is_empty")]
    pub retries: Vec<Retry>,
}

/// A stretch of the script, done again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Retry {
    /// In the place of the keys after `from_s` and up to `at_s`, at their instants.
    pub keys: Vec<ScriptKey>,
}

impl ScriptScene {
    /// True for a stretch inside the round.
    fn is_stretch(&self, from_s: f64, to_s: f64) -> bool {
        from_s >= 0.0 && from_s < to_s && to_s < self.period_s
    }

    /// First defect of the retargets in a scene with `bodies` rigid bodies: key, what was expected,
    /// what was found.
    pub(super) fn defect_of_retargets(&self, bodies: usize) -> Option<Defect> {
        let is_sound = |retarget: &Retarget| {
            let numbers = retarget.place_in_eye_mm.iter().chain(retarget.along_in_eye.iter().flatten());
            self.is_stretch(retarget.at_s, retarget.until_s)
                && (retarget.instrument as usize) < INSTRUMENTS
                && retarget.body.is_none_or(|b| (b as usize) < bodies)
                && { numbers }.all(|c| c.abs() <= 30.0)
        };
        let wrong = self.retargets.iter().position(|r| !is_sound(r))?;
        let expected = "at_s before until_s inside the period, instrument 0 or 1, a body of the scene, \
                        coordinates within 30 mm";
        refuse(format!("script.retargets[{wrong}]"), expected, shown(&self.retargets[wrong]))
    }

    /// First defect of the goal checks under a task with `goals` goals, as above.
    pub(super) fn defect_of_goal_checks(&self, goals: usize) -> Option<Defect> {
        for (i, check) in self.goal_checks.iter().enumerate() {
            let field = || format!("script.goal_checks[{i}]");
            if !self.is_stretch(check.from_s, check.at_s) || check.goal as usize >= goals {
                let expected = format!("from_s before at_s inside the period, one of {goals} goals");
                return refuse(field(), expected, shown(check));
            }
            let rests = |instrument: u32| {
                let at = |t: f64| {
                    let same = |k: &ScriptKey| (k.at_s - t).abs() < SAME_INSTANT_S;
                    self.keys.iter().any(|k| k.instrument == instrument && same(k))
                };
                at(check.from_s) && at(check.at_s)
            };
            if !(0..INSTRUMENTS as u32).all(rests) {
                let expected = "both instruments with a key at from_s and at at_s: they rest at a check";
                return refuse(field(), expected, format!("{} s, {} s", check.from_s, check.at_s));
            }
            let within = |k: &ScriptKey| {
                k.at_s > check.from_s + SAME_INSTANT_S && k.at_s < check.at_s + SAME_INSTANT_S && k.is_sound()
            };
            if let Some(key) = check.retries.iter().flat_map(|r| &r.keys).find(|k| !within(k)) {
                let expected = "keys after from_s and up to at_s, tip within 30 mm, jaw 0 to 3.2";
                return refuse(format!("{}.retries", field()), expected, shown(key));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SceneFile;

    #[test]
    fn odd_retargets_and_goal_checks_are_refused_by_name() {
        let mut scene = SceneFile::load("bodies").unwrap();
        let mut script = scene.script.clone().unwrap();
        let retarget = Retarget {
            at_s: 0.5,
            until_s: 1.0,
            instrument: 0,
            body: Some(0),
            place_in_eye_mm: [0.0, 0.0, -11.0],
            along_in_eye: None,
            carries: false,
        };
        let mut with = |script: &ScriptScene| {
            scene.script = Some(script.clone());
            SceneFile::parse(&scene.to_toml(), "s").map_err(|e| e.to_string())
        };
        script.retargets = vec![retarget.clone()];
        assert_eq!(with(&script).unwrap().script.as_ref(), Some(&script));
        script.retargets[0].body = Some(99);
        assert!(with(&script).unwrap_err().contains("script.retargets[0]"));
        script.retargets[0] = Retarget { until_s: 0.4, ..retarget };
        assert!(with(&script).unwrap_err().contains("script.retargets[0]"));
        script.retargets.clear();
        script.goal_checks = vec![GoalCheck { at_s: 1.0, from_s: 0.0, goal: 0, retries: vec![] }];
        assert!(with(&script).unwrap_err().contains("script.goal_checks[0]"), "no task, no goals");
    }

    #[test]
    fn the_former_keys_are_read() {
        let script: ScriptScene = toml::from_str(
            "period_s = 9.0\ntremor_um = 0.0\ntremor_hz = 9.0\neye_turn_rad = [0.0, 0.0]\nkeys = []\n\
             [[aims]]\nat_s = 0.5\nuntil_s = 1.0\ninstrument = 0\nplace_in_eye_mm = [0.0, 0.0, -11.0]\n\
             [[looks]]\nat_s = 1.0\nfrom_s = 0.5\ngoal = 0\ntakes = [{ keys = [] }]\n",
        )
        .unwrap();
        assert_eq!((script.retargets.len(), script.goal_checks[0].retries.len()), (1, 1));
    }
}
