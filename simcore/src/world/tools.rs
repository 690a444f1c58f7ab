//! Vitrector and needle of a substep: where they are, what the foot makes of them, what they do to
//! the membrane.

use super::World;
use super::plan::{InstrumentPoses, StepPlan};
use nalgebra::Vector3;
use protocol::handles::Tool;
use protocol::limits::{INSTRUMENTS, SUBSTEP_NS};
use tissue::constants::SUBSTEP_S;
use tissue::needle::Needle;
use tissue::vitrector::Port;

/// The ports and needles of a substep, by instrument; `None` for other tools and for what is not
/// tracked.
#[derive(Debug, Clone, Copy, Default)]
pub struct PlacedTools {
    /// Vitrectors' ports.
    pub ports: [Option<Port>; INSTRUMENTS],
    /// Needles.
    pub needles: [Option<Needle>; INSTRUMENTS],
}

impl World {
    /// Turns the blade and finds where ports and needles are at the end of the substep.
    pub(super) fn place_tools(&mut self, plan: &StepPlan, poses: &InstrumentPoses) -> PlacedTools {
        let figures = self.figures;
        let tools = &mut self.state.tools;
        let blade = tools.cutter.turn(tools.cuts_per_min, figures.vitrector.open_share, SUBSTEP_NS);
        let mut placed = PlacedTools::default();
        for i in (0..INSTRUMENTS).filter(|&i| plan.touches[i]) {
            let pose = &poses.eye_from_instrument[i];
            match Tool::from_wire(self.state.instruments[i].tool) {
                Some(Tool::Vitrector) => {
                    let radius = self.scene.instruments[i].shaft_radius_mm;
                    let suction = self.state.tools.suction_pa;
                    let port = Port::new(pose, radius, &figures.vitrector, blade, suction);
                    placed.ports[i] = Some(port);
                }
                Some(Tool::Needle) => {
                    placed.needles[i] = Some(Needle {
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
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::no_clock;
    use protocol::handles::PORT_RADIUS_MM;
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;

    /// In the scene, with the edge before the port: every force is p₀·(r/d) on a third of each
    /// triangle seen, towards the apex.
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
        let poses = InstrumentPoses {
            eye_from_instrument: pose,
            tip_step_mm: [Vector3::zeros(); INSTRUMENTS],
            travelled_mm: [0.0; INSTRUMENTS],
        };
        let input = rehearsal.inputs(150);
        let plan = world.plan(input.input().frame);
        let ports = world.place_tools(&plan, &poses).ports;
        let port = ports[0].unwrap();
        let body = world.membrane.as_mut().unwrap();
        body.draw(&mut world.state.membrane, &ports, &poses.eye_from_instrument);
        let body = world.membrane.as_ref().unwrap();
        let (start, sheet) = (world.sheet().start(), world.sheet());
        let seen = body.seen_by_port();
        let mut sucked = 0;
        for node in 0..sheet.nodes() {
            let around = seen.iter().filter(|&&t| sheet.triangles[t as usize].contains(&(node as u32)));
            let area = |&t: &u32| {
                let [a, b, c] =
                    sheet.triangles[t as usize].map(|n| start.position(n as usize).map(f64::from));
                (b - a).cross(&(c - a)).norm() / 6.0
            };
            let share: f64 = around.map(area).sum();
            let force = Vector3::from(body.solver.outer_un.each_ref().map(|f| f64::from(f[node])));
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
