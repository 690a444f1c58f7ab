//! The retina's share of a step: needles, jaws and tips on it, its own movement, and what happened to it.

use super::World;
use super::plan::{Plan, Poses};
use crate::constants::UNDER_MARGIN_MM;
use crate::event_log::Happening;
use crate::state::State;
use collision::surface::{CollisionError, Surface};
use collision::zcoll::Zcoll;
use nalgebra::Vector3;
use protocol::events::{EventKind, NO_INSTRUMENT};
use protocol::handles::{PedalMode, Tool};
use protocol::limits::INSTRUMENTS;
use scene::VitrectorScene;
use tissue::cutting::Cutting;
use tissue::forceps::{self, Grasp};
use tissue::retina::Retina;
use tissue::retina::state::RetinaState;
use tissue::vitrector::Port;

/// Mm³/s in µl/min.
const UL_PER_MIN: f64 = 60.0;

/// The retina's model and its collision images.
#[derive(Debug)]
pub(super) struct RetinaPart {
    pub model: Retina,
    zcoll: Zcoll,
    cutting: Cutting,
    /// A port drew at it in the last substep: its outer forces are not 0.
    sucked: bool,
}

impl RetinaPart {
    pub fn new(
        model: Retina,
        volume: collision::instrument_image::Volume,
        vitrector: &VitrectorScene,
    ) -> Result<Self, CollisionError> {
        let zcoll = Zcoll::new(volume, &model.sheet.triangles, model.sheet.nodes())?;
        let cutting = Cutting::new(vitrector, &model.sheet)?;
        Ok(RetinaPart { model, zcoll, cutting, sucked: false })
    }

    /// Vitrectors at loose retina: open ports draw it, closing ones take what is in them. Retina that lies on is out of their reach.
    fn use_ports(&mut self, retina: &mut RetinaState, ports: &[Option<Port>; INSTRUMENTS], poses: &Poses) {
        if std::mem::take(&mut self.sucked) {
            self.model.solver.clear_outer();
        }
        for (i, port) in ports.iter().enumerate() {
            let Some(port) = port.filter(|p| p.cuts || (p.open && p.suction_pa > 0.0)) else { continue };
            if !self.model.reaches(retina, &port.cone.apex_in_eye_mm, self.cutting.reach_mm()) {
                continue;
            }
            let position_mm = retina.tissue.position_mm.each_ref().map(Vec::as_slice);
            let (triangles, alive) = (&self.model.sheet.triangles[..], &self.model.pieces.loose_alive[..]);
            let surface = Surface { position_mm, triangles, alive };
            if !self.cutting.look(&poses.eye_from_instrument[i], &surface) {
                continue;
            }
            if port.open {
                let Retina { sheet, solver, .. } = &mut self.model;
                self.cutting.suck(&port, sheet, &retina.tissue, &mut solver.outer_un);
                self.sucked = true;
            }
            let RetinaState { tissue, removed, .. } = retina;
            if port.cuts && self.cutting.cut(&port, &self.model.sheet, tissue, removed, i) {
                self.model.after_loss(retina);
            }
        }
    }
}

impl World {
    /// The retina's model, where the scene has one.
    pub fn retina(&self) -> Option<&Retina> {
        self.retina.as_ref().map(|part| &part.model)
    }

    /// One substep of the retina: jaws, needles, fluid, springs.
    pub(super) fn move_retina(&mut self, plan: &Plan, poses: &Poses, k: u64) {
        let Some(mut part) = self.retina.take() else { return };
        let Some(mut retina) = self.state.retina.take() else {
            self.retina = Some(part);
            return;
        };
        part.use_ports(&mut retina, &self.aimed.ports, poses);
        let model = &mut part.model;
        let mut pressure = [None; INSTRUMENTS];
        for (i, pressure) in pressure.iter_mut().enumerate() {
            self.use_jaws_on_retina(model, &mut retina, plan, poses, (i, k));
            let needle = self.aimed.needles[i];
            let news = model.follow_needle(&mut retina, i, needle.as_ref());
            self.tell_needle(i, &news, model.figures.scene.needle_warn_mm_s);
            let in_place = needle.filter(|_| retina.needles[i].inside);
            *pressure = in_place.filter(|n| n.pressure_pa > 0.0).map(|n| n.pressure_pa);
        }
        model.flow(&mut retina, pressure);
        model.substep(&mut retina, self.state.substeps);
        (self.retina, self.state.retina) = (Some(part), Some(retina));
    }

    fn tell_needle(&mut self, i: usize, news: &tissue::retina::NeedleNews, limit: f64) {
        let tip = self.state.instruments[i].tip_in_eye_mm.into();
        let told = [
            (EventKind::RetinaPierced, news.pierced_mm, 0.0),
            (EventKind::BlebFilled, news.left_mm3, 0.0),
            (EventKind::NeedleFast, news.fast_mm_s, limit),
        ];
        for (kind, value, limit) in told {
            if let Some(value) = value {
                self.log.raise(Happening { limit, ..Happening::new(kind, value).by(i, tip) });
            }
        }
    }

    /// Closing jaws take hold of loose retina, opening ones let go, a grip pulled too hard slips. `at` is instrument and substep.
    fn use_jaws_on_retina(
        &mut self,
        model: &mut Retina,
        retina: &mut RetinaState,
        plan: &Plan,
        poses: &Poses,
        at: (usize, u64),
    ) {
        let (i, pose) = (at.0, &poses.eye_from_instrument[at.0]);
        let now = plan.jaw(i, plan.share(at.1));
        let before = std::mem::replace(&mut retina.presses[i].jaw_rad, now);
        let jaws = plan.touches[i] && forceps::has_jaws(self.state.instruments[i].tool);
        let held = !retina.held[i].is_empty();
        if !jaws && !held {
            return;
        }
        let contact = &self.scene.contact;
        let grasp = forceps::grasp(before, now, contact);
        let (mut kind, mut value) = (EventKind::TissueReleased, 0.0);
        if held && (!jaws || grasp == Some(Grasp::Opened)) {
            value = model.let_go(retina, i) as f64;
        } else if held {
            model.carry(retina, i, pose);
            let pull = model.pull_un(retina, i);
            if pull > contact.grip_un {
                model.let_go(retina, i);
                (kind, value) = (EventKind::GripSlipped, pull);
            }
        } else if grasp == Some(Grasp::Closed) && self.state.instruments[i].held.is_empty() {
            kind = EventKind::TissueGrabbed;
            value = model.grab(retina, i, pose, contact.grab_reach_mm) as f64;
        }
        if value > 0.0 {
            self.log.raise(Happening::new(kind, value).by(i, pose.translation.vector.into()));
        }
    }

    /// Distance of a tip from the retina as the touch events see it, mm: from the lifted retina where it is lifted; a needle in it is a
    /// touch until it reaches the choroid's depth.
    pub(super) fn retina_clearance(&mut self, i: usize) -> f64 {
        let tip = &self.state.instruments[i].tip_in_eye_mm;
        let over_choroid = self.scene.eye.retina_radius_mm - tip.norm();
        let (Some(part), Some(retina)) = (&mut self.retina, &self.state.retina) else { return over_choroid };
        let deep = part.model.figures.scene.deep_mm;
        if retina.needles[i].inside {
            return if over_choroid < -deep { over_choroid + deep } else { 0.0 };
        }
        let found = part.model.clearance(retina, tip);
        // Loose retina gives way; what lies under it is hurt only from the choroid on.
        if found.loose && found.mm < 0.0 { over_choroid.min(0.0) } else { found.mm }
    }

    /// ZCOLL for every instrument that presses on loose retina; a needle pierces and does not press.
    pub(super) fn push_retina(&mut self, plan: &Plan, poses: &Poses) {
        let (Some(mut part), Some(mut retina)) = (self.retina.take(), self.state.retina.take()) else {
            return;
        };
        for i in 0..INSTRUMENTS {
            let way = Vector3::from(retina.presses[i].way_mm);
            let needle = self.state.instruments[i].tool == Tool::Needle as u32;
            let near = part.model.reaches(
                &retina,
                &poses.eye_from_instrument[i].translation.vector,
                self.volume.reach_mm(),
            );
            let press = &mut retina.presses[i];
            press.way_mm = [0.0; 3];
            if !plan.touches[i] || needle || !near || !retina.held[i].is_empty() {
                (press.in_contact, press.under) = (false, false);
                continue;
            }
            self.press(&mut part, &mut retina, poses, (i, way));
        }
        (self.retina, self.state.retina) = (Some(part), Some(retina));
    }

    fn press(
        &mut self,
        part: &mut RetinaPart,
        retina: &mut RetinaState,
        poses: &Poses,
        at: (usize, Vector3<f64>),
    ) {
        let ((i, way), pose) = (at, &poses.eye_from_instrument[at.0]);
        self.images[i].prepare(self.state.instruments[i].jaw_rad, &self.volume);
        let position_mm = retina.tissue.position_mm.each_ref().map(Vec::as_slice);
        let (triangles, alive) = (&part.model.sheet.triangles[..], &part.model.pieces.loose_alive[..]);
        let surface = Surface { position_mm, triangles, alive };
        let found = part.zcoll.query(&self.images[i], &pose.inverse(), &surface);
        self.tell_look(i, &found);
        let press = &mut retina.presses[i];
        let deepest = self.volume.depth_steps_mm(found.deepest);
        if found.pixels == 0 {
            press.under = false;
        } else if !press.in_contact && deepest > way.norm() + UNDER_MARGIN_MM {
            press.under = true;
        }
        press.in_contact = found.pixels > 0;
        if found.pixels == 0 || press.under {
            return;
        }
        let ahead = -(pose.rotation * Vector3::z());
        let drag = (way - ahead * way.dot(&ahead)) * part.model.figures.scene.drag;
        for (node, steps) in part.zcoll.displaced() {
            let push = ahead * self.volume.depth_steps_mm(steps) + drag;
            part.model.push_node(retina, node, &push);
        }
        let pressed = part.zcoll.displaced().map(|(node, _)| node);
        part.model.press_on(retina, pressed);
    }

    /// Adds the ways of the tips, which pressing tips drag retina by.
    pub(super) fn note_ways(&mut self, poses: &Poses) {
        let Some(retina) = &mut self.state.retina else { return };
        for (press, step) in retina.presses.iter_mut().zip(&poses.tip_step_mm) {
            press.way_mm.iter_mut().zip(step.iter()).for_each(|(sum, s)| *sum += s);
        }
    }

    /// Takes the pedal's fluid–air exchange: its first axis lets air in, its second one fluid.
    pub(super) fn exchange_air(&mut self) {
        let foot = &self.state.microscope;
        let (in_mode, exchange) = (foot.mode == PedalMode::Exchange as u32, self.state.tools.exchange);
        let Some(retina) = &mut self.state.retina else { return };
        let fluid = in_mode && foot.axes[1] > 0.0;
        let air = exchange > 0.0 || (retina.air && !fluid);
        if air != retina.air {
            retina.air = air;
            let value = if air { 1.0 } else { 0.0 };
            self.log.raise(Happening::new(EventKind::AirExchange, value));
        }
    }

    /// Ends the retina's step and raises the events of its toll.
    pub(super) fn end_retina(&mut self) {
        let (Some(part), Some(retina)) = (&mut self.retina, &mut self.state.retina) else { return };
        part.model.end_step(retina);
        let (toll, scene) = (part.model.toll, &part.model.figures.scene);
        let counts = [
            (EventKind::RetinaDetached, toll.detached),
            (EventKind::RetinaReattached, toll.lying),
            (EventKind::RetinaRipped, toll.torn),
            (EventKind::TissueDisabled, toll.disabled),
        ];
        for (kind, (count, node)) in counts.into_iter().filter(|c| c.1.0 > 0) {
            let position_in_eye_mm = retina.tissue.position(node as usize).map(f64::from).into();
            let event = Happening::new(kind, f64::from(count));
            self.log.raise(Happening {
                subject: node,
                position_in_eye_mm,
                instrument: NO_INSTRUMENT,
                ..event
            });
        }
        if toll.merged.0 > 0 {
            self.log.raise(Happening::new(EventKind::BlebsMerged, toll.merged.1));
        }
        for (i, cut_mm2) in part.cutting.take_cuts() {
            let event = Happening::new(EventKind::RetinaCut, cut_mm2);
            self.log.raise(event.by(i, self.state.instruments[i].tip_in_eye_mm.into()));
        }
        for i in 0..INSTRUMENTS {
            let (flow, limit) = (toll.flow_mm3_s[i] * UL_PER_MIN, scene.flow_warn_ul_per_min);
            let tip = self.state.instruments[i].tip_in_eye_mm.into();
            let warned = &mut retina.needles[i].flow_warned;
            if flow > limit && !*warned {
                let event = Happening::new(EventKind::InjectionFast, flow).by(i, tip);
                self.log.raise(Happening { limit, ..event });
            }
            *warned = flow > limit;
        }
    }

    /// Begins the retina's step.
    pub(super) fn begin_retina(&mut self) {
        if let (Some(part), Some(retina)) = (&mut self.retina, &self.state.retina) {
            part.model.begin_step(retina);
        }
    }

    /// What is wrong with the retina of a restored state.
    pub(super) fn check_retina(&self, state: &State) -> Result<(), &'static str> {
        match (&self.retina, &state.retina) {
            (None, None) => Ok(()),
            (Some(part), Some(retina)) => {
                retina.check(&part.model.sheet)?;
                if part.model.agrees(retina) {
                    Ok(())
                } else {
                    Err("the blebs are not those of the loose retina")
                }
            }
            _ => Err("the scene has a retina and the state has none, or the reverse"),
        }
    }

    /// Makes everything about the retina follow from the state again.
    pub(super) fn refind_retina(&mut self) {
        if let (Some(part), Some(retina)) = (&mut self.retina, &mut self.state.retina) {
            retina.reserve();
            part.model.find_again(retina);
        }
    }
}
