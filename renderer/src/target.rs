//! Pictures to draw into: one for each tier, made at start-up, both channels side by side.

use crate::governor::Tier;
use crate::passes::{COLOUR, DEPTH};
use wgpu::{Device, Texture, TextureDescriptor, TextureUsages, TextureView};

/// A picture of both channels with its depth.
pub struct Target {
    /// The picture.
    pub texture: Texture,
    /// Its view.
    pub colour: TextureView,
    /// Depth.
    pub depth: TextureView,
    /// Width of a channel, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
}

impl Target {
    /// For `tier`.
    pub fn new(device: &Device, tier: &Tier) -> Self {
        let size =
            wgpu::Extent3d { width: 2 * tier.width_px, height: tier.height_px, depth_or_array_layers: 1 };
        let make = |format, usage| {
            device.create_texture(&TextureDescriptor {
                label: Some("picture"),
                size,
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: TextureUsages::RENDER_ATTACHMENT | usage,
                view_formats: &[],
            })
        };
        let texture = make(COLOUR, TextureUsages::COPY_SRC | TextureUsages::TEXTURE_BINDING);
        let depth = make(DEPTH, TextureUsages::empty());
        let view = |t: &Texture| t.create_view(&wgpu::TextureViewDescriptor::default());
        Self {
            colour: view(&texture),
            depth: view(&depth),
            texture,
            width_px: tier.width_px,
            height_px: tier.height_px,
        }
    }
}
