//! A scene drawn at random: a shipped one with its figures changed within what its keys allow.

use protocol::handles::Tool;
use protocol::random::Random;
use scene::module;
use scene::{
    ElementsLaw, ElementsScene, MembraneIntegrator, MembraneScene, RetinaOperation, RetinaScene, SHIPPED,
    SceneFile,
};
use surgeon::skill::NOVICE;
use tissue::sheet::material::Material;
use tissue::sheet::mesh::SheetMesh;

const TOOLS: [Tool; 5] = [Tool::Forceps, Tool::LightPipe, Tool::Pick, Tool::Vitrector, Tool::Needle];

/// Most squares along a side of a membrane whose substeps seek the balance of all forces, which
/// takes longest.
const BALANCED_SQUARES: u32 = 8;
/// The same for the other implicit integrator.
const IMPLICIT_SQUARES: u32 = 14;

/// A valid scene, shipped by itself or with a module. Tissue stays stable at a substep of 1 ms: a
/// stiffer one gets heavier nodes.
///
/// # Panics
/// If a scene that is built in does not parse.
pub fn random_scene(draw: &mut Random) -> SceneFile {
    let mut scene = shipped(draw);
    if let Some(membrane) = &mut scene.membrane {
        vary_membrane(membrane, draw);
        choose_integrator(membrane, draw);
    }
    if let Some(retina) = &mut scene.retina {
        vary_retina(retina, draw);
    }
    if let Some(vitreous) = &mut scene.vitreous {
        vitreous.lattice = 12 + draw.below(21) as u32;
    }
    let contact = &mut scene.contact;
    contact.volume_mm = [draw.between(0.4, 1.2), draw.between(0.8, 2.0)];
    contact.resolution = [16, 32, 64][draw.below(3)];
    contact.grab_reach_mm = draw.between(0.1, 0.6);
    contact.grip_un *= draw.factor(100.0);
    if draw.once_in(3) {
        contact.friction = draw.between(0.0, 1.0);
    }
    for instrument in &mut scene.instruments {
        instrument.tool = TOOLS[draw.below(TOOLS.len())];
        instrument.shaft_radius_mm = draw.between(0.2, 0.45);
    }
    let mut scene = SceneFile::parse(&scene.to_toml(), "varied").expect("varied scenes stay in range");
    keep_stable(&mut scene);
    scene
}

/// A shipped scene, or that of a level of a shipped module.
fn shipped(draw: &mut Random) -> SceneFile {
    let modules: Vec<&str> = module::names().collect();
    if !draw.once_in(4) {
        return SceneFile::load(SHIPPED[draw.below(SHIPPED.len())].0).expect("shipped scenes are tested");
    }
    let module = surgeon::load(modules[draw.below(modules.len())]).expect("shipped modules are tested");
    let level = 1 + draw.below(module.levels() as usize) as u32;
    surgeon::compose(&module, level, &NOVICE, draw.bits()).expect("shipped levels are tested")
}

/// Explicit Euler needs damping, which not every tissue has: what cannot be split into stable parts
/// moves by the new velocity instead.
fn keep_stable(scene: &mut SceneFile) {
    let sheet = SheetMesh::new(scene).expect("a sheet of squares");
    let unstable = Material::new(scene).split(&sheet).is_err();
    if let Some(membrane) = &mut scene.membrane
        && membrane.integrator == MembraneIntegrator::Explicit
        && unstable
    {
        membrane.integrator = MembraneIntegrator::SemiImplicit;
    }
}

fn vary_retina(r: &mut RetinaScene, draw: &mut Random) {
    r.rings = 6 + draw.below(20) as u32;
    let stiffer = draw.factor(2.0);
    r.stiffness_un_per_mm *= stiffer;
    // A coarser node carries more area; a stiffer one must be heavier.
    r.node_mass_g *= stiffer.max(1.0) * draw.between(1.0, 3.0);
    r.fluid_damping_per_s *= draw.factor(2.0);
    r.v_max_mm_s *= draw.factor(2.0);
    r.p_tear *= draw.factor(5.0);
    r.tear_tension_n_per_m *= if draw.once_in(4) { 0.0 } else { draw.factor(5.0) };
    r.prestrain = draw.between(0.0, 0.05);
    r.adhesion_n_per_m *= draw.factor(4.0);
    r.flow_from_pa *= draw.between(0.2, 1.5);
    r.flow_ul_per_min_per_kpa *= draw.factor(3.0);
    r.detach_mm_per_kpa *= draw.factor(3.0);
    r.needle_tear_mm_s = r.needle_warn_mm_s * draw.between(1.0, 5.0);
    r.hole_open_share = draw.between(0.0, 1.0);
    r.hole_close_s *= draw.factor(10.0);
    r.air_pa *= draw.factor(3.0);
    r.seep_um_per_s *= draw.factor(5.0);
    r.drag = draw.between(0.0, 1.0);
    if draw.once_in(3) {
        let detached_rad = draw.between(0.2, 1.2);
        let cut = draw.once_in(3);
        let cut_rad = if cut { detached_rad * draw.between(0.5, 0.95) } else { 0.0 };
        let fluid_mm3 = if cut { 0.0 } else { draw.between(0.0, 60.0) };
        r.operation = Some(RetinaOperation { detached_rad, fluid_mm3, cut_rad });
    }
}

/// How substeps are made, limits of strain, and creep where springs move themselves.
fn choose_integrator(m: &mut MembraneScene, draw: &mut Random) {
    m.integrator = match draw.below(12) {
        0 | 1 => MembraneIntegrator::Explicit,
        2 => MembraneIntegrator::Implicit,
        3 => MembraneIntegrator::QuasiStatic,
        _ => MembraneIntegrator::SemiImplicit,
    };
    let squares = match m.integrator {
        MembraneIntegrator::Implicit => IMPLICIT_SQUARES,
        MembraneIntegrator::QuasiStatic => BALANCED_SQUARES,
        _ => u32::MAX,
    };
    m.squares = m.squares.map(|n| n.min(squares));
    let springs = matches!(m.integrator, MembraneIntegrator::Explicit | MembraneIntegrator::SemiImplicit);
    if m.integrator == MembraneIntegrator::Explicit {
        m.spring_damping_un_s_per_mm *= draw.between(1.0, 3.0);
    }
    if !springs && draw.once_in(2) {
        let young_un_per_mm = m.stiffness_un_per_mm * draw.factor(3.0);
        m.elements = Some(if draw.once_in(2) {
            ElementsScene { young_un_per_mm, poisson: None, law: ElementsLaw::NeoHookean }
        } else {
            let poisson = Some(draw.between(0.0, 0.49));
            ElementsScene { young_un_per_mm, poisson, law: ElementsLaw::StVenantKirchhoff }
        });
    }
    if draw.once_in(4) {
        m.strain_limit = draw.between(0.02, 0.5);
    }
    if springs && draw.once_in(4) {
        m.yield_strain = draw.between(0.02, 0.5);
        m.creep_per_s = draw.between(0.1, 20.0);
    }
    if springs && draw.once_in(6) {
        m.v_max_mm_s = 0.0;
    }
}

fn vary_membrane(m: &mut MembraneScene, draw: &mut Random) {
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
    if let Some(adhesion) = &mut m.adhesion {
        let weaker = draw.between(0.02, 1.0);
        adhesion.energy_un_per_mm *= weaker;
        adhesion.patches.iter_mut().for_each(|p| p.energy_un_per_mm *= weaker);
        adhesion.retina_warn_pa *= draw.between(0.05, 1.0);
        adhesion.retina_lift_pa = adhesion.retina_warn_pa * draw.between(1.0, 2.0);
        // A coarser node carries more area, and its bond is stiffer by that.
        let cell_mm2 = m.size_mm[0] * m.size_mm[1] / f64::from(m.squares[0] * m.squares[1]);
        m.node_mass_g *= (cell_mm2 / 0.0576).max(1.0);
    }
    if let Some(curl) = &mut m.curl {
        curl.radius_mm = draw.between(0.6, 5.0);
    }
}
