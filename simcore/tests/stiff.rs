//! Tissue of published stiffness and real mass through the shipped script, under the integrators made for it.

use protocol::events::EventKind;
use protocol::scene_file::{MembraneIntegrator, SceneFile};
use simcore::guard::all_finite;
use simcore::membrane::tear::check_mesh;
use simcore::rehearsal::Rehearsal;
use simcore::world::{World, no_clock};

/// The shipped scene with 2 N/m and 10 µm of water as mass, which explicit substeps of 1 ms cannot follow.
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
        hashes.push(rehearsal.play(&mut world, field, &mut no_clock).state_hash);
        let disabled = world.events().iter().any(|e| e.kind == EventKind::TissueDisabled as u32);
        assert!(!disabled, "field {field}: a node had to be taken out");
    }
    (world, hashes)
}

#[test]
fn stiff_tissue_goes_through_the_script_and_gives_the_same_bits_again() {
    for (integrator, limit) in [(MembraneIntegrator::Implicit, 0.1), (MembraneIntegrator::QuasiStatic, 0.0)] {
        let scene = stiff(integrator, limit);
        let again = SceneFile::parse(&scene.to_toml(), "again").unwrap();
        let (world, hashes) = play(&scene);
        let membrane = &world.state().membrane;
        assert!(all_finite(membrane), "{integrator:?}");
        assert_eq!(check_mesh(world.sheet(), membrane), Ok(()));
        let fastest = (0..membrane.nodes()).map(|n| membrane.velocity(n).norm()).fold(0.0, f32::max);
        assert!(fastest <= 300.1, "{integrator:?}: {fastest} mm/s");
        assert!(!world.state().instruments.iter().all(|i| i.held.is_empty()), "{integrator:?}: nothing held");
        assert_eq!(play(&again).1, hashes, "{integrator:?}");
    }
}
