//! A graphics device that is lost while frames are drawn.

use crate::stage::Stage;
use renderer::gpu::{Gpu, GpuError};
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::membrane_scene;

/// A tier with depth of field and one without.
const TIERS: [usize; 2] = [2, 6];

#[test]
fn a_device_that_goes_away_is_an_error_and_the_next_one_draws() {
    let Some(stage) = Stage::open() else { return };
    let scene = membrane_scene(&stage.file, &stage.rig, [0.9, 0.5, -9.5], 0.3, 0.0);
    let latched = latch_scene(&scene.header);
    let draw = |offscreen: &mut Offscreen, tier: usize| {
        offscreen.renderer.take_scene(&offscreen.gpu, &scene.header, scene.payload()).unwrap();
        offscreen.draw(tier, &latched);
        let done = offscreen.gpu.wait();
        offscreen.renderer.pass_times();
        done
    };
    let mut offscreen = stage.renderer(TIERS[0]);
    TIERS.iter().for_each(|&tier| draw(&mut offscreen, tier).expect("the device is there"));
    stage.gpu.device.destroy();
    // Nothing panics, and every frame returns the reason.
    for tier in TIERS {
        let problem = draw(&mut offscreen, tier).expect_err("the device is gone");
        assert!(matches!(problem, GpuError::Lost(_)), "{problem}");
        assert!(problem.to_string().starts_with("graphics device lost: "), "{problem}");
        assert!(offscreen.read(tier, &mut Picture::default()).is_err(), "no picture comes back");
    }
    // A fresh process, as the launcher starts one, opens the adapter again and draws.
    let gpu = Gpu::headless().expect("the adapter is still there");
    let mut offscreen = Offscreen::new(gpu, stage.config(TIERS[0])).unwrap();
    TIERS.iter().for_each(|&tier| draw(&mut offscreen, tier).expect("the new device draws"));
}
