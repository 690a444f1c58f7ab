//! The retina in a step: needles in it, fluid behind it, air before it, and what happened to it.

use super::World;
use super::plan::InstrumentPoses;
use super::sheets::SheetName;
use super::tools::PlacedTools;
use protocol::events::{EventDraft, EventKind};
use protocol::handles::PedalMode;
use protocol::limits::INSTRUMENTS;
use tissue::retina::{NeedleEvents, Retina, RetinaCounts};

/// Mm³/s in µl/min.
const UL_PER_MIN: f64 = 60.0;

impl World {
    /// The retina's model, where the scene has one.
    pub fn retina(&self) -> Option<&Retina> {
        self.retina.as_ref()
    }

    /// One substep of the retina: ports, needles, fluid, springs.
    pub(super) fn move_retina(&mut self, poses: &InstrumentPoses, tools: &PlacedTools) {
        let (Some(model), Some(retina)) = (&mut self.retina, &mut self.state.retina) else { return };
        model.draw(retina, &tools.ports, &poses.eye_from_instrument);
        let mut events = [NeedleEvents::default(); INSTRUMENTS];
        let mut pressure = [None; INSTRUMENTS];
        for (i, needle) in tools.needles.iter().enumerate() {
            events[i] = model.follow_needle(retina, i, needle.as_ref());
            let in_place = needle.filter(|_| retina.needles[i].inside);
            pressure[i] = in_place.filter(|n| n.pressure_pa > 0.0).map(|n| n.pressure_pa);
        }
        model.flow(retina, pressure);
        model.substep(retina, self.state.substeps);
        let limit = model.figures.scene.needle_warn_mm_s;
        events.iter().enumerate().for_each(|(i, events)| self.emit_needle(i, events, limit));
    }

    fn emit_needle(&mut self, i: usize, needle: &NeedleEvents, limit: f64) {
        let tip = self.state.instruments[i].tip_in_eye_mm.into();
        let events = [
            (EventKind::RetinaPierced, needle.pierced_mm, 0.0),
            (EventKind::BlebFilled, needle.left_mm3, 0.0),
            (EventKind::NeedleFast, needle.fast_mm_s, limit),
        ];
        for (kind, value, limit) in events {
            if let Some(value) = value {
                self.log.emit(EventDraft { limit, ..EventDraft::new(kind, value).by(i, tip) });
            }
        }
    }

    /// Distance of a tip from the retina as the touch events see it, mm: from the lifted retina
    /// where it is lifted; a needle in it is a touch until it reaches the choroid's depth.
    pub(super) fn retina_clearance(&mut self, i: usize) -> f64 {
        let tip = &self.state.instruments[i].tip_in_eye_mm;
        let over_choroid = self.scene.eye.retina_radius_mm - tip.norm();
        let (Some(model), Some(retina)) = (&mut self.retina, &self.state.retina) else { return over_choroid };
        let deep = model.figures.scene.deep_mm;
        if retina.needles[i].inside {
            return if over_choroid < -deep { over_choroid + deep } else { 0.0 };
        }
        let found = model.clearance(retina, tip);
        // Loose retina gives way; what lies under it is hurt only from the choroid on.
        if found.loose && found.mm < 0.0 { over_choroid.min(0.0) } else { found.mm }
    }

    /// Takes the pedal's fluid–air exchange: its first axis lets air in, its second one fluid.
    pub(super) fn apply_infusion(&mut self) {
        let foot = &self.state.microscope;
        let (in_mode, exchange) = (foot.mode == PedalMode::Exchange as u32, self.state.tools.exchange);
        let Some(retina) = &mut self.state.retina else { return };
        let fluid = in_mode && foot.axes[1] > 0.0;
        let air = exchange > 0.0 || (retina.air && !fluid);
        if air != retina.air {
            retina.air = air;
            let value = if air { 1.0 } else { 0.0 };
            self.log.emit(EventDraft::new(EventKind::AirExchange, value));
        }
    }

    /// What happened to the retina in the step.
    pub(super) fn emit_retina(&mut self, counts: &RetinaCounts, rearms: bool) {
        self.emit_tally(SheetName::Retina, EventKind::RetinaDetached, counts.sheet.detached);
        self.emit_tally(SheetName::Retina, EventKind::RetinaReattached, counts.attached);
        if counts.merged.0 > 0 {
            self.log.emit(EventDraft::new(EventKind::BlebsMerged, counts.merged.1));
        }
        let (Some(model), Some(retina)) = (&self.retina, &mut self.state.retina) else { return };
        let limit = model.figures.scene.flow_warn_ul_per_min;
        for i in 0..INSTRUMENTS {
            let flow = counts.flow_mm3_s[i] * UL_PER_MIN;
            let tip = self.state.instruments[i].tip_in_eye_mm.into();
            let warned = &mut retina.needles[i].flow_warned;
            if flow > limit && !*warned {
                let event = EventDraft::new(EventKind::InjectionFast, flow).by(i, tip);
                self.log.emit(EventDraft { limit, ..event });
            }
            let peak = self.state.ticks.flow_mm3_s[i].note(flow, rearms);
            *warned = flow > limit || (*warned && peak.is_none_or(|peak| peak > limit));
        }
    }
}
