//! Start of the renderer: scene and rig, tiers, and a warm-up in which the driver compiles its
//! programs (60 to 700 ms on a software driver, too long for the first picture).

use crate::assets::Assets;
use crate::compose::output_px;
use crate::config::Config;
use crate::costs::Costs;
use crate::frame::{Renderer, RendererConfig};
use crate::governor::{FIRST_LEAN, HARDWARE_START, SOFTWARE_START, TIERS};
use crate::gpu::Gpu;
use crate::latch::{Latched, latch_scene};
use crate::reference_scene::{Contents, SceneBlock};
use crate::tools::{NOMINAL_CANNULA_MM, Shaft};
use crate::workers;
use anyhow::{Context, Result};
use bytemuck::Zeroable;
use protocol::geometry::Pose;
use protocol::limits::INSTRUMENTS;
use protocol::poses::BODY_NAMES;
use protocol::scene::{NODE_FREE, SceneBody, SceneBrick, SceneHeader, SceneMark, SceneNode, SceneTriangle};
use protocol::time::Nanos;
use rig::Rig;
use scene::SceneFile;

/// Edge of the fundus map on a software driver: about the texels that its best tiers can show; the
/// others use its mip levels.
const SOFTWARE_MAP_PX: u32 = 1024;
/// Edge of the fundus map on a GPU, and for pictures that are not drawn in real time.
pub const HARDWARE_MAP_PX: u32 = 2048;
/// Rounds of the warm-up after which the driver has compiled everything.
const COMPILED_AFTER: usize = 2;
/// Rounds of it with those that are measured.
const ROUNDS: usize = 5;
/// Length of a shaft where the rig gives none, mm.
const SHAFT_LENGTH_MM: f64 = 60.0;

/// The best tier for which resources are made.
pub fn first_tier(gpu: &Gpu, fixed: Option<usize>) -> usize {
    let best = if gpu.is_software || gpu.is_lean { FIRST_LEAN } else { 0 };
    fixed.map_or(best, |tier| tier.min(best))
}

/// The tier to begin with.
pub fn start_tier(gpu: &Gpu) -> usize {
    let tier = if gpu.is_software { SOFTWARE_START } else { HARDWARE_START };
    tier.max(first_tier(gpu, None))
}

/// Size of a channel of a video's pictures: that of the fixed tier in files, or of one that a machine
/// of this kind usually reaches.
pub fn video_px(gpu: &Gpu, fixed: Option<usize>) -> [u32; 2] {
    output_px(&TIERS[fixed.unwrap_or(if gpu.is_software { 5 } else { 2 })])
}

/// What a renderer allocates for a scene and the rig's instruments.
pub fn renderer_config(scene: &SceneFile, rig: &Rig, first_tier: usize, map_px: u32) -> RendererConfig {
    let shafts: [Shaft; INSTRUMENTS] = std::array::from_fn(|i| Shaft {
        radius_mm: scene.instruments[i].shaft_radius_mm as f32,
        length_mm: rig.body(BODY_NAMES[i]).and_then(|b| b.length).unwrap_or(SHAFT_LENGTH_MM) as f32,
        cannula_mm: scene.needle.as_ref().map_or(NOMINAL_CANNULA_MM, |n| n.radius_mm as f32),
    });
    let tissue = scene.membrane.as_ref().map_or([1, 0], |m| match &m.mesh {
        Some(mesh) => [mesh.positions_mm.len(), mesh.triangles.len()],
        None => {
            let [w, h] = m.squares.map(|n| n as usize);
            [(w + 1) * (h + 1), 2 * w * h]
        }
    });
    RendererConfig {
        side: scene.eye.side,
        retina_radius_mm: scene.eye.retina_radius_mm,
        shafts,
        tissue,
        first_tier,
        map_px,
    }
}

/// Edge of the fundus map for this kind of device.
pub fn map_px(gpu: &Gpu) -> u32 {
    if gpu.is_software { SOFTWARE_MAP_PX } else { HARDWARE_MAP_PX }
}

/// Whether the warm-up must be short, asked before each of its frames, and the tier to begin at, if one
/// is named.
pub type Hurry<'a> = &'a dyn Fn() -> Option<Option<usize>>;

/// A renderer for `scene` that has drawn its first frames, and the costs of the tiers measured from
/// these; `clock` gives ns. In a `hurry` it draws no more than is needed to begin, and takes the
/// usual costs.
///
/// # Errors
/// If the rig cannot be read, or the device is lost.
pub fn renderer(
    gpu: &Gpu,
    scene: &SceneFile,
    config: &Config,
    assets: &Assets,
    first_tier: usize,
    hurry: Hurry<'_>,
    clock: fn() -> Nanos,
) -> Result<(Renderer, Costs)> {
    let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
    let begun = clock();
    let mut renderer =
        Renderer::with_assets(gpu, renderer_config(scene, &rig, first_tier, map_px(gpu)), assets);
    let made = clock();
    let costs = WarmUp::new(gpu, &mut renderer, scene, clock)?.costs(first_tier, hurry)?;
    if gpu.is_software {
        workers::place();
    }
    let ms = |from: Nanos, to: Nanos| (to - from) as f64 * 1e-6;
    let (resources_ms, warm_up_ms) = (ms(begun, made), ms(made, clock()));
    tracing::debug!(resources_ms, warm_up_ms, "started");
    Ok((renderer, costs))
}

/// Draws everything once, tracked and lost. The frames after that measure the cost of the tiers.
struct WarmUp<'a> {
    gpu: &'a Gpu,
    renderer: &'a mut Renderer,
    poses: Latched,
    clock: fn() -> Nanos,
}

impl<'a> WarmUp<'a> {
    fn new(
        gpu: &'a Gpu,
        renderer: &'a mut Renderer,
        scene: &SceneFile,
        clock: fn() -> Nanos,
    ) -> Result<Self> {
        let block = everything(scene);
        renderer.take_scene(gpu, &block.header, block.payload())?;
        Ok(WarmUp { gpu, renderer, poses: latch_scene(&block.header), clock })
    }

    fn costs(mut self, first_tier: usize, hurry: Hurry<'_>) -> Result<Costs> {
        let mut shortest_ns = [None::<u64>; TIERS.len()];
        for round in 0..ROUNDS {
            if round == COMPILED_AFTER && self.gpu.is_software {
                workers::place();
            }
            for (tier, shortest) in shortest_ns.iter_mut().enumerate().skip(first_tier) {
                if let Some(begin_at) = hurry() {
                    let soon = begin_at.unwrap_or(start_tier(self.gpu)).max(first_tier);
                    let missing = if round < COMPILED_AFTER { COMPILED_AFTER } else { 0 };
                    (0..missing).try_for_each(|round| self.draw(soon, round).map(drop))?;
                    return Ok(Costs::default());
                }
                let took = self.draw(tier, round)?;
                if round >= COMPILED_AFTER {
                    *shortest = Some(shortest.map_or(took, |before| before.min(took)));
                }
            }
        }
        Ok(Costs::measured(&shortest_ns))
    }

    /// Draws a frame of a round; ns that it took.
    fn draw(&mut self, tier: usize, round: usize) -> Result<u64> {
        // What a person may ask for later is compiled too; it is not part of what is measured.
        self.renderer.show_dose(self.gpu, round < COMPILED_AFTER);
        let tracked = round != 1;
        let latched = Latched { tracked: [tracked; INSTRUMENTS], eye_tracked: tracked, ..self.poses };
        let begun = (self.clock)();
        let commands = self.renderer.encode(self.gpu, tier);
        self.renderer.submit(self.gpu, tier, &latched, [commands]);
        self.gpu.wait()?;
        Ok((self.clock)() - begun)
    }
}

/// A scene with something of everything that can be drawn.
fn everything(scene: &SceneFile) -> SceneBlock {
    let node = |x: f32, y: f32| SceneNode { position_mm: [x, y, -11.0], flag: NODE_FREE as u16, dye: 0 };
    let body = |shape| SceneBody {
        shape,
        half_extents_mm: [0.5; 3],
        rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        rgba: [1.0; 4],
        ..SceneBody::zeroed()
    };
    let contents = Contents {
        nodes: vec![node(0.0, 0.0), node(1.0, 0.0), node(0.0, 1.0)],
        triangles: [0, 1].map(|tissue| SceneTriangle { nodes: [0, 1, 2], tissue }).into(),
        bodies: [0, 1, 2].map(body).into(),
        marks: vec![SceneMark { position_mm: [0.0, 0.0, -11.5], radius_mm: 1.0, rgba: [1.0; 4] }],
        bricks: vec![SceneBrick { edge_mm: 8.0, ..SceneBrick::zeroed() }],
        homes: Vec::new(),
    };
    let mut header = SceneHeader::zeroed();
    header.microscope = scene.start_microscope();
    header.world_from_eye = Pose::IDENTITY;
    // No real scene has this number, so the first one brings its triangles.
    header.topology = u64::MAX;
    for (i, x) in [1.0, -1.0].into_iter().enumerate() {
        header.instruments[i].tool = scene.instruments[i].tool as u32;
        header.instruments[i].world_from_instrument = Pose { position_mm: [x, 0.0, -6.0], ..Pose::IDENTITY };
    }
    contents.block(header)
}
