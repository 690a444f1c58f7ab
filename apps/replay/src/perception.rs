//! What a scripted surgeon sees of the simulation: bodies, tissue, and which goals are done. A
//! person sees as much in the picture.

use nalgebra::Vector3;
use protocol::poses::TrackerFrame;
use protocol::scene::NODE_FREE;
use simcore::world::{StepReport, World, no_clock};
use surgeon::rehearsal::Rehearsal;
use surgeon::script::{PerceivedBody, Perception};

/// A world as a scripted surgeon sees it.
pub struct WorldPerception<'a>(pub &'a World);

/// Steps a world by one field of a rehearsal, and lets the surgeon see what came of it; the poses of
/// the field, and what the step reports.
pub fn perform(rehearsal: &mut Rehearsal, world: &mut World, field: u64) -> (Box<TrackerFrame>, StepReport) {
    let inputs = rehearsal.inputs(field);
    let report = world.step(&inputs.input(), &mut no_clock);
    rehearsal.see(field, &WorldPerception(world));
    (inputs.frame, report)
}

impl Perception for WorldPerception<'_> {
    fn reached(&self, goal: usize) -> bool {
        self.0.task().is_some_and(|(_, state)| state.goals.get(goal).is_some_and(|g| g.reached))
    }

    fn body(&self, number: usize) -> Option<PerceivedBody> {
        let state = self.0.state().bodies.as_ref()?.body.get(number)?;
        let scene = self.0.scene().bodies.as_ref()?.body.get(number)?;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|a| state.eye_from_body.rotation * a);
        Some(PerceivedBody::new(state.eye_from_body.translation.vector, axes, scene.half_extents_mm))
    }

    fn tissue_near(&self, place_in_eye_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
        let membrane = &self.0.state().membrane;
        let free = (0..membrane.nodes()).filter(|&n| membrane.flag[n] == NODE_FREE);
        let places = free.map(|n| membrane.position(n).map(f64::from));
        places.min_by(|a, b| {
            (a - place_in_eye_mm).norm_squared().total_cmp(&(b - place_in_eye_mm).norm_squared())
        })
    }
}
