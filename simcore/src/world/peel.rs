//! The glue's share of a step: it pulls, breaks, and pulls at the retina; what is free curls.

use super::{World, WorldError};
use crate::checkpoint::CheckpointError;
use crate::constants::RIM_REARM;
use crate::event_log::Happening;
use protocol::events::EventKind;
use protocol::scene::{NODE_DEAD, NODE_FREE};
use scene::SceneFile;
use tissue::constants::SUBSTEP_S;
use tissue::forceps;
use tissue::membrane::adhesion::{Adhesion, AdhesionState, LIFTED_MM, Parting};
use tissue::membrane::curl::{Curl, stiffest_un_per_mm};
use tissue::membrane::sheet::Sheet;
use tissue::state::MembraneState;

/// The freed area is reported whenever another such share of the glued area is off.
const PEELED_STEPS: f64 = 10.0;

/// What happened to the glue in a step.
#[derive(Debug, Clone, Copy, Default)]
pub struct StepParting {
    most: Parting,
    freed_before_mm2: f64,
    begun: bool,
}

/// The bonds of a scene; refuses those that an explicit substep cannot carry. They move with the substep whatever
/// the integrator of the springs, and share the bound of [`tissue::membrane::solver`] with them: here half of it.
pub fn adhesion(scene: &SceneFile, sheet: &Sheet) -> Result<Option<Adhesion>, WorldError> {
    let Some(membrane) = &scene.membrane else { return Ok(None) };
    let Some(glue) = &membrane.adhesion else { return Ok(None) };
    let adhesion = Adhesion::new(sheet, glue, scene.eye.retina_radius_mm);
    let stiffness_un_per_mm = f64::from(adhesion.stiffest_un_per_mm());
    let (least_g, found_g) = (0.5 * SUBSTEP_S * SUBSTEP_S * stiffness_un_per_mm, membrane.node_mass_g);
    if found_g < least_g {
        return Err(WorldError::Glue { stiffness_un_per_mm, least_g, found_g });
    }
    Ok(Some(adhesion))
}

/// The hinges of a scene.
pub fn curl(scene: &SceneFile, sheet: &Sheet) -> Option<Curl> {
    let membrane = scene.membrane.as_ref()?;
    let most_un_per_mm = stiffest_un_per_mm(membrane.node_mass_g, SUBSTEP_S);
    Some(Curl::new(sheet, membrane.curl.as_ref()?, most_un_per_mm))
}

/// The membrane at the start: glue takes the place of pins.
pub fn start_membrane(sheet: &Sheet, adhesion: Option<&Adhesion>) -> MembraneState {
    let mut membrane = sheet.start();
    if adhesion.is_some() {
        membrane.flag.fill(NODE_FREE);
    }
    membrane
}

/// Refuses glue that is not the scene's.
pub fn check(adhesion: Option<&Adhesion>, state: Option<&AdhesionState>) -> Result<(), CheckpointError> {
    let fits = match (adhesion, state) {
        (Some(adhesion), Some(state)) => adhesion.accepts(state),
        (None, None) => true,
        _ => false,
    };
    if fits { Ok(()) } else { Err(CheckpointError::Content("the membrane's glue is not the scene's")) }
}

impl World {
    /// Bonds of the membrane, where the scene has glue.
    pub fn adhesion(&self) -> Option<&Adhesion> {
        self.adhesion.as_ref()
    }

    /// Force that the tissue in the jaws of an instrument pulls with, µN.
    pub fn pull_un(&self, instrument: usize) -> f64 {
        forceps::pull_un(&self.state.instruments[instrument].held, &self.solver)
    }

    /// The area of the broken bonds is the area that was freed, and every number is in range.
    pub(super) fn audit_glue(&self) -> Result<(), String> {
        let (Some(adhesion), Some(bonds)) = (&self.adhesion, &self.state.adhesion) else { return Ok(()) };
        if !adhesion.accepts(bonds) {
            return Err("the glue has numbers out of range".into());
        }
        let (broken, freed) = (adhesion.broken_mm2(bonds), bonds.freed_mm2);
        let balanced = (broken - freed).abs() <= 1e-9 * adhesion.glued_mm2().max(1.0);
        if balanced {
            Ok(())
        } else {
            Err(format!("{freed} mm² were freed, the broken bonds have {broken} mm²"))
        }
    }

    /// Adds the forces of glue and curl on the nodes to the solver's outer forces.
    pub(super) fn pull_at_glue(&mut self) {
        let (membrane, solver) = (&self.state.membrane, &mut self.solver);
        let mut glue = self.adhesion.as_ref().zip(self.state.adhesion.as_mut());
        if let Some((adhesion, bonds)) = &mut glue {
            if !self.parting.begun {
                (self.parting.begun, self.parting.freed_before_mm2) = (true, bonds.freed_mm2);
            }
            let parting = adhesion.pull(membrane, bonds, solver, SUBSTEP_S as f32);
            self.parting.add(&parting);
        }
        if let Some(curl) = &mut self.curl {
            let glue = glue.map(|(a, s)| (a, &*s));
            curl.bend(membrane, glue, &mut solver.outer_un);
            if self.implicit.is_some() {
                curl.stiffen(membrane, glue, &mut solver.outer_un_per_mm);
            }
        }
    }

    /// Raises the events of the glue.
    pub(super) fn tell_peel(&mut self) {
        if self.parting.begun {
            self.tell_retina();
            self.tell_peeled();
        }
    }

    /// The pull at the retina: warning, lift, tear.
    fn tell_retina(&mut self) {
        let (Some(adhesion), Some(bonds)) = (&self.adhesion, &mut self.state.adhesion) else { return };
        let Some(scene) = self.scene.membrane.as_ref().and_then(|m| m.adhesion.as_ref()) else { return };
        let most = &self.parting.most;
        let event = |kind, value: f64, limit, (node, bonds): (usize, &AdhesionState)| {
            let position_in_eye_mm = adhesion.place(bonds, node).map(f64::from).into();
            let subject = node as u32;
            Happening { limit, subject, position_in_eye_mm, ..Happening::new(kind, value) }
        };
        let (pa, node) = most.highest_pa;
        if passes(&mut bonds.warned, f64::from(pa), scene.retina_warn_pa) {
            let (value, limit) = (f64::from(pa), scene.retina_warn_pa);
            self.log.raise(event(EventKind::RetinaPulled, value, limit, (node, bonds)));
        }
        let (mm, node) = most.highest_mm;
        if passes(&mut bonds.lifted, f64::from(mm), LIFTED_MM) {
            self.log.raise(event(EventKind::RetinaLifted, f64::from(mm), LIFTED_MM, (node, bonds)));
        }
        let (torn, node) = most.torn;
        if torn > 0 {
            let (value, depth_mm) = (bonds.torn_mm2, scene.retina_tear_mm);
            let wound = event(EventKind::RetinaTorn, value, 0.0, (node, bonds));
            self.log.raise(wound);
            self.bleed(wound.position_in_eye_mm.into(), depth_mm);
        }
    }

    /// How much of the membrane is off.
    fn tell_peeled(&mut self) {
        let (Some(adhesion), Some(bonds)) = (&self.adhesion, &self.state.adhesion) else { return };
        if self.parting.most.broken == 0 {
            return;
        }
        let flag = &self.state.membrane.flag;
        let steps = |mm2: f64| (mm2 / adhesion.glued_mm2() * PEELED_STEPS) as u64;
        let (before, now) = (self.parting.freed_before_mm2, bonds.freed_mm2);
        let off = |n: usize| flag[n] == NODE_DEAD || !adhesion.holds(bonds, n);
        if (0..flag.len()).all(off) {
            self.log.raise(Happening::new(EventKind::MembraneOff, now));
        } else if steps(now) > steps(before) {
            self.log.raise(Happening::new(EventKind::MembranePeeled, now));
        }
    }
}

/// True once when `value` passes `limit`; armed again when it falls well below.
fn passes(told: &mut bool, value: f64, limit: f64) -> bool {
    let first = value > limit && !*told;
    *told = first || (*told && value >= f64::from(RIM_REARM) * limit);
    first
}

impl StepParting {
    fn add(&mut self, now: &Parting) {
        self.most.broken += now.broken;
        if now.highest_pa.0 > self.most.highest_pa.0 {
            self.most.highest_pa = now.highest_pa;
        }
        if now.highest_mm.0 > self.most.highest_mm.0 {
            self.most.highest_mm = now.highest_mm;
        }
        if now.torn.0 > 0 {
            self.most.torn = (self.most.torn.0 + now.torn.0, now.torn.1);
        }
    }
}
