//! Plans of abstract tasks: a script that reaches every goal without a fault, derived from the
//! goals. An operation brings its own script.

use nalgebra::Vector3;
use protocol::limits::INSTRUMENTS;
use scene::{Goal, GoalCheck, Retarget, SceneFile, ScriptKey, ScriptScene, TaskScene};

/// Mean speed on the way to a goal, mm/s, and the time that is added to every movement, s.
const REACH_MM_S: f64 = 3.5;
const REACH_S: f64 = 0.5;
/// Mean speed along a path and close to the retina, mm/s.
const CAREFUL_MM_S: f64 = 1.2;
/// Margin of a hold over its required duration, s.
const HOLD_MORE_S: f64 = 0.4;
/// Height over a place at which an instrument arrives before it comes down, mm.
const ABOVE_MM: f64 = 1.6;
/// Depth of the jaws' tips below a body's middle, mm; a body gripped above its middle is squeezed
/// out.
const DEEPER_MM: f64 = 0.12;
/// Opening of the jaws before they grip and after they let go, rad.
const OPEN_RAD: f64 = 1.2;
/// Commanded opening of the gripping jaws, rad; a body between them stops them earlier.
const CLOSED_RAD: f64 = 0.1;
/// Time to close or open the jaws, s.
const JAWS_S: f64 = 1.0;
/// Rest over a place, in which the surgeon perceives how a body lies in the jaws, s.
const LOOK_S: f64 = 0.3;

/// Pose of an instrument at the end of the plan so far.
#[derive(Debug, Clone, Copy)]
struct PlannedPose {
    tip: Vector3<f64>,
    jaw_rad: f64,
    roll_rad: f64,
    at_s: f64,
}

struct Planner {
    keys: Vec<ScriptKey>,
    retargets: Vec<Retarget>,
    goal_checks: Vec<GoalCheck>,
    /// The body that was gripped last, and the instant at which the instrument set out for it, s.
    gripped: Option<(u32, f64)>,
    instruments: [PlannedPose; INSTRUMENTS],
    /// Where each body is when its turn comes.
    bodies: Vec<Vector3<f64>>,
    /// Longest axis of each at the start, eye frame.
    axes: Vec<Vector3<f64>>,
    radius_mm: f64,
}

/// The plan of a task in its scene; its last key joins its first. Instruments begin where the
/// scene's own script has them first; tremor and turn of the eye are that script's.
pub fn of_goals(scene: &SceneFile, task: &TaskScene) -> ScriptScene {
    let own = scene.script_or_rest();
    let start = |i: usize| {
        let key = own.first_key(i).expect("a checked script has a key for each instrument");
        let tip = Vector3::from(key.tip_in_eye_mm);
        PlannedPose { tip, jaw_rad: key.jaw_rad, roll_rad: 0.0, at_s: 0.0 }
    };
    let radius_mm = scene.eye.retina_radius_mm;
    let bodies = scene.bodies.iter().flat_map(|b| &b.body).map(|b| lying(b, radius_mm)).collect();
    let axes = scene.bodies.iter().flat_map(|b| &b.body).map(scene::BodyScene::longest_axis).collect();
    let mut planner = Planner {
        keys: Vec::new(),
        retargets: Vec::new(),
        goal_checks: Vec::new(),
        gripped: None,
        instruments: std::array::from_fn(start),
        bodies,
        axes,
        radius_mm,
    };
    (0..INSTRUMENTS).for_each(|i| planner.stay(i, 0.0));
    for (number, goal) in task.goals.iter().enumerate() {
        planner.reach(goal);
        planner.check_goal(number, goal);
    }
    (0..INSTRUMENTS).for_each(|i| planner.go(i, start(i).tip, REACH_MM_S));
    let period_s = planner.instruments.iter().map(|h| h.at_s).fold(0.0, f64::max) + 1.0;
    let Planner { mut keys, retargets, goal_checks, .. } = planner;
    keys.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    ScriptScene { keys, period_s, retargets, goal_checks, pedal: Vec::new(), ..own.into_owned() }
}

/// Place where a body comes to lie, eye frame, mm: on the retina, straight outwards.
fn lying(body: &scene::BodyScene, radius_mm: f64) -> Vector3<f64> {
    let at = Vector3::from(body.position_in_eye_mm);
    let lowest = body.half_extents_mm.iter().copied().fold(f64::INFINITY, f64::min);
    at.try_normalize(1e-6).map_or(at, |out| out * (radius_mm - lowest))
}

fn deeper(at: Vector3<f64>) -> Vector3<f64> {
    at * ((at.norm() + DEEPER_MM) / at.norm())
}

/// Length of the paths of both tips in a script, mm.
pub fn path_mm(keys: &[ScriptKey]) -> f64 {
    let of = |i: usize| {
        let own: Vec<_> = keys.iter().filter(|k| k.instrument as usize == i).collect();
        let step =
            |w: &[&ScriptKey]| (Vector3::from(w[1].tip_in_eye_mm) - Vector3::from(w[0].tip_in_eye_mm)).norm();
        own.windows(2).map(step).sum::<f64>()
    };
    (0..INSTRUMENTS).map(of).sum()
}

impl Planner {
    fn reach(&mut self, goal: &Goal) {
        match goal {
            Goal::Hold { instrument, at_in_eye_mm, hold_s, .. } => {
                let i = *instrument as usize;
                self.go(i, Vector3::from(*at_in_eye_mm), REACH_MM_S);
                self.stay(i, hold_s + HOLD_MORE_S);
            }
            Goal::Near { instrument, towards_in_eye, clearance_mm: [low, high], hold_s, .. } => {
                let i = *instrument as usize;
                let out = Vector3::from(*towards_in_eye).normalize();
                let at = |clearance: f64| out * (self.radius_mm - clearance);
                let (above, place) = (at(high + ABOVE_MM), at(0.5 * (low + high)));
                self.go(i, above, REACH_MM_S);
                self.go(i, place, CAREFUL_MM_S);
                self.stay(i, hold_s + HOLD_MORE_S);
                self.go(i, above, CAREFUL_MM_S);
            }
            Goal::Follow { instrument, path_in_eye_mm, .. } => {
                let i = *instrument as usize;
                self.go(i, Vector3::from(path_in_eye_mm[0]), REACH_MM_S);
                self.stay(i, HOLD_MORE_S);
                for p in &path_in_eye_mm[1..] {
                    self.go(i, Vector3::from(*p), CAREFUL_MM_S);
                }
                self.stay(i, HOLD_MORE_S);
            }
            Goal::Align { at_in_eye_mm, hold_s, .. } => {
                (0..INSTRUMENTS).for_each(|i| self.go(i, Vector3::from(at_in_eye_mm[i]), REACH_MM_S));
                self.meet();
                (0..INSTRUMENTS).for_each(|i| self.stay(i, hold_s + HOLD_MORE_S));
            }
            Goal::Grip { body, instrument } => self.grip(*instrument as usize, *body as usize),
            Goal::Place { body, at_in_eye_mm, along_in_eye, .. } => {
                self.place(*body as usize, Vector3::from(*at_in_eye_mm), *along_in_eye);
            }
            Goal::Event { .. } | Goal::Gel { .. } | Goal::Retina { .. } => {}
        }
        // The other instrument waits where it is.
        self.meet();
    }

    /// Adds a check of a grip or a place: a body that is not in its place is picked up again.
    fn check_goal(&mut self, number: usize, goal: &Goal) {
        let (Goal::Grip { body, .. } | Goal::Place { body, .. }) = goal else { return };
        let Some((_, from_s)) = self.gripped.filter(|(gripped, _)| gripped == body) else { return };
        let at_s = self.instruments[0].at_s;
        self.goal_checks.push(GoalCheck { at_s, from_s, goal: number as u32, retries: Vec::new() });
    }

    fn grip(&mut self, i: usize, body: usize) {
        let at = self.bodies[body];
        let above = self.above(at);
        self.jaws(i, OPEN_RAD);
        self.meet();
        let begin_s = self.instruments[i].at_s;
        self.gripped = Some((body as u32, begin_s));
        self.go(i, above, REACH_MM_S);
        self.go(i, deeper(at), CAREFUL_MM_S);
        self.jaws(i, CLOSED_RAD);
        self.stay(i, HOLD_MORE_S);
        let along_in_eye = Some(self.axes[body].into());
        self.retargets.push(Retarget {
            at_s: begin_s,
            until_s: self.instruments[i].at_s,
            instrument: i as u32,
            body: Some(body as u32),
            place_in_eye_mm: at.into(),
            along_in_eye,
            carries: false,
        });
    }

    /// Lets the instrument nearest to the body carry it.
    fn place(&mut self, body: usize, to: Vector3<f64>, along: Option<[f64; 3]>) {
        let turn_rad = along.map_or(0.0, |along| self.turn(body, &Vector3::from(along)));
        let from = self.bodies[body];
        let away = |h: &PlannedPose| (h.tip - from).norm();
        let i = if away(&self.instruments[0]) <= away(&self.instruments[1]) { 0 } else { 1 };
        if self.instruments[i].jaw_rad > CLOSED_RAD {
            self.grip(i, body);
        }
        let (lifted, over) = (self.above(from), self.above(to));
        self.go(i, lifted, CAREFUL_MM_S);
        self.instruments[i].roll_rad = turn_rad;
        self.go(i, over, REACH_MM_S);
        self.stay(i, LOOK_S);
        let over_s = self.instruments[i].at_s;
        self.go(i, deeper(to), CAREFUL_MM_S);
        self.stay(i, HOLD_MORE_S);
        self.jaws(i, OPEN_RAD);
        self.stay(i, HOLD_MORE_S);
        self.retargets.push(Retarget {
            at_s: over_s,
            until_s: self.instruments[i].at_s,
            instrument: i as u32,
            body: Some(body as u32),
            place_in_eye_mm: (over * ((over.norm() - DEEPER_MM) / over.norm())).into(),
            along_in_eye: along,
            carries: true,
        });
        self.go(i, over, CAREFUL_MM_S);
        self.instruments[i].roll_rad = 0.0;
        self.stay(i, JAWS_S);
        self.bodies[body] = to;
    }

    /// Roll that aligns a body with a direction, rad, within ±π/2; shafts are nearly upright in the
    /// eye.
    fn turn(&self, body: usize, along: &Vector3<f64>) -> f64 {
        let axis = self.axes[body];
        let angle = libm::atan2(along.y, along.x) - libm::atan2(axis.y, axis.x);
        let half = std::f64::consts::PI;
        angle - libm::round(angle / half) * half
    }

    fn above(&self, at: Vector3<f64>) -> Vector3<f64> {
        at * ((at.norm() - ABOVE_MM) / at.norm())
    }

    /// Lets both instruments wait for the later one.
    fn meet(&mut self) {
        let latest = self.instruments.iter().map(|h| h.at_s).fold(0.0, f64::max);
        for i in 0..INSTRUMENTS {
            let wait = latest - self.instruments[i].at_s;
            if wait > 0.0 {
                self.stay(i, wait);
                self.instruments[i].at_s = latest;
            }
        }
    }

    fn go(&mut self, i: usize, to: Vector3<f64>, mm_s: f64) {
        let way = (to - self.instruments[i].tip).norm();
        if way > 1e-9 {
            self.instruments[i].tip = to;
            self.stay(i, REACH_S + way / mm_s);
        }
    }

    fn jaws(&mut self, i: usize, rad: f64) {
        if self.instruments[i].jaw_rad != rad {
            self.instruments[i].jaw_rad = rad;
            self.stay(i, JAWS_S);
        }
    }

    /// Adds a key of the unchanged pose, `for_s` later.
    fn stay(&mut self, i: usize, for_s: f64) {
        let pose = &mut self.instruments[i];
        pose.at_s += for_s;
        self.keys.push(ScriptKey {
            at_s: pose.at_s,
            instrument: i as u32,
            tip_in_eye_mm: pose.tip.into(),
            roll_rad: pose.roll_rad,
            jaw_rad: pose.jaw_rad,
            tool: None,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::Script;
    use scene::GoalOrder;

    #[test]
    fn the_plan_is_where_the_goals_are_for_as_long_as_they_ask() {
        let mut scene = SceneFile::load("bodies").unwrap();
        let hold =
            |x| Goal::Hold { instrument: 0, at_in_eye_mm: [x, 0.0, -6.0], radius_mm: 0.3, hold_s: 1.0 };
        let task = TaskScene {
            module: "m".into(),
            level: 1,
            title: "t".into(),
            limit_s: 60.0,
            par_s: 1.0,
            par_mm: 1.0,
            order: GoalOrder::Sequence,
            instructions: Vec::new(),
            goals: vec![hold(2.0), Goal::Grip { body: 0, instrument: 0 }, hold(-2.0)],
        };
        let plan = of_goals(&scene, &task);
        scene.script = Some(plan.clone());
        let script = Script::new(&scene);
        for x in [2.0, -2.0] {
            let at = Vector3::new(x, 0.0, -6.0);
            let inside = (0..(plan.period_s * 50.0) as u32)
                .filter(|k| (script.at(0, f64::from(*k) * 0.02).tip_in_eye_mm - at).norm() < 0.3);
            assert!(inside.count() >= 50, "a second at {x}");
        }
        let body = Vector3::new(1.4, 0.3, -10.95).normalize() * 11.1;
        let closed = (0..(plan.period_s * 50.0) as u32).map(|k| script.at(0, f64::from(k) * 0.02));
        assert!(
            closed
                .into_iter()
                .any(|g| (g.tip_in_eye_mm - body).norm() < DEEPER_MM + 0.05 && g.jaw_rad < 0.15)
        );
        assert!(path_mm(&plan.keys) > 15.0);
        scene.task = Some(task);
        SceneFile::parse(&scene.to_toml(), "plan").expect("a plan is a valid script");
    }
}
