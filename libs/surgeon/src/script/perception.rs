//! Reactions of the scripted surgeon: before a movement its target is perceived ([`Retarget`]),
//! after a stretch whether its goal is reached ([`GoalCheck`]).
//!
//! Reactions change only keys that have not been played, so that a script stays a function of time.

use super::{Script, gestures};
use nalgebra::Vector3;
use scene::{GoalCheck, PedalKey, Retarget, SAME_INSTANT_S, ScriptScene};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Time before a movement at which its target is perceived, s: more than a field, so that none of
/// the movement has been played.
pub const LOOK_AHEAD_S: f64 = 0.03;
/// Latest perception after its instant, s; the movement that it changes has hardly begun.
const LATE_S: f64 = 0.1;
/// A target further than this from its planned place is another one or lost, and the movement stays
/// as planned, mm.
const FAR_MM: f64 = 4.0;
/// The same for a body in the jaws, mm.
const FAR_IN_JAWS_MM: f64 = 1.2;

/// A rigid body as perceived, eye frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PerceivedBody {
    /// Its middle, mm.
    pub at_in_eye_mm: Vector3<f64>,
    /// Direction of its longest axis, the first of equals.
    pub along_in_eye: Vector3<f64>,
    /// Half of its length along that axis, mm.
    pub half_mm: f64,
    /// All sides are equal: the body is symmetric under a quarter turn.
    pub square: bool,
}

impl PerceivedBody {
    /// From its middle, the columns of its rotation and half its sides.
    pub fn new(at_in_eye_mm: Vector3<f64>, axes: [Vector3<f64>; 3], half_mm: [f64; 3]) -> Self {
        let [x, y, z] = half_mm;
        let longest = if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) };
        let square = (x - y).abs() < 1e-6 && (y - z).abs() < 1e-6;
        PerceivedBody { at_in_eye_mm, along_in_eye: axes[longest], half_mm: half_mm[longest], square }
    }
}

/// The surgeon's perception of the scene.
pub trait Perception {
    /// Whether a goal of the task is reached.
    fn reached(&self, goal: usize) -> bool;
    /// A rigid body of the scene.
    fn body(&self, number: usize) -> Option<PerceivedBody>;
    /// The free tissue of a membrane that is nearest to a place, eye frame, mm.
    fn tissue_near(&self, place_in_eye_mm: &Vector3<f64>) -> Option<Vector3<f64>>;
}

/// Pending reactions of a script.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Reactions {
    /// Retargets, and whether each is done; those of a repeated stretch become pending again.
    retargets: Vec<(Retarget, bool)>,
    /// Still to come.
    goal_checks: Vec<GoalCheck>,
}

impl Reactions {
    pub(super) fn of(script: &ScriptScene) -> Self {
        let mut goal_checks = script.goal_checks.clone();
        goal_checks.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        Reactions { retargets: script.retargets.iter().map(|a| (a.clone(), false)).collect(), goal_checks }
    }

    /// Drops overdue reactions: they would change keys that have been played.
    fn forget(&mut self, before_s: f64) {
        self.retargets.iter_mut().filter(|(a, _)| a.at_s < before_s).for_each(|(_, done)| *done = true);
        self.goal_checks.retain(|l| l.at_s >= before_s);
    }

    /// Takes the earliest pending retarget until an instant.
    fn next_retarget(&mut self, until_s: f64) -> Option<Retarget> {
        let due = self.retargets.iter_mut().filter(|(a, done)| !done && a.at_s <= until_s);
        let (retarget, done) = due.min_by(|(a, _), (b, _)| a.at_s.total_cmp(&b.at_s))?;
        *done = true;
        Some(retarget.clone())
    }
}

impl Script {
    /// True if the script reacts to perception.
    pub fn is_reactive(&self) -> bool {
        !self.reactions.retargets.is_empty() || !self.reactions.goal_checks.is_empty()
    }

    /// True if a reaction is due until [`LOOK_AHEAD_S`] after `now_s`; perception may be costly.
    pub fn perceives_now(&self, now_s: f64) -> bool {
        let due = |at_s: f64| at_s <= now_s + LOOK_AHEAD_S;
        self.reactions.retargets.iter().any(|(a, done)| !done && due(a.at_s))
            || self.reactions.goal_checks.iter().any(|l| due(l.at_s))
    }

    /// Carries out the reactions due, once all keys until `now_s` (s after the start) have been
    /// played.
    pub fn see(&mut self, now_s: f64, perception: &dyn Perception) {
        let until_s = now_s + LOOK_AHEAD_S;
        self.reactions.forget(now_s - LATE_S);
        // A retry comes before the retargets of what follows it.
        while self.reactions.goal_checks.first().is_some_and(|l| l.at_s <= until_s) {
            let check = self.reactions.goal_checks.remove(0);
            if !perception.reached(check.goal as usize) {
                self.insert_retry(check);
            }
        }
        while let Some(retarget) = self.reactions.next_retarget(until_s) {
            self.move_keys(&retarget, perception);
        }
    }

    /// Moves the keys of a retarget by the offset of its target from the planned place.
    fn move_keys(&mut self, retarget: &Retarget, perception: &dyn Perception) {
        let place = Vector3::from(retarget.place_in_eye_mm);
        let body = retarget.body.map(|b| perception.body(b as usize));
        let at = match body {
            Some(body) => body.map(|b| b.at_in_eye_mm),
            None => perception.tissue_near(&place),
        };
        let Some(off) = at.map(|at| at - place) else { return };
        let far = if retarget.carries { FAR_IN_JAWS_MM } else { FAR_MM };
        if off.norm() > far {
            return;
        }
        let sign = if retarget.carries { -1.0 } else { 1.0 };
        let turn = body.flatten().zip(retarget.along_in_eye).map_or(0.0, |(b, along)| b.turned_rad(&along));
        let (by, turn) = (off * sign, turn * sign);
        let droop_mm = body.flatten().filter(|_| retarget.carries).map_or(0.0, |b| b.droop_mm());
        let within = |t: f64| t > retarget.at_s + SAME_INSTANT_S && t < retarget.until_s + SAME_INSTANT_S;
        let Some(keys) = self.keys.get_mut(retarget.instrument as usize) else { return };
        for (_, gesture) in keys.iter_mut().filter(|(t, _)| within(*t)) {
            let (deep, tip) = (gesture.tip_in_eye_mm.norm(), gesture.tip_in_eye_mm + by);
            // Aside and up, but never deeper than was planned.
            let most = deep - droop_mm;
            gesture.tip_in_eye_mm = if tip.norm() > most { tip * (most / tip.norm()) } else { tip };
            gesture.roll_rad += turn;
        }
    }

    /// Inserts the next retry of a stretch; later keys are delayed by it.
    fn insert_retry(&mut self, mut check: GoalCheck) {
        if check.retries.is_empty() {
            return;
        }
        let retry = check.retries.remove(0);
        let (from_s, at_s, later_s) = (check.from_s, check.at_s, check.at_s - check.from_s);
        let after = |t: f64| t > at_s + SAME_INSTANT_S;
        let within = |t: f64| t > from_s + SAME_INSTANT_S && !after(t);
        for (instrument, keys) in self.keys.iter_mut().enumerate() {
            keys.iter_mut().filter(|(t, _)| after(*t)).for_each(|(t, _)| *t += later_s);
            let place = keys.partition_point(|(t, _)| !after(*t));
            // The tool is that at the begin of the stretch until a key names another.
            let before = keys[..place].iter().rev().find(|(t, _)| *t < from_s + SAME_INSTANT_S);
            let Some((_, before)) = before.or(keys[..place].first()) else { continue };
            let added = gestures(&retry.keys, instrument, before.tool);
            let added: Vec<_> = added.map(|(t, gesture)| (t + later_s, gesture)).collect();
            keys.splice(place..place, added);
        }
        self.pedal.iter_mut().filter(|k| after(k.at_s)).for_each(|k| k.at_s += later_s);
        let delayed = |k: &PedalKey| PedalKey { at_s: k.at_s + later_s, ..k.clone() };
        let pressed: Vec<PedalKey> = self.pedal.iter().filter(|k| within(k.at_s)).map(delayed).collect();
        self.pedal.extend(pressed);
        self.pedal.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        self.period_s += later_s;
        self.reactions.repeat(check, later_s);
    }
}

impl Reactions {
    /// Delays every reaction after a goal check, and schedules the check and its retargets again.
    fn repeat(&mut self, mut check: GoalCheck, later_s: f64) {
        let (from_s, at_s) = (check.from_s, check.at_s);
        let later =
            |a: &Retarget| Retarget { at_s: a.at_s + later_s, until_s: a.until_s + later_s, ..a.clone() };
        let of_stretch = |a: &Retarget| a.at_s > from_s - SAME_INSTANT_S && a.until_s < at_s + SAME_INSTANT_S;
        let retargets: Vec<_> =
            self.retargets.iter().filter(|(a, _)| of_stretch(a)).map(|(a, _)| (later(a), false)).collect();
        self.retargets
            .iter_mut()
            .filter(|(a, _)| a.at_s > at_s - SAME_INSTANT_S)
            .for_each(|(a, _)| *a = later(a));
        self.retargets.extend(retargets);
        // A stretch that began before is repeated as planned, without inserted retries.
        self.goal_checks.iter_mut().for_each(|l| postpone(l, later_s));
        postpone(&mut check, later_s);
        let place = self.goal_checks.partition_point(|l| l.at_s < check.at_s);
        self.goal_checks.insert(place, check);
    }
}

fn postpone(check: &mut GoalCheck, by_s: f64) {
    (check.from_s, check.at_s) = (check.from_s + by_s, check.at_s + by_s);
    check.retries.iter_mut().flat_map(|t| &mut t.keys).for_each(|k| k.at_s += by_s);
}

impl PerceivedBody {
    /// How much lower one end hangs than the middle, mm: so much higher it is let go.
    fn droop_mm(&self) -> f64 {
        let out = self.at_in_eye_mm.try_normalize(1e-6).unwrap_or(-Vector3::z());
        let slope = self.along_in_eye.dot(&out).abs();
        if self.square { 0.0 } else { self.half_mm * slope }
    }

    /// How far it is turned from a direction about the view, rad, the short way.
    fn turned_rad(&self, along: &[f64; 3]) -> f64 {
        let flat = self.along_in_eye.xy().norm();
        // A rod that stands upright points nowhere.
        if flat < 0.3 {
            return 0.0;
        }
        let turn = libm::atan2(self.along_in_eye.y, self.along_in_eye.x) - libm::atan2(along[1], along[0]);
        let alike = if self.square { FRAC_PI_2 } else { PI };
        turn - libm::round(turn / alike) * alike
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use scene::{Goal, GoalOrder, Retry, SceneFile, ScriptKey, TaskScene};

    struct Seen {
        reached: bool,
        body: Vector3<f64>,
    }

    impl Perception for Seen {
        fn reached(&self, _: usize) -> bool {
            self.reached
        }

        fn body(&self, _: usize) -> Option<PerceivedBody> {
            let axes = [Vector3::y(), -Vector3::x(), Vector3::z()];
            Some(PerceivedBody::new(self.body, axes, [0.6, 0.3, 0.3]))
        }

        fn tissue_near(&self, _: &Vector3<f64>) -> Option<Vector3<f64>> {
            None
        }
    }

    const PLACE: [f64; 3] = [1.0, 0.0, -10.0];

    fn key(at_s: f64, instrument: u32, x: f64) -> ScriptKey {
        ScriptKey {
            at_s,
            instrument,
            tip_in_eye_mm: [x, 0.0, -10.0],
            roll_rad: 0.0,
            jaw_rad: 0.0,
            tool: None,
        }
    }

    /// Instrument 0 goes to the place from 2 s to 4 s and away until 6 s.
    fn scene() -> SceneFile {
        let mut scene = SceneFile::load("bodies").unwrap();
        let script = scene.script.as_mut().unwrap();
        script.period_s = 8.0;
        let hand = [(0.0, 0.0), (2.0, 0.0), (4.0, 1.0), (6.0, 3.0)];
        script.keys = hand.iter().map(|(t, x)| key(*t, 0, *x)).collect();
        script.keys.extend([0.0, 2.0, 4.0, 6.0].map(|t| key(t, 1, -2.0)));
        script.retargets = vec![Retarget {
            at_s: 2.0,
            until_s: 4.0,
            instrument: 0,
            body: Some(0),
            place_in_eye_mm: PLACE,
            along_in_eye: Some([1.0, 0.0, 0.0]),
            carries: false,
        }];
        let take = Retry { keys: vec![key(4.0, 0, 1.1), key(4.0, 1, -2.0)] };
        script.goal_checks = vec![GoalCheck { at_s: 4.0, from_s: 2.0, goal: 0, retries: vec![take] }];
        scene.task = Some(TaskScene {
            module: "m".into(),
            level: 1,
            title: "t".into(),
            limit_s: 60.0,
            par_s: 1.0,
            par_mm: 1.0,
            order: GoalOrder::Any,
            instructions: Vec::new(),
            goals: vec![Goal::Grip { body: 0, instrument: 0 }],
        });
        SceneFile::parse(&scene.to_toml(), "s").unwrap()
    }

    fn played(seen: &Seen) -> Script {
        let mut script = Script::new(&scene());
        (0..500).for_each(|k| script.see(f64::from(k) * 0.02, seen));
        script
    }

    #[test]
    fn the_hand_goes_and_turns_to_where_the_body_lies() {
        let script = played(&Seen { reached: true, body: Vector3::new(1.0, 0.5, -9.9) });
        let there = script.at(0, 4.0);
        assert!((there.tip_in_eye_mm - Vector3::new(1.0, 0.5, -9.9)).norm() < 1e-9);
        assert!((there.roll_rad.abs() - FRAC_PI_2).abs() < 1e-9, "the rod lies across");
        assert!((script.at(0, 6.0).tip_in_eye_mm.x - 3.0).abs() < 1e-9, "afterwards as planned");
        assert!((script.period_s() - 8.0).abs() < 1e-12);
        let far = played(&Seen { reached: true, body: Vector3::new(9.0, 0.0, 0.0) });
        assert!((far.at(0, 4.0).tip_in_eye_mm - Vector3::from(PLACE)).norm() < 1e-9);
        let deep = played(&Seen { reached: true, body: Vector3::new(1.0, 0.0, -11.0) });
        assert!(deep.at(0, 4.0).tip_in_eye_mm.norm() < Vector3::from(PLACE).norm() + 1e-9);
    }

    #[test]
    fn what_was_missed_is_done_again_once_a_take_and_all_else_waits() {
        let script = played(&Seen { reached: false, body: Vector3::from(PLACE) });
        assert!((script.period_s() - 10.0).abs() < 1e-12, "two seconds longer");
        for (t, x) in [(4.0, 1.0), (6.0, 1.1), (8.0, 3.0)] {
            assert!((script.at(0, t).tip_in_eye_mm.x - x).abs() < 1e-9, "{t} s");
        }
        assert_eq!(script.keys[1].len(), 5);
    }

    #[test]
    fn a_script_that_was_kept_goes_on_as_it_stood() {
        let seen = Seen { reached: false, body: Vector3::new(1.0, 0.5, -9.9) };
        let mut script = Script::new(&scene());
        (0..150).for_each(|k| script.see(f64::from(k) * 0.02, &seen));
        let mut again: Script = serde_json::from_str(&serde_json::to_string(&script).unwrap()).unwrap();
        for k in 150..500 {
            let t = f64::from(k) * 0.02;
            script.see(t, &seen);
            again.see(t, &seen);
            for i in 0..2 {
                let off = script.at(i, t).tip_in_eye_mm - again.at(i, t).tip_in_eye_mm;
                assert!(off.norm() < 1e-9, "{t} s");
            }
        }
        assert!((script.period_s() - 10.0).abs() < 1e-9 && (again.period_s() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn the_pedal_is_pressed_again_with_the_stretch() {
        let mut scene = scene();
        let press = |at_s, x| PedalKey {
            at_s,
            mode: protocol::handles::PedalMode::Aspirate,
            axes: [x, 0.0],
            buttons: Vec::new(),
        };
        scene.script.as_mut().unwrap().pedal =
            vec![press(0.0, 0.0), press(2.5, 1.0), press(3.5, 0.0), press(5.0, 0.5)];
        let mut script = Script::new(&scene);
        let seen = Seen { reached: false, body: Vector3::from(PLACE) };
        (0..500).for_each(|k| script.see(f64::from(k) * 0.02, &seen));
        let at = |t: f64| script.pedal_at(t, 0, 0).axes[0];
        assert_eq!([2.6, 3.6, 4.6, 5.6, 6.9, 7.1].map(at), [1.0, 0.0, 1.0, 0.0, 0.0, 0.5]);
    }

    proptest! {
        /// Played keys stay, whatever is perceived.
        #[test]
        fn the_past_does_not_change(x in -1.0..1.0f64, y in -1.0..1.0f64, first in 0u32..40, reached: bool) {
            let mut script = Script::new(&scene());
            let seen = Seen { reached, body: Vector3::from(PLACE) + Vector3::new(x, y, 0.0) };
            let mut past = Vec::new();
            for k in 0..500u32 {
                let now_s = f64::from(k) * 0.02 + f64::from(first) * 5e-4;
                past.push((now_s, [0, 1].map(|i| script.at(i, now_s))));
                script.see(now_s, &seen);
            }
            for (t, gestures) in past.iter().filter(|(t, _)| *t < 7.9) {
                for (i, before) in gestures.iter().enumerate() {
                    let moved = (script.at(i, *t).tip_in_eye_mm - before.tip_in_eye_mm).norm();
                    prop_assert!(moved < 1e-9, "{} mm at {} s", moved, t);
                }
            }
        }
    }
}
