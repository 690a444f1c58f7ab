//! A renderer without window and process: scenes in, pictures out. For films, stills, measurements
//! and tests.

use crate::assets::{AssetError, Assets};
use crate::compose::{Composer, output_px};
use crate::frame::{Renderer, RendererConfig};
use crate::governor::TIERS;
use crate::gpu::{Gpu, GpuError};
use crate::latch::Latched;
use crate::readback::{Picture, ReadBack};
use crate::stereo::Arrangement;

/// A renderer, its device, and the buffer through which its pictures come back.
pub struct Offscreen {
    /// The device.
    pub gpu: Gpu,
    /// What draws.
    pub renderer: Renderer,
    composer: Composer,
    read_back: ReadBack,
}

impl Offscreen {
    /// A renderer on `gpu` with the shipped photograph and meshes.
    ///
    /// # Errors
    /// If a shipped asset cannot be decoded.
    pub fn new(gpu: Gpu, config: RendererConfig) -> Result<Self, AssetError> {
        Ok(Self::with_assets(gpu, config, &Assets::shipped()?))
    }

    /// As [`Self::new`], with other assets than the shipped ones.
    pub fn with_assets(gpu: Gpu, config: RendererConfig, assets: &Assets) -> Self {
        let renderer = Renderer::with_assets(&gpu, config, assets);
        let read_back = ReadBack::new(&gpu, config.first_tier);
        let composer = Composer::new(&gpu);
        Self { gpu, renderer, composer, read_back }
    }

    /// Records and submits a frame of the scene that was taken last.
    pub fn draw(&mut self, tier: usize, latched: &Latched) {
        let commands = self.renderer.encode(&self.gpu, tier);
        self.renderer.submit(&self.gpu, tier, latched, [commands]);
    }

    /// Waits for the frame drawn last and copies it into `picture`, whose memory is used again: the
    /// tier's own picture, without text.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn read(&self, tier: usize, picture: &mut Picture) -> Result<(), GpuError> {
        self.read_back.read(&self.gpu, &self.renderer.target(tier).texture, picture)
    }

    /// As [`Self::read`], as it is written into files: with text, and as large as text needs
    /// ([`output_px`]). The channels lie side by side; `arrangement` is what the file makes of them.
    ///
    /// # Errors
    /// If the device was lost.
    pub fn compose(
        &mut self,
        tier: usize,
        arrangement: Arrangement,
        picture: &mut Picture,
    ) -> Result<(), GpuError> {
        let (target, size_px) = (self.renderer.target(tier), output_px(&TIERS[tier]));
        let texture = self.composer.compose(&self.gpu, target, size_px, self.renderer.text(), arrangement);
        self.read_back.read(&self.gpu, texture, picture)
    }
}
