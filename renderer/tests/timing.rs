//! The device's own stamps hold together and fit the processor's clock. Where there is no graphics driver, or it stamps
//! nothing, the test says so in one line and passes.

#[path = "../examples/common/mod.rs"]
mod common;

use common::{Contents, scene_of};
use ipc::clock::now;
use protocol::rig::Rig;
use renderer::frame::Renderer;
use renderer::gpu::Gpu;
use renderer::gpu_clock::GpuClock;
use renderer::latch::latch_scene;
use renderer::start::plan;
use scene::{DEFAULT_SCENE, SceneFile};

/// A tier with depth of field and one without, and how many passes they have.
const TIERS: [(usize, usize); 2] = [(2, 3), (6, 2)];

#[test]
fn stamps_lie_between_submission_and_end() {
    let gpu = match Gpu::headless() {
        Ok(gpu) => gpu,
        Err(e) => return println!("skipped: {e}"),
    };
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE).unwrap(), Rig::load_or_shipped(None).unwrap());
    let mut renderer = Renderer::new(&gpu, plan(&file, &rig, TIERS[0].0, 512)).unwrap();
    let scene = scene_of(&file, &rig, [0.9, 0.5, -8.5], 0.3, &Contents::default());
    renderer.take_scene(&gpu, &scene.header, bytemuck::cast_slice(&scene.payload)).unwrap();
    let latched = latch_scene(&scene.header);
    let mut clock = GpuClock::default();
    assert_eq!(renderer.pass_times(), None, "nothing was drawn yet");
    for frame in 0..16 {
        let (tier, passes) = TIERS[frame / 2 % 2];
        let commands = renderer.encode(&gpu, tier);
        let submitted = now();
        renderer.submit(&gpu, tier, &latched, commands);
        if frame % 4 == 3 {
            // Nobody waits for or reads this one; the next must not stumble over it.
            continue;
        }
        gpu.wait().unwrap();
        let done = now();
        let Some(times) = renderer.pass_times() else {
            return println!("skipped: {} stamps nothing", gpu.name);
        };
        assert_eq!(renderer.pass_times(), None, "stamps are read once");
        let whole = times.whole.end_ns - times.whole.begin_ns;
        assert!(
            times.passes_ns[..passes].iter().all(|&ns| ns > 0)
                && times.passes_ns.iter().sum::<u64>() <= whole
        );
        assert!(
            times.passes_ns[passes..].iter().all(|&ns| ns == 0),
            "a pass that is not there takes no time"
        );
        assert!(times.whole.begin_ns <= times.whole.end_ns);
        let drawn = clock.drawn(submitted, times.whole, done);
        assert!((submitted..=done).contains(&drawn));
    }
}
