//! What a stereo frame costs, by tier and by layer: wall time and processor time, which on a software driver is the true
//! cost, however busy the machine is.
//!
//! `cargo bench -p renderer --bench frame` prints tables; with `-- --json` one object a line, with `-- --tier N` one tier only, with `-- --subject NAME`
//! another scene than `peel`: bleb, vitreous, bodies.

#[path = "../examples/common/mod.rs"]
mod common;

use anyhow::Result;
use protocol::rig::Rig;
use protocol::scene_file::{DEFAULT_SCENE, SceneFile};
use protocol::time::now;
use renderer::frame::Renderer;
use renderer::governor::TIERS;
use renderer::gpu::Gpu;
use renderer::latch::{Latched, latch_scene};
use renderer::layers::Layers;
use renderer::start::plan;

/// Frames of a measurement, and time after which it ends early, ns.
const FRAMES: usize = 60;
const LONGEST_NS: u64 = 1_500_000_000;

struct Bench {
    gpu: Gpu,
    renderer: Renderer,
    latched: Latched,
}

/// Medians, ms.
struct Cost {
    wall: f64,
    processor: f64,
}

impl Bench {
    fn frame(&mut self, tier: usize, layers: Layers) -> Result<()> {
        let commands = self.renderer.encode_layers(&self.gpu, tier, layers);
        self.renderer.submit(&self.gpu, tier, &self.latched, commands);
        Ok(self.gpu.wait()?)
    }

    fn measure(&mut self, tier: usize, layers: Layers) -> Result<Cost> {
        (0..3).try_for_each(|_| self.frame(tier, layers))?;
        let (mut wall, mut processor) = (Vec::new(), Vec::new());
        let begun = now();
        while wall.len() < FRAMES && now() - begun < LONGEST_NS {
            let (start, used) = (now(), processor_ms());
            self.frame(tier, layers)?;
            wall.push((now() - start) as f64 * 1e-6);
            processor.push(processor_ms() - used);
        }
        Ok(Cost { wall: median(wall), processor: median(processor) })
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Processor time of all threads of this process, ms.
fn processor_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

fn main() -> Result<()> {
    env_logger::init();
    let args: Vec<String> = std::env::args().collect();
    let json = args.iter().any(|a| a == "--json");
    let only = args.iter().position(|a| a == "--tier").and_then(|i| args.get(i + 1)?.parse::<usize>().ok());
    let (file, rig) = (SceneFile::load(DEFAULT_SCENE)?, Rig::load_or_shipped(None)?);
    let gpu = Gpu::headless()?;
    let map_px = renderer::start::map_px(&gpu);
    let mut renderer = Renderer::new(&gpu, plan(&file, &rig, 0, map_px))?;
    let subject =
        args.iter().position(|a| a == "--subject").and_then(|i| args.get(i + 1)).map_or("peel", |s| s);
    let mut latched = None;
    for scene in common::subject(&file, &rig, subject) {
        renderer.take_scene(&gpu, &scene.header, bytemuck::cast_slice(&scene.payload))?;
        latched = Some(latch_scene(&scene.header));
    }
    let mut bench = Bench { latched: latched.expect("a scene"), gpu, renderer };
    let name = bench.gpu.name.clone();
    if !json {
        println!("{name}; ms of a stereo frame, median; of a layer: what leaving it out saves");
        print!("tier  picture      shading   wall  processor");
        Layers::EACH.iter().for_each(|(layer, _)| print!("  {layer:>11}"));
        println!("         rest");
    }
    for (index, tier) in TIERS.iter().enumerate().filter(|(index, _)| only.is_none_or(|o| o == *index)) {
        let whole = bench.measure(index, Layers::ALL)?;
        let mut layers = Vec::new();
        for (layer, bit) in Layers::EACH {
            let rest = bench.measure(index, Layers::ALL.without(bit))?;
            layers.push((layer, whole.processor - rest.processor));
        }
        let rest = bench.measure(index, Layers::NONE)?.processor;
        layers.push(("rest", rest));
        let (w, h, shading) = (tier.width_px, tier.height_px, tier.shading.name());
        if json {
            let each: Vec<String> = layers.iter().map(|(l, ms)| format!("\"{l}\":{ms:.3}")).collect();
            println!(
                "{{\"adapter\":\"{name}\",\"tier\":{index},\"width_px\":{w},\"height_px\":{h},\"shading\":\"{shading}\",\
                 \"wall_ms\":{:.3},\"processor_ms\":{:.3},\"layers_processor_ms\":{{{}}}}}",
                whole.wall,
                whole.processor,
                each.join(",")
            );
        } else {
            print!("{index:>4}  2×{w:<4}×{h:<4}  {shading:<7} {:>6.2}  {:>9.2}", whole.wall, whole.processor);
            layers.iter().for_each(|(_, ms)| print!("  {ms:>11.2}"));
            println!();
        }
    }
    Ok(())
}
