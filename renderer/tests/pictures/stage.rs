//! A device with the shipped scene and rig; pictures of reference scenes.

use renderer::frame::RendererConfig;
use renderer::governor::Shading;
use renderer::gpu::Gpu;
use renderer::latch::latch_scene;
use renderer::offscreen::Offscreen;
use renderer::readback::Picture;
use renderer::reference_scene::SceneBlock;
use renderer::similarity::reference_tier;
use renderer::start::renderer_config;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};

/// Edge of the fundus map: that of a software driver, whatever the device.
const MAP_PX: u32 = 512;

/// What draws.
pub struct Stage {
    pub gpu: Gpu,
    pub file: SceneFile,
    pub rig: Rig,
}

impl Stage {
    /// Opens a device; without one prints that the test is skipped.
    pub fn open() -> Option<Self> {
        let gpu = Gpu::headless().map_err(|e| skips::skip(&e)).ok()?;
        let (file, rig) = (SceneFile::load(DEFAULT_SCENE).unwrap(), Rig::load_or_shipped(None).unwrap());
        Some(Self { gpu, file, rig })
    }

    /// For the tiers from `first_tier` on.
    pub fn config(&self, first_tier: usize) -> RendererConfig {
        renderer_config(&self.file, &self.rig, first_tier, MAP_PX)
    }

    /// A fresh renderer for the tiers from `first_tier` on.
    pub fn renderer(&self, first_tier: usize) -> Offscreen {
        Offscreen::new(self.gpu.clone(), self.config(first_tier)).unwrap()
    }

    /// The picture of the last of `scenes`, which a fresh renderer takes one after the other.
    pub fn draw(&self, scenes: &[SceneBlock], tier: usize) -> Picture {
        let mut offscreen = self.renderer(reference_tier(Shading::Full));
        for scene in scenes {
            offscreen.renderer.take_scene(&self.gpu, &scene.header, scene.payload()).unwrap();
        }
        offscreen.draw(tier, &latch_scene(&scenes.last().expect("a scene").header));
        let mut picture = Picture::default();
        offscreen.read(tier, &mut picture).unwrap();
        picture
    }
}
