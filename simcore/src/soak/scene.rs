//! A scene drawn at random: a shipped one with its figures changed within what its keys allow.

use super::Draw;
use protocol::handles::Tool;
use protocol::scene_file::{MembraneIntegrator, MembraneScene, SHIPPED, SceneFile};

const TOOLS: [Tool; 5] = [Tool::Forceps, Tool::LightPipe, Tool::Pick, Tool::Vitrector, Tool::Needle];

/// A valid scene. Tissue stays stable at a substep of 1 ms: a stiffer one gets heavier nodes.
///
/// # Panics
/// If a scene that is built in does not parse.
pub fn random_scene(draw: &mut Draw) -> SceneFile {
    let (name, _) = SHIPPED[draw.below(SHIPPED.len())];
    let mut scene = SceneFile::load(name).expect("shipped scenes are tested");
    if let Some(membrane) = &mut scene.membrane {
        vary_membrane(membrane, draw);
    }
    if let Some(vitreous) = &mut scene.vitreous {
        vitreous.lattice = 12 + draw.below(21) as u32;
    }
    let contact = &mut scene.contact;
    contact.volume_mm = [draw.between(0.4, 1.2), draw.between(0.8, 2.0)];
    contact.resolution = [16, 32, 64][draw.below(3)];
    contact.grab_reach_mm = draw.between(0.1, 0.6);
    contact.grip_un *= draw.factor(100.0);
    for instrument in &mut scene.instruments {
        instrument.tool = TOOLS[draw.below(TOOLS.len())];
        instrument.shaft_radius_mm = draw.between(0.2, 0.45);
    }
    SceneFile::parse(&scene.to_toml(), name).expect("varied scenes stay in range")
}

fn vary_membrane(m: &mut MembraneScene, draw: &mut Draw) {
    m.squares = [4 + draw.below(24) as u32, 4 + draw.below(20) as u32];
    m.size_mm = [draw.between(2.0, 8.0), draw.between(2.0, 6.0)];
    let stiffer = draw.factor(2.0);
    m.stiffness_un_per_mm *= stiffer;
    m.bending_un_per_mm *= stiffer;
    m.node_mass_g *= stiffer.max(1.0) * draw.between(1.0, 3.0);
    m.fluid_damping_per_s *= draw.factor(2.0);
    m.lift_mm *= draw.between(0.0, 2.0);
    m.tear_tension_n_per_m *= if draw.once_in(4) { 0.0 } else { draw.factor(5.0) };
    m.p_tear *= draw.factor(5.0);
    m.rim_warn_un = (m.rim_warn_un * draw.factor(3.0)).min(1e9);
    m.rim_tear_un = (m.rim_tear_un * draw.factor(10.0)).min(1e9);
    if draw.once_in(6) {
        m.v_max_mm_s = 0.0;
    }
    if draw.once_in(8) {
        m.integrator = MembraneIntegrator::Implicit;
    }
    if let Some(glue) = &mut m.adhesion {
        let weaker = draw.between(0.02, 1.0);
        glue.energy_un_per_mm *= weaker;
        glue.patches.iter_mut().for_each(|p| p.energy_un_per_mm *= weaker);
        glue.retina_warn_pa *= draw.between(0.05, 1.0);
        glue.retina_lift_pa = glue.retina_warn_pa * draw.between(1.0, 2.0);
        // A coarser node carries more area, and its bond is stiffer by that.
        let cell_mm2 = m.size_mm[0] * m.size_mm[1] / f64::from(m.squares[0] * m.squares[1]);
        m.node_mass_g *= (cell_mm2 / 0.0576).max(1.0);
    }
    if let Some(curl) = &mut m.curl {
        curl.radius_mm = draw.between(0.6, 5.0);
    }
}
