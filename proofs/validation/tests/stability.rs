//! Successive pictures of the shipped scenes and modules differ by no more than what moves in them.
//! Figures of the example `stability` on Mesa's llvmpipe 22.3.6; limits are some half higher.

use renderer::gpu::Gpu;
use scene::SceneFile;
use surgeon::skill::EXPERT;
use validation::moments::{REFERENCE_MAP_PX, ScenePlayer};
use validation::stability::{Shown, Stability, watch};

/// The least tier that a surgeon can train with.
const TIER: usize = 6;

fn watched(mut player: ScenePlayer, span_s: [f64; 2], shown: Shown) -> Option<Stability> {
    let gpu = Gpu::headless().map_err(|e| skips::skip(&e)).ok()?;
    let found = watch(&gpu, &mut player, span_s, TIER, REFERENCE_MAP_PX, shown);
    println!("{span_s:?} s, {shown:?}: {found:?}");
    Some(found)
}

fn scene(name: &str) -> ScenePlayer {
    ScenePlayer::begin(SceneFile::load(name).unwrap())
}

fn holds(found: Option<Stability>, mean: f64, most: u8, patch_px: usize) {
    let Some(found) = found else { return };
    assert!(found.mean <= mean && found.most <= most && found.patch.0 <= patch_px, "{found:?}");
}

/// Only the eye turns, by some pixels a second.
#[test]
fn a_scene_at_rest_jumps_nowhere() {
    holds(watched(scene("relocation"), [0.0, 0.4], Shown::Tissue), 0.07, 2, 0);
}

#[test]
fn a_growing_bleb_jumps_nowhere() {
    holds(watched(scene("relocation"), [5.0, 7.5], Shown::Tissue), 0.11, 9, 260);
    holds(watched(scene("relocation"), [5.0, 7.5], Shown::Whole), 0.13, 9, 160);
}

#[test]
fn a_membrane_that_is_peeled_jumps_nowhere() {
    holds(watched(scene("erm"), [6.5, 8.0], Shown::Tissue), 0.10, 4, 65);
    let module = surgeon::load("peeling").unwrap();
    let peeling = || ScenePlayer::begin(surgeon::compose(&module, 1, &EXPERT, 1).unwrap());
    holds(watched(peeling(), [8.0, 9.5], Shown::Tissue), 0.06, 3, 15);
    holds(watched(peeling(), [8.0, 9.5], Shown::Whole), 0.23, 11, 40);
}
