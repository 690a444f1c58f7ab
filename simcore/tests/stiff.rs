//! Tissue of published stiffness and real mass through the shipped script, under the integrators
//! made for it.

use protocol::events::EventKind;
use scene::{ElementsLaw, ElementsScene, MembraneIntegrator, SceneFile};
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::guard::all_finite;
use tissue::sheet::tearing::check_mesh;

/// The shipped scene with 2 N/m and 10 µm of water as mass, which explicit substeps of 1 ms cannot
/// follow.
fn stiff(integrator: MembraneIntegrator, strain_limit: f64) -> SceneFile {
    let mut scene = SceneFile::load("peel").unwrap();
    let membrane = scene.membrane.as_mut().unwrap();
    membrane.stiffness_un_per_mm = 2000.0;
    membrane.bending_un_per_mm = 20.0;
    membrane.node_mass_g = 5.3e-7;
    (membrane.integrator, membrane.strain_limit) = (integrator, strain_limit);
    scene
}

/// Hashes of each field while the jaws close on the tissue.
fn play(scene: &SceneFile) -> (World, Vec<u64>) {
    let (rehearsal, mut world) = (Rehearsal::shipped(scene), World::new(scene).unwrap());
    let mut hashes = Vec::new();
    for field in 255..262 {
        hashes.push(world.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash);
        let disabled = world.events().iter().any(|e| e.kind == EventKind::TissueDisabled as u32);
        assert!(!disabled, "field {field}: a node had to be taken out");
    }
    (world, hashes)
}

/// The same sheet as a continuum of the same stiffness.
fn continuum(law: ElementsLaw, integrator: MembraneIntegrator) -> SceneFile {
    let mut scene = stiff(integrator, 0.0);
    let membrane = scene.membrane.as_mut().unwrap();
    membrane.elements = Some(ElementsScene { law, young_un_per_mm: 2000.0, poisson: None });
    scene
}

#[test]
fn stiff_tissue_goes_through_the_script_and_gives_the_same_bits_again() {
    use ElementsLaw::{NeoHookean, StVenantKirchhoff};
    use MembraneIntegrator::{Implicit, QuasiStatic};
    let scenes = [stiff(Implicit, 0.1), stiff(QuasiStatic, 0.0)];
    let elements = [continuum(NeoHookean, Implicit), continuum(StVenantKirchhoff, QuasiStatic)];
    for scene in scenes.into_iter().chain(elements) {
        let membrane = scene.membrane.as_ref().unwrap();
        let integrator = (membrane.integrator, membrane.elements.map(|e| e.law));
        let again = SceneFile::parse(&scene.to_toml(), "again").unwrap();
        let (world, hashes) = play(&scene);
        let membrane = &world.state().membrane;
        assert!(all_finite(membrane), "{integrator:?}");
        assert_eq!(check_mesh(world.sheet(), membrane), Ok(()));
        let fastest = (0..membrane.nodes()).map(|n| membrane.velocity(n).norm()).fold(0.0, f32::max);
        assert!(fastest <= 300.1, "{integrator:?}: {fastest} mm/s");
        assert!(!world.state().membrane.held.iter().all(Vec::is_empty), "{integrator:?}: nothing held");
        assert_eq!(play(&again).1, hashes, "{integrator:?}");
    }
}

/// A scene whose elements tear at a tension that the jaws reach loses triangles, and the mesh stays
/// whole.
#[test]
fn a_continuum_tears_where_its_tension_passes_the_limit() {
    let mut scene = continuum(ElementsLaw::NeoHookean, MembraneIntegrator::Implicit);
    scene.membrane.as_mut().unwrap().tear_tension_n_per_m = 0.004;
    let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
    let mut torn = 0.0;
    for field in 255..264 {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        let events = world.events().iter().filter(|e| e.kind == EventKind::TissueTorn as u32);
        torn += events.map(|e| e.value).sum::<f64>();
        assert_eq!(check_mesh(world.sheet(), &world.state().membrane), Ok(()), "field {field}");
    }
    let lost = world.state().membrane.triangle_alive.iter().filter(|&&alive| alive == 0).count();
    assert!(torn > 0.0 && lost > 0 && lost < world.sheet().triangles.len() / 2, "{torn} torn, {lost} lost");
}
