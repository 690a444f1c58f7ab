//! Timestamps of the device are consistent and fit the processor's clock. Skipped too where the
//! device has none.

use crate::stage::Stage;
use ipc::clock::now;
use renderer::gpu_clock::GpuClock;
use renderer::latch::latch_scene;
use renderer::reference_scene::{Contents, scene_with};

/// A tier with depth of field and one without, and how many passes they have.
const TIERS: [(usize, usize); 2] = [(2, 3), (6, 2)];

#[test]
fn timestamps_lie_between_submission_and_end() {
    let Some(stage) = Stage::open() else { return };
    let gpu = &stage.gpu;
    let mut renderer = stage.renderer(TIERS[0].0).renderer;
    let scene = scene_with(&stage.file, &stage.rig, [0.9, 0.5, -8.5], 0.3, &Contents::default());
    renderer.take_scene(gpu, &scene.header, scene.payload()).unwrap();
    let latched = latch_scene(&scene.header);
    let mut clock = GpuClock::default();
    assert_eq!(renderer.pass_times(), None, "nothing was drawn yet");
    for frame in 0..16 {
        let (tier, passes) = TIERS[frame / 2 % 2];
        let commands = renderer.encode(gpu, tier);
        let submitted = now();
        renderer.submit(gpu, tier, &latched, [commands]);
        if frame % 4 == 3 {
            // This one is neither awaited nor read; the next must not be disturbed by it.
            continue;
        }
        gpu.wait().unwrap();
        let done = now();
        let Some(times) = renderer.pass_times() else {
            return skips::skip(&format!("{} has no timestamps", gpu.name));
        };
        assert_eq!(renderer.pass_times(), None, "timestamps are read once");
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
        let drawn = clock.finished_at(submitted, times.whole, done);
        assert!((submitted..=done).contains(&drawn));
    }
}
