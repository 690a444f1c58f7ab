//! A graphics device that goes away in the middle of the work. Where there is no graphics driver the test says so in one line and
//! passes.

#[path = "../examples/common/mod.rs"]
mod common;

use protocol::rig::Rig;
use renderer::frame::Renderer;
use renderer::gpu::{Gpu, GpuError};
use renderer::latch::latch_scene;
use renderer::readback::{Picture, ReadBack};
use renderer::start::plan;
use scene::{DEFAULT_SCENE, SceneFile};

/// A tier with depth of field and one without.
const TIERS: [usize; 2] = [2, 6];

#[test]
fn a_device_that_goes_away_is_an_error_and_the_next_one_draws() {
    let gpu = match Gpu::headless() {
        Ok(gpu) => gpu,
        Err(e) => return println!("skipped: {e}"),
    };
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE).unwrap(), Rig::load_or_shipped(None).unwrap());
    let scene = common::scene(&file, &rig, [0.9, 0.5, -9.5], 0.3, 0.0);
    let latched = latch_scene(&scene.header);
    let open = |gpu: &Gpu| Renderer::new(gpu, plan(&file, &rig, TIERS[0], 512)).unwrap();
    let draw = |gpu: &Gpu, renderer: &mut Renderer, tier: usize| {
        renderer.take_scene(gpu, &scene.header, bytemuck::cast_slice(&scene.payload)).unwrap();
        let commands = renderer.encode(gpu, tier);
        renderer.submit(gpu, tier, &latched, commands);
        let done = gpu.wait();
        renderer.pass_times();
        done
    };
    let mut renderer = open(&gpu);
    let read_back = ReadBack::new(&gpu, TIERS[0]);
    TIERS.iter().for_each(|&tier| draw(&gpu, &mut renderer, tier).expect("the device is there"));
    gpu.device.destroy();
    // Nothing panics, and every frame says what is wrong, however often it is tried.
    for tier in TIERS {
        let problem = draw(&gpu, &mut renderer, tier).expect_err("the device is gone");
        assert!(matches!(problem, GpuError::Lost(_)), "{problem}");
        assert!(problem.to_string().starts_with("graphics device lost: "), "{problem}");
        let mut picture = Picture::default();
        assert!(read_back.read(&gpu, renderer.target(tier), &mut picture).is_err(), "no picture comes back");
    }
    // A fresh process, as the launcher starts one, opens the adapter again and draws.
    let again = Gpu::headless().expect("the adapter is still there");
    let mut renderer = open(&again);
    TIERS.iter().for_each(|&tier| draw(&again, &mut renderer, tier).expect("the new device draws"));
}
