//! Instruments against membrane and retina.

use super::World;
use super::plan::{Plan, Poses};
use crate::constants::{COLLISION_EVERY, FOLD_QUIET_NS, LOOKED_WAY_MM, MAX_MARKS, UNDER_MARGIN_MM};
use crate::event_log::Happening;
use crate::state::MarkState;
use collision::continuous::path_hits;
use collision::eyeball;
use collision::instrument_image::{InstrumentImage, NOTHING};
use collision::raster::DEPTH_STEPS;
use collision::zcoll::{Contacts, Zcoll};
use nalgebra::{UnitVector3, Vector3};
use protocol::events::EventKind;
use protocol::handles::{HOOK_THICKNESS_MM, JAW_LENGTH_MM, Tool};
use protocol::limits::INSTRUMENTS;
use protocol::scene::NODE_FREE;
use tissue::constants::SUBSTEP_S;

/// Radius of a fresh bleeding point, mm.
const MARK_RADIUS_MM: f64 = 0.08;
/// Bleeding points nearer than this to an old one make it grow instead, mm.
const MARK_MERGE_MM: f32 = 0.2;

/// What an instrument has done to the membrane that a look found.
enum Passed {
    Nothing,
    /// It came through from above, and pushes.
    Through,
    /// It came round an edge, and lifts.
    Under,
}

/// Of the pixels of hook and jaws in which the membrane was passed: does it lie above their middle in most? `None` where only shaft was.
fn above_middle(image: &InstrumentImage, zcoll: &Zcoll) -> Option<bool> {
    let (mut above, mut below) = (0, 0);
    for hit in zcoll.hits() {
        let pixel = hit.pixel as usize;
        let (bottom, back) = (image.depth[pixel], image.back().depth[pixel]);
        if back != NOTHING {
            let top = DEPTH_STEPS - back;
            let higher = 2 * (bottom + hit.depth) > bottom + top;
            (above, below) = (above + i32::from(higher), below + i32::from(!higher));
        }
    }
    (above + below > 0).then_some(above > below)
}

/// Way of a node sideways between two looks by friction: towards the tip's own, at most `limit_mm`.
fn dragged(slide_mm: &Vector3<f32>, velocity_mm_s: &Vector3<f32>, limit_mm: f32) -> Vector3<f32> {
    let lag = (slide_mm - velocity_mm_s * SUBSTEP_S as f32) * COLLISION_EVERY as f32;
    let length = lag.norm();
    if length > limit_mm { lag * (limit_mm / length) } else { lag }
}

impl World {
    /// ZCOLL for every instrument near the membrane; jaws that hold tissue push none.
    pub(super) fn push_membrane(&mut self, plan: &Plan, poses: &Poses) {
        let Some(mut zcoll) = self.zcoll.take() else { return };
        let reach = self.volume.reach_mm();
        for i in 0..INSTRUMENTS {
            let instrument = &mut self.state.instruments[i];
            let free = plan.touches[i] && instrument.held.is_empty();
            if !free || !self.state.membrane.is_near(&instrument.tip_in_eye_mm, reach) {
                (instrument.in_contact, instrument.under, instrument.travelled_mm) = (false, false, 0.0);
                (instrument.hooked, instrument.pierced) = (false, None);
                continue;
            }
            let pose = &poses.eye_from_instrument[i];
            self.images[i].prepare(instrument.jaw_rad, &self.volume);
            let (image, membrane) = (&self.images[i], &self.state.membrane);
            let found = zcoll.query(image, &pose.inverse(), &membrane.surface(&self.sheet));
            self.tell_look(i, &found);
            if found.pixels == 0 && self.jumped_through(i, plan) {
                let instrument = &mut self.state.instruments[i];
                (instrument.in_contact, instrument.under, instrument.travelled_mm) = (true, true, 0.0);
                continue;
            }
            if self.pierces(i, &zcoll) {
                let instrument = &mut self.state.instruments[i];
                (instrument.in_contact, instrument.under, instrument.travelled_mm) = (true, false, 0.0);
                continue;
            }
            let handle = pose.rotation * Vector3::z_axis();
            match self.passed(i, &zcoll, &found) {
                Passed::Nothing => {}
                Passed::Through => self.displace(&zcoll, &-handle, &poses.tip_step_mm[i]),
                Passed::Under => {
                    let image = &self.images[i];
                    let surface = self.state.membrane.surface(&self.sheet);
                    let lifted = zcoll.query_reversed(image, &pose.inverse(), &surface);
                    self.tell_look(i, &lifted);
                    if self.lifts(i, &lifted) {
                        self.displace(&zcoll, &handle, &poses.tip_step_mm[i]);
                        self.tell_hooked(i, &zcoll);
                    }
                }
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
        fast && path_hits(from.into(), to.into(), &self.state.membrane.surface(&self.sheet))
    }

    /// What became of the membrane that was found. Contact that began on the far side of the instrument came round an edge: the
    /// instrument is **under** the membrane until it is clear. Where hook or jaws were passed, that is so if most pixels have the
    /// membrane above their middle; where only shaft was, if the first contact is deeper than the instrument's way since
    /// the last look.
    fn passed(&mut self, i: usize, zcoll: &Zcoll, found: &Contacts) -> Passed {
        let deepest_mm = self.volume.depth_steps_mm(found.deepest);
        let above = above_middle(&self.images[i], zcoll);
        let instrument = &mut self.state.instruments[i];
        let touching = found.pixels > 0;
        if !touching {
            (instrument.under, instrument.hooked) = (false, false);
        } else if !instrument.in_contact {
            let deep = deepest_mm > instrument.travelled_mm + UNDER_MARGIN_MM;
            instrument.under = above.unwrap_or(deep);
        }
        instrument.in_contact = touching;
        instrument.travelled_mm = 0.0;
        match (touching, instrument.under) {
            (false, _) => Passed::Nothing,
            (true, false) => Passed::Through,
            (true, true) => Passed::Under,
        }
    }

    /// True if what the reversed camera found can be lifted: not so deep that it lies below hook and jaws.
    fn lifts(&self, i: usize, lifted: &Contacts) -> bool {
        let jaws = self.state.instruments[i].tool == Tool::Forceps as u32;
        let thick = if jaws { JAW_LENGTH_MM } else { HOOK_THICKNESS_MM };
        lifted.pixels > 0 && self.volume.depth_steps_mm(lifted.deepest) <= thick + UNDER_MARGIN_MM
    }

    fn tell_hooked(&mut self, i: usize, zcoll: &Zcoll) {
        let instrument = &mut self.state.instruments[i];
        if !instrument.hooked {
            instrument.hooked = true;
            let nodes = zcoll.displaced().count() as f64;
            let event = Happening::new(EventKind::TissueHooked, nodes);
            self.log.raise(event.by(i, instrument.tip_in_eye_mm.into()));
        }
    }

    /// Moves the colliding nodes along `along` (Eq. 1); they then move no slower than the tip. Friction takes them sideways with the tip
    /// (which moved by `tip_step_mm` in this substep), by no more than its share of the push.
    fn displace(&mut self, zcoll: &Zcoll, along: &UnitVector3<f64>, tip_step_mm: &Vector3<f64>) {
        let membrane = &mut self.state.membrane;
        let tip_speed_mm_s = tip_step_mm.dot(along) / SUBSTEP_S;
        let speed = if tip_speed_mm_s > 0.0 { tip_speed_mm_s as f32 } else { 0.0 };
        let slide = (tip_step_mm - along.into_inner() * tip_step_mm.dot(along)).map(|c| c as f32);
        let (ahead, radius) = (along.map(|c| c as f32), self.tissue.radius_mm);
        let friction = self.scene.contact.friction as f32;
        for (node, steps) in zcoll.displaced() {
            if membrane.flag[node] != NODE_FREE {
                continue;
            }
            let way = self.volume.depth_steps_mm(steps) as f32;
            let v = membrane.velocity(node);
            let mut p = membrane.position(node) + ahead * way;
            if friction > 0.0 {
                p += dragged(&slide, &(v - ahead * v.dot(&ahead)), friction * way);
            }
            let distance = p.norm();
            membrane.set_position(node, if distance > radius { p * (radius / distance) } else { p });
            let lacking = speed - v.dot(&ahead);
            if lacking > 0.0 {
                membrane.set_velocity(node, v + ahead * lacking);
            }
        }
    }

    /// Events for what a look at membrane or retina could not see rightly: second layers, triangles that its image cannot hold, and triangles
    /// without area in it. The last ones are seldom a loss: their neighbours fill the image.
    pub(super) fn tell_look(&mut self, i: usize, found: &Contacts) {
        let instrument = &mut self.state.instruments[i];
        let troubled = found.folded > 0 || found.refused > 0 || found.flat > 0;
        if !troubled || self.state.exposed_ns < instrument.fold_quiet_ns {
            return;
        }
        instrument.fold_quiet_ns = self.state.exposed_ns + FOLD_QUIET_NS;
        let tip = instrument.tip_in_eye_mm.into();
        let told = [
            (EventKind::NotPiConvex, found.folded),
            (EventKind::TrianglesRefused, found.refused),
            (EventKind::TrianglesFlat, found.flat),
        ];
        for (kind, count) in told.into_iter().filter(|t| t.1 > 0) {
            self.log.raise(Happening::new(kind, f64::from(count)).by(i, tip));
        }
    }

    /// The tips against the retina's sphere.
    pub(super) fn touch_retina(&mut self, plan: &Plan) {
        for i in 0..INSTRUMENTS {
            if !plan.touches[i] {
                continue;
            }
            let clearance = self.retina_clearance(i);
            let instrument = &mut self.state.instruments[i];
            let tip = instrument.tip_in_eye_mm;
            let substep = self.state.substeps;
            let contact = &self.scene.contact;
            let Some(change) = eyeball::update_contact(&mut instrument.retina, clearance, substep, contact)
            else {
                continue;
            };
            let event = Happening::new(change.kind, change.value);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::no_clock;
    use nalgebra::Isometry3;
    use protocol::geometry::Pose;
    use protocol::steps::StepInput;
    use scene::{RetinaOperation, SceneFile};
    use surgeon::rehearsal::Rehearsal;

    /// Coulomb: what sticks goes with the tip, what slides is dragged by its share of the push, and what keeps up is left alone.
    #[test]
    fn friction_drags_no_farther_than_the_tip_and_no_more_than_its_share() {
        let slide = Vector3::new(0.003f32, -0.004, 0.0);
        let looks = COLLISION_EVERY as f32;
        let rest = Vector3::zeros();
        let stuck = dragged(&slide, &rest, 1.0);
        assert!((stuck - slide * looks).norm() < 1e-7, "{stuck}");
        let limit = 0.4 * slide.norm() * looks;
        let slipping = dragged(&slide, &rest, limit);
        assert!((slipping.norm() - limit).abs() < 1e-7 && slipping.dot(&slide) > 0.0);
        let along = slide / SUBSTEP_S as f32;
        assert!(dragged(&slide, &along, 1.0).norm() < 1e-7);
    }

    /// Two steps of a scene with an instrument's tip at a place, over tissue that was changed before: kinds and values of the events.
    fn looked_at(scene: &SceneFile, tip_mm: [f64; 3], change: impl FnOnce(&mut World)) -> Vec<(u32, f64)> {
        let (rehearsal, mut world) = (Rehearsal::shipped(scene), World::new(scene).unwrap());
        let mut told = Vec::new();
        let mut change = Some(change);
        for field in 0..4 {
            if field == 2 {
                change.take().unwrap()(&mut world);
            }
            let (mut frame, mut handles) = rehearsal.field(field);
            frame.bodies[0].world_from_body.position_mm = tip_mm;
            frame.bodies[protocol::poses::EYE].world_from_body = Pose::from_isometry(&Isometry3::identity());
            handles.iter_mut().for_each(|h| h.jaw_rad = 0.5);
            world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[] }, &mut no_clock);
            told.extend(world.events().iter().map(|e| (e.kind, e.value)));
        }
        told
    }

    fn count(told: &[(u32, f64)], kind: EventKind) -> usize {
        told.iter().filter(|e| e.0 == kind as u32 && e.1 > 0.0).count()
    }

    /// Folds a sheet over the plane x = 0, the folded half a little higher.
    fn fold(tissue: &mut tissue::state::MembraneState) {
        for n in 0..tissue.nodes() {
            let p = tissue.position(n);
            if p.x < 0.0 {
                tissue.set_position(n, Vector3::new(-p.x, p.y, p.z + 0.15));
            }
        }
    }

    fn untearable() -> SceneFile {
        let mut scene = SceneFile::load("peel").unwrap();
        let membrane = scene.membrane.as_mut().unwrap();
        (membrane.tear_tension_n_per_m, membrane.p_tear, membrane.rim_tear_un) = (0.0, 1e9, 1e9);
        scene
    }

    #[test]
    fn a_folded_membrane_is_told_once_in_a_while() {
        let scene = untearable();
        let tip = [1.2, 0.4, -10.9];
        assert_eq!(count(&looked_at(&scene, tip, |_| {}), EventKind::NotPiConvex), 0);
        let told = looked_at(&scene, tip, |w| fold(&mut w.state.membrane));
        assert_eq!(count(&told, EventKind::NotPiConvex), 1, "{told:?}");
    }

    #[test]
    fn a_folded_retina_is_told_too() {
        let mut scene = SceneFile::load("relocation").unwrap();
        scene.instruments[0].tool = Tool::Pick;
        scene.script.as_mut().unwrap().keys.iter_mut().for_each(|k| k.tool = None);
        let retina = scene.retina.as_mut().unwrap();
        (retina.tear_tension_n_per_m, retina.p_tear) = (0.0, 1e9);
        retina.operation = Some(RetinaOperation { detached_rad: 0.9, fluid_mm3: 60.0, cut_rad: 0.0 });
        let tip = [1.0, 0.2, -10.9];
        assert_eq!(count(&looked_at(&scene, tip, |_| {}), EventKind::NotPiConvex), 0);
        let told = looked_at(&scene, tip, |w| fold(&mut w.state.retina.as_mut().unwrap().tissue));
        assert_eq!(count(&told, EventKind::NotPiConvex), 1, "{told:?}");
    }

    /// A triangle with a corner far behind the handle does not fit the image's depth.
    #[test]
    fn a_triangle_too_large_for_the_image_is_told() {
        let scene = untearable();
        let told = looked_at(&scene, [1.2, 0.4, -10.9], |w| {
            let way = |n: usize| (w.state.membrane.position(n) - Vector3::new(1.2, 0.4, -11.0)).norm();
            let nearest = (0..w.sheet.nodes()).min_by(|&a, &b| way(a).total_cmp(&way(b))).unwrap();
            w.state.membrane.flag[nearest] = tissue::state::NODE_PINNED;
            w.state.membrane.set_position(nearest, Vector3::new(1.2, 0.4, 80.0));
            w.refresh();
        });
        assert_eq!(count(&told, EventKind::TrianglesRefused), 1, "{told:?}");
    }

    /// Two corners of a triangle under the tip lie on each other: it has no area from anywhere.
    #[test]
    fn a_triangle_without_area_is_told() {
        let scene = untearable();
        let tip = [1.2, 0.4, -10.9];
        let told = looked_at(&scene, tip, |_| {});
        assert_eq!(count(&told, EventKind::TrianglesFlat), 0, "{told:?}");
        let told = looked_at(&scene, tip, |w| {
            let middle = |t: &[u32; 3]| {
                t.iter().map(|&n| w.state.membrane.position(n as usize)).sum::<Vector3<f32>>() / 3.0
            };
            let way = |t: &[u32; 3]| (middle(t) - Vector3::new(1.2, 0.4, -11.0)).norm();
            let nearest = w.sheet.triangles.iter().min_by(|a, b| way(a).total_cmp(&way(b))).unwrap();
            let [a, b] = [nearest[0] as usize, nearest[1] as usize];
            let place = w.state.membrane.position(a);
            w.state.membrane.set_position(b, place);
            // Both stay there.
            [a, b].iter().for_each(|&n| w.state.membrane.flag[n] = tissue::state::NODE_PINNED);
            w.refresh();
        });
        assert_eq!(count(&told, EventKind::TrianglesFlat), 1, "{told:?}");
    }
}
