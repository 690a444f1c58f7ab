//! The tissue's share of a step: it moves, tears, pulls at the retina and at the jaws.

use super::World;
use super::plan::{Plan, Poses};
use crate::constants::RIM_REARM;
use crate::event_log::Happening;
use nalgebra::Vector3;
use protocol::events::EventKind;
use protocol::handles::JAW_LENGTH_MM;
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_FREE;
use tissue::constants::{STRAIN_SWEEPS, SUBSTEP_S};
use tissue::forceps::{self, Grasp};
use tissue::guard;
use tissue::membrane::strain::limit_strain;
use tissue::membrane::tear;
use tissue::state::NODE_PINNED;

/// What happened to the membrane in a step, added up so that a step raises one event of a kind.
#[derive(Debug, Clone, Copy, Default)]
pub struct Toll {
    torn: u32,
    torn_at: usize,
    rim_un: f32,
    rim_node: usize,
    detached: u32,
}

impl World {
    /// One substep of the membrane.
    pub(super) fn move_tissue(&mut self, plan: &Plan, poses: &Poses) {
        self.solver.clear_outer();
        let membrane = &mut self.state.membrane;
        for (i, pose) in poses.eye_from_instrument.iter().enumerate() {
            if plan.touches[i] {
                forceps::carry(&self.state.instruments[i].held, membrane, pose, SUBSTEP_S);
            }
        }
        self.pull_at_glue();
        self.suck_membrane(poses);
        for _ in 0..self.splits {
            self.advance_membrane();
        }
    }

    /// One part of a substep: forces, what they tear, motion.
    fn advance_membrane(&mut self) {
        let alarms = self.solver.accelerate(&self.sheet, &self.state.membrane, &self.tissue);
        if alarms.not_finite {
            self.contain();
        }
        self.bear_elements();
        if alarms.over_acceleration || alarms.over_tension {
            // Accelerations of stiff tissue at the begin of a substep say nothing about its end.
            self.tear(alarms.over_acceleration && self.implicit.is_none());
        }
        if self.tissue.is_plastic() {
            self.solver.creep(&self.sheet, &mut self.state.membrane, &self.tissue);
        }
        self.integrate();
        self.watch_rim();
    }

    fn integrate(&mut self) {
        let (state, tissue) = (&mut self.state.membrane, &self.tissue);
        match &mut self.implicit {
            Some(implicit) => _ = implicit.integrate(state, tissue, &self.solver),
            None => self.solver.integrate(state, tissue),
        }
        if tissue.strain_limit > 0.0 {
            let drawn = limit_strain(&self.sheet, state, tissue, STRAIN_SWEEPS);
            if drawn > 0 {
                self.solver.stay_inside(state, tissue.radius_mm);
            }
        }
    }

    /// The share of elements that carry the sheet in place of springs: forces for pins and jaws, and what they tear.
    fn bear_elements(&mut self) {
        let Some(implicit) = &mut self.implicit else { return };
        implicit.bear(&self.state.membrane, &mut self.solver, &self.tissue);
        let Some(&first) = implicit.rent().first() else { return };
        let (sheet, state) = (&self.sheet, &mut self.state.membrane);
        implicit.rent().iter().for_each(|&t| tear::remove_triangle(sheet, state, t));
        let (torn, place) = (implicit.rent().len() as u32, sheet.triangles[first][0] as usize);
        (self.toll.torn, self.toll.torn_at) = (self.toll.torn + torn, place);
        self.after_loss();
    }

    fn contain(&mut self) {
        let log = &mut self.log;
        let (state, solver) = (&mut self.state.membrane, &mut self.solver);
        guard::contain(&self.sheet, state, solver, &self.last_good, |node| log.raise(disabled(node)));
        self.after_loss();
    }

    /// The last check of a step: whatever is not finite by now is taken out.
    pub(super) fn check_finite(&mut self) {
        if guard::all_finite(&self.state.membrane) {
            return;
        }
        let log = &mut self.log;
        let state = &mut self.state.membrane;
        guard::disable_bad_nodes(&self.sheet, state, &self.last_good, |node| log.raise(disabled(node)));
        self.after_loss();
    }

    fn tear(&mut self, over_acceleration: bool) {
        let (sheet, state, solver) = (&self.sheet, &mut self.state.membrane, &self.solver);
        let (mut torn, mut place) = tear::tear_by_tension(sheet, state, solver);
        if over_acceleration {
            let (more, at) = tear::tear_by_acceleration(sheet, state, solver, self.tissue.a_tear);
            (torn, place) = (torn + more, if more > 0 { at } else { place });
        }
        if torn > 0 {
            (self.toll.torn, self.toll.torn_at) = (self.toll.torn + torn, place);
            self.after_loss();
        }
    }

    /// After triangles have gone: the solver and the jaws forget what belonged to them.
    pub(super) fn after_loss(&mut self) {
        for i in 0..INSTRUMENTS {
            let instrument = &mut self.state.instruments[i];
            if forceps::drop_dead(&mut instrument.held, &self.state.membrane) && instrument.held.is_empty() {
                let tip = instrument.tip_in_eye_mm.into();
                let event = Happening::new(EventKind::TissueReleased, 0.0);
                self.log.raise(event.by(i, tip));
            }
        }
        self.refresh();
    }

    /// Force on the pinned nodes: the largest is kept for the warning, too large a one detaches.
    fn watch_rim(&mut self) {
        let Some(scene) = &self.scene.membrane else { return };
        let tear2 = (scene.rim_tear_un * scene.rim_tear_un) as f32;
        let [fx, fy, fz] = &self.solver.force_un;
        let before = self.toll.detached;
        for &node in &self.sheet.rim {
            let n = node as usize;
            if self.state.membrane.flag[n] != NODE_PINNED {
                continue;
            }
            let f2 = fx[n] * fx[n] + fy[n] * fy[n] + fz[n] * fz[n];
            if f2 > self.toll.rim_un * self.toll.rim_un {
                (self.toll.rim_un, self.toll.rim_node) = (f2.sqrt(), n);
            }
            if f2 > tear2 {
                self.state.membrane.flag[n] = NODE_FREE;
                self.toll.detached += 1;
            }
        }
        if self.toll.detached > before {
            self.refresh();
        }
    }

    /// Jaws that close, open or slip during substep `k`.
    pub(super) fn use_forceps(&mut self, plan: &Plan, poses: &Poses, k: u64) {
        let s = plan.share(k);
        for i in 0..INSTRUMENTS {
            let instrument = &mut self.state.instruments[i];
            let (before, now) = (instrument.jaw_rad, plan.jaw(i, s));
            instrument.jaw_rad = now;
            if !plan.touches[i] || !forceps::has_jaws(instrument.tool) {
                continue;
            }
            instrument.travelled_mm += 0.5 * (now - before).abs() * JAW_LENGTH_MM;
            match forceps::grasp(before, now, &self.scene.contact) {
                Some(Grasp::Closed) if instrument.held.is_empty() => self.grab(i, poses),
                Some(Grasp::Opened) => self.let_go(i),
                _ => self.slip(i),
            }
        }
    }

    fn grab(&mut self, i: usize, poses: &Poses) {
        let reach = self.scene.contact.grab_reach_mm;
        let pose = &poses.eye_from_instrument[i];
        let instrument = &mut self.state.instruments[i];
        let held = forceps::bind(&mut instrument.held, i, &mut self.state.membrane, pose, reach);
        if held > 0 {
            let event = Happening::new(EventKind::TissueGrabbed, held as f64);
            self.log.raise(event.by(i, pose.translation.vector.into()));
            self.refresh();
        }
    }

    /// Opens the grip of instrument `i`, if it holds anything.
    pub(super) fn let_go(&mut self, i: usize) {
        let instrument = &mut self.state.instruments[i];
        let released =
            forceps::release(&mut instrument.held, &mut self.state.membrane, self.tissue.radius_mm);
        if released > 0 {
            let tip = instrument.tip_in_eye_mm.into();
            let event = Happening::new(EventKind::TissueReleased, released as f64);
            self.log.raise(event.by(i, tip));
            self.refresh();
        }
    }

    fn slip(&mut self, i: usize) {
        let instrument = &mut self.state.instruments[i];
        if instrument.held.is_empty() {
            return;
        }
        let (pull, limit) = (forceps::pull_un(&instrument.held, &self.solver), self.scene.contact.grip_un);
        if pull > limit {
            forceps::release(&mut instrument.held, &mut self.state.membrane, self.tissue.radius_mm);
            let event = Happening::new(EventKind::GripSlipped, pull);
            let tip = instrument.tip_in_eye_mm.into();
            self.log.raise(Happening { limit, ..event.by(i, tip) });
            self.refresh();
        }
    }

    /// Raises the events of the toll.
    pub(super) fn tell_toll(&mut self) {
        let toll = self.toll;
        let Some(scene) = &self.scene.membrane else { return };
        let at = |node: usize| self.state.membrane.position(node).map(f64::from);
        let event = |kind, value: f64, limit, node: usize, at: Vector3<f64>| Happening {
            limit,
            subject: node as u32,
            position_in_eye_mm: at.into(),
            ..Happening::new(kind, value)
        };
        let rim = f64::from(toll.rim_un);
        if toll.torn > 0 {
            let (value, place) = (f64::from(toll.torn), at(toll.torn_at));
            let torn = event(EventKind::TissueTorn, value, 0.0, toll.torn_at, place);
            self.log.raise(torn);
        }
        let place = at(toll.rim_node);
        if toll.detached > 0 {
            let (kind, limit) = (EventKind::RimDetached, scene.rim_tear_un);
            self.log.raise(event(kind, rim, limit, toll.rim_node, place));
        }
        let warned = self.state.membrane.rim_warned;
        if rim > scene.rim_warn_un && !warned {
            self.state.membrane.rim_warned = true;
            let (kind, limit) = (EventKind::RimForceHigh, scene.rim_warn_un);
            self.log.raise(event(kind, rim, limit, toll.rim_node, place));
        } else if toll.rim_un < RIM_REARM * scene.rim_warn_un as f32 {
            self.state.membrane.rim_warned = false;
        }
    }
}

fn disabled(node: usize) -> Happening {
    let event = Happening::new(EventKind::TissueDisabled, node as f64);
    Happening { subject: node as u32, ..event }
}
