//! What a trainee is asked to do in a scene: key `task`. A training module is composed into it, so
//! that one scene file (and with it every recording) says all that a run and its score depend on.

use super::{Defect, Range, refuse};
use protocol::events::EventKind;
use protocol::limits::INSTRUMENTS;
use serde::{Deserialize, Serialize};

/// Most goals of a task.
pub const MAX_GOALS: usize = 24;
/// Most points of a path to follow.
pub const MAX_PATH: usize = 32;

/// A task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskScene {
    /// Name of the module.
    pub module: String,
    /// Level, from 1 on.
    pub level: u32,
    /// One line for the picture.
    pub title: String,
    /// Time after which the attempt ends, s.
    pub limit_s: f64,
    /// Time that the plan of the module takes, s: what efficiency is measured by.
    pub par_s: f64,
    /// Way of the tips in the plan of the module, mm.
    pub par_mm: f64,
    /// Whether goals are reached in their order, or as the trainee likes.
    #[serde(default)]
    pub order: GoalOrder,
    /// What to read before and while working, a line each.
    #[serde(default)]
    pub instructions: Vec<String>,
    /// What to do.
    pub goals: Vec<Goal>,
}

/// In which order goals count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GoalOrder {
    /// One after the other.
    #[default]
    Sequence,
    /// Any goal that is open can be reached.
    Any,
}

/// One thing to do. Positions are in the eye frame, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Goal {
    /// Bring the tip of an instrument into a ball and keep it there.
    Hold {
        /// 0 or 1.
        instrument: u32,
        /// Centre.
        at_in_eye_mm: [f64; 3],
        /// Radius of the ball, mm.
        radius_mm: f64,
        /// How long without leaving, s.
        hold_s: f64,
    },
    /// Bring the tip near the retina over a point of it, without touching, and keep it there.
    Near {
        /// 0 or 1.
        instrument: u32,
        /// Direction from the eye's centre to the point; its length does not matter.
        towards_in_eye: [f64; 3],
        /// How far beside that line the tip may be, mm.
        radius_mm: f64,
        /// Least and greatest clearance from the retina, mm.
        clearance_mm: [f64; 2],
        /// How long without leaving, s.
        hold_s: f64,
    },
    /// Lead the tip along a path inside a tube, from its first point to its last.
    Follow {
        /// 0 or 1.
        instrument: u32,
        /// Corners of the path.
        path_in_eye_mm: Vec<[f64; 3]>,
        /// Radius of the tube, mm.
        radius_mm: f64,
    },
    /// Bring both tips to their places and keep them there at the same time.
    Align {
        /// Place of each tip.
        at_in_eye_mm: [[f64; 3]; INSTRUMENTS],
        /// How far each may be off, mm.
        radius_mm: f64,
        /// How long without leaving, s.
        hold_s: f64,
    },
    /// Grip a body.
    Grip {
        /// Number of the body.
        body: u32,
        /// 0 or 1.
        instrument: u32,
    },
    /// Put a body down at a place.
    Place {
        /// Number of the body.
        body: u32,
        /// Where its centre must be when no jaws hold it.
        at_in_eye_mm: [f64; 3],
        /// How far it may be off, mm.
        radius_mm: f64,
        /// Direction along which the body's longest axis must lie, either way, if that matters.
        along_in_eye: Option<[f64; 3]>,
        /// How far the axis may be off, rad.
        #[serde(default = "quarter_turn")]
        within_rad: f64,
    },
    /// Take vitreous away.
    Gel {
        /// In words, for the picture.
        what: String,
        /// Where.
        zone: GelZone,
        /// How much, ml.
        removed_ml: f64,
    },
    /// Bring the retina where it is to be.
    Retina {
        /// In words, for the picture.
        what: String,
        /// How far the retina that came off has turned, rad, either way: about the optic disc where
        /// the scene has one, else about the fovea.
        #[serde(default)]
        turned_rad: f64,
        /// At most this share of its nodes is off the choroid.
        #[serde(default = "whole")]
        loose_share: f64,
        /// For how long, s.
        #[serde(default)]
        hold_s: f64,
    },
    /// Wait for an event of the simulation whose figure comes to a value, or for a number of
    /// them.
    Event {
        /// Kind of event, by its name (or number) in `protocol::events::EVENTS`.
        event: EventKind,
        /// In words, for the picture.
        what: String,
        /// Least figure of the event, in its unit.
        #[serde(default)]
        at_least: f64,
        /// How many of them.
        #[serde(default = "one")]
        count: u32,
        /// In a sequence, what came before its turn counts too: for what stays once it is so.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        early: bool,
    },
}

/// A part of the vitreous, by where it lies at rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GelZone {
    /// Within [`CORE_MM`] of the eye's centre.
    Core,
    /// Beyond that, in front of [`PERIPHERY_FROM_Z_MM`].
    Periphery,
}

/// Radius of the vitreous' core, mm.
pub const CORE_MM: f64 = 7.0;
/// The periphery lies in front of this plane, z in the eye frame, mm.
pub const PERIPHERY_FROM_Z_MM: f64 = -6.0;

/// Whether a vector points anywhere; one that is not a number does not.
fn has_direction(along: &[f64; 3]) -> bool {
    along.iter().map(|c| c * c).sum::<f64>() > 1e-6
}

fn quarter_turn() -> f64 {
    std::f64::consts::FRAC_PI_2
}

fn whole() -> f64 {
    1.0
}

fn one() -> u32 {
    1
}

impl TaskScene {
    /// Its plain numbers with their allowed ranges, both ends included.
    pub(super) fn ranges(&self) -> Vec<Range> {
        vec![
            ("task.limit_s", self.limit_s, 1.0, 3600.0),
            ("task.par_s", self.par_s, 0.1, 3600.0),
            ("task.par_mm", self.par_mm, 0.0, 1e5),
        ]
    }

    /// The first inconsistency, for an eye of this radius (mm) with this many bodies.
    pub(super) fn defect(&self, radius_mm: f64, bodies: usize) -> Option<Defect> {
        let count = self.goals.len();
        if !(1..=MAX_GOALS).contains(&count) {
            return refuse("task.goals", format!("1 to {MAX_GOALS} goals"), count);
        }
        if self.level == 0 {
            return refuse("task.level", "1 or more", 0);
        }
        self.goals.iter().enumerate().find_map(|(i, goal)| {
            let (field, expected, found) = goal.defect(radius_mm, bodies)?;
            Some((format!("task.goals[{i}].{field}"), expected, found))
        })
    }
}

impl Goal {
    /// The instrument that must do it, if it names one.
    pub fn instrument(&self) -> Option<u32> {
        match self {
            Goal::Hold { instrument, .. }
            | Goal::Near { instrument, .. }
            | Goal::Follow { instrument, .. }
            | Goal::Grip { instrument, .. } => Some(*instrument),
            Goal::Align { .. } | Goal::Place { .. } => None,
            Goal::Event { .. } | Goal::Gel { .. } | Goal::Retina { .. } => None,
        }
    }

    /// How far off its place a tip or a body may be, mm, if the goal has a place.
    pub fn radius_mm(&self) -> Option<f64> {
        match self {
            Goal::Hold { radius_mm, .. }
            | Goal::Near { radius_mm, .. }
            | Goal::Follow { radius_mm, .. }
            | Goal::Align { radius_mm, .. }
            | Goal::Place { radius_mm, .. } => Some(*radius_mm),
            Goal::Grip { .. } | Goal::Event { .. } | Goal::Gel { .. } | Goal::Retina { .. } => None,
        }
    }

    /// Centres that must lie in the eye.
    fn places(&self) -> Vec<[f64; 3]> {
        match self {
            Goal::Hold { at_in_eye_mm, .. } | Goal::Place { at_in_eye_mm, .. } => vec![*at_in_eye_mm],
            Goal::Align { at_in_eye_mm, .. } => at_in_eye_mm.to_vec(),
            Goal::Follow { path_in_eye_mm, .. } => path_in_eye_mm.clone(),
            Goal::Near { .. } | Goal::Grip { .. } => Vec::new(),
            Goal::Event { .. } | Goal::Gel { .. } | Goal::Retina { .. } => Vec::new(),
        }
    }

    fn defect(&self, radius_mm: f64, bodies: usize) -> Option<Defect> {
        if let Some(i) = self.instrument().filter(|&i| i as usize >= INSTRUMENTS) {
            return refuse("instrument", "0 or 1", i);
        }
        // A sum that is not a number lies nowhere, so it must not pass as inside.
        let inside = |p: &[f64; 3]| p.iter().map(|c| c * c).sum::<f64>() <= radius_mm * radius_mm;
        if let Some(p) = self.places().iter().find(|p| !inside(p)) {
            let expected = format!("within {radius_mm} mm of the eye's centre");
            return refuse("at_in_eye_mm", expected, format!("{p:?}"));
        }
        if let Goal::Hold { hold_s, .. } | Goal::Near { hold_s, .. } | Goal::Align { hold_s, .. } = self
            && !(0.0..=60.0).contains(hold_s)
        {
            return refuse("hold_s", "0 to 60", hold_s);
        }
        if let Some(radius) = self.radius_mm().filter(|&r| !(r > 0.0 && r <= 30.0)) {
            return refuse("radius_mm", "above 0, at most 30", radius);
        }
        self.own_defect(radius_mm, bodies)
    }

    /// What is wrong with the keys that only goals of this kind have.
    fn own_defect(&self, radius_mm: f64, bodies: usize) -> Option<Defect> {
        match self {
            Goal::Near { towards_in_eye, clearance_mm: [low, high], .. } => {
                let length = towards_in_eye.iter().map(|c| c * c).sum::<f64>();
                if !(length > 1e-6 && length < 1e6) {
                    return refuse("towards_in_eye", "a direction", format!("{towards_in_eye:?}"));
                }
                let rises = *low >= 0.0 && low < high && *high <= radius_mm;
                if !rises {
                    let expected = "0 ≤ least < greatest ≤ the eye's radius";
                    return refuse("clearance_mm", expected, format!("[{low}, {high}]"));
                }
                None
            }
            Goal::Follow { path_in_eye_mm, .. } if !(2..=MAX_PATH).contains(&path_in_eye_mm.len()) => {
                refuse("path_in_eye_mm", format!("2 to {MAX_PATH} points"), path_in_eye_mm.len())
            }
            Goal::Grip { body, .. } | Goal::Place { body, .. } if *body as usize >= bodies => {
                refuse("body", format!("one of the scene's {bodies} bodies"), body)
            }
            Goal::Place { along_in_eye: Some(along), .. } if !has_direction(along) => {
                refuse("along_in_eye", "a direction", format!("{along:?}"))
            }
            Goal::Place { within_rad, .. } if !(*within_rad > 0.0 && *within_rad <= 3.2) => {
                refuse("within_rad", "above 0, at most 3.2", within_rad)
            }
            Goal::Event { at_least, .. } if !at_least.is_finite() => refuse("at_least", "a number", at_least),
            Goal::Gel { removed_ml, .. } if !(*removed_ml > 0.0 && *removed_ml <= 10.0) => {
                refuse("removed_ml", "above 0, at most 10", removed_ml)
            }
            Goal::Retina { turned_rad, .. } if !(0.0..=3.0).contains(turned_rad) => {
                refuse("turned_rad", "0 to 3", turned_rad)
            }
            Goal::Retina { loose_share, .. } if !(0.0..=1.0).contains(loose_share) => {
                refuse("loose_share", "0 to 1", loose_share)
            }
            Goal::Retina { hold_s, .. } if !(0.0..=60.0).contains(hold_s) => {
                refuse("hold_s", "0 to 60", hold_s)
            }
            Goal::Event { count: 0, .. } => refuse("count", "1 or more", 0),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::SceneFile;

    const TASK: &str = r#"
        [task]
        module = "m"
        level = 1
        title = "t"
        limit_s = 60.0
        par_s = 20.0
        par_mm = 30.0
        order = "any"
        [[task.goals]]
        kind = "hold"
        instrument = 0
        at_in_eye_mm = [1.0, 0.0, -6.0]
        radius_mm = 0.5
        hold_s = 1.0
        [[task.goals]]
        kind = "event"
        event = 61
        what = "membrane off"
    "#;

    fn parse(task: &str) -> Result<SceneFile, String> {
        let peel = SceneFile::load("peel").unwrap().to_toml();
        SceneFile::parse(&format!("{peel}\n{task}"), "s.toml").map_err(|e| e.to_string())
    }

    #[test]
    fn a_task_is_read_and_written_back() {
        let scene = parse(TASK).unwrap();
        assert_eq!(scene.task.as_ref().unwrap().goals.len(), 2);
        assert_eq!(SceneFile::parse(&scene.to_toml(), "again").unwrap(), scene);
    }

    #[test]
    fn what_contradicts_itself_is_refused_by_goal_and_field() {
        for (from, to, field) in [
            ("instrument = 0", "instrument = 2", "goals[0].instrument"),
            ("-6.0]", "-16.0]", "goals[0].at_in_eye_mm"),
            ("radius_mm = 0.5", "radius_mm = 0.0", "goals[0].radius_mm"),
            ("hold_s = 1.0", "hold_s = -1.0", "goals[0].hold_s"),
            ("event = 61", "event = 9999", "the name of an event"),
            ("event = 61", "event = \"retina.bleb\"", "the name of an event"),
            ("limit_s = 60.0", "limit_s = 0.0", "task.limit_s"),
            ("level = 1", "level = 0", "task.level"),
            ("what =", "whatever = 1\nwhat =", "whatever"),
            ("kind = \"event\"", "kind = \"dance\"", "dance"),
            (
                "kind = \"event\"\n        event = 61\n        what = \"membrane off\"",
                "kind = \"grip\"\ninstrument = 0\nbody = 0",
                "goals[1].body",
            ),
            (
                "kind = \"event\"\n        event = 61\n        what = \"membrane off\"",
                "kind = \"gel\"\nwhat = \"core\"\nzone = \"core\"\nremoved_ml = 0.0",
                "goals[1].removed_ml",
            ),
            (
                "kind = \"event\"\n        event = 61\n        what = \"membrane off\"",
                "kind = \"retina\"\nwhat = \"turn\"\nturned_rad = -0.5",
                "goals[1].turned_rad",
            ),
        ] {
            assert!(TASK.contains(from), "{from}");
            let problem = parse(&TASK.replace(from, to)).unwrap_err();
            assert!(problem.contains(field), "{problem}");
        }
    }
}
