//! Vitrector and needle of a substep: where they are, what the foot makes of them, what they do to the membrane.

use super::World;
use super::plan::{Plan, Poses};
use crate::constants::NEEDLE_OUT_MM;
use crate::event_log::Happening;
use crate::state::Pierced;
use collision::zcoll::Zcoll;
use nalgebra::{UnitVector3, Vector3};
use protocol::events::EventKind;
use protocol::handles::Tool;
use protocol::limits::{INSTRUMENTS, SUBSTEP_NS};
use protocol::scene::NODE_FREE;
use tissue::constants::SUBSTEP_S;
use tissue::needle::Needle;
use tissue::vitrector::Port;

/// The ports and needles of a substep, by instrument; `None` for other tools and for what is not tracked.
#[derive(Debug, Clone, Copy, Default)]
pub struct Aimed {
    /// Vitrectors' ports.
    pub ports: [Option<Port>; INSTRUMENTS],
    /// Needles.
    pub needles: [Option<Needle>; INSTRUMENTS],
}

impl World {
    /// PortCamera on what the ports see: each node is drawn to the port by the pressure at its distance on its share of the area seen.
    pub(super) fn suck_membrane(&mut self, poses: &Poses) {
        let Some(cutting) = &mut self.cutting else { return };
        for i in 0..INSTRUMENTS {
            let Some(port) = self.aimed.ports[i].filter(|p| p.open && p.suction_pa > 0.0) else { continue };
            let membrane = &self.state.membrane;
            let near = membrane.is_near(&port.cone.apex_in_eye_mm, cutting.reach_mm());
            let eye_from_instrument = &poses.eye_from_instrument[i];
            if near && cutting.look(eye_from_instrument, &membrane.surface(&self.sheet)) {
                cutting.suck(&port, &self.sheet, membrane, &mut self.solver.outer_un);
            }
        }
    }

    /// The blades that close in this substep take away what is in their ports.
    pub(super) fn cut_membrane(&mut self, poses: &Poses) {
        for i in 0..INSTRUMENTS {
            let Some(port) = self.aimed.ports[i].filter(|p| p.cuts) else { continue };
            let Some(cutting) = &mut self.cutting else { return };
            let membrane = &mut self.state.membrane;
            let near = membrane.is_near(&port.cone.apex_in_eye_mm, cutting.reach_mm());
            let eye_from_instrument = &poses.eye_from_instrument[i];
            if near && cutting.look(eye_from_instrument, &membrane.surface(&self.sheet)) {
                let removed = &mut self.state.tools.removed;
                if cutting.cut(&port, &self.sheet, membrane, removed, i) {
                    self.after_loss();
                }
            }
        }
    }

    /// One event for what each vitrector cut away in this step.
    pub(super) fn tell_cuts(&mut self) {
        let Some(cutting) = &mut self.cutting else { return };
        for (i, cut_mm2) in cutting.take_cuts() {
            let event = Happening::new(EventKind::TissueCut, cut_mm2);
            self.log.raise(event.by(i, self.state.instruments[i].tip_in_eye_mm.into()));
        }
    }

    /// True if a needle has gone through the membrane, before or now: then it pushes nothing, and the hole follows its shaft. `zcoll`
    /// holds what the tip has passed, if it was still outside.
    pub(super) fn pierces(&mut self, i: usize, zcoll: &Zcoll) -> bool {
        let Some(needle) = self.aimed.needles[i] else {
            self.state.instruments[i].pierced = None;
            return false;
        };
        let tip = needle.tip_in_eye_mm.into();
        if self.state.instruments[i].pierced.is_some() {
            if !self.drag_hole(i, &needle) {
                self.state.instruments[i].pierced = None;
                let event = Happening::new(EventKind::NeedleOut, 0.0);
                self.log.raise(event.by(i, tip));
            }
            return true;
        }
        let (resistance, limit) =
            (self.resistance_un(zcoll, &needle.axis_in_eye), self.figures.needle.pierce_un);
        if resistance <= limit {
            return false;
        }
        let surface = self.state.membrane.surface(&self.sheet);
        // A look in every substep keeps the sheet just ahead of the tip that presses on it: the tip's point lies there, too.
        let ahead = needle.tip_in_eye_mm - needle.axis_in_eye.into_inner() * NEEDLE_OUT_MM;
        let inside = Needle { tip_in_eye_mm: ahead, ..needle }.in_mesh(&surface, self.volume.depth_mm);
        let Some(place) = inside.and_then(|p| p.place) else { return false };
        let hole = Pierced { triangle: place.triangle, weights: place.weights };
        self.state.instruments[i].pierced = Some(hole);
        let event = Happening::new(EventKind::MembranePierced, resistance);
        self.log.raise(Happening { limit, ..event.by(i, tip) });
        true
    }

    /// Force with which the nodes that were passed press back along the shaft, µN. Added up in whole pN, so that the order of the
    /// nodes does not matter.
    fn resistance_un(&self, zcoll: &Zcoll, towards_handle: &UnitVector3<f64>) -> f64 {
        let force = |n: usize| Vector3::from(self.solver.force_un.each_ref().map(|f| f64::from(f[n])));
        let along = |n: usize| (force(n).dot(towards_handle) * 1e6) as i64;
        let sum = zcoll.displaced().fold(0i64, |sum, (n, _)| sum.saturating_add(along(n)));
        sum as f64 * 1e-6
    }

    /// Moves the corners around a hole so that it lies on the needle's shaft; `false` if the needle is out of it, or the hole is gone.
    fn drag_hole(&mut self, i: usize, needle: &Needle) -> bool {
        let Some(hole) = self.state.instruments[i].pierced else { return false };
        let membrane = &mut self.state.membrane;
        if membrane.triangle_alive[hole.triangle as usize] == 0 {
            return false;
        }
        let nodes = self.sheet.triangles[hole.triangle as usize].map(|n| n as usize);
        let corner = |k: usize| membrane.position(nodes[k]).map(f64::from) * hole.weights[k];
        let at = corner(0) + corner(1) + corner(2);
        let way = needle.tip_in_eye_mm - at;
        let before_hole_mm = way.dot(&needle.axis_in_eye);
        if before_hole_mm > NEEDLE_OUT_MM {
            return false;
        }
        let aside = way - needle.axis_in_eye.into_inner() * before_hole_mm;
        let squares: f64 = hole.weights.iter().map(|w| w * w).sum();
        for (&node, weight) in nodes.iter().zip(hole.weights) {
            if membrane.flag[node] == NODE_FREE {
                let move_mm = (aside * (weight / squares)).map(|c| c as f32);
                membrane.set_position(node, membrane.position(node) + move_mm);
            }
        }
        true
    }

    /// Turns the blade and finds where ports and needles are at the end of the substep.
    pub(super) fn aim_tools(&mut self, plan: &Plan, poses: &Poses) {
        let figures = self.figures;
        let tools = &mut self.state.tools;
        let blade = tools.cutter.turn(tools.cuts_per_min, figures.vitrector.open_share, SUBSTEP_NS);
        self.aimed = Aimed::default();
        for i in (0..INSTRUMENTS).filter(|&i| plan.touches[i]) {
            let pose = &poses.eye_from_instrument[i];
            match Tool::from_wire(self.state.instruments[i].tool) {
                Some(Tool::Vitrector) => {
                    let radius = self.scene.instruments[i].shaft_radius_mm;
                    let suction = self.state.tools.suction_pa;
                    let port = Port::new(pose, radius, &figures.vitrector, blade, suction);
                    self.aimed.ports[i] = Some(port);
                }
                Some(Tool::Needle) => {
                    self.aimed.needles[i] = Some(Needle {
                        tip_in_eye_mm: pose.translation.vector,
                        axis_in_eye: pose.rotation * Vector3::z_axis(),
                        velocity_mm_s: poses.tip_step_mm[i] / SUBSTEP_S,
                        radius_mm: figures.needle.radius_mm,
                        pressure_pa: self.state.tools.injection_pa,
                    });
                }
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::no_clock;
    use protocol::handles::PORT_RADIUS_MM;
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;

    /// In the scene, with the edge before the port: every force is p₀·(r/d) on a third of each triangle seen, towards the apex.
    #[test]
    fn suction_on_the_membrane_is_proportional_to_the_reciprocal_distance() {
        let mut scene = SceneFile::load("trim").unwrap();
        scene.script.as_mut().unwrap().pedal[0].axes = [1.0, 0.0];
        let rehearsal = Rehearsal::shipped(&scene);
        let mut world = World::new(&scene).unwrap();
        for field in 130..150 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        }
        let pose = world.state.instruments.each_ref().map(|i| i.eye_from_instrument);
        let poses = Poses { eye_from_instrument: pose, tip_step_mm: [Vector3::zeros(); INSTRUMENTS] };
        let port = world.aimed.ports[0].unwrap();
        world.solver.clear_outer();
        world.suck_membrane(&poses);
        let (start, sheet) = (world.sheet.start(), &world.sheet);
        let seen = world.cutting.as_ref().unwrap().seen();
        let mut sucked = 0;
        for node in 0..sheet.nodes() {
            let around = seen.iter().filter(|&&t| sheet.triangles[t as usize].contains(&(node as u32)));
            let area = |&t: &u32| {
                let [a, b, c] =
                    sheet.triangles[t as usize].map(|n| start.position(n as usize).map(f64::from));
                (b - a).cross(&(c - a)).norm() / 6.0
            };
            let share: f64 = around.map(area).sum();
            let force = Vector3::from(world.solver.outer_un.each_ref().map(|f| f64::from(f[node])));
            let way = port.cone.apex_in_eye_mm - world.state.membrane.position(node).map(f64::from);
            if way.norm() > PORT_RADIUS_MM {
                let expected = way / way.norm() * (port.suction_pa * PORT_RADIUS_MM * share / way.norm());
                assert!(
                    (force - expected).norm() <= 1e-4 * expected.norm(),
                    "node {node}: {force} {expected}"
                );
                sucked += usize::from(share > 0.0);
            }
        }
        assert!(sucked > 5, "the test must see something: {sucked} nodes");
    }
}
