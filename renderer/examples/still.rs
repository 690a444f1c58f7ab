//! Draws one still of the shipped scene without any other process, and times each tier:
//! `cargo run --release -p renderer --example still -- OUT.png [TIER]`.

mod common;

use anyhow::Result;
use protocol::rig::Rig;
use protocol::scene_file::{DEFAULT_SCENE, SceneFile};
use protocol::time::now;
use renderer::frame::Renderer;
use renderer::governor::TIERS;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::output::save_png;
use renderer::readback::{Picture, ReadBack};
use renderer::start::plan;

/// Frames timed for each tier.
const FRAMES: usize = 40;

fn main() -> Result<()> {
    env_logger::init();
    let mut args = std::env::args().skip(1);
    let out = args.next().unwrap_or_else(|| "still.png".into());
    let tier: usize = args.next().map_or(Ok(2), |t| t.parse())?;
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE)?, Rig::load_or_shipped(None)?);
    let gpu = Gpu::headless()?;
    let mut renderer = Renderer::new(&gpu, plan(&file, &rig, 0, renderer::start::map_px(&gpu)))?;
    let scene = common::scene(&file, &rig, [0.9, 0.5, -10.1], 0.06, 0.3);
    renderer.take_scene(&gpu, &scene.header, bytemuck::cast_slice(&scene.payload))?;
    let latched = latch_scene(&scene.header);
    let mut draw = |tier: usize| -> Result<u64> {
        let start = now();
        let commands = renderer.encode(&gpu, tier);
        renderer.submit(&gpu, tier, &latched, commands);
        gpu.wait()?;
        Ok(now() - start)
    };
    println!("{}{}", gpu.name, if gpu.is_software { ", in software" } else { "" });
    for index in (0..TIERS.len()).rev() {
        draw(index)?;
        let before = cpu_ms();
        let mut times = (0..FRAMES).map(|_| draw(index)).collect::<Result<Vec<u64>>>()?;
        let cpu = (cpu_ms() - before) / FRAMES as f64;
        times.sort_unstable();
        let ms = |k: usize| times[k] as f64 * 1e-6;
        let t = &TIERS[index];
        let (p50, p95) = (ms(FRAMES / 2), ms(FRAMES * 95 / 100));
        println!(
            "tier {index}  2×{}×{}  p50 {p50:.2} ms  p95 {p95:.2} ms  CPU {cpu:.2} ms",
            t.width_px, t.height_px
        );
    }
    draw(tier)?;
    let mut picture = Picture::default();
    ReadBack::new(&gpu, 0).read(&gpu, renderer.target(tier), &mut picture)?;
    save_png(out.as_ref(), &picture)?;
    Ok(())
}

/// Processor time of all threads, ms: the cost on a software driver, however busy the machine is.
fn cpu_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}
