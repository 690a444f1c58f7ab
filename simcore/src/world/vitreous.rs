//! The vitreous' share of a step: shafts drag it, the vitrector takes it, it comes back, and the retina feels it.
//!
//! It moves in parts of a step of about [`VITREOUS_SUBSTEPS`] substeps, after the substeps of the membrane: the gel is slow,
//! and a part covers the instruments' whole way, so that nothing is lost between two of them.

use super::World;
use super::plan::Plan;
use crate::checkpoint::CheckpointError;
use crate::constants::{TRACTION_EVERY, TRACTION_REARM, VITREOUS_QUIET_NS, VITREOUS_SUBSTEPS};
use crate::event_log::Happening;
use crate::state::State;
use crate::vitreous::state::VitreousState;
use crate::vitreous::traction::{Stress, Traction};
use crate::vitreous::{Shaft, Vitreous, state};
use protocol::events::{EventKind, Severity};
use protocol::limits::INSTRUMENTS;

impl World {
    /// The vitreous and its state, if the scene has one.
    pub fn vitreous(&self) -> Option<(&Vitreous, &VitreousState)> {
        self.vitreous.as_ref().zip(self.state.vitreous.as_ref())
    }

    /// A step of the vitreous.
    pub(super) fn move_vitreous(&mut self, plan: &Plan) {
        let Some(mut gel) = self.vitreous.take() else { return };
        if let Some(mut state) = self.state.vitreous.take() {
            let parts = plan.substeps.div_ceil(VITREOUS_SUBSTEPS);
            for part in 0..parts {
                self.drag_vitreous(
                    plan,
                    [part, part + 1].map(|p| p as f64 / parts as f64),
                    &mut gel,
                    &mut state,
                );
                gel.relax(&mut state);
                gel.free();
            }
            if parts > 0 && self.state.step.is_multiple_of(TRACTION_EVERY) {
                let traction = gel.look(&mut state);
                self.tell_vitreous(&gel, &mut state, &traction);
            }
            gel.draw(&state);
            self.state.vitreous = Some(state);
        }
        self.vitreous = Some(gel);
    }

    /// The shafts from one share of their way to another.
    fn drag_vitreous(
        &mut self,
        plan: &Plan,
        [from, to]: [f64; 2],
        gel: &mut Vitreous,
        state: &mut VitreousState,
    ) {
        for i in (0..INSTRUMENTS).filter(|&i| plan.touches[i]) {
            let way = [plan.pose(i, from), plan.pose(i, to)];
            gel.carry(state, &Shaft { way, radius_mm: self.scene.instruments[i].shaft_radius_mm });
        }
    }

    /// Raises the events of a step.
    fn tell_vitreous(&mut self, gel: &Vitreous, state: &mut VitreousState, traction: &Traction) {
        let Some(scene) = &self.scene.vitreous else { return };
        let lattice = gel.lattice();
        let at = |element: u32| state.place_um(lattice, element as usize).map(|c| f64::from(c) * 1e-3);
        let pulled = |kind, severity, stress: Stress, limit| Happening {
            limit,
            subject: stress.element,
            position_in_eye_mm: at(stress.element),
            ..Happening::new(kind, severity, f64::from(stress.pa))
        };
        let (greatest, base, adhesion) = (traction.greatest, traction.base, &scene.adhesion);
        let warning = pulled(EventKind::VitreousTraction, Severity::Warning, greatest, adhesion.warn_pa);
        let danger = pulled(EventKind::BaseTraction, Severity::Injury, base, adhesion.tear_pa);
        let released_at = at(traction.released_at);
        for (event, out) in [(warning, &mut state.warned), (danger, &mut state.tear_warned)] {
            if event.value > event.limit && !*out {
                *out = true;
                self.log.raise(event);
            } else if event.value < TRACTION_REARM * event.limit {
                *out = false;
            }
        }
        let now = self.state.exposed_ns;
        if traction.released > 0 && now >= state.quiet_until_ns {
            state.quiet_until_ns = now + VITREOUS_QUIET_NS;
            let pitch_mm = f64::from(lattice.pitch_um) * 1e-3;
            let area_mm2 = state.released as f64 * pitch_mm * pitch_mm;
            let event = Happening::new(EventKind::VitreousDetached, Severity::Info, area_mm2);
            self.log.raise(Happening { position_in_eye_mm: released_at, ..event });
        }
        let removed_ml = state.removed_um3(lattice) as f64 * 1e-12;
        let milestones = (removed_ml / scene.suction.milestone_ml) as u64;
        if milestones > state.milestones {
            state.milestones = milestones;
            self.log.raise(Happening::new(EventKind::VitreousRemoved, Severity::Info, removed_ml));
        }
    }

    /// Refuses the vitreous of a foreign state.
    pub(super) fn check_vitreous(&self, state: &State) -> Result<(), CheckpointError> {
        match (&self.vitreous, &state.vitreous) {
            (Some(gel), Some(state)) => state::check(gel.lattice(), state).map_err(CheckpointError::Content),
            (None, None) => Ok(()),
            _ => Err(CheckpointError::Content("a vitreous where the scene has none, or the reverse")),
        }
    }

    /// After another state took the place of the last one.
    pub(super) fn refresh_vitreous(&mut self) {
        if let (Some(gel), Some(state)) = (&mut self.vitreous, &self.state.vitreous) {
            gel.refresh(state);
        }
    }
}
