//! The task as a state machine: goals are reached in sequence or in any order, within a limit of
//! time. Each step takes an [`Observation`] in and emits [`EventDraft`]s, which the simulation
//! numbers and publishes.

mod eye;
mod goal;

pub use eye::{LENS_HALF_MM, LENS_RADIUS_MM, lens_depth_mm};

use crate::sample::Tip;
use goal::{Check, GoalState};
use nalgebra::{Isometry3, Vector3};
use protocol::events::{Event, EventDraft, EventKind};
use protocol::handles::Tool;
use protocol::limits::{INSTRUMENTS, MAX_STEP_NS};
use protocol::time::Nanos;
use scene::{BodyScene, GoalOrder, SceneFile, TaskScene};
use serde::{Deserialize, Serialize};

/// Tips are smoothed with this time constant before distances from goals are averaged, s: tremor is
/// scored as tremor and not a second time as lack of aim.
const SMOOTHING_S: f64 = 0.1;
/// An attempt begins when a smoothed tip is this far from where it was first seen in the eye, mm:
/// beyond the tremor of a resting hand, which is below 0.2 mm.
const FIRST_MOVE_MM: f64 = 0.5;

/// State of a rigid body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyObservation {
    /// `eye_from_body`, mm.
    pub eye_from_body: Isometry3<f64>,
    /// The instrument whose jaws hold it.
    pub held_by: Option<u32>,
}

/// State of the retina.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetinaObservation {
    /// How far what came off has turned, rad.
    pub turned_rad: f64,
    /// Share of its nodes that are off the choroid.
    pub loose_share: f64,
}

/// What a step shows of the eye.
#[derive(Debug, Clone, Copy)]
pub struct Observation<'a> {
    /// Exposure of the step.
    pub now_ns: Nanos,
    /// Instruments that are tracked.
    pub tips: [Option<Tip>; INSTRUMENTS],
    /// What is in the hands, [`Tool`] on the wire.
    pub tools: [u32; INSTRUMENTS],
    /// Tips that are inside the retina.
    pub in_retina: [bool; INSTRUMENTS],
    /// The pedal is pressed for suction, injection or air.
    pub pressed: bool,
    /// The scene's bodies, in their order.
    pub bodies: &'a [BodyObservation],
    /// Vitreous removed from core and periphery, ml; only in the steps in which it was looked at.
    pub gel_ml: Option<[f64; 2]>,
    /// The retina, where the scene has it as tissue.
    pub retina: Option<RetinaObservation>,
    /// `world_from_eye`.
    pub world_from_eye: Isometry3<f64>,
    /// Point that the microscope looks at, world frame, mm.
    pub microscope_target_mm: [f64; 3],
    /// Diameter of its field of view, mm.
    pub field_mm: f64,
    /// What happened in the step.
    pub events: &'a [Event],
}

/// Phase of an attempt.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// No instrument has moved in the eye and the pedal has not been pressed.
    #[default]
    Waiting,
    /// Time runs.
    Running,
    /// Every goal is reached.
    Finished,
    /// The time was over before.
    TimedOut,
}

/// The attempt's state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskState {
    /// How far it is.
    pub phase: Phase,
    /// Begin; 0 before.
    pub begun_ns: Nanos,
    /// Exposure of the last step seen.
    pub last_ns: Nanos,
    /// One for each goal.
    pub goals: Vec<GoalState>,
    /// Smoothed tips, eye frame, mm.
    smooth_mm: [Option<Vector3<f64>>; INSTRUMENTS],
    /// Where each was first seen in the eye, eye frame, mm.
    rest_mm: [Option<Vector3<f64>>; INSTRUMENTS],
    /// Since when a tip has been out of view; 0 while in view.
    out_since_ns: [Nanos; INSTRUMENTS],
    /// Since when a shaft has been in the lens; 0 while clear.
    lens_since_ns: [Nanos; INSTRUMENTS],
}

impl TaskState {
    /// Goals that are reached.
    pub fn reached(&self) -> usize {
        self.goals.iter().filter(|g| g.reached).count()
    }

    /// Time since the begin, s.
    pub fn elapsed_s(&self) -> f64 {
        if self.begun_ns == 0 { 0.0 } else { self.last_ns.saturating_sub(self.begun_ns) as f64 * 1e-9 }
    }

    /// A pause, or another gap long enough that the simulation stood still: no clock of the attempt
    /// runs in it.
    fn skip_gap(&mut self, gap_ns: u64) {
        let clocks = self.out_since_ns.iter_mut().chain(&mut self.lens_since_ns).chain([&mut self.begun_ns]);
        clocks.filter(|since| **since > 0).for_each(|since| *since += gap_ns);
        self.goals.iter_mut().for_each(|goal| goal.skip_gap(gap_ns));
    }

    /// True if it could be the state of `task`: for checkpoints.
    pub fn fits(&self, task: &Task) -> bool {
        let points = self.smooth_mm.iter().chain(&self.rest_mm);
        let finite = points.flatten().all(|p| p.iter().all(|c| c.is_finite()));
        finite && self.goals.len() == task.scene.goals.len() && self.goals.iter().all(GoalState::is_sound)
    }
}

/// A task of a scene.
#[derive(Debug, Clone)]
pub struct Task {
    scene: TaskScene,
    radius_mm: f64,
    /// Back of the lens, z in the eye frame, mm.
    lens_back_mm: f64,
    /// Longest axis of each body, in its own frame.
    axes: Vec<Vector3<f64>>,
}

impl Task {
    /// The scene's task, if it has one.
    pub fn of(scene: &SceneFile) -> Option<Self> {
        let lens_back_mm = scene.vitreous.as_ref().map_or(eye::LENS_BACK_MM, |v| v.front_mm);
        let task = scene.task.clone()?;
        let axes = scene.bodies.iter().flat_map(|b| &b.body).map(BodyScene::longest_axis).collect();
        Some(Task { scene: task, radius_mm: scene.eye.retina_radius_mm, lens_back_mm, axes })
    }

    /// What was asked.
    pub fn scene(&self) -> &TaskScene {
        &self.scene
    }

    /// Before the first step.
    pub fn start(&self) -> TaskState {
        TaskState { goals: vec![GoalState::default(); self.scene.goals.len()], ..TaskState::default() }
    }

    /// True if goal `index` counts now.
    pub fn is_open(&self, state: &TaskState, index: usize) -> bool {
        let first = state.goals.iter().position(|g| !g.reached);
        match self.scene.order {
            GoalOrder::Sequence => first == Some(index),
            GoalOrder::Any => !state.goals[index].reached,
        }
    }

    /// Goes on by one step. Allocates nothing.
    pub fn advance(&self, state: &mut TaskState, seen: &Observation, emit: &mut dyn FnMut(EventDraft)) {
        let first = state.last_ns == 0;
        let gap_ns = if first { 0 } else { seen.now_ns.saturating_sub(state.last_ns) };
        state.last_ns = seen.now_ns;
        if gap_ns > MAX_STEP_NS {
            state.skip_gap(gap_ns);
        }
        let dt_s = if gap_ns > MAX_STEP_NS { 0.0 } else { gap_ns as f64 * 1e-9 };
        if matches!(state.phase, Phase::Finished | Phase::TimedOut) {
            return;
        }
        smooth(&mut state.smooth_mm, seen, if first { 0.0 } else { dt_s });
        if state.phase == Phase::Waiting {
            if !self.has_begun(state, seen) {
                return;
            }
            (state.phase, state.begun_ns) = (Phase::Running, seen.now_ns);
            emit(EventDraft::new(EventKind::TaskStarted, self.scene.limit_s));
        }
        self.watch_view(state, seen, emit);
        self.watch_lens(state, seen, emit);
        self.check_goals(state, seen, emit);
        self.end(state, emit);
    }

    /// Whether somebody works: a tip in the eye has moved, or the pedal is pressed.
    fn has_begun(&self, state: &mut TaskState, seen: &Observation) -> bool {
        let mut moved = false;
        for (i, smooth) in state.smooth_mm.iter().enumerate() {
            let Some(at) = smooth.filter(|at| at.norm() < self.radius_mm) else { continue };
            moved |= (at - *state.rest_mm[i].get_or_insert(at)).norm() > FIRST_MOVE_MM;
        }
        moved || (seen.pressed && state.rest_mm.iter().any(Option::is_some))
    }

    fn check_goals(&self, state: &mut TaskState, seen: &Observation, emit: &mut dyn FnMut(EventDraft)) {
        for index in 0..self.scene.goals.len() {
            if !self.is_open(state, index) && !state.goals[index].reached {
                state.goals[index].note_early(&self.scene.goals[index], seen.events);
            }
        }
        for index in 0..self.scene.goals.len() {
            if !self.is_open(state, index) {
                continue;
            }
            let check =
                Check { seen, smooth_mm: &state.smooth_mm, radius_mm: self.radius_mm, axes: &self.axes };
            let own = &mut state.goals[index];
            let before = own.tenths();
            check.advance(&self.scene.goals[index], own, index as u32, emit);
            if !own.reached && own.tenths() > before {
                let share = f64::from(own.tenths()) / 10.0;
                emit(EventDraft::new(EventKind::GoalProgress, share).about(index as u32));
            }
            if own.reached {
                let missed = own.mean_mm();
                emit(EventDraft::new(EventKind::GoalReached, missed).about(index as u32));
                // What reached this goal must not reach the next one, too.
                if self.scene.order == GoalOrder::Sequence {
                    return;
                }
            }
        }
    }

    fn end(&self, state: &mut TaskState, emit: &mut dyn FnMut(EventDraft)) {
        let (open, took_s) = (state.goals.len() - state.reached(), state.elapsed_s());
        let (phase, over) = if open == 0 {
            (Phase::Finished, EventDraft::new(EventKind::TaskFinished, took_s))
        } else if took_s >= self.scene.limit_s {
            (Phase::TimedOut, EventDraft::new(EventKind::TaskTimedOut, open as f64))
        } else {
            return;
        };
        state.phase = phase;
        emit(EventDraft { limit: self.scene.limit_s, ..over });
    }

    /// Emits when the tip of a working instrument leaves the picture and returns. The light is
    /// ignored.
    fn watch_view(&self, state: &mut TaskState, seen: &Observation, emit: &mut dyn FnMut(EventDraft)) {
        for i in 0..INSTRUMENTS {
            let inside = |t: &Tip| t.tip_in_eye_mm.norm() < self.radius_mm;
            let works = seen.tools[i] != Tool::LightPipe as u32;
            let Some(tip) = seen.tips[i].filter(inside).filter(|_| works) else { continue };
            let beyond = eye::beyond_view_mm(seen, &tip);
            let since = &mut state.out_since_ns[i];
            if beyond > 0.0 && *since == 0 {
                *since = seen.now_ns;
                emit(EventDraft::new(EventKind::TipOutOfView, beyond).by(i, tip.tip_in_eye_mm.into()));
            } else if beyond <= 0.0 && *since > 0 {
                let lasted_s = (seen.now_ns - *since) as f64 * 1e-9;
                *since = 0;
                emit(EventDraft::new(EventKind::TipInView, lasted_s).by(i, tip.tip_in_eye_mm.into()));
            }
        }
    }

    fn watch_lens(&self, state: &mut TaskState, seen: &Observation, emit: &mut dyn FnMut(EventDraft)) {
        for i in 0..INSTRUMENTS {
            let Some(tip) = seen.tips[i] else { continue };
            let (depth, since) = (lens_depth_mm(&tip, self.lens_back_mm), &mut state.lens_since_ns[i]);
            if depth > 0.0 && *since == 0 {
                *since = seen.now_ns;
                emit(EventDraft::new(EventKind::LensTouched, depth).by(i, tip.tip_in_eye_mm.into()));
            } else if depth <= -eye::LENS_CLEAR_MM && *since > 0 {
                let lasted_s = (seen.now_ns - *since) as f64 * 1e-9;
                *since = 0;
                emit(EventDraft::new(EventKind::LensLeft, lasted_s).by(i, tip.tip_in_eye_mm.into()));
            }
        }
    }
}

fn smooth(smooth_mm: &mut [Option<Vector3<f64>>; INSTRUMENTS], seen: &Observation, dt_s: f64) {
    let share = 1.0 - libm::exp(-dt_s / SMOOTHING_S);
    for (kept, tip) in smooth_mm.iter_mut().zip(&seen.tips) {
        *kept = match (*kept, tip) {
            (Some(old), Some(tip)) => Some(old + (tip.tip_in_eye_mm - old) * share),
            (None, Some(tip)) => Some(tip.tip_in_eye_mm),
            (_, None) => None,
        };
    }
}

#[cfg(test)]
mod tests;
