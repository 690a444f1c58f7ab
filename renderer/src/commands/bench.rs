//! `vitreo bench render`: cost of a stereo frame by tier and by layer, as wall time and as
//! processor time; the latter is the true cost on a software driver, however busy the machine is.
//! The cost of a layer is the time saved by leaving it out.

use anyhow::Result;
use ipc::clock::now;
use renderer::frame::Renderer;
use renderer::governor::{TIERS, Tier};
use renderer::gpu::Gpu;
use renderer::latch::{Latched, latch_scene};
use renderer::layers::Layers;
use renderer::passes::COLOUR;
use renderer::passes::text::Text;
use renderer::reference_scene::{self, SUBJECTS};
use renderer::start::{map_px, renderer_config};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};

/// Rounds of a measurement, time after which it ends early (ns), and least number of rounds.
const ROUNDS: usize = 60;
const MAX_TIME_NS: u64 = 15_000_000_000;
const MIN_ROUNDS: usize = 3;

/// Text over the picture while one works.
const TEXT: &str = "<Level 2\n<3 of 7\n>4:32\n^Grip slipped\n_Next: the edge is in the jaws\n";

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct RenderArgs {
    /// Print one JSON object per tier.
    #[arg(long)]
    pub json: bool,
    /// Measure one tier only.
    #[arg(long, value_name = "N", value_parser = settings::commands::numbers::whole::<u32>(0, TIERS.len() as u64 - 1))]
    pub tier: Option<u32>,
    /// Scene to draw.
    #[arg(long, default_value = "peel", value_parser = SUBJECTS)]
    pub subject: String,
}

struct Bench {
    gpu: Gpu,
    renderer: Renderer,
    latched: Latched,
    text: Text,
}

/// Of a frame, ms.
#[derive(Clone, Copy)]
struct Cost {
    wall: f64,
    processor: f64,
}

/// Costs of a tier.
struct Row {
    /// All layers, medians.
    whole: Cost,
    /// Processor time (software driver) or wall time saved by leaving a layer out, ms; last, the
    /// time of a frame without any.
    layers: Vec<(&'static str, f64)>,
}

impl Bench {
    fn open(subject: &str) -> Result<Self> {
        let (file, rig) = (SceneFile::load(DEFAULT_SCENE)?, Rig::load_or_shipped(None)?);
        let gpu = Gpu::headless()?;
        let mut renderer = Renderer::new(&gpu, renderer_config(&file, &rig, 0, map_px(&gpu)))?;
        let scenes = reference_scene::subject(&file, &rig, subject);
        for scene in &scenes {
            renderer.take_scene(&gpu, &scene.header, scene.payload())?;
        }
        let latched = latch_scene(&scenes[scenes.len() - 1].header);
        let text = Text::new(&gpu.device, COLOUR);
        Ok(Self { gpu, renderer, latched, text })
    }

    fn frame(&mut self, tier: usize, layers: Layers) -> Result<()> {
        let commands = self.renderer.encode_layers(&self.gpu, tier, layers);
        let text = layers.has(Layers::TEXT).then(|| self.text(tier));
        self.renderer.submit(&self.gpu, tier, &self.latched, [commands].into_iter().chain(text));
        Ok(self.gpu.wait()?)
    }

    /// Writes the text of a usual moment over the picture, as a window of its size does in the pass
    /// that copies it.
    fn text(&mut self, tier: usize) -> wgpu::CommandBuffer {
        let target = self.renderer.target(tier);
        let (gpu, size_px) = (&self.gpu, [target.width_px, target.height_px]);
        self.text.set(&gpu.device, &gpu.queue, TEXT, size_px);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let ops = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let view = &target.colour;
        let colour = wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("text"),
            color_attachments: &[Some(colour)],
            ..Default::default()
        });
        self.text.draw(&mut pass, &[[0, 0], [size_px[0], 0]], 1);
        drop(pass);
        encoder.finish()
    }

    /// One frame, after another that is not counted and fills the caches for these layers.
    fn measured(&mut self, tier: usize, layers: Layers) -> Result<Cost> {
        self.frame(tier, layers)?;
        let (start, used) = (now(), processor_ms());
        self.frame(tier, layers)?;
        Ok(Cost { wall: (now() - start) as f64 * 1e-6, processor: processor_ms() - used })
    }

    /// Rounds of: all layers, all but one, none. A changing load of the machine burdens each alike,
    /// and a layer's cost is the median of differences within a round.
    fn row(&mut self, tier: usize) -> Result<Row> {
        let without = |&(_, bit): &(&str, Layers)| Layers::ALL.without(bit);
        let variants: Vec<Layers> = Layers::EACH.iter().map(without).chain([Layers::NONE]).collect();
        let (mut wholes, mut rests) = (Vec::new(), vec![Vec::new(); variants.len()]);
        let begun = now();
        while wholes.len() < ROUNDS && now() - begun < MAX_TIME_NS || wholes.len() < MIN_ROUNDS {
            wholes.push(self.measured(tier, Layers::ALL)?);
            for (rest, &layers) in rests.iter_mut().zip(&variants) {
                rest.push(self.measured(tier, layers)?);
            }
        }
        let software = self.gpu.is_software;
        let of = |cost: &Cost| if software { cost.processor } else { cost.wall };
        let saved = |rest: &[Cost]| median(wholes.iter().zip(rest).map(|(w, r)| of(w) - of(r)).collect());
        let names = Layers::EACH.iter().map(|(name, _)| *name);
        let mut layers: Vec<_> = names.zip(rests.iter().map(|rest| saved(rest))).collect();
        layers.push(("rest", median(rests[variants.len() - 1].iter().map(of).collect())));
        let whole = Cost {
            wall: median(wholes.iter().map(|c| c.wall).collect()),
            processor: median(wholes.iter().map(|c| c.processor).collect()),
        };
        Ok(Row { whole, layers })
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

/// Measures and prints, one line a tier.
///
/// # Errors
/// If there is no graphics driver, it cannot draw the tier that was asked for, or the device is lost.
pub fn render(args: &RenderArgs) -> Result<()> {
    let mut bench = Bench::open(&args.subject)?;
    args.tier.map_or(Ok(()), |tier| bench.gpu.check_tier(tier as usize))?;
    let name = bench.gpu.name.clone();
    if !args.json {
        let layer = if bench.gpu.is_software { "processor time" } else { "wall time" };
        println!(
            "{name}; scene {}; ms of a stereo frame, medians; of a layer: {layer} saved by leaving it out",
            args.subject
        );
        print!("tier  picture      shading   wall  processor");
        Layers::EACH.iter().for_each(|(layer, _)| print!("  {layer:>11}"));
        println!("         rest");
    }
    let wanted = |index: usize| args.tier.is_none_or(|only| only as usize == index);
    for (index, tier) in TIERS.iter().enumerate().filter(|(index, _)| wanted(*index)) {
        if let Err(why) = bench.gpu.check_tier(index) {
            eprintln!("tier {index} is skipped: {why}");
            continue;
        }
        let row = bench.row(index)?;
        if args.json {
            print_json(&name, &args.subject, index, tier, &row)
        } else {
            print_row(index, tier, &row)
        }
    }
    Ok(())
}

fn print_row(index: usize, tier: &Tier, row: &Row) {
    let (w, h, shading) = (tier.width_px, tier.height_px, tier.shading.name());
    print!("{index:>4}  2×{w:<4}×{h:<4}  {shading:<7} {:>6.2}  {:>9.2}", row.whole.wall, row.whole.processor);
    row.layers.iter().for_each(|(_, ms)| print!("  {ms:>11.2}"));
    println!();
}

fn print_json(adapter: &str, subject: &str, index: usize, tier: &Tier, row: &Row) {
    let (w, h, shading) = (tier.width_px, tier.height_px, tier.shading.name());
    let each: Vec<String> = row.layers.iter().map(|(l, ms)| format!("\"{l}\":{ms:.3}")).collect();
    println!(
        "{{\"adapter\":{adapter:?},\"subject\":\"{subject}\",\"tier\":{index},\"width_px\":{w},\"height_px\":{h},\
         \"shading\":\"{shading}\",\"wall_ms\":{:.3},\"processor_ms\":{:.3},\"layers_ms\":{{{}}}}}",
        row.whole.wall,
        row.whole.processor,
        each.join(",")
    );
}
