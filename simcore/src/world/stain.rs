//! Dye: needles that inject before the membrane colour it.

use super::World;
use super::plan::StepPlan;
use protocol::events::{EventDraft, EventKind};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use scene::SceneFile;
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::stain::StainState;

/// Room for the dye of a scene's membrane.
pub(super) fn room(scene: &SceneFile, sheet: &SheetMesh) -> Option<StainState> {
    scene.membrane.as_ref().map(|_| StainState::new(sheet.nodes()))
}

impl World {
    /// A tick of the jets, from where they are at its end. There is no dye, and nothing is kept of it, before the first jet has
    /// reached the membrane.
    pub(super) fn stain_membrane(&mut self, plan: &StepPlan) {
        let pressure = self.state.tools.injection_pa;
        let full = self.figures.needle.pressure_pa;
        if plan.ticks() == 0 || self.scene.membrane.is_none() || pressure <= 0.0 || full <= 0.0 {
            return;
        }
        let share = pressure / full;
        let dt_s = plan.ticked_s();
        for i in 0..INSTRUMENTS {
            let instrument = &self.state.instruments[i];
            if !plan.touches[i]
                || instrument.tool != Tool::Needle as u32
                || self.state.membrane.contact[i].pierced.is_some()
            {
                continue;
            }
            let (membrane, tip) = (&self.state.membrane, instrument.tip_in_eye_mm);
            let Some(stain) = self.state.stain.as_mut().or(self.no_stain.as_mut()) else { return };
            let reached = stain.wash(membrane, &tip, share, dt_s);
            if let Some(percent) = stain.report(membrane) {
                let event = EventDraft::new(EventKind::MembraneStained, percent);
                self.log.emit(event.by(i, tip.into()));
            }
            if reached && self.state.stain.is_none() {
                self.state.stain = self.no_stain.take();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::scene_block::SceneWriter;
    use crate::world::{World, no_clock};
    use protocol::events::EventKind;
    use protocol::handles::{PedalMode, Tool};
    use protocol::scene::{SceneNode, section};
    use scene::{PedalKey, SceneFile};
    use surgeon::rehearsal::Rehearsal;

    /// A needle over the membrane of `erm`, the foot pressed or not.
    fn dyed(axes: [f64; 2]) -> (World, Vec<f64>) {
        let mut scene = SceneFile::load("erm").unwrap();
        let script = scene.script.as_mut().unwrap();
        script.keys.retain(|k| k.at_s == 0.0);
        script.keys[0].tip_in_eye_mm = [0.0, 0.0, -9.8];
        script.keys[0].tool = Some(Tool::Needle);
        script.pedal = vec![PedalKey { at_s: 0.0, mode: PedalMode::Inject, axes, buttons: Vec::new() }];
        let rehearsal = Rehearsal::shipped(&scene);
        let (mut world, mut told) = (World::new(&scene).unwrap(), Vec::new());
        for field in 0..100 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let events = world.events().iter().filter(|e| e.kind == EventKind::MembraneStained as u32);
            told.extend(events.map(|e| e.value));
        }
        (world, told)
    }

    /// The dye of every node in the scene block.
    fn shown(world: &World) -> Vec<u16> {
        let mut payload = vec![0u128; 1 << 14];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
        let header = SceneWriter::new(world).write(world, bytemuck::Zeroable::zeroed(), 0, bytes);
        let nodes = section::<SceneNode>(bytes, header.nodes).unwrap();
        nodes[..world.sheet().nodes()].iter().map(|n| n.dye).collect()
    }

    #[test]
    fn a_jet_colours_the_membrane_and_a_checkpoint_keeps_it() {
        let (world, told) = dyed([1.0, 0.0]);
        assert!(told.len() >= 2 && told.is_sorted(), "{told:?}");
        let percent = world.state().stain.as_ref().unwrap().percent(&world.state().membrane);
        assert_eq!(told.last().map(|&t| t as u32 / 10), Some(percent as u32 / 10), "{percent}");
        assert_eq!(shown(&world), world.state().stain.as_ref().unwrap().dye);
        let mut saved = Vec::new();
        world.save(&mut saved).unwrap();
        let mut other = World::new(world.scene()).unwrap();
        assert_ne!(other.state_hash(), world.state_hash());
        other.restore(&saved).unwrap();
        assert_eq!((other.state_hash(), &other.state().stain), (world.state_hash(), &world.state().stain));
        other.reset();
        assert_eq!(other.state().stain, None);
    }

    #[test]
    fn without_pressure_nothing_is_coloured() {
        let (world, told) = dyed([0.0, 0.0]);
        assert!(told.is_empty() && world.state().stain.is_none());
    }
}
