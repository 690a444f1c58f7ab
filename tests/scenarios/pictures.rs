//! A moment of every shipped scene and training module, in both shadings, against pictures kept in
//! `tests/data/pictures/scenes`. `make pictures` renews them; say in the commit why.
//!
//! The pictures were made by Mesa's llvmpipe 22.3.6 (LLVM 15), where another run differs by
//! nothing. Other adapters rasterise edges differently. Tissue that moves a little otherwise stays
//! within these bounds; a tool or a tear in another place does not.

use renderer::governor::Shading;
use renderer::gpu::Gpu;
use renderer::readback::Picture;
use renderer::similarity::{colour_difference, reference_sized, reference_tier, similarity};
use validation::moments::{MOMENTS, Moment, REFERENCE_MAP_PX};
use vitreo_tests::repository;

/// Least similarity where the adapter is the one that made the pictures, and elsewhere.
const SIMILAR: [f64; 2] = [0.985, 0.95];
/// Largest mean difference of colour, of 255, in the same order.
const COLOUR: [f64; 2] = [1.5, 4.0];

fn reference(name: &str) -> Picture {
    let path = repository().join("tests/data/pictures/scenes").join(name);
    let image = image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgba8();
    Picture { width_px: image.width(), height_px: image.height(), rgba: image.into_raw() }
}

fn looks_as_it_did(gpu: &Gpu, moment: &Moment) {
    let name = moment.file();
    let mut player = moment.begin();
    let block = player.play_to(moment.at_s);
    let other = usize::from(!gpu.name.starts_with("llvmpipe"));
    for shading in Shading::ALL {
        let (tier, shading) = (reference_tier(shading), shading.name());
        let picture = reference_sized(&player.draw(gpu, &block, tier, REFERENCE_MAP_PX));
        let known = reference(&format!("{name}-{shading}.png"));
        let (similar, colour) = (similarity(&picture, &known), colour_difference(&picture, &known));
        assert!(
            similar >= SIMILAR[other] && colour <= COLOUR[other],
            "{name}, {shading}: similarity {similar:.4}, colour {colour:.2} on {}",
            gpu.name
        );
    }
}

#[test]
fn every_moment_looks_as_it_did() {
    let Ok(gpu) = Gpu::headless().map_err(|e| skips::skip(&e)) else { return };
    // Each is played on a thread of its own.
    std::thread::scope(|threads| {
        let gpu = &gpu;
        let played = MOMENTS.map(|moment| threads.spawn(move || looks_as_it_did(gpu, &moment)));
        let failed = played.map(|thread| thread.join().is_err());
        assert!(!failed.contains(&true), "a scene looks different");
    });
}

#[test]
fn every_shipped_scene_and_module_has_its_moment() {
    let shipped = std::fs::read_dir(repository().join("assets/scenes")).unwrap().flatten();
    let scenes = shipped.map(|f| f.path()).filter(|p| p.extension().is_some_and(|e| e == "toml"));
    let scenes = scenes.map(|p| p.file_stem().unwrap().to_string_lossy().into_owned());
    let named: Vec<_> =
        scenes.map(|n| (n, false)).chain(scene::module::names().map(|n| (n.into(), true))).collect();
    assert!(named.len() > 12, "{named:?}");
    for (name, is_module) in named {
        let found = MOMENTS.iter().any(|m| m.name == name && m.is_module == is_module);
        assert!(found, "{name} (a module: {is_module}) has no reference picture");
    }
}
