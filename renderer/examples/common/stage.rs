//! A renderer without any other process, and pictures made small for comparison.
#![allow(dead_code)]

use super::Scene;
use protocol::rig::Rig;
use renderer::frame::Renderer;
use renderer::governor::{Shading, TIERS};
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::readback::{Picture, ReadBack};
use renderer::start::plan;
use scene::{DEFAULT_SCENE, SceneFile};

/// Edge of the fundus map: that of a software driver, whatever the device.
const MAP_PX: u32 = 512;
/// Size of a channel of a small picture, px.
pub const SMALL_PX: [u32; 2] = [160, 128];

/// What draws.
pub struct Stage {
    pub gpu: Gpu,
    pub file: SceneFile,
    pub rig: Rig,
    read_back: ReadBack,
}

impl Stage {
    /// Opens a device; without one says so in a line.
    pub fn open() -> Option<Self> {
        let gpu = Gpu::headless().map_err(|e| println!("skipped: {e}")).ok()?;
        let (file, rig) = (SceneFile::load(DEFAULT_SCENE).unwrap(), Rig::load_or_shipped(None).unwrap());
        let read_back = ReadBack::new(&gpu, tier_of(Shading::Full));
        Some(Self { gpu, file, rig, read_back })
    }

    /// The picture of the last of `scenes`, which a fresh renderer takes one after the other.
    pub fn draw(&mut self, scenes: &[Scene], tier: usize) -> Picture {
        let plan = plan(&self.file, &self.rig, tier_of(Shading::Full), MAP_PX);
        let mut renderer = Renderer::new(&self.gpu, plan).unwrap();
        for scene in scenes {
            renderer.take_scene(&self.gpu, &scene.header, bytemuck::cast_slice(&scene.payload)).unwrap();
        }
        let latched = latch_scene(&scenes.last().expect("a scene").header);
        let commands = renderer.encode(&self.gpu, tier);
        renderer.submit(&self.gpu, tier, &latched, commands);
        let mut picture = Picture::default();
        self.read_back.read(&self.gpu, renderer.target(tier), &mut picture).unwrap();
        picture
    }
}

/// The smallest tier with this shading that is no smaller than a small picture.
pub fn tier_of(shading: Shading) -> usize {
    let fits = |t: &renderer::governor::Tier| t.shading == shading && t.width_px >= 2 * SMALL_PX[0];
    TIERS.iter().rposition(fits).expect("a tier of each shading")
}

/// `picture` at [`SMALL_PX`], each pixel the mean of those it stands for.
pub fn small(picture: &Picture) -> Picture {
    renderer::similarity::reduced(picture, 2 * SMALL_PX[0])
}
