//! Vitrector and needle of a substep: where they are, what the foot makes of them, what they do to the membrane.

use super::World;
use super::plan::{Plan, Poses};
use crate::collision::suction::{Suction, View};
use crate::collision::surface::Unusable;
use crate::collision::zcoll::{self, Zcoll};
use crate::constants::{NEEDLE_OUT_MM, SUBSTEP_S};
use crate::event_log::Happening;
use crate::membrane::sheet::Sheet;
use crate::membrane::tear;
use crate::state::Pierced;
use crate::tools::ToolFigures;
use crate::tools::needle::Needle;
use crate::tools::vitrector::Port;
use nalgebra::{UnitVector3, Vector3};
use protocol::events::{EventKind, Severity};
use protocol::handles::Tool;
use protocol::limits::{INSTRUMENTS, SUBSTEP_NS};
use protocol::scene::NODE_FREE;

/// The ports and needles of a substep, by instrument; `None` for other tools and for what is not tracked.
#[derive(Debug, Clone, Copy, Default)]
pub struct Aimed {
    /// Vitrectors' ports.
    pub ports: [Option<Port>; INSTRUMENTS],
    /// Needles.
    pub needles: [Option<Needle>; INSTRUMENTS],
}

/// What suction and cutting need beside the state.
#[derive(Debug)]
pub struct Cutting {
    camera: Suction,
    view: View,
    /// Area of each triangle at rest, µm², rounded.
    rest_um2: Vec<u32>,
    /// Area at rest of the triangles seen around each node, thirds added up, mm²; all 0 between two looks.
    share_mm2: Vec<f64>,
    nodes: Vec<u32>,
    /// Triangles in the port.
    caught: Vec<u32>,
    /// Area cut away in this step by each instrument, µm².
    cut_um2: [u64; INSTRUMENTS],
}

impl Cutting {
    /// For the membrane of a sheet.
    pub fn new(figures: &ToolFigures, sheet: &Sheet) -> Result<Self, Unusable> {
        let start = sheet.start();
        let area_um2 = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|n| start.position(n as usize).map(f64::from));
            (0.5e6 * (b - a).cross(&(c - a)).norm() + 0.5) as u32
        };
        let vitrector = &figures.vitrector;
        Ok(Cutting {
            camera: Suction::new(vitrector.resolution as usize, &sheet.triangles, sheet.nodes())?,
            view: View {
                tan_half_angle: libm::tan(vitrector.cone_half_angle_rad),
                reach_mm: vitrector.cone_reach_mm,
            },
            rest_um2: sheet.triangles.iter().map(area_um2).collect(),
            share_mm2: vec![0.0; sheet.nodes()],
            nodes: Vec::with_capacity(sheet.nodes()),
            caught: Vec::with_capacity(sheet.triangles.len()),
            cut_um2: [0; INSTRUMENTS],
        })
    }

    /// Adds up the areas that the camera sees by nodes.
    fn share(&mut self, triangles: &[[u32; 3]]) {
        for &t in self.camera.triangles() {
            let third = f64::from(self.rest_um2[t as usize]) * (1e-6 / 3.0);
            for &node in &triangles[t as usize] {
                let share = &mut self.share_mm2[node as usize];
                if *share == 0.0 {
                    self.nodes.push(node);
                }
                *share += third;
            }
        }
    }
}

impl World {
    /// Suction on what the ports see: each node is drawn to the port by the pressure at its distance on its share of the area seen.
    pub(super) fn suck_membrane(&mut self, poses: &Poses) {
        let Some(mut cutting) = self.cutting.take() else { return };
        for i in 0..INSTRUMENTS {
            let Some(port) = self.aimed.ports[i].filter(|p| p.open && p.suction_pa > 0.0) else { continue };
            if !self.look_out(&mut cutting, i, poses) {
                continue;
            }
            cutting.share(&self.sheet.triangles);
            for node in cutting.nodes.drain(..) {
                let n = node as usize;
                let way = port.cone.apex_in_eye_mm - self.state.membrane.position(n).map(f64::from);
                let pull = port.pull_un(&way, cutting.share_mm2[n]).map(|f| f as f32);
                cutting.share_mm2[n] = 0.0;
                for (axis, force) in self.solver.outer_un.iter_mut().enumerate() {
                    force[n] += pull[axis];
                }
            }
        }
        self.cutting = Some(cutting);
    }

    /// Draws the image of a port; `false` where no membrane is near.
    fn look_out(&self, cutting: &mut Cutting, i: usize, poses: &Poses) -> bool {
        let pose = &poses.eye_from_instrument[i];
        let Some(port) = self.aimed.ports[i] else { return false };
        let wide = libm::sqrt(1.0 + cutting.view.tan_half_angle * cutting.view.tan_half_angle);
        let reach = cutting.view.reach_mm * wide;
        let membrane = &self.state.membrane;
        if !zcoll::near_membrane(membrane, &port.cone.apex_in_eye_mm, reach) {
            return false;
        }
        let surface = membrane.surface(&self.sheet);
        cutting.camera.look(&pose.inverse(), &cutting.view, &surface).pixels > 0
    }

    /// The blades that close in this substep take away what is in their ports: every triangle that the port sees within itself,
    /// and every one seen that has a corner there.
    pub(super) fn cut_membrane(&mut self, poses: &Poses) {
        let Some(mut cutting) = self.cutting.take() else { return };
        for i in 0..INSTRUMENTS {
            let Some(port) = self.aimed.ports[i].filter(|p| p.cuts) else { continue };
            if !self.look_out(&mut cutting, i, poses) {
                continue;
            }
            self.catch(&mut cutting, &port);
            let removed = &mut self.state.tools.removed;
            let before = removed.area_um2;
            for t in cutting.caught.drain(..).map(|t| t as usize) {
                if self.state.membrane.triangle_alive[t] != 0 {
                    tear::remove_triangle(&self.sheet, &mut self.state.membrane, t);
                    removed.area_um2 += u64::from(cutting.rest_um2[t]);
                    removed.triangles += 1;
                }
            }
            let cut = removed.area_um2 - before;
            if cut > 0 {
                removed.cuts += 1;
                cutting.cut_um2[i] += cut;
                self.after_loss();
            }
        }
        self.cutting = Some(cutting);
    }

    fn catch(&self, cutting: &mut Cutting, port: &Port) {
        cutting.caught.clear();
        for spot in cutting.camera.spots() {
            let [along, aside] = cutting.camera.place_mm(&spot, &cutting.view);
            if along <= port.depth_mm && aside <= port.radius_mm {
                cutting.caught.push(spot.triangle);
            }
        }
        let at = |n: u32| self.state.membrane.position(n as usize).map(f64::from);
        for &t in cutting.camera.triangles() {
            if self.sheet.triangles[t as usize].iter().any(|&n| port.holds(&at(n))) {
                cutting.caught.push(t);
            }
        }
        cutting.caught.sort_unstable();
        cutting.caught.dedup();
    }

    /// One event for what each vitrector cut away in this step.
    pub(super) fn tell_cuts(&mut self) {
        let Some(cutting) = &mut self.cutting else { return };
        for (i, cut) in cutting.cut_um2.iter_mut().enumerate().filter(|(_, cut)| **cut > 0) {
            let event = Happening::new(EventKind::TissueCut, Severity::Info, *cut as f64 * 1e-6);
            self.log.raise(event.by(i, self.state.instruments[i].tip_in_eye_mm.into()));
            *cut = 0;
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
                let event = Happening::new(EventKind::NeedleOut, Severity::Info, 0.0);
                self.log.raise(event.by(i, tip));
            }
            return true;
        }
        let surface = self.state.membrane.surface(&self.sheet);
        // A look in every substep keeps the sheet just ahead of the tip that presses on it: the tip's point lies there, too.
        let ahead = needle.tip_in_eye_mm - needle.axis_in_eye.into_inner() * NEEDLE_OUT_MM;
        let inside = Needle { tip_in_eye_mm: ahead, ..needle }.in_mesh(&surface, self.volume.depth_mm);
        let resistance = self.resistance_un(zcoll, &needle.axis_in_eye);
        let Some(place) = inside.and_then(|p| p.place) else { return false };
        let limit = self.figures.needle.pierce_un;
        if resistance <= limit {
            return false;
        }
        let hole = Pierced { triangle: place.triangle, weights: place.weights };
        self.state.instruments[i].pierced = Some(hole);
        let event = Happening::new(EventKind::MembranePierced, Severity::Info, resistance);
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
    use crate::rehearsal::Rehearsal;
    use crate::world::no_clock;
    use protocol::handles::PORT_RADIUS_MM;
    use protocol::scene_file::SceneFile;

    /// In the scene, with the edge before the port: every force is p₀·(r/d) on a third of each triangle seen, towards the apex.
    #[test]
    fn suction_on_the_membrane_is_proportional_to_the_reciprocal_distance() {
        let mut scene = SceneFile::load("trim").unwrap();
        scene.script.pedal[0].axes = [1.0, 0.0];
        let rehearsal = Rehearsal::shipped(&scene);
        let mut world = World::new(&scene).unwrap();
        for field in 130..150 {
            rehearsal.play(&mut world, field, &mut no_clock);
        }
        let pose = world.state.instruments.each_ref().map(|i| i.eye_from_instrument);
        let poses = Poses { eye_from_instrument: pose, tip_step_mm: [Vector3::zeros(); INSTRUMENTS] };
        let port = world.aimed.ports[0].unwrap();
        world.solver.clear_outer();
        world.suck_membrane(&poses);
        let (start, sheet) = (world.sheet.start(), &world.sheet);
        let seen = world.cutting.as_ref().unwrap().camera.triangles();
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
