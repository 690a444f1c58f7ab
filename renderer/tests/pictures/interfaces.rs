//! Every tier through every graphics interface of this machine: drawn, or refused in words.

use crate::stage::Stage;
use renderer::governor::TIERS;
use renderer::gpu::{Gpu, GpuError};
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::membrane_scene;
use wgpu::Backends;

#[test]
fn no_tier_is_a_black_field() {
    let Some(stage) = Stage::open() else { return };
    let scene = membrane_scene(&stage.file, &stage.rig, [0.9, 0.5, -9.5], 0.3, 0.0);
    let mut drawn = 0;
    for gpu in [Backends::VULKAN, Backends::GL].into_iter().filter_map(|b| Gpu::headless_through(b).ok()) {
        let admitted: Vec<usize> = (0..TIERS.len()).filter(|&tier| gpu.check_tier(tier).is_ok()).collect();
        assert!(admitted.len() >= 6, "{}: {admitted:?}", gpu.name);
        let refused = gpu.check_tier(0).err();
        assert!(refused.is_none_or(|e| matches!(e, GpuError::LeanOnly { tier: 0, .. })));
        let mut offscreen = Offscreen::new(gpu.clone(), stage.config(admitted[0])).unwrap();
        offscreen.renderer.take_scene(&gpu, &scene.header, scene.payload()).unwrap();
        for tier in admitted {
            offscreen.draw(tier, &latch_scene(&scene.header));
            let mut picture = Picture::default();
            offscreen.read(tier, &mut picture).unwrap();
            let lit = picture.rgba.chunks_exact(4).filter(|p| p[0] > 40).count() * 4;
            let share = lit as f64 / picture.rgba.len() as f64;
            assert!(share > 0.2, "{}, tier {tier}: {share:.3} of the picture is lit", gpu.name);
            drawn += 1;
        }
    }
    assert!(drawn >= 6, "{drawn} pictures");
}
