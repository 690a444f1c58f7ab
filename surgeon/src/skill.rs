//! Scripted surgeons: what a hand makes of a plan. Each is a set of parameters; with a seed it turns the plan's key frames into
//! those of one attempt. The tremor is added when the script is played ([`crate::tremor`]).

use nalgebra::Vector3;
use protocol::handles::PedalMode;
use protocol::random::Random;
use scene::{GoalCheck, PedalKey, Retarget, Retry, SAME_INSTANT_S, ScriptKey, ScriptScene};

/// Keys nearer to the retina than this are subject to the depth bias, mm.
const DEPTH_FROM_MM: f64 = 3.0;
/// Movements shorter than this have neither detours nor overshoots, mm.
const SHORT_MM: f64 = 0.6;
/// How far a hand wanders that leaves a hold too early, mm.
const WANDER_MM: f64 = 1.0;
/// Longest way over a goal, mm.
const OVERSHOOT_MM: f64 = 1.0;
/// Mean speed at which movements go astray and over their goals by the whole share, mm/s. The spread of a movement's end grows with
/// its mean speed (Schmidt et al. 1979, Psychological Review 86(5), 415): slow movements keep nearer to what is aimed at.
const FREE_MM_S: f64 = 3.0;

/// How a surgeon works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Skill {
    /// Name for people and programs.
    pub name: &'static str,
    /// Time taken, as a multiple of the plan's.
    pub pace: f64,
    /// Deviation of each coordinate of a place aimed at, mm.
    pub waver_mm: f64,
    /// How much too deep the hand is near the retina, mm: mean and deviation.
    pub depth_mm: [f64; 2],
    /// How far a movement shoots over its goal, as a share of its length.
    pub overshoot: f64,
    /// How far a movement goes astray on its way, as a share of its length.
    pub detour: f64,
    /// Tremor at the tip, all axes together, µm RMS.
    pub tremor_um: f64,
    /// Probability that a hold is left too early.
    pub hasty: f64,
    /// Probability that the jaws open on the way.
    pub slips: f64,
    /// How often what was missed is tried again.
    pub patience: u32,
}

/// Steady, direct, on time.
pub const EXPERT: Skill = Skill {
    name: "expert",
    pace: 1.0,
    waver_mm: 0.03,
    depth_mm: [0.0, 0.01],
    overshoot: 0.01,
    detour: 0.01,
    tremor_um: 20.0,
    hasty: 0.0,
    slips: 0.0,
    patience: 3,
};

/// A practised hand.
pub const AVERAGE: Skill = Skill {
    name: "average",
    pace: 1.6,
    waver_mm: 0.08,
    depth_mm: [0.02, 0.03],
    overshoot: 0.06,
    detour: 0.12,
    tremor_um: 55.0,
    hasty: 0.03,
    slips: 0.03,
    patience: 3,
};

/// Slow and unsure, but careful.
pub const NOVICE: Skill = Skill {
    name: "novice",
    pace: 2.1,
    waver_mm: 0.15,
    depth_mm: [0.06, 0.06],
    overshoot: 0.12,
    detour: 0.3,
    tremor_um: 85.0,
    hasty: 0.12,
    slips: 0.1,
    patience: 3,
};

/// Fast, rough, too deep.
pub const CARELESS: Skill = Skill {
    name: "careless",
    pace: 0.7,
    waver_mm: 0.4,
    depth_mm: [0.75, 0.2],
    overshoot: 0.25,
    detour: 0.6,
    tremor_um: 130.0,
    hasty: 0.5,
    slips: 0.5,
    patience: 1,
};

/// Every shipped one, best first.
pub const SKILLS: [Skill; 4] = [EXPERT, AVERAGE, NOVICE, CARELESS];

/// By name.
pub fn by_name(name: &str) -> Option<Skill> {
    SKILLS.into_iter().find(|s| s.name == name)
}

impl Skill {
    /// What this surgeon makes of a plan in an eye of this radius (mm), drawn from a seed.
    pub fn perform(&self, plan: &ScriptScene, radius_mm: f64, seed: u64) -> ScriptScene {
        let mut random = Random::new(seed, 1);
        let mut keys = Vec::new();
        for instrument in [0, 1] {
            let own: Vec<&ScriptKey> = sorted(plan, instrument);
            keys.extend(self.hand(&own, radius_mm, &mut random));
        }
        let pedal = self.foot(&plan.pedal);
        let period_s = plan.period_s * self.pace;
        keys.iter_mut().for_each(|k| k.at_s *= self.pace);
        let aim =
            |a: &Retarget| Retarget { at_s: a.at_s * self.pace, until_s: a.until_s * self.pace, ..a.clone() };
        let retargets = plan.retargets.iter().map(aim).collect();
        let mut random = Random::new(seed, 2);
        let goal_checks =
            plan.goal_checks.iter().map(|look| self.look(look, plan, radius_mm, &mut random)).collect();
        ScriptScene {
            period_s,
            tremor_um: self.tremor_um,
            keys,
            pedal,
            retargets,
            goal_checks,
            ..plan.clone()
        }
    }

    /// A look at this surgeon's pace, with as many takes as there is patience: each is drawn anew, none is better than the first.
    fn look(&self, look: &GoalCheck, plan: &ScriptScene, radius_mm: f64, random: &mut Random) -> GoalCheck {
        let (from_s, at_s) = (look.from_s, look.at_s);
        let within = |k: &&ScriptKey| k.at_s > from_s - SAME_INSTANT_S && k.at_s < at_s + SAME_INSTANT_S;
        let mut take = || {
            let mut keys: Vec<ScriptKey> = Vec::new();
            for instrument in 0..2 {
                let own: Vec<&ScriptKey> = sorted(plan, instrument).into_iter().filter(within).collect();
                // Where the hand was at first is not where it is now.
                let again = self.hand(&own, radius_mm, random).into_iter();
                keys.extend(again.filter(|k| k.at_s > from_s + SAME_INSTANT_S));
            }
            keys.iter_mut().for_each(|k| k.at_s *= self.pace);
            Retry { keys }
        };
        let retries = (0..self.patience).map(|_| take()).collect();
        GoalCheck { at_s: at_s * self.pace, from_s: from_s * self.pace, retries, ..look.clone() }
    }

    /// The foot at this surgeon's pace. An injection lasts as long as planned, whatever the pace: it is ended when the fluid is in.
    fn foot(&self, plan: &[PedalKey]) -> Vec<PedalKey> {
        let mut pedal = plan.to_vec();
        pedal.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let planned: Vec<f64> = pedal.iter().map(|key| key.at_s).collect();
        pedal.iter_mut().for_each(|key| key.at_s *= self.pace);
        for i in 1..pedal.len() {
            let before = &pedal[i - 1];
            if before.mode == PedalMode::Inject && before.axes[0] > 0.0 {
                pedal[i].at_s = before.at_s + planned[i] - planned[i - 1];
            }
        }
        pedal
    }

    /// One hand's keys, still at the plan's times.
    fn hand(&self, plan: &[&ScriptKey], radius_mm: f64, random: &mut Random) -> Vec<ScriptKey> {
        let aimed: Vec<Vector3<f64>> = self.aim(plan, radius_mm, random);
        let mut keys: Vec<ScriptKey> = Vec::new();
        for (i, key) in plan.iter().enumerate() {
            let here = ScriptKey { tip_in_eye_mm: aimed[i].into(), ..(*key).clone() };
            if i == 0 {
                keys.push(here);
                continue;
            }
            let before = keys[keys.len() - 1].clone();
            let (from, way) = (Vector3::from(before.tip_in_eye_mm), aimed[i] - aimed[i - 1]);
            let (begin_s, took_s) = (plan[i - 1].at_s, key.at_s - plan[i - 1].at_s);
            let mut between = |share: f64, tip: Vector3<f64>, jaw_rad: f64| {
                let at_s = begin_s + share * took_s;
                let tip_in_eye_mm = kept_inside(tip, radius_mm).into();
                keys.push(ScriptKey { at_s, tip_in_eye_mm, jaw_rad, tool: None, ..before.clone() });
            };
            let moves = way.norm() > SHORT_MM;
            let pace_mm_s = way.norm() / (took_s * self.pace).max(1e-3);
            let loose = (pace_mm_s / FREE_MM_S).min(1.0);
            let keeps_shut = before.jaw_rad == key.jaw_rad && key.jaw_rad < 0.3;
            if moves {
                let astray = random.vector() * (loose * self.detour * way.norm() / 3f64.sqrt());
                let opens = keeps_shut && random.chance(self.slips * 0.5);
                between(0.45, from + way * 0.5 + astray, if opens { 0.9 } else { before.jaw_rad });
                let over = way * (loose * self.overshoot * random.uniform() * 2.0);
                let over = over * (OVERSHOOT_MM / over.norm().max(OVERSHOOT_MM));
                let jaw_rad = 0.5 * (before.jaw_rad + key.jaw_rad);
                between(0.8, aimed[i] + over, jaw_rad);
            } else if way.norm() < 1e-9 && took_s > 0.3 && random.chance(self.hasty) {
                between(0.2, from, before.jaw_rad);
                between(0.6, from + random.vector() * WANDER_MM, before.jaw_rad);
            }
            keys.push(here);
        }
        keys
    }

    /// Where the keys are aimed at: keys at one place stay at one place.
    fn aim(&self, plan: &[&ScriptKey], radius_mm: f64, random: &mut Random) -> Vec<Vector3<f64>> {
        let mut aimed: Vec<Vector3<f64>> = Vec::with_capacity(plan.len());
        for (i, key) in plan.iter().enumerate() {
            if i > 0 && plan[i - 1].tip_in_eye_mm == key.tip_in_eye_mm {
                aimed.push(aimed[i - 1]);
                continue;
            }
            let tip = Vector3::from(key.tip_in_eye_mm);
            let mut astray = random.vector() * self.waver_mm;
            let [mean, spread] = self.depth_mm;
            let deeper = mean + spread * random.normal();
            if radius_mm - tip.norm() < DEPTH_FROM_MM {
                // How deep the hand goes there is judged by the shadow, which is another error than that of the aim.
                let out = tip.try_normalize(1e-6).unwrap_or(-Vector3::z());
                astray += out * (deeper - astray.dot(&out));
            }
            aimed.push(kept_inside(tip + astray, radius_mm));
        }
        aimed
    }
}

/// No hand goes further through the wall than this, mm.
const THROUGH_MM: f64 = 0.4;

fn kept_inside(tip: Vector3<f64>, radius_mm: f64) -> Vector3<f64> {
    let most = radius_mm + THROUGH_MM;
    if tip.norm() > most { tip * (most / tip.norm()) } else { tip }
}

fn sorted(plan: &ScriptScene, instrument: u32) -> Vec<&ScriptKey> {
    let mut own: Vec<&ScriptKey> = plan.keys.iter().filter(|k| k.instrument == instrument).collect();
    own.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    own
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
                assert_ne!(of(3), of(4));
                let performed = SceneFile { script: Some(of(3)), ..scene.clone() };
                SceneFile::parse(&performed.to_toml(), surgeon.name).unwrap();
            }
        }
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
                assert!((own[0].at_s - NOVICE.pace * planned[0].at_s).abs() < 1e-9);
            }
        }
    }
}
