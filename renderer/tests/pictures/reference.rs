//! Every subject, in both shadings, against pictures kept in `tests/data/pictures`, by a perceptual
//! measure: mean structural similarity of brightness (Wang et al. 2004, windows of 8×8, every
//! fourth place), and colour on average. `make pictures` renews them; say in the commit why.
//!
//! The pictures were made by Mesa's llvmpipe 22.3.6 (LLVM 15). There another run differs by
//! nothing, another version of the compiler by a few steps of 255 at edges; other adapters filter
//! and rasterise edges differently, which costs up to 0.02 of similarity.

use crate::stage::Stage;
use renderer::governor::Shading;
use renderer::readback::Picture;
use renderer::reference_scene::{SUBJECTS, subject};
use renderer::similarity::{colour_difference, reference_sized, reference_tier, similarity};
use std::path::PathBuf;

/// Least similarity where the adapter is the one that made the pictures, and elsewhere.
const SIMILAR: [f64; 2] = [0.99, 0.95];
/// Largest mean difference of colour, of 255, in the same order.
const COLOUR: [f64; 2] = [1.0, 4.0];

fn reference(name: &str) -> Picture {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/pictures")).join(name);
    let image = image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgba8();
    Picture { width_px: image.width(), height_px: image.height(), rgba: image.into_raw() }
}

#[test]
fn every_subject_looks_as_it_did() {
    let Some(stage) = Stage::open() else { return };
    let other = usize::from(!stage.gpu.name.starts_with("llvmpipe"));
    for (name, shading) in SUBJECTS.iter().flat_map(|n| Shading::ALL.map(|s| (n, s))) {
        let scenes = subject(&stage.file, &stage.rig, name);
        let picture = reference_sized(&stage.draw(&scenes, reference_tier(shading)));
        let known = reference(&format!("{name}-{}.png", shading.name()));
        let (similar, colour) = (similarity(&picture, &known), colour_difference(&picture, &known));
        assert!(
            similar >= SIMILAR[other] && colour <= COLOUR[other],
            "{name}, {}: similarity {similar:.4}, colour {colour:.2} on {}",
            shading.name(),
            stage.gpu.name
        );
    }
}

#[test]
fn lean_shading_looks_like_full_shading() {
    let pairs = SUBJECTS.map(|n| Shading::ALL.map(|s| reference(&format!("{n}-{}.png", s.name()))));
    for (name, [full, lean]) in SUBJECTS.iter().zip(&pairs) {
        let (similar, colour) = (similarity(full, lean), colour_difference(full, lean));
        assert!(similar > 0.93 && colour < 4.0, "{name}: similarity {similar:.4}, colour {colour:.2}");
    }
}

#[test]
fn the_measure_sees_what_a_surgeon_would() {
    let pictures = SUBJECTS.map(|n| reference(&format!("{n}-lean.png")));
    let same = similarity(&pictures[0], &pictures[0]);
    assert!((same - 1.0).abs() < 1e-12);
    // Without its bleb, a fundus is another picture; so is one shifted by a pixel.
    assert!(similarity(&pictures[0], &pictures[1]) < 0.97);
    let mut shifted = pictures[0].clone();
    shifted.rgba.rotate_right(4);
    assert!(similarity(&pictures[0], &shifted) < 0.985);
}
