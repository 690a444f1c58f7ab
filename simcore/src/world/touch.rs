//! Instruments against membrane and retina.

use super::World;
use super::plan::{Plan, Poses};
use crate::collision::continuous::crosses;
use crate::collision::eyeball;
use crate::collision::zcoll::{self, Found, Zcoll};
use crate::constants::{FOLD_QUIET_NS, LOOKED_WAY_MM, MAX_MARKS, SUBSTEP_S, UNDER_MARGIN_MM};
use crate::event_log::Happening;
use crate::state::MarkState;
use nalgebra::{UnitVector3, Vector3};
use protocol::events::{EventKind, Severity};
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_FREE;

/// Radius of a fresh bleeding point, mm.
const MARK_RADIUS_MM: f64 = 0.08;
/// Bleeding points nearer than this to an old one make it grow instead, mm.
const MARK_MERGE_MM: f32 = 0.2;

impl World {
    /// ZCOLL for every instrument near the membrane; jaws that hold tissue push none.
    pub(super) fn push_membrane(&mut self, plan: &Plan, poses: &Poses) {
        let Some(mut zcoll) = self.zcoll.take() else { return };
        let reach = self.volume.reach_mm();
        for i in 0..INSTRUMENTS {
            let instrument = &mut self.state.instruments[i];
            let near = zcoll::near_membrane(&self.state.membrane, &instrument.tip_in_eye_mm, reach);
            if !plan.touches[i] || !instrument.held.is_empty() || !near {
                (instrument.in_contact, instrument.under, instrument.travelled_mm) = (false, false, 0.0);
                continue;
            }
            let pose = &poses.eye_from_instrument[i];
            self.images[i].prepare(instrument.jaw_rad, &self.volume);
            let (image, membrane) = (&self.images[i], &self.state.membrane);
            let found = zcoll.look(image, &pose.inverse(), &membrane.surface(&self.sheet));
            self.tell_fold(i, &found);
            if found.pixels == 0 && self.jumped_through(i, plan) {
                let instrument = &mut self.state.instruments[i];
                (instrument.in_contact, instrument.under, instrument.travelled_mm) = (true, true, 0.0);
                continue;
            }
            if self.passed_through(i, &found) {
                let ahead = -(pose.rotation * Vector3::z_axis());
                let speed = poses.tip_step_mm[i].dot(&ahead) / SUBSTEP_S;
                self.displace(&zcoll, &ahead, speed);
            }
        }
        self.zcoll = Some(zcoll);
    }

    /// True if a fast tip crossed the membrane on its way in this step so far, as it lies now, and went so far beyond it that the
    /// collision volume no longer holds it. The instrument is then under the membrane.
    fn jumped_through(&self, i: usize, plan: &Plan) -> bool {
        let from = plan.pose(i, 0.0).translation.vector;
        let to = self.state.instruments[i].tip_in_eye_mm;
        let fast = (to - from).norm() > LOOKED_WAY_MM;
        fast && crosses(from.into(), to.into(), &self.state.membrane.surface(&self.sheet))
    }

    /// True if what was found is membrane that the instrument pushes. Contact that is at once deeper than the
    /// instrument's way since the last look came round an edge: the instrument is **under** the membrane, and
    /// pushes nothing until it is clear. (Lifting from below, for the pick, is not part of the step yet.)
    fn passed_through(&mut self, i: usize, found: &Found) -> bool {
        let deepest_mm = self.volume.depth_steps_mm(found.deepest);
        let instrument = &mut self.state.instruments[i];
        let touching = found.pixels > 0;
        if !touching {
            instrument.under = false;
        } else if !instrument.in_contact && deepest_mm > instrument.travelled_mm + UNDER_MARGIN_MM {
            instrument.under = true;
        }
        instrument.in_contact = touching;
        instrument.travelled_mm = 0.0;
        touching && !instrument.under
    }

    /// Moves the colliding nodes `ahead` (Eq. 1); they then move no slower than the tip.
    fn displace(&mut self, zcoll: &Zcoll, ahead: &UnitVector3<f64>, tip_speed_mm_s: f64) {
        let membrane = &mut self.state.membrane;
        let ahead = ahead.map(|c| c as f32);
        let speed = if tip_speed_mm_s > 0.0 { tip_speed_mm_s as f32 } else { 0.0 };
        let radius = self.tissue.radius_mm;
        for (node, steps) in zcoll.displaced() {
            if membrane.flag[node] != NODE_FREE {
                continue;
            }
            let way = self.volume.depth_steps_mm(steps) as f32;
            let p = membrane.position(node) + ahead * way;
            let distance = p.norm();
            membrane.set_position(node, if distance > radius { p * (radius / distance) } else { p });
            let v = membrane.velocity(node);
            let lacking = speed - v.dot(&ahead);
            if lacking > 0.0 {
                membrane.set_velocity(node, v + ahead * lacking);
            }
        }
    }

    fn tell_fold(&mut self, i: usize, found: &Found) {
        let instrument = &mut self.state.instruments[i];
        if found.folded == 0 || self.state.exposed_ns < instrument.fold_quiet_ns {
            return;
        }
        instrument.fold_quiet_ns = self.state.exposed_ns + FOLD_QUIET_NS;
        let event = Happening::new(EventKind::NotPiConvex, Severity::Info, f64::from(found.folded));
        self.log.raise(event.by(i, instrument.tip_in_eye_mm.into()));
    }

    /// The tips against the retina's sphere.
    pub(super) fn touch_retina(&mut self, plan: &Plan) {
        for i in 0..INSTRUMENTS {
            if !plan.touches[i] {
                continue;
            }
            let instrument = &mut self.state.instruments[i];
            let tip = instrument.tip_in_eye_mm;
            let clearance = self.scene.eye.retina_radius_mm - tip.norm();
            let substep = self.state.substeps;
            let contact = &self.scene.contact;
            let Some(change) = eyeball::follow(&mut instrument.retina, clearance, substep, contact) else {
                continue;
            };
            let event = Happening::new(change.kind, change.severity, change.value);
            self.log.raise(Happening { limit: change.limit, ..event.by(i, tip.into()) });
            if change.kind == EventKind::RetinaPenetrated {
                self.bleed(tip, change.value);
            }
        }
    }

    /// Marks where the retina was hurt; a wound that is there already grows.
    pub(super) fn bleed(&mut self, tip: Vector3<f64>, depth_mm: f64) {
        let at = (tip.normalize() * self.scene.eye.retina_radius_mm).map(|c| c as f32);
        let radius_mm = (MARK_RADIUS_MM + 0.5 * depth_mm.clamp(0.0, 1.0)) as f32;
        let marks = &mut self.state.marks;
        let old = marks.iter_mut().find(|m| (Vector3::from(m.position_mm) - at).norm() < MARK_MERGE_MM);
        if let Some(old) = old {
            old.radius_mm = if radius_mm > old.radius_mm { radius_mm } else { old.radius_mm };
        } else if marks.len() < MAX_MARKS {
            marks.push(MarkState { position_mm: at.into(), radius_mm });
        }
    }
}
