//! Light on the retina: what the light pipe shines in a tick, from where it is at its end.

use super::World;
use super::plan::StepPlan;
use protocol::handles::Tool;

impl World {
    /// Counts the light of every tracked light pipe that is in the eye.
    pub(super) fn accumulate_light_dose(&mut self, plan: &StepPlan) {
        if plan.ticks() == 0 {
            return;
        }
        let dt_s = plan.ticked_s();
        let state = &mut self.state;
        for (instrument, touches) in state.instruments.iter().zip(plan.touches) {
            if touches && instrument.tool == Tool::LightPipe as u32 {
                self.light_dose.expose(&mut state.dose, &instrument.eye_from_instrument, dt_s);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::world::{World, no_clock};
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;

    fn played(fields: std::ops::Range<u64>, world: &mut World) {
        let rehearsal = Rehearsal::shipped(world.scene());
        fields.for_each(|field| {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        });
    }

    #[test]
    fn light_is_counted_for_the_time_that_passes_and_a_checkpoint_keeps_it() {
        let scene = SceneFile::load("peel").unwrap();
        let mut world = World::new(&scene).unwrap();
        played(0..50, &mut world);
        let all = |world: &World| world.state().dose.mj_mm2.iter().sum::<f64>();
        let first = all(&world);
        let mut saved = Vec::new();
        world.save(&mut saved).unwrap();
        played(50..100, &mut world);
        // The same pipe at about the same place for as long again.
        assert!(first > 0.0 && (all(&world) / first - 2.0).abs() < 0.2, "{first}, {}", all(&world));
        let mut other = World::new(&scene).unwrap();
        other.restore(&saved).unwrap();
        played(50..100, &mut other);
        assert_eq!(other.state(), world.state());
    }

    #[test]
    fn doses_decide_nothing_and_a_reset_forgets_them() {
        let scene = SceneFile::load("peel").unwrap();
        let mut world = World::new(&scene).unwrap();
        played(0..20, &mut world);
        let hash = world.state_hash();
        world.state.dose.mj_mm2[500] += 1.0;
        assert_eq!(world.state_hash(), hash);
        let mut saved = Vec::new();
        world.state.dose.mj_mm2[500] = -1.0;
        world.save(&mut saved).unwrap();
        assert!(World::new(&scene).unwrap().restore(&saved).is_err(), "no dose is negative");
        world.reset();
        assert_eq!(world.state().dose, crate::dose::DoseState::start());
    }
}
