//! What happened to membrane and retina in a step, as events.

use super::World;
use super::sheets::SheetName;
use crate::constants::{FOLD_QUIET_NS, RIM_REARM};
use collision::zcoll::Contacts;
use nalgebra::Vector3;
use protocol::events::{EventDraft, EventKind};
use protocol::limits::INSTRUMENTS;
use tissue::sheet::adhesion::{LIFTED_MM, Parting};
use tissue::sheet::collider::Pushed;
use tissue::sheet::step_counts::{SheetCounts, Tally};

/// The freed area is reported whenever another such share of the adhering area is off.
const PEELED_STEPS: f64 = 10.0;

/// An event about a node.
fn at_node(kind: EventKind, value: f64, node: usize, at_mm: Vector3<f64>) -> EventDraft {
    let (subject, position_in_eye_mm) = (node as u32, at_mm.into());
    EventDraft { subject, position_in_eye_mm, ..EventDraft::new(kind, value) }
}

/// True once when `value` passes `limit`; armed again at a tick in which it stayed well below all
/// along.
fn passes(warned: &mut bool, value: f64, peak: Option<f64>, limit: f64) -> bool {
    let first = value > limit && !*warned;
    *warned = first || (*warned && peak.is_none_or(|peak| peak >= f64::from(RIM_REARM) * limit));
    first
}

impl World {
    /// What was torn, disabled or cut of a sheet, and grips that were lost by it.
    pub(super) fn emit_sheet_counts(&mut self, name: SheetName, counts: &SheetCounts) {
        let (torn, cut) = match name {
            SheetName::Membrane => (EventKind::TissueTorn, EventKind::TissueCut),
            SheetName::Retina => (EventKind::RetinaRipped, EventKind::RetinaCut),
        };
        self.emit_tally(name, torn, counts.torn);
        self.emit_tally(name, EventKind::TissueDisabled, counts.disabled);
        for i in (0..INSTRUMENTS).filter(|&i| counts.lost_grip[i]) {
            self.emit_by(i, EventKind::TissueReleased, 0.0);
        }
        for i in (0..INSTRUMENTS).filter(|&i| counts.cut_um2[i] > 0) {
            self.emit_by(i, cut, counts.cut_um2[i] as f64 * 1e-6);
        }
    }

    /// One event for nodes of a sheet to which the same happened.
    pub(super) fn emit_tally(&mut self, name: SheetName, kind: EventKind, tally: Tally) {
        if tally.count > 0
            && let Some((_, sheet)) = self.sheet_mut(name)
        {
            let at_mm = World::place_mm(sheet, tally.node as usize);
            self.log.emit(at_node(kind, f64::from(tally.count), tally.node as usize, at_mm));
        }
    }

    /// The pull at the membrane's rim: warning, and what came off.
    pub(super) fn emit_rim(&mut self, counts: &SheetCounts, rearms: bool) {
        let (Some(scene), sheet) = (&self.scene.membrane, &mut self.state.membrane) else { return };
        let (rim_un, node) = (f64::from(counts.rim_un.0), counts.rim_un.1);
        let at_mm = World::place_mm(sheet, node);
        if counts.detached.count > 0 {
            let event = at_node(EventKind::RimDetached, rim_un, node, at_mm);
            self.log.emit(EventDraft { limit: scene.rim_tear_un, ..event });
        }
        let peak = self.state.ticks.rim_un.note(rim_un, rearms);
        if passes(&mut sheet.rim_warned, rim_un, peak, scene.rim_warn_un) {
            let event = at_node(EventKind::RimForceHigh, rim_un, node, at_mm);
            self.log.emit(EventDraft { limit: scene.rim_warn_un, ..event });
        }
    }

    /// The pull of the membrane's bonds at the retina: warning, lift, tear.
    pub(super) fn emit_traction(&mut self, parting: &Parting, rearms: bool) {
        let (Some(body), Some(bonds)) = (&self.membrane, &mut self.state.membrane.adhesion) else { return };
        let Some(adhesion) = body.adhesion() else { return };
        let Some(scene) = self.scene.membrane.as_ref().and_then(|m| m.adhesion.as_ref()) else { return };
        let (pa, node) = parting.highest_pa;
        let peak = self.state.ticks.pull_pa.note(f64::from(pa), rearms);
        if passes(&mut bonds.warned, f64::from(pa), peak, scene.retina_warn_pa) {
            let (kind, at_mm) = (EventKind::RetinaPulled, adhesion.place(bonds, node).map(f64::from));
            let event = at_node(kind, f64::from(pa), node, at_mm);
            self.log.emit(EventDraft { limit: scene.retina_warn_pa, ..event });
        }
        let (mm, node) = parting.highest_mm;
        let peak = self.state.ticks.lift_mm.note(f64::from(mm), rearms);
        if passes(&mut bonds.lifted, f64::from(mm), peak, LIFTED_MM) {
            let (kind, at_mm) = (EventKind::RetinaLifted, adhesion.place(bonds, node).map(f64::from));
            let event = at_node(kind, f64::from(mm), node, at_mm);
            self.log.emit(EventDraft { limit: LIFTED_MM, ..event });
        }
        let (torn, node) = parting.torn;
        if torn > 0 {
            let (value, depth_mm) = (bonds.torn_mm2, scene.retina_tear_mm);
            let at_mm = adhesion.place(bonds, node).map(f64::from);
            self.log.emit(at_node(EventKind::RetinaTorn, value, node, at_mm));
            self.bleed(at_mm, depth_mm);
        }
    }

    /// How much of the membrane is off, of which `before_mm2` was before the step.
    pub(super) fn emit_peeled(&mut self, before_mm2: f64) {
        let (Some(body), sheet) = (&self.membrane, &self.state.membrane) else { return };
        let (Some(adhesion), Some(bonds)) = (body.adhesion(), &sheet.adhesion) else { return };
        let steps = |mm2: f64| (mm2 / adhesion.bonded_mm2() * PEELED_STEPS) as u64;
        let now = bonds.freed_mm2;
        if body.is_off(sheet) {
            self.log.emit(EventDraft::new(EventKind::MembraneOff, now));
        } else if steps(now) > steps(before_mm2) {
            self.log.emit(EventDraft::new(EventKind::MembranePeeled, now));
        }
    }

    /// What an instrument's push did.
    pub(super) fn emit_push(&mut self, i: usize, pushed: &Pushed) {
        pushed.found.iter().for_each(|found| self.emit_look(i, found));
        if let Some(nodes) = pushed.hooked {
            self.emit_by(i, EventKind::TissueHooked, nodes as f64);
        }
        if pushed.needle_out {
            self.emit_by(i, EventKind::NeedleOut, 0.0);
        }
        if let Some(resistance_un) = pushed.pierced_un {
            let tip = self.state.instruments[i].tip_in_eye_mm.into();
            let event = EventDraft::new(EventKind::MembranePierced, resistance_un);
            self.log.emit(EventDraft { limit: self.figures.needle.pierce_un, ..event.by(i, tip) });
        }
    }

    /// Defects of a query of a sheet: second layers, triangles that its image cannot hold, and
    /// triangles without area in it. The last ones are seldom a loss: their neighbours fill the
    /// image.
    fn emit_look(&mut self, i: usize, found: &Contacts) {
        let instrument = &mut self.state.instruments[i];
        let troubled = found.folded > 0 || found.refused > 0 || found.flat > 0;
        if !troubled || self.state.exposed_ns < instrument.fold_quiet_ns {
            return;
        }
        instrument.fold_quiet_ns = self.state.exposed_ns + FOLD_QUIET_NS;
        let events = [
            (EventKind::NotPiConvex, found.folded),
            (EventKind::TrianglesRefused, found.refused),
            (EventKind::TrianglesFlat, found.flat),
        ];
        for (kind, count) in events.into_iter().filter(|event| event.1 > 0) {
            self.emit_by(i, kind, f64::from(count));
        }
    }
}
