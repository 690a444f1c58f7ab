//! The bodies' share of a step: instruments push them, forceps pick them up and place them.

use super::World;
use super::plan::{InstrumentPoses, StepPlan};
use crate::bodies::grip;
use crate::bodies::solve::{BodySolver, SolverParams, StoppedBodies, ToolMotion};
use crate::bodies::state::BodiesState;
use crate::event_log::EventLog;
use crate::state::{InstrumentState, State};
use collision::rigid::Compound;
use collision::surface::CollisionError;
use nalgebra::{Isometry3, Vector3};
use protocol::events::{EventDraft, EventKind};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use scene::SceneFile;
use tissue::constants::SUBSTEP_S;
use tissue::sheet::grasp;

/// Length of an instrument that can touch bodies, in radii of the retina: from any tip to beyond
/// the trocar.
const LENGTH_RADII: f64 = 2.5;

/// The bodies of a scene at work.
#[derive(Debug)]
pub struct Bodies {
    solver: BodySolver,
    /// Shapes of the instruments, and of which tool each is.
    tools: [Compound; INSTRUMENTS],
    of_tool: [u32; INSTRUMENTS],
    length_mm: f64,
}

impl Bodies {
    /// Shapes and work space for a scene that has bodies.
    ///
    /// # Errors
    /// [`CollisionError`] for a shape without extent.
    pub fn new(scene: &SceneFile) -> Result<Option<Self>, CollisionError> {
        let Some(bodies) = &scene.bodies else { return Ok(None) };
        let length_mm = LENGTH_RADII * scene.eye.retina_radius_mm;
        let mut tools = Vec::with_capacity(INSTRUMENTS);
        for instrument in &scene.instruments {
            tools.push(Compound::instrument(instrument.tool, instrument.shaft_radius_mm, length_mm)?);
        }
        let tools: Result<[Compound; INSTRUMENTS], _> = tools.try_into();
        let Ok(tools) = tools else { return Ok(None) };
        Ok(Some(Bodies {
            solver: BodySolver::new(bodies)?,
            tools,
            of_tool: std::array::from_fn(|i| scene.instruments[i].tool as u32),
            length_mm,
        }))
    }
}

/// What the bodies meet in substep `k`: the instruments, the scene, and the log of events.
struct Substep<'a> {
    scene: &'a SceneFile,
    instruments: &'a [InstrumentState; INSTRUMENTS],
    plan: &'a StepPlan,
    poses: &'a InstrumentPoses,
    k: u64,
    log: &'a mut EventLog,
}

impl World {
    /// Moves the bodies over substep `k`; returns which of them were stopped.
    pub(super) fn move_bodies(&mut self, plan: &StepPlan, poses: &InstrumentPoses, k: u64) -> StoppedBodies {
        let World { bodies, state, scene, log, .. } = self;
        let State { bodies: body_states, instruments, world_from_eye, .. } = state;
        let (Some(bodies), Some(states)) = (bodies, body_states) else { return StoppedBodies::default() };
        let Some(figures) = &scene.bodies else { return StoppedBodies::default() };
        let down = world_from_eye.rotation.inverse() * -Vector3::z();
        let params = SolverParams {
            weight_mm_s2: down * figures.weight_mm_s2,
            damping_per_s: figures.damping_per_s,
            retina_radius_mm: scene.eye.retina_radius_mm,
            grip_un: scene.contact.grip_un,
            dt_s: SUBSTEP_S,
        };
        bodies.step(states, &params, &mut Substep { scene, instruments, plan, poses, k, log })
    }

    /// Raises one event for the bodies that were stopped in this step.
    pub(super) fn emit_stopped(&mut self, stopped: StoppedBodies) {
        if stopped.count == 0 {
            return;
        }
        let state = self.state.bodies.as_ref().map(|s| s.body[stopped.last as usize]);
        let at = state.map_or_else(Vector3::zeros, |b| b.eye_from_body.translation.vector);
        let event = EventDraft::new(EventKind::BodyStopped, f64::from(stopped.count));
        self.log.emit(EventDraft { subject: stopped.last, position_in_eye_mm: at.into(), ..event });
    }
}

impl Bodies {
    /// Moves jaws and bodies over a substep; grips slip, open and close.
    fn step(
        &mut self,
        state: &mut BodiesState,
        params: &SolverParams,
        substep: &mut Substep,
    ) -> StoppedBodies {
        let (plan, poses) = (substep.plan, substep.poses);
        let closing: [bool; INSTRUMENTS] = std::array::from_fn(|i| self.move_jaws(state, i, substep));
        let before = plan.share(substep.k - 1);
        let motions = std::array::from_fn(|i| ToolMotion {
            pose: poses.eye_from_instrument[i],
            before: plan.pose(i, before),
            touches: plan.touches[i],
        });
        let stopped = self.solver.step(&mut state.body, &state.grip, &self.tools, &motions, params);
        for (i, motion) in motions.iter().enumerate() {
            if let Some(held) = &mut state.grip[i] {
                grip::slide(held, &state.body[held.body as usize], &motion.pose);
                if held.slid_mm > substep.scene.contact.grab_reach_mm {
                    let pull = self.solver.pull_un(i, SUBSTEP_S).norm();
                    substep.release(state, i, EventKind::GripSlipped, pull);
                }
            } else if closing[i] {
                self.grip_body(state, i, &motion.pose, substep);
            }
        }
        stopped
    }

    /// Opens or closes an instrument's jaws, which a body between them stops, and releases a body;
    /// true while they close.
    fn move_jaws(&mut self, state: &mut BodiesState, i: usize, substep: &mut Substep) -> bool {
        let tool = substep.instruments[i].tool;
        if tool != self.of_tool[i] {
            let radius_mm = substep.scene.instruments[i].shaft_radius_mm;
            let shape = Tool::from_wire(tool).map(|t| Compound::instrument(t, radius_mm, self.length_mm));
            if let Some(Ok(shape)) = shape {
                (self.tools[i], self.of_tool[i]) = (shape, tool);
            }
        }
        let (plan, k) = (substep.plan, substep.k);
        let (before, now) = (plan.jaw(i, plan.share(k - 1)), plan.jaw(i, plan.share(k)));
        let has_jaws = grasp::has_jaws(tool);
        if let Some(held) = state.grip[i] {
            let open = now > held.opening_rad + grip::RELEASE_RAD;
            if open || !has_jaws || !plan.touches[i] {
                let centre = state.body[held.body as usize].eye_from_body.translation.vector;
                let clearance_mm = substep.scene.eye.retina_radius_mm - centre.norm();
                substep.release(state, i, EventKind::BodyReleased, clearance_mm);
            }
        }
        let stop = state.grip[i].map_or(0.0, |held| held.opening_rad);
        if has_jaws {
            self.tools[i].open_jaws(if now > stop { now } else { stop });
        }
        has_jaws && plan.touches[i] && now < before
    }

    /// Grips the body between the jaws, if no other instrument holds it.
    fn grip_body(&self, state: &mut BodiesState, i: usize, pose: &Isometry3<f64>, substep: &mut Substep) {
        let Some(body) = grip::between_jaws(self.solver.touched(), i) else { return };
        if state.grip.iter().flatten().any(|other| other.body as usize == body) {
            return;
        }
        let opening = substep.instruments[i].jaw_rad;
        state.grip[i] = Some(grip::take(body, &state.body[body], pose, opening));
        let event = EventDraft::new(EventKind::BodyGripped, opening);
        let at = state.body[body].eye_from_body.translation.vector.into();
        substep.log.emit(EventDraft { subject: body as u32, ..event.by(i, at) });
    }
}

impl Substep<'_> {
    /// Opens the grip of instrument `i` with an event of this kind.
    fn release(&mut self, state: &mut BodiesState, i: usize, kind: EventKind, value: f64) {
        let Some(held) = state.grip[i].take() else { return };
        let at = state.body[held.body as usize].eye_from_body.translation.vector.into();
        let limit = if kind == EventKind::GripSlipped { self.scene.contact.grip_un } else { 0.0 };
        let event = EventDraft::new(kind, value);
        self.log.emit(EventDraft { subject: held.body, limit, ..event.by(i, at) });
    }
}
