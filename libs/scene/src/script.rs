//! What a scripted surgeon does in a scene: table `script`. A scene needs none.

mod reactions;

pub use reactions::{GoalCheck, Retarget, Retry, SAME_INSTANT_S};

use crate::{Defect, Range, refuse, shown};
use protocol::handles::{PedalMode, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::optics::PedalButton;
use serde::{Deserialize, Serialize};

/// Tips of instruments at rest, eye frame, mm: in the middle of the eye, on the sides of their
/// trocars.
const REST_TIPS_MM: [[f64; 3]; INSTRUMENTS] = [[3.0, 0.0, -2.0], [-3.0, 0.0, -2.0]];

/// Movements of both instruments and of the pedal, repeated round after round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptScene {
    /// Length of a round, s; key frames lie inside it and the last joins the first.
    pub period_s: f64,
    /// Tremor of the tips held still, µm RMS (all axes together).
    pub tremor_um: f64,
    /// Centre of the tremor's band, Hz.
    pub tremor_hz: f64,
    /// Rotation of the eye by the shafts: amplitude about x and y, rad.
    pub eye_turn_rad: [f64; 2],
    /// Key frames of instrument 0 and 1.
    pub keys: Vec<ScriptKey>,
    /// States of the pedal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pedal: Vec<PedalKey>,
    /// Movements that aim at where a body or tissue is seen.
    #[serde(default, alias = "aims", skip_serializing_if = "Vec::is_empty")]
    pub retargets: Vec<Retarget>,
    /// Stretches that are done again where their goal is missed.
    #[serde(default, alias = "looks", skip_serializing_if = "Vec::is_empty")]
    pub goal_checks: Vec<GoalCheck>,
}

/// State of the pedal from an instant of the round until the next key; before the first key as
/// after the last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PedalKey {
    /// Instant in the round, s.
    pub at_s: f64,
    /// What the axes mean.
    pub mode: PedalMode,
    /// Two axes, −1 to 1.
    #[serde(default)]
    pub axes: [f64; 2],
    /// Buttons that are held.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub buttons: Vec<PedalButton>,
}

/// Pose of an instrument at an instant of the round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptKey {
    /// Instant in the round, s.
    pub at_s: f64,
    /// 0 or 1.
    pub instrument: u32,
    /// Tip in the eye frame, mm.
    pub tip_in_eye_mm: [f64; 3],
    /// Turn of the handle about the shaft, rad.
    #[serde(default)]
    pub roll_rad: f64,
    /// Jaw opening, rad.
    #[serde(default)]
    pub jaw_rad: f64,
    /// Tool in the hand from here on; without it the one before. A round begins with the
    /// instrument's own.
    pub tool: Option<Tool>,
}

impl ScriptScene {
    /// Instruments that rest with closed jaws; for scenes without a script.
    pub fn at_rest() -> Self {
        let key = |i: usize| ScriptKey {
            at_s: 0.0,
            instrument: i as u32,
            tip_in_eye_mm: REST_TIPS_MM[i],
            roll_rad: 0.0,
            jaw_rad: 0.0,
            tool: None,
        };
        ScriptScene {
            period_s: 10.0,
            tremor_um: 0.0,
            tremor_hz: 9.0,
            eye_turn_rad: [0.0; 2],
            keys: (0..INSTRUMENTS).map(key).collect(),
            pedal: Vec::new(),
            retargets: Vec::new(),
            goal_checks: Vec::new(),
        }
    }

    /// First key of an instrument; a checked script has one.
    pub fn first_key(&self, instrument: usize) -> Option<&ScriptKey> {
        let own = self.keys.iter().filter(|k| k.instrument as usize == instrument);
        own.min_by(|a, b| a.at_s.total_cmp(&b.at_s))
    }

    /// Plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> [Range; 5] {
        let turn = self.eye_turn_rad;
        [
            ("script.period_s", self.period_s, 0.1, 3600.0),
            ("script.tremor_um", self.tremor_um, 0.0, 5000.0),
            ("script.tremor_hz", self.tremor_hz, 0.1, 24.0),
            ("script.eye_turn_rad[0]", turn[0], -0.5, 0.5),
            ("script.eye_turn_rad[1]", turn[1], -0.5, 0.5),
        ]
    }

    /// First defect of keys and reactions, for a task with `goals` goals and a scene with `bodies`
    /// rigid bodies: key, what was expected, what was found.
    pub(super) fn defect(&self, goals: usize, bodies: usize) -> Option<Defect> {
        for (i, key) in self.keys.iter().enumerate() {
            if !(0.0..self.period_s).contains(&key.at_s) || !key.is_sound() {
                let expected = "instant inside the period, instrument 0 or 1, tip within 30 mm, jaw 0 to 3.2";
                return refuse(format!("script.keys[{i}]"), expected, shown(key));
            }
        }
        for (i, key) in self.pedal.iter().enumerate() {
            let inside = (0.0..self.period_s).contains(&key.at_s);
            if !inside || !key.axes.iter().all(|a| (-1.0..=1.0).contains(a)) {
                let expected = "instant inside the period, axes −1 to 1";
                return refuse(format!("script.pedal[{i}]"), expected, shown(key));
            }
        }
        if let Some(i) = (0..INSTRUMENTS).find(|&i| self.first_key(i).is_none()) {
            return refuse("script.keys", "a key for each instrument", format!("none for {i}"));
        }
        self.defect_of_retargets(bodies).or_else(|| self.defect_of_goal_checks(goals))
    }
}

impl ScriptKey {
    /// True if its numbers make sense.
    fn is_sound(&self) -> bool {
        let numbers = self.tip_in_eye_mm.iter().all(|c| c.abs() <= 30.0) && self.roll_rad.abs() < 100.0;
        numbers && (self.instrument as usize) < INSTRUMENTS && (0.0..=3.2).contains(&self.jaw_rad)
    }
}
