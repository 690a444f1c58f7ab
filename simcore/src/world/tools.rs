//! Vitrector and needle of a substep: where they are, what the foot makes of them.

use super::World;
use super::plan::{Plan, Poses};
use crate::constants::SUBSTEP_S;
use crate::tools::needle::Needle;
use crate::tools::vitrector::Port;
use nalgebra::Vector3;
use protocol::handles::Tool;
use protocol::limits::{INSTRUMENTS, SUBSTEP_NS};

/// The ports and needles of a substep, by instrument; `None` for other tools and for what is not tracked.
#[derive(Debug, Clone, Copy, Default)]
pub struct Aimed {
    /// Vitrectors' ports.
    pub ports: [Option<Port>; INSTRUMENTS],
    /// Needles.
    pub needles: [Option<Needle>; INSTRUMENTS],
}

impl World {
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
