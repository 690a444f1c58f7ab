//! The bodies' share of a step: instruments push them, forceps pick them up and place them.

use super::World;
use super::plan::{Plan, Poses};
use crate::bodies::grip;
use crate::bodies::solve::{BodySolver, Hand, Surroundings};
use crate::bodies::state::{BodiesState, Grip};
use crate::event_log::Happening;
use collision::rigid::Compound;
use collision::surface::CollisionError;
use nalgebra::Vector3;
use protocol::events::EventKind;
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use scene::SceneFile;
use tissue::constants::SUBSTEP_S;
use tissue::sheet::grasp;

/// Length of an instrument that can touch bodies, in radii of the retina: from any tip to beyond the trocar.
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

impl World {
    /// Moves the bodies over substep `k`.
    pub(super) fn move_bodies(&mut self, plan: &Plan, poses: &Poses, k: u64) {
        let Some(mut bodies) = self.bodies.take() else { return };
        if let Some(mut state) = self.state.bodies.take() {
            self.use_bodies(&mut bodies, &mut state, plan, poses, k);
            self.state.bodies = Some(state);
        }
        self.bodies = Some(bodies);
    }

    /// One event for the bodies that were stopped in this step.
    pub(super) fn tell_stopped(&mut self) {
        let Some((times, body)) = self.bodies.as_mut().and_then(|b| b.solver.take_stopped()) else { return };
        let state = self.state.bodies.as_ref().map(|s| s.body[body as usize]);
        let at = state.map_or_else(Vector3::zeros, |b| b.eye_from_body.translation.vector);
        let event = Happening::new(EventKind::BodyStopped, f64::from(times));
        self.log.raise(Happening { subject: body, position_in_eye_mm: at.into(), ..event });
    }

    fn use_bodies(
        &mut self,
        bodies: &mut Bodies,
        state: &mut BodiesState,
        plan: &Plan,
        poses: &Poses,
        k: u64,
    ) {
        let Some(scene) = &self.scene.bodies else { return };
        let down = self.state.world_from_eye.rotation.inverse() * -Vector3::z();
        let around = Surroundings {
            weight_mm_s2: down * scene.weight_mm_s2,
            damping_per_s: scene.damping_per_s,
            retina_radius_mm: self.scene.eye.retina_radius_mm,
            grip_un: self.scene.contact.grip_un,
            dt_s: SUBSTEP_S,
        };
        let closing: [bool; INSTRUMENTS] =
            std::array::from_fn(|i| self.prepare_tool(bodies, state, plan, i, k));
        let before = plan.share(k - 1);
        let hands = std::array::from_fn(|i| Hand {
            pose: poses.eye_from_instrument[i],
            before: plan.pose(i, before),
            touches: plan.touches[i],
        });
        bodies.solver.step(&mut state.body, &state.grip, &bodies.tools, &hands, &around);
        for (i, hand) in hands.iter().enumerate() {
            if let Some(mut held) = state.grip[i] {
                let body = state.body[held.body as usize];
                grip::slide(&mut held, &body, &hand.pose);
                state.grip[i] = Some(held);
                if held.slid_mm > self.scene.contact.grab_reach_mm {
                    let pull = bodies.solver.pull_un(i, SUBSTEP_S).norm();
                    self.drop_body(state, i, EventKind::GripSlipped, pull);
                }
            } else if closing[i] {
                self.take_body(bodies, state, i, &hand.pose);
            }
        }
    }

    /// Opens or closes an instrument's jaws, which a body between them stops, and lets a body go; true while they close.
    fn prepare_tool(
        &mut self,
        bodies: &mut Bodies,
        state: &mut BodiesState,
        plan: &Plan,
        i: usize,
        k: u64,
    ) -> bool {
        let tool = self.state.instruments[i].tool;
        if tool != bodies.of_tool[i] {
            let radius_mm = self.scene.instruments[i].shaft_radius_mm;
            let shape = Tool::from_wire(tool).map(|t| Compound::instrument(t, radius_mm, bodies.length_mm));
            if let Some(Ok(shape)) = shape {
                (bodies.tools[i], bodies.of_tool[i]) = (shape, tool);
            }
        }
        let (before, now) = (plan.jaw(i, plan.share(k - 1)), plan.jaw(i, plan.share(k)));
        let has_jaws = grasp::has_jaws(tool);
        if let Some(held) = state.grip[i] {
            let open = now > held.opening_rad + grip::RELEASE_RAD;
            if open || !has_jaws || !plan.touches[i] {
                let clearance = self.clearance_mm(state, &held);
                self.drop_body(state, i, EventKind::BodyReleased, clearance);
            }
        }
        let stop = state.grip[i].map_or(0.0, |held| held.opening_rad);
        if has_jaws {
            bodies.tools[i].open_jaws(if now > stop { now } else { stop });
        }
        has_jaws && plan.touches[i] && now < before
    }

    fn take_body(
        &mut self,
        bodies: &Bodies,
        state: &mut BodiesState,
        i: usize,
        pose: &nalgebra::Isometry3<f64>,
    ) {
        let Some(body) = grip::between_jaws(bodies.solver.touched(), i) else { return };
        if state.grip.iter().flatten().any(|other| other.body as usize == body) {
            return;
        }
        let opening = self.state.instruments[i].jaw_rad;
        state.grip[i] = Some(grip::take(body, &state.body[body], pose, opening));
        let event = Happening::new(EventKind::BodyGripped, opening);
        let at = state.body[body].eye_from_body.translation.vector.into();
        self.log.raise(Happening { subject: body as u32, ..event.by(i, at) });
    }

    fn drop_body(&mut self, state: &mut BodiesState, i: usize, kind: EventKind, value: f64) {
        let Some(held) = state.grip[i].take() else { return };
        let at = state.body[held.body as usize].eye_from_body.translation.vector.into();
        let limit = if kind == EventKind::GripSlipped { self.scene.contact.grip_un } else { 0.0 };
        let event = Happening::new(kind, value);
        self.log.raise(Happening { subject: held.body, limit, ..event.by(i, at) });
    }

    /// Distance of a body's centre from the retina, mm.
    fn clearance_mm(&self, state: &BodiesState, held: &Grip) -> f64 {
        let centre = state.body[held.body as usize].eye_from_body.translation.vector;
        self.scene.eye.retina_radius_mm - centre.norm()
    }
}
