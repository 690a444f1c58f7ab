//! Skill of a scripted surgeon: parameters of the error model that turns a plan into one attempt.
//!
//! A seed draws the errors of the attempt's key frames. Tremor is added when the script is played
//! ([`crate::tremor`]).

use crate::script::keys_of;
use nalgebra::Vector3;
use protocol::handles::PedalMode;
use protocol::random::Random;
use scene::{GoalCheck, PedalKey, Retarget, Retry, SAME_INSTANT_S, ScriptKey, ScriptScene};

/// Keys nearer to the retina than this have the depth bias, mm.
const DEPTH_FROM_MM: f64 = 3.0;
/// Movements shorter than this have neither deviation nor overshoot, mm.
const SHORT_MM: f64 = 0.6;
/// Standard deviation of the drift after an early release, on each axis, mm.
const DRIFT_MM: f64 = 1.0;
/// Longest overshoot, mm.
const OVERSHOOT_MM: f64 = 1.0;
/// Mean speed from which deviation and overshoot have their full share, mm/s. Below it they are
/// proportional to the mean speed, as the spread of a movement's end is (Schmidt et al. 1979,
/// Psychological Review 86(5), 415).
const FREE_MM_S: f64 = 3.0;
/// Length of the only movement of hands that rest, mm: more than begins an attempt.
const FIRST_MOVE_MM: f64 = 1.0;

/// Error model of a surgeon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skill {
    /// Name for people and programs.
    pub name: &'static str,
    /// Carries out the plan; else the hands rest after the first movement.
    pub works: bool,
    /// Duration as a multiple of the plan's.
    pub time_scale: f64,
    /// Standard deviation of the aim on each axis, mm.
    pub aim_sigma_mm: f64,
    /// Depth error near the retina, positive outwards: mean and standard deviation, mm.
    pub depth_bias_mm: [f64; 2],
    /// Mean overshoot of a movement as a share of its length.
    pub overshoot: f64,
    /// Standard deviation of a movement's middle from the straight line, as a share of its length.
    pub deviation: f64,
    /// Tremor of the tip, all axes together, µm RMS.
    pub tremor_um: f64,
    /// Probability that the instrument leaves a hold early.
    pub early_release_probability: f64,
    /// Twice the probability that closed jaws open during a movement.
    pub jaw_slip_probability: f64,
    /// Most retries of a stretch whose goal check fails.
    pub max_retries: u32,
}

/// Accurate, direct, on time.
pub const EXPERT: Skill = Skill {
    name: "expert",
    works: true,
    time_scale: 1.0,
    aim_sigma_mm: 0.03,
    depth_bias_mm: [0.0, 0.01],
    overshoot: 0.01,
    deviation: 0.01,
    tremor_um: 20.0,
    early_release_probability: 0.0,
    jaw_slip_probability: 0.0,
    max_retries: 3,
};

/// Moderate errors, slower than planned.
pub const AVERAGE: Skill = Skill {
    name: "average",
    works: true,
    time_scale: 1.6,
    aim_sigma_mm: 0.08,
    depth_bias_mm: [0.02, 0.03],
    overshoot: 0.06,
    deviation: 0.12,
    tremor_um: 55.0,
    early_release_probability: 0.03,
    jaw_slip_probability: 0.03,
    max_retries: 3,
};

/// Large errors, slow, little depth bias.
pub const NOVICE: Skill = Skill {
    name: "novice",
    works: true,
    time_scale: 2.1,
    aim_sigma_mm: 0.15,
    depth_bias_mm: [0.06, 0.06],
    overshoot: 0.12,
    deviation: 0.3,
    tremor_um: 85.0,
    early_release_probability: 0.12,
    jaw_slip_probability: 0.1,
    max_retries: 3,
};

/// Largest errors, fast, strong depth bias.
pub const CARELESS: Skill = Skill {
    name: "careless",
    works: true,
    time_scale: 0.7,
    aim_sigma_mm: 0.4,
    depth_bias_mm: [0.75, 0.2],
    overshoot: 0.25,
    deviation: 0.6,
    tremor_um: 130.0,
    early_release_probability: 0.5,
    jaw_slip_probability: 0.5,
    max_retries: 1,
};

/// One small movement, by which the attempt begins; then the hands rest until the time is over.
pub const IDLE: Skill = Skill {
    name: "idle",
    works: false,
    // Longer than the limit of any level, which is about three times its plan.
    time_scale: 6.0,
    aim_sigma_mm: 0.0,
    depth_bias_mm: [0.0, 0.0],
    overshoot: 0.0,
    deviation: 0.0,
    tremor_um: 20.0,
    early_release_probability: 0.0,
    jaw_slip_probability: 0.0,
    max_retries: 0,
};

/// Every shipped skill, best first.
pub const SKILLS: [Skill; 5] = [EXPERT, AVERAGE, NOVICE, CARELESS, IDLE];

/// There is no such surgeon.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("--surgeon: expected one of {}, found {found}", SKILLS.map(|skill| skill.name).join(", "))]
pub struct UnknownSkill {
    found: String,
}

/// The shipped skill of this name.
///
/// # Errors
/// For any other name.
pub fn named(name: &str) -> Result<Skill, UnknownSkill> {
    SKILLS.into_iter().find(|s| s.name == name).ok_or_else(|| UnknownSkill { found: name.into() })
}

/// A movement, or a hold, between two key frames of one instrument.
struct Movement<'a> {
    /// Planned keys at its ends.
    plan: [&'a ScriptKey; 2],
    /// Sampled aims at its ends, mm.
    aims: [Vector3<f64>; 2],
    /// The attempt's key at the beginning.
    start: ScriptKey,
    radius_mm: f64,
}

impl Movement<'_> {
    /// Planned duration, s.
    fn planned_s(&self) -> f64 {
        self.plan[1].at_s - self.plan[0].at_s
    }

    /// A key between the ends, after a share of the planned duration.
    fn key(&self, share: f64, tip: Vector3<f64>, jaw_rad: f64) -> ScriptKey {
        let at_s = self.plan[0].at_s + share * self.planned_s();
        let tip_in_eye_mm = kept_inside(tip, self.radius_mm).into();
        ScriptKey { at_s, tip_in_eye_mm, jaw_rad, tool: None, ..self.start.clone() }
    }
}

impl Skill {
    /// One attempt at a plan in an eye of radius `radius_mm`, drawn from a seed.
    pub fn perform(&self, plan: &ScriptScene, radius_mm: f64, seed: u64) -> ScriptScene {
        if !self.works {
            return self.rest(plan);
        }
        let mut random = Random::new(seed, 1);
        let mut keys = Vec::new();
        for instrument in [0, 1] {
            let own = keys_of(&plan.keys, instrument);
            keys.extend(self.instrument_keys(&own, radius_mm, &mut random));
        }
        let scale = self.time_scale;
        keys.iter_mut().for_each(|k| k.at_s *= scale);
        let retarget =
            |r: &Retarget| Retarget { at_s: r.at_s * scale, until_s: r.until_s * scale, ..r.clone() };
        let mut random = Random::new(seed, 2);
        let goal_check = |check: &GoalCheck| self.goal_check(check, plan, radius_mm, &mut random);
        ScriptScene {
            period_s: plan.period_s * scale,
            tremor_um: self.tremor_um,
            keys,
            pedal: self.pedal_keys(&plan.pedal),
            retargets: plan.retargets.iter().map(retarget).collect(),
            goal_checks: plan.goal_checks.iter().map(goal_check).collect(),
            ..plan.clone()
        }
    }

    /// Hands that rest where the plan begins, but for one movement towards the eye's centre and back.
    fn rest(&self, plan: &ScriptScene) -> ScriptScene {
        let mut keys = Vec::new();
        for first in [0, 1].into_iter().filter_map(|i| plan.first_key(i)) {
            let tip = Vector3::from(first.tip_in_eye_mm);
            let inwards = -tip.try_normalize(1e-6).unwrap_or(-Vector3::z()) * FIRST_MOVE_MM;
            let key =
                |at_s, tip: Vector3<f64>| ScriptKey { at_s, tip_in_eye_mm: tip.into(), ..first.clone() };
            keys.extend([key(0.0, tip), key(1.0, tip), key(2.0, tip + inwards), key(3.0, tip)]);
        }
        ScriptScene {
            period_s: plan.period_s * self.time_scale,
            tremor_um: self.tremor_um,
            keys,
            pedal: Vec::new(),
            retargets: Vec::new(),
            goal_checks: Vec::new(),
            ..plan.clone()
        }
    }

    /// A goal check with [`Skill::max_retries`] retries, each drawn independently from the same
    /// error model.
    fn goal_check(
        &self,
        check: &GoalCheck,
        plan: &ScriptScene,
        radius_mm: f64,
        random: &mut Random,
    ) -> GoalCheck {
        let (from_s, at_s) = (check.from_s, check.at_s);
        let within = |k: &&ScriptKey| k.at_s > from_s - SAME_INSTANT_S && k.at_s < at_s + SAME_INSTANT_S;
        let mut retry = || {
            let mut keys: Vec<ScriptKey> = Vec::new();
            for instrument in 0..2 {
                let own: Vec<_> = keys_of(&plan.keys, instrument).into_iter().filter(within).collect();
                // A retry begins where the instrument is then, not at the first key of the stretch.
                let drawn = self.instrument_keys(&own, radius_mm, random).into_iter();
                keys.extend(drawn.filter(|k| k.at_s > from_s + SAME_INSTANT_S));
            }
            keys.iter_mut().for_each(|k| k.at_s *= self.time_scale);
            Retry { keys }
        };
        let retries = (0..self.max_retries).map(|_| retry()).collect();
        GoalCheck { at_s: at_s * self.time_scale, from_s: from_s * self.time_scale, retries, ..check.clone() }
    }

    /// The pedal's keys in scaled time. An injection keeps its planned duration: it ends when the
    /// fluid is in.
    fn pedal_keys(&self, plan: &[PedalKey]) -> Vec<PedalKey> {
        let mut pedal = plan.to_vec();
        pedal.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let planned: Vec<f64> = pedal.iter().map(|key| key.at_s).collect();
        pedal.iter_mut().for_each(|key| key.at_s *= self.time_scale);
        for i in 1..pedal.len() {
            let before = &pedal[i - 1];
            if before.mode == PedalMode::Inject && before.axes[0] > 0.0 {
                pedal[i].at_s = before.at_s + planned[i] - planned[i - 1];
            }
        }
        pedal
    }

    /// Key frames of one instrument with their errors, in planned time.
    fn instrument_keys(&self, plan: &[&ScriptKey], radius_mm: f64, random: &mut Random) -> Vec<ScriptKey> {
        let aims = self.sample_aims(plan, radius_mm, random);
        let mut keys: Vec<ScriptKey> = Vec::new();
        for (i, key) in plan.iter().enumerate() {
            if let Some(start) = keys.last().cloned() {
                let (plan, aims) = ([plan[i - 1], *key], [aims[i - 1], aims[i]]);
                keys.extend(self.errors_between(&Movement { plan, aims, start, radius_mm }, random));
            }
            keys.push(ScriptKey { tip_in_eye_mm: aims[i].into(), ..(*key).clone() });
        }
        keys
    }

    /// Keys that errors add between two keys of the plan: deviation and overshoot of a movement,
    /// drift from a hold that is left early.
    fn errors_between(&self, movement: &Movement, random: &mut Random) -> Vec<ScriptKey> {
        let ([before, key], from) = (movement.plan, Vector3::from(movement.start.tip_in_eye_mm));
        let (path, jaw_rad) = (movement.aims[1] - movement.aims[0], movement.start.jaw_rad);
        if path.norm() > SHORT_MM {
            let speed_mm_s = path.norm() / (movement.planned_s() * self.time_scale).max(1e-3);
            let share = (speed_mm_s / FREE_MM_S).min(1.0);
            let deviation = random.vector() * (share * self.deviation * path.norm() / 3f64.sqrt());
            let keeps_shut = jaw_rad == key.jaw_rad && key.jaw_rad < 0.3;
            let opens = keeps_shut && random.chance(self.jaw_slip_probability * 0.5);
            let middle = from + path * 0.5 + deviation;
            let over = path * (share * self.overshoot * random.uniform() * 2.0);
            let over = over * (OVERSHOOT_MM / over.norm().max(OVERSHOOT_MM));
            vec![
                movement.key(0.45, middle, if opens { 0.9 } else { jaw_rad }),
                movement.key(0.8, movement.aims[1] + over, 0.5 * (jaw_rad + key.jaw_rad)),
            ]
        } else if path.norm() < 1e-9
            && key.at_s - before.at_s > 0.3
            && random.chance(self.early_release_probability)
        {
            let drift = random.vector() * DRIFT_MM;
            vec![movement.key(0.2, from, jaw_rad), movement.key(0.6, from + drift, jaw_rad)]
        } else {
            Vec::new()
        }
    }

    /// Aims of the keys, mm; successive keys at one place share their aim.
    fn sample_aims(&self, plan: &[&ScriptKey], radius_mm: f64, random: &mut Random) -> Vec<Vector3<f64>> {
        let mut aims: Vec<Vector3<f64>> = Vec::with_capacity(plan.len());
        for (i, key) in plan.iter().enumerate() {
            if i > 0 && plan[i - 1].tip_in_eye_mm == key.tip_in_eye_mm {
                aims.push(aims[i - 1]);
                continue;
            }
            let tip = Vector3::from(key.tip_in_eye_mm);
            let mut error = random.vector() * self.aim_sigma_mm;
            let [mean, sigma] = self.depth_bias_mm;
            let depth_error = mean + sigma * random.normal();
            if radius_mm - tip.norm() < DEPTH_FROM_MM {
                // Depth is judged by the instrument's shadow: its error replaces that of the aim.
                let out = tip.try_normalize(1e-6).unwrap_or(-Vector3::z());
                error += out * (depth_error - error.dot(&out));
            }
            aims.push(kept_inside(tip + error, radius_mm));
        }
        aims
    }
}

/// Tips go no further through the wall than this, mm.
const THROUGH_MM: f64 = 0.4;

/// `tip`, moved back to [`THROUGH_MM`] beyond the wall where it is further out.
fn kept_inside(tip: Vector3<f64>, radius_mm: f64) -> Vector3<f64> {
    let most = radius_mm + THROUGH_MM;
    if tip.norm() > most { tip * (most / tip.norm()) } else { tip }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::SceneFile;

    #[test]
    fn the_same_seed_makes_the_same_attempt_and_it_is_a_valid_script() {
        for name in ["peel", "relocation", "vitrectomy", "bodies"] {
            let scene = SceneFile::load(name).unwrap();
            for surgeon in SKILLS {
                let of = |seed| surgeon.perform(scene.script.as_ref().unwrap(), 11.5, seed);
                assert_eq!(of(3), of(3));
                assert_eq!(of(3) != of(4), surgeon.works);
                let performed = SceneFile { script: Some(of(3)), ..scene.clone() };
                SceneFile::parse(&performed.to_toml(), surgeon.name).unwrap();
            }
        }
    }

    #[test]
    fn idle_hands_move_once_and_press_nothing() {
        let scene = SceneFile::load("relocation").unwrap();
        let plan = scene.script.as_ref().unwrap();
        let idle = IDLE.perform(plan, 11.5, 1);
        assert!(idle.pedal.is_empty() && idle.goal_checks.is_empty() && idle.period_s > 5.0 * plan.period_s);
        assert!((crate::plan::path_mm(&idle.keys) - 4.0 * FIRST_MOVE_MM).abs() < 1e-9);
        assert!(idle.keys.iter().all(|k| k.at_s <= 3.0));
    }

    #[test]
    fn the_careless_go_further_and_deeper_than_the_expert() {
        let scene = SceneFile::load("peel").unwrap();
        let script = scene.script.as_ref().unwrap();
        let deepest = |s: Skill| {
            let of = |seed| {
                s.perform(script, 11.5, seed)
                    .keys
                    .iter()
                    .map(|k| Vector3::from(k.tip_in_eye_mm).norm())
                    .fold(0.0, f64::max)
            };
            (0..20).map(of).sum::<f64>() / 20.0
        };
        let way = |s: Skill| crate::plan::path_mm(&s.perform(script, 11.5, 1).keys);
        assert!(deepest(CARELESS) > deepest(EXPERT) + 0.3);
        assert!(way(CARELESS) > 1.2 * way(EXPERT));
    }

    #[test]
    fn an_injection_lasts_as_long_as_planned_and_all_else_follows_the_pace() {
        let plan = SceneFile::load("relocation").unwrap().script.unwrap();
        let novice = NOVICE.perform(&plan, 11.5, 1);
        for (own, planned) in novice.pedal.windows(2).zip(plan.pedal.windows(2)) {
            let [lasts, should] = [own, planned].map(|w| w[1].at_s - w[0].at_s);
            if planned[0].mode == PedalMode::Inject {
                assert!((lasts - should).abs() < 1e-9, "{lasts} s instead of {should} s");
                assert!((own[0].at_s - NOVICE.time_scale * planned[0].at_s).abs() < 1e-9);
            }
        }
    }
}
