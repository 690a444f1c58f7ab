//! The task's share of a step: what it observes, its events, and the score when it ends. What
//! counts as done and how it is judged is decided in the crate `training`.

use super::World;
use super::plan::StepPlan;
use crate::bodies::state::BodiesState;
use crate::checkpoint::CheckpointError;
use crate::constants::GEL_EVERY;
use crate::state::State;
use collision::eyeball::RetinaLevel;
use nalgebra::{Isometry3, UnitVector3, Vector3};
use protocol::poses::TrackerFrame;
use scene::{CORE_MM, Goal, MAX_BODIES, PERIPHERY_FROM_Z_MM, SceneFile};
use tissue::retina::Retina;
use tissue::retina::state::RetinaState;
use tissue::vitreous::Vitreous;
use tissue::vitreous::lattice::Lattice;
use tissue::vitreous::state::VitreousState;
use training::sample::Sample;
use training::score::recording::is_over;
use training::score::{Meter, Scorer};
use training::task::{BodyObservation, Observation, RetinaObservation, Task, TaskState};

/// A scene's task at work.
#[derive(Debug)]
pub struct TaskPart {
    task: Task,
    scorer: Scorer,
    /// Elements of the vitreous' core and periphery, where a goal asks for them.
    zones: Option<[Vec<u32>; 2]>,
    /// A goal asks for the retina's place.
    asks_retina: bool,
}

impl TaskPart {
    /// Of a scene, if it has a task.
    pub fn of(scene: &SceneFile) -> Option<Self> {
        let task = Task::of(scene)?;
        let asks_retina = task.scene().goals.iter().any(|g| matches!(g, Goal::Retina { .. }));
        Some(TaskPart { task, scorer: Scorer::of(scene)?, zones: None, asks_retina })
    }

    /// With the zones of the vitreous, where a goal asks for them.
    pub fn with_gel(mut self, gel: Option<&Vitreous>) -> Self {
        let asks = self.task.scene().goals.iter().any(|g| matches!(g, Goal::Gel { .. }));
        self.zones = gel.filter(|_| asks).map(|gel| zones(gel.lattice()));
        self
    }
}

/// Elements of core and periphery.
fn zones(lattice: &Lattice) -> [Vec<u32>; 2] {
    let (mut core, mut periphery) = (Vec::new(), Vec::new());
    for e in lattice.numbers() {
        let [x, y, z] = lattice.rest_um(e).map(|c| f64::from(c) * 1e-3);
        if x * x + y * y + z * z <= CORE_MM * CORE_MM {
            core.push(e as u32);
        } else if z >= PERIPHERY_FROM_Z_MM {
            periphery.push(e as u32);
        }
    }
    [core, periphery]
}

/// Where the rigid bodies are and who holds them; how many there are.
fn bodies_seen(state: Option<&BodiesState>) -> ([BodyObservation; MAX_BODIES], usize) {
    let mut bodies = [BodyObservation { eye_from_body: Isometry3::identity(), held_by: None }; MAX_BODIES];
    let Some(state) = state else { return (bodies, 0) };
    for (seen, body) in bodies.iter_mut().zip(&state.body) {
        seen.eye_from_body = body.eye_from_body;
    }
    for (instrument, grip) in state.grip.iter().enumerate() {
        if let Some(seen) = grip.and_then(|grip| bodies.get_mut(grip.body as usize)) {
            seen.held_by = Some(instrument as u32);
        }
    }
    (bodies, state.body.len().min(MAX_BODIES))
}

/// Gel that is gone from each zone, ml.
fn removed_ml(zones: &[Vec<u32>; 2], gel: &Vitreous, state: &VitreousState) -> [f64; 2] {
    let cell_ml = gel.lattice().cell_um3() as f64 * 1e-12;
    zones
        .each_ref()
        .map(|zone| zone.iter().filter(|&&e| !state.is_alive(e as usize)).count() as f64 * cell_ml)
}

/// Where the retina is: its turn about the optic disc where the scene has one, else about the
/// fovea.
fn retina_seen(model: &Retina, state: &RetinaState) -> RetinaObservation {
    let disc = model.figures.scene.disc_in_eye_mm.map(Vector3::from);
    let about = disc.map_or(Vector3::z_axis(), |disc| UnitVector3::new_normalize(-disc));
    let nodes = state.sheet.nodes();
    let loose = (0..nodes).filter(|&n| state.is_loose(n)).count();
    RetinaObservation {
        turned_rad: state.turn_about_rad(&model.home_mm, &about),
        loose_share: loose as f64 / nodes as f64,
    }
}

/// The attempt before its first step.
pub fn start(scene: &SceneFile) -> Option<(TaskState, Meter)> {
    let part = TaskPart::of(scene)?;
    Some((part.task.start(), part.scorer.start()))
}

impl World {
    /// Shows the step to the task and to the score; when the attempt ends, its score becomes
    /// events.
    pub(super) fn end_task(&mut self, plan: &StepPlan, frame: &TrackerFrame) {
        let (Some(part), Some((attempt, meter))) = (&self.task, &mut self.state.task) else { return };
        let was_over = is_over(attempt);
        if was_over {
            return;
        }
        let log = &mut self.log;
        let tips = training::sample::tips(frame);
        let (bodies, there) = bodies_seen(self.state.bodies.as_ref());
        let looks = self.state.step == 0 || plan.reaches(GEL_EVERY);
        let zones = part.zones.as_ref().filter(|_| looks);
        let gel = self.vitreous.as_ref().zip(self.state.vitreous.as_ref());
        let gel_ml = zones.zip(gel).map(|(zones, (gel, state))| removed_ml(zones, gel, state));
        let retina = self.retina.as_ref().zip(self.state.retina.as_ref()).filter(|_| part.asks_retina);
        let retina = retina.map(|(retina, state)| retina_seen(retina, state));
        // The task's events go into the log, which it must not read twice.
        let mut raised = [None; MAX_SIGNALS];
        let mut count = 0;
        let seen = Observation {
            now_ns: frame.instants.exposed,
            tips,
            tools: self.state.instruments.each_ref().map(|i| i.tool),
            in_retina: self.state.instruments.each_ref().map(|i| i.retina.level == RetinaLevel::Inside),
            pressed: self.state.tools.is_pressed(),
            bodies: &bodies[..there],
            gel_ml,
            retina,
            world_from_eye: self.state.world_from_eye,
            microscope_target_mm: self.state.microscope.target_in_world_mm,
            field_mm: self.state.microscope.field_mm,
            events: log.events(),
        };
        part.task.advance(attempt, &seen, &mut |signal| {
            if let Some(slot) = raised.get_mut(count) {
                *slot = Some(signal);
                count += 1;
            }
        });
        raised.iter().flatten().for_each(|draft| log.emit(*draft));
        part.scorer.note(meter, &Sample { exposed_ns: frame.instants.exposed, tips, events: log.events() });
        if is_over(attempt) {
            part.scorer.score(meter).events().into_iter().for_each(|draft| log.emit(draft));
        }
    }

    /// The task and how far the attempt is, where the scene has one.
    pub fn task(&self) -> Option<(&Task, &TaskState)> {
        Some((&self.task.as_ref()?.task, &self.state.task.as_ref()?.0))
    }

    /// The score of the attempt as it stands, where the scene has a task.
    pub fn score(&self) -> Option<training::score::Score> {
        Some(self.task.as_ref()?.scorer.score(&self.state.task.as_ref()?.1))
    }

    pub(super) fn check_task(&self, state: &State) -> Result<(), CheckpointError> {
        let sound = match (&self.task, &state.task) {
            (None, None) => true,
            (Some(part), Some((attempt, meter))) => attempt.fits(&part.task) && meter.is_sound(),
            _ => false,
        };
        if sound {
            Ok(())
        } else {
            Err(CheckpointError::Content("the attempt does not fit the scene's task"))
        }
    }
}

/// Most signals of a step: every goal at once, and the events of two instruments.
const MAX_SIGNALS: usize = 2 * scene::MAX_GOALS + 8;

#[cfg(test)]
mod tests {
    use crate::world::{World, no_clock};
    use protocol::events::{Event, EventKind};
    use surgeon::rehearsal::Rehearsal;
    use surgeon::skill::EXPERT;

    /// The live score of a rehearsed attempt is what the same poses, steps and events give
    /// afterwards, to the bit; and a checkpoint in the middle changes nothing.
    #[test]
    fn the_live_score_is_the_recordings_score() {
        let module = surgeon::load("navigation").unwrap();
        let scene = surgeon::compose(&module, 1, &EXPERT, 1).unwrap();
        let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
        let mut reader = training::score::recording::Reader::new(&scene).unwrap();
        let (mut told, mut saved) = (None, Vec::new());
        for field in 0..rehearsal.fields() {
            let report = world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let (frame, _) = rehearsal.field(field);
            let events: Vec<Event> = world.events().to_vec();
            told = events.iter().find(|e| e.kind == EventKind::ScoreTotal as u32).map(|e| e.value).or(told);
            if field == 300 {
                world.save(&mut saved).unwrap();
                let (hash, before) = (world.state_hash(), world.state().task.clone());
                world = World::new(&scene).unwrap();
                assert_ne!(world.state().task, before);
                world.restore(&saved).unwrap();
                assert_eq!((world.state_hash(), &world.state().task), (hash, &before));
            }
            // As a recorder may get them: events before poses.
            events.into_iter().for_each(|e| reader.take_event(e));
            reader.take_poses(Box::new(frame));
            let mut step: protocol::steps::StepRecord = bytemuck::Zeroable::zeroed();
            (step.step, step.field, step.frame) = (field + 1, field, field);
            step.state_hash = report.state_hash;
            reader.take_step(&step);
        }
        let verdict = reader.finish();
        assert_eq!((verdict.agrees(), verdict.unmatched, verdict.ended), (Some(true), 0, true));
        assert_eq!(told, Some(verdict.score.total));
        assert!(verdict.score.finished && verdict.score.total > 85.0, "{:?}", verdict.score);
    }
}
