//! Every subject, in both shadings, against pictures kept in `tests/data/pictures`, by a perceptual
//! measure: mean structural similarity of brightness (Wang et al. 2004, windows of 8×8, every fourth
//! place), and colour on average. `make pictures` renews them; say in the commit why.
//!
//! The pictures were made by Mesa's llvmpipe 22.3.6 (LLVM 15). There another run differs by nothing,
//! another version of the compiler by a few steps of 255 at edges; other adapters filter and rasterise
//! edges differently, which costs up to 0.02 of similarity.

#[path = "../examples/common/mod.rs"]
mod common;

use common::stage::{Stage, small, tier_of};
use renderer::governor::Shading;
use renderer::readback::Picture;
use std::path::PathBuf;

/// Least similarity where the adapter is the one that made the pictures, and elsewhere.
const SIMILAR: [f64; 2] = [0.99, 0.95];
/// Largest mean difference of colour, of 255, in the same order.
const COLOUR: [f64; 2] = [1.0, 4.0];

const WINDOW: u32 = 8;

fn luma(p: [u8; 3]) -> f64 {
    0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])
}

/// Structural similarity of two pictures of the same size, 1 where they are the same.
fn similarity(a: &Picture, b: &Picture) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for y in (0..=a.height_px - WINDOW).step_by(4) {
        for x in (0..=a.width_px - WINDOW).step_by(4) {
            sum += window_similarity(a, b, x, y);
            count += 1.0;
        }
    }
    sum / count
}

fn window_similarity(a: &Picture, b: &Picture, x: u32, y: u32) -> f64 {
    let n = f64::from(WINDOW * WINDOW);
    let pairs: Vec<[f64; 2]> = (0..WINDOW * WINDOW)
        .map(|i| (x + i % WINDOW, y + i / WINDOW))
        .map(|(x, y)| [luma(a.rgb(x, y)), luma(b.rgb(x, y))])
        .collect();
    let mean = |f: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(f).sum::<f64>() / n;
    let (ma, mb) = (mean(&|p| p[0]), mean(&|p| p[1]));
    let (va, vb) = (mean(&|p| (p[0] - ma).powi(2)), mean(&|p| (p[1] - mb).powi(2)));
    let both = mean(&|p| (p[0] - ma) * (p[1] - mb));
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    (2.0 * ma * mb + c1) * (2.0 * both + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2))
}

fn colour_difference(a: &Picture, b: &Picture) -> f64 {
    let sum: u64 = a.rgba.iter().zip(&b.rgba).map(|(x, y)| u64::from(x.abs_diff(*y))).sum();
    sum as f64 / (0.75 * a.rgba.len() as f64)
}

fn reference(name: &str) -> Picture {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/pictures")).join(name);
    let image = image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgba8();
    Picture { width_px: image.width(), height_px: image.height(), rgba: image.into_raw() }
}

#[test]
fn every_subject_looks_as_it_did() {
    let Some(mut stage) = Stage::open() else { return };
    let other = usize::from(!stage.gpu.name.starts_with("llvmpipe"));
    for (name, shading) in common::SUBJECTS.iter().flat_map(|n| Shading::ALL.map(|s| (n, s))) {
        let scenes = common::subject(&stage.file, &stage.rig, name);
        let picture = small(&stage.draw(&scenes, tier_of(shading)));
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
    let pairs = common::SUBJECTS.map(|n| Shading::ALL.map(|s| reference(&format!("{n}-{}.png", s.name()))));
    for (name, [full, lean]) in common::SUBJECTS.iter().zip(&pairs) {
        let (similar, colour) = (similarity(full, lean), colour_difference(full, lean));
        assert!(similar > 0.93 && colour < 4.0, "{name}: similarity {similar:.4}, colour {colour:.2}");
    }
}

#[test]
fn the_measure_sees_what_a_surgeon_would() {
    let pictures = common::SUBJECTS.map(|n| reference(&format!("{n}-lean.png")));
    let same = similarity(&pictures[0], &pictures[0]);
    assert!((same - 1.0).abs() < 1e-12);
    // Without its bleb, a fundus is another picture; so is one shifted by a pixel.
    assert!(similarity(&pictures[0], &pictures[1]) < 0.97);
    let mut shifted = pictures[0].clone();
    shifted.rgba.rotate_right(4);
    assert!(similarity(&pictures[0], &shifted) < 0.985);
}
