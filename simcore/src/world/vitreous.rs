//! The vitreous' share of a step: shafts drag it, the vitrector takes it, it comes back, and the
//! retina feels it.
//!
//! It moves once a tick ([`crate::ticks`]), after the substeps of the membrane: the gel is slow, and a
//! tick covers the instruments' whole way, so that nothing is lost between two of them. What the ports
//! drew and where the shafts were at the last tick is kept until the next one.

use super::World;
use super::plan::{InstrumentPoses, StepPlan};
use super::tools::PlacedTools;
use crate::checkpoint::CheckpointError;
use crate::constants::{TRACTION_EVERY, TRACTION_REARM, VITREOUS_QUIET_NS};
use crate::event_log::EventLog;
use crate::state::State;
use crate::sweep::Sweep;
use crate::ticks::OpenPort;
use crate::tools::ToolFigures;
use protocol::events::{EventDraft, EventKind};
use protocol::limits::INSTRUMENTS;
use protocol::time::Nanos;
use scene::{SceneFile, VitreousScene};
use tissue::constants::SUBSTEP_S;
use tissue::vitrector::{Blade, Port};
use tissue::vitreous::state::VitreousState;
use tissue::vitreous::traction::{Stress, Traction};
use tissue::vitreous::{Shaft, Vitreous, state};

/// A blade that leaves its port open.
const OPEN: Blade = Blade { open: true, cuts: false };

/// Draws the gel in the suction cones, for the substeps in which their ports were open.
fn draw(
    open: &[Option<OpenPort>; INSTRUMENTS],
    gel: &mut Vitreous,
    state: &mut VitreousState,
    scene: &SceneFile,
    tools: &ToolFigures,
) {
    let Some(figures) = &scene.vitreous else { return };
    for (open, instrument) in open.iter().zip(&scene.instruments) {
        let Some(OpenPort { substeps, eye_from_instrument, suction_pa }) = open else { continue };
        let radius_mm = instrument.shaft_radius_mm;
        let port = Port::new(eye_from_instrument, radius_mm, &tools.vitrector, OPEN, *suction_pa);
        let mm_per_pa = figures.suction.speed_mm_s_per_kpa * 1e-3 * SUBSTEP_S * f64::from(*substeps);
        gel.suck(state, port.cone.apex_in_eye_mm, port.cone.reach_mm, |at| {
            port.cone.distance_mm(at).map(|distance| mm_per_pa * port.pressure_pa(distance))
        });
    }
}

impl World {
    /// The vitreous and its state, if the scene has one.
    pub fn vitreous(&self) -> Option<(&Vitreous, &VitreousState)> {
        self.vitreous.as_ref().zip(self.state.vitreous.as_ref())
    }

    /// One substep of the vitrectors: closing ones cut the gel, and the open ones are counted for the
    /// next tick.
    pub(super) fn apply_suction(&mut self, tools: &PlacedTools, poses: &InstrumentPoses) {
        let (Some(gel), Some(scene)) = (&mut self.vitreous, &self.scene.vitreous) else { return };
        let State { vitreous: Some(state), ticks, .. } = &mut self.state else { return };
        for (i, port) in tools.ports.iter().enumerate() {
            let Some(port) = port.filter(|p| p.suction_pa > 0.0) else { continue };
            if port.open {
                let substeps = ticks.open[i].map_or(0, |open| open.substeps) + 1;
                let (eye_from_instrument, suction_pa) = (poses.eye_from_instrument[i], port.suction_pa);
                ticks.open[i] = Some(OpenPort { substeps, eye_from_instrument, suction_pa });
            }
            if port.cuts {
                let middle =
                    port.cone.apex_in_eye_mm + port.cone.axis_in_eye.scale(port.depth_mm - port.radius_mm);
                gel.bite(state, middle, scene.suction.bite_mm);
            }
        }
    }

    /// Moves the vitreous over the ticks of the step: shafts drag it, open ports draw it, it relaxes.
    pub(super) fn move_vitreous(&mut self, plan: &StepPlan) {
        let World { vitreous, state, scene, figures: tools, log, .. } = self;
        let State { vitreous: gel_state, ticks, instruments, exposed_ns, .. } = state;
        let (Some(gel), Some(state), Some(figures)) = (vitreous, gel_state, &scene.vitreous) else { return };
        for tick in 0..plan.ticks() {
            let share = [tick, tick + 1].map(|t| t as f64 / plan.ticks() as f64);
            for i in (0..INSTRUMENTS).filter(|&i| plan.touches[i]) {
                let sweep = Sweep { from: ticks.from[i], to: instruments[i].eye_from_instrument };
                let way = share.map(|s| sweep.pose(s));
                gel.carry(state, &Shaft { way, radius_mm: scene.instruments[i].shaft_radius_mm });
            }
            if tick + 1 == plan.ticks() {
                draw(&std::mem::take(&mut ticks.open), gel, state, scene, tools);
            }
            gel.relax(state);
            gel.free();
        }
        if plan.reaches(TRACTION_EVERY) {
            let traction = gel.look(state);
            emit_vitreous(gel, state, figures, &traction, *exposed_ns, log);
        }
        gel.draw(state);
    }

    /// Refuses the vitreous of a foreign state.
    pub(super) fn check_vitreous(&self, state: &State) -> Result<(), CheckpointError> {
        match (&self.vitreous, &state.vitreous) {
            (Some(gel), Some(state)) => state::check(gel.lattice(), state).map_err(CheckpointError::Content),
            (None, None) => Ok(()),
            _ => Err(CheckpointError::Content("only one of scene and state has a vitreous")),
        }
    }

    /// After another state took the place of the last one.
    pub(super) fn refresh_vitreous(&mut self) {
        if let (Some(gel), Some(state)) = (&mut self.vitreous, &self.state.vitreous) {
            gel.refresh(state);
        }
    }
}

/// Raises the events of a step.
fn emit_vitreous(
    gel: &Vitreous,
    state: &mut VitreousState,
    scene: &VitreousScene,
    traction: &Traction,
    now: Nanos,
    log: &mut EventLog,
) {
    let lattice = gel.lattice();
    let at = |element: u32| state.place_um(lattice, element as usize).map(|c| f64::from(c) * 1e-3);
    let pulled = |kind, stress: Stress, limit| EventDraft {
        limit,
        subject: stress.element,
        position_in_eye_mm: at(stress.element),
        ..EventDraft::new(kind, f64::from(stress.pa))
    };
    let (greatest, base, adhesion) = (traction.greatest, traction.base, &scene.adhesion);
    let warning = pulled(EventKind::VitreousTraction, greatest, adhesion.warn_pa);
    let danger = pulled(EventKind::BaseTraction, base, adhesion.tear_pa);
    let released_at = at(traction.released_at);
    for (event, out) in [(warning, &mut state.warned), (danger, &mut state.tear_warned)] {
        if event.value > event.limit && !*out {
            *out = true;
            log.emit(event);
        } else if event.value < TRACTION_REARM * event.limit {
            *out = false;
        }
    }
    if traction.released > 0 && now >= state.quiet_until_ns {
        state.quiet_until_ns = now + VITREOUS_QUIET_NS;
        let pitch_mm = f64::from(lattice.pitch_um) * 1e-3;
        let area_mm2 = state.released as f64 * pitch_mm * pitch_mm;
        let event = EventDraft::new(EventKind::VitreousDetached, area_mm2);
        log.emit(EventDraft { position_in_eye_mm: released_at, ..event });
    }
    let removed_ml = state.removed_um3(lattice) as f64 * 1e-12;
    let milestones = (removed_ml / scene.suction.milestone_ml) as u64;
    if milestones > state.milestones {
        state.milestones = milestones;
        log.emit(EventDraft::new(EventKind::VitreousRemoved, removed_ml));
    }
}

#[cfg(test)]
mod tests {
    use crate::scene_block::{SceneWriter, bytes_needed};
    use crate::world::{World, no_clock};
    use protocol::events::EventKind;
    use protocol::limits::MAX_CHECKPOINT_BYTES;
    use protocol::scene::{SceneBrick, section};
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;
    use tissue::vitreous::state;

    fn densities(world: &World) -> u64 {
        let mut writer = SceneWriter::new(world);
        let bytes = bytes_needed(world.sheet(), false, world.vitreous().map(|(v, _)| v), None);
        let mut payload = vec![0u128; bytes.div_ceil(16)];
        let payload: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
        let header = writer.write(world, bytemuck::Zeroable::zeroed(), 0, payload);
        let bricks = section::<SceneBrick>(payload, header.bricks).unwrap();
        assert!(!bricks.is_empty());
        bricks.iter().flat_map(|b| b.density).map(u64::from).sum()
    }

    #[test]
    fn the_shipped_vitrectomy_takes_gel_and_the_account_balances() {
        let scene = SceneFile::load("vitrectomy").unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        let mut world = World::new(&scene).unwrap();
        let start = densities(&world);
        let (mut milestones, mut saved) = (Vec::new(), Vec::new());
        let mut hash = 0;
        for field in 0..350 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let told = world.events().iter().filter(|e| e.kind == EventKind::VitreousRemoved as u32);
            milestones.extend(told.map(|e| e.value));
            if field == 300 {
                world.save(&mut saved).unwrap();
                assert!(saved.len() < MAX_CHECKPOINT_BYTES / 2, "{} bytes", saved.len());
            }
            hash = world.state_hash();
        }
        let (gel, state) = world.vitreous().unwrap();
        let lattice = gel.lattice();
        assert_eq!(state::check(lattice, state), Ok(()));
        let whole = lattice.elements() as u64 * lattice.cell_um3();
        assert_eq!(state.removed_um3(lattice) + state.remaining_um3(lattice), whole, "to the last µm³");
        assert!(state.removed > 500, "{} elements", state.removed);
        assert!(!milestones.is_empty() && milestones.is_sorted());
        // Where gel went there is no haze: removed elements take their densities with them, but for
        // rounding down in cells.
        let gone = start - densities(&world);
        let least = state.removed * 25;
        assert!(gone > least, "{gone} of {start} gone with {} elements", state.removed);

        // The same from a checkpoint, in another world; and a foreign one is refused.
        let mut other = World::new(&scene).unwrap();
        other.restore(&saved).unwrap();
        (301..350).for_each(|field| {
            other.step(&rehearsal.inputs(field).input(), &mut no_clock);
        });
        assert_eq!(other.state_hash(), hash);
        let (_, same) = other.vitreous().unwrap();
        assert!(same == world.vitreous().unwrap().1);
        assert_eq!(densities(&other), densities(&world));
        let at = saved.len() / 2;
        saved[at] ^= 0x40;
        assert!(other.restore(&saved).is_err() || other.state_hash() != hash);
        assert!(World::new(&SceneFile::load("peel").unwrap()).unwrap().restore(&saved).is_err());
        other.reset();
        assert_eq!(other.vitreous().unwrap().1.removed, 0);
    }

    #[test]
    fn suction_that_pulls_at_the_retina_warns_and_lets_the_gel_off() {
        let mut scene = SceneFile::load("vitrectomy").unwrap();
        // Over the posterior pole, suction without the cutter, drawn away from it.
        scene.script.as_mut().unwrap().pedal.truncate(1);
        scene.script.as_mut().unwrap().pedal[0].axes = [1.0, 0.0];
        scene.script.as_mut().unwrap().period_s = 8.0;
        let mut keys = scene.script.as_ref().unwrap().keys.clone();
        keys.retain(|k| k.at_s == 0.0);
        keys[0].tip_in_eye_mm = [1.0, 0.0, -10.3];
        let mut away = keys[0].clone();
        (away.at_s, away.tip_in_eye_mm) = (5.0, [1.0, 0.0, -5.0]);
        keys.push(away);
        scene.script.as_mut().unwrap().keys = keys;
        let vitreous = scene.vitreous.as_mut().unwrap();
        vitreous.lattice = 40;
        vitreous.slip_mm = 3.0;
        let rehearsal = Rehearsal::shipped(&scene);
        let mut world = World::new(&scene).unwrap();
        let mut kinds = Vec::new();
        for field in 0..300 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            kinds.extend(world.events().iter().map(|e| e.kind));
        }
        let (gel, state) = world.vitreous().unwrap();
        assert!(kinds.contains(&(EventKind::VitreousTraction as u32)), "{kinds:?}");
        assert!(state.released > 0 && kinds.contains(&(EventKind::VitreousDetached as u32)));
        assert_eq!((state.removed, state::check(gel.lattice(), state)), (0, Ok(())));
    }
}
