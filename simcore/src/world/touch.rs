//! Tips against the retina: grazing, touching, injuring.

use super::World;
use super::plan::StepPlan;
use crate::constants::MAX_MARKS;
use crate::state::MarkState;
use collision::eyeball;
use nalgebra::Vector3;
use protocol::events::{EventDraft, EventKind};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;

/// Radius of a fresh bleeding point, mm.
const MARK_RADIUS_MM: f64 = 0.08;
/// Bleeding points nearer than this to an old one make it grow instead, mm.
const MARK_MERGE_MM: f32 = 0.2;

impl World {
    /// The tips against the retina's sphere.
    pub(super) fn touch_retina(&mut self, plan: &StepPlan) {
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
            let event = EventDraft::new(change.kind, change.value);
            let event = EventDraft { limit: change.limit, ..event.by(i, tip.into()) };
            // Under a retina that can be lifted a needle injects; the touch before it goes in is
            // the way there. The score counts it where the needle does not go in.
            let injects = self.retina.is_some() && instrument.tool == Tool::Needle as u32;
            if injects && change.kind == EventKind::RetinaTouched {
                self.log.emit_unwarned(event);
            } else {
                self.log.emit(event);
            }
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

    /// Two steps of a scene with an instrument's tip at a place, over tissue that was changed
    /// before: kinds and values of the events.
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
    fn fold(tissue: &mut tissue::sheet::state::SheetState) {
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

    /// A needle over a retina that can be lifted touches it on the way into it: that is recorded,
    /// and no warning. The same touch by a pick is one.
    #[test]
    fn a_needle_that_is_to_inject_touches_without_a_warning() {
        let noticed = |tool: Tool| {
            let mut scene = SceneFile::load("relocation").unwrap();
            scene.instruments[0].tool = tool;
            scene.script.as_mut().unwrap().keys.iter_mut().for_each(|k| k.tool = None);
            let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
            let (mut touched, mut warned) = (0, 0);
            for field in 0..40 {
                let (mut frame, mut handles) = rehearsal.field(field);
                let depth = 11.2 + 0.01 * field.min(28) as f64;
                frame.bodies[0].world_from_body.position_mm = [0.0, 0.0, -depth];
                frame.bodies[protocol::poses::EYE].world_from_body =
                    Pose::from_isometry(&Isometry3::identity());
                handles.iter_mut().for_each(|h| (h.jaw_rad, h.tool) = (0.5, tool as u32));
                world.step(&StepInput { frame: &frame, handles: &handles[..1], pedals: &[] }, &mut no_clock);
                let is = |kind: EventKind| world.events().iter().filter(|e| e.kind == kind as u32).count();
                touched += is(EventKind::RetinaTouched);
                warned += u32::from(world.state().notice_kind == EventKind::RetinaTouched as u32);
            }
            (touched, warned > 0)
        };
        let ((by_needle, warned), (by_pick, of_pick)) = (noticed(Tool::Needle), noticed(Tool::Pick));
        assert!(by_needle > 0 && by_pick > 0, "{by_needle} {by_pick}");
        assert_eq!((warned, of_pick), (false, true));
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
        let told = looked_at(&scene, tip, |w| fold(&mut w.state.retina.as_mut().unwrap().sheet));
        assert_eq!(count(&told, EventKind::NotPiConvex), 1, "{told:?}");
    }

    /// A triangle with a corner far behind the handle does not fit the image's depth.
    #[test]
    fn a_triangle_too_large_for_the_image_is_told() {
        let scene = untearable();
        let told = looked_at(&scene, [1.2, 0.4, -10.9], |w| {
            let way = |n: usize| (w.state.membrane.position(n) - Vector3::new(1.2, 0.4, -11.0)).norm();
            let nearest = (0..w.sheet().nodes()).min_by(|&a, &b| way(a).total_cmp(&way(b))).unwrap();
            w.state.membrane.flag[nearest] = tissue::sheet::state::NODE_PINNED;
            w.state.membrane.set_position(nearest, Vector3::new(1.2, 0.4, 80.0));
            w.membrane.as_mut().unwrap().refresh(&w.state.membrane);
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
            let nearest = w.sheet().triangles.iter().min_by(|a, b| way(a).total_cmp(&way(b))).unwrap();
            let [a, b] = [nearest[0] as usize, nearest[1] as usize];
            let place = w.state.membrane.position(a);
            w.state.membrane.set_position(b, place);
            // Both stay there.
            [a, b].iter().for_each(|&n| w.state.membrane.flag[n] = tissue::sheet::state::NODE_PINNED);
            w.membrane.as_mut().unwrap().refresh(&w.state.membrane);
        });
        assert_eq!(count(&told, EventKind::TrianglesFlat), 1, "{told:?}");
    }
}
