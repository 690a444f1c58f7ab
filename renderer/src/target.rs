//! Pictures to draw into: one for each tier, made at start-up, both channels side by side.

use crate::cells::cells;
use crate::governor::Tier;
use crate::passes::{COLOUR, DEPTH, IndexList, texture_descriptor, view};
use wgpu::{Device, Texture, TextureDescriptor, TextureUsages, TextureView};

/// A picture of both channels with its depth.
pub struct Target {
    /// The picture.
    pub texture: Texture,
    /// Its view.
    pub colour: TextureView,
    /// Depth; of full tiers that of the samples.
    pub depth: TextureView,
    /// Of full tiers: what their samples are drawn into.
    pub multisampled: Option<Multisampled>,
    /// What the retina is drawn as.
    pub cells: IndexList,
    /// Width of a channel, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
}

/// Attachments of a full tier, several samples a pixel.
pub struct Multisampled {
    /// Colour of the samples.
    pub samples: TextureView,
    /// Colour resolved to one value a pixel, before the depth of field.
    pub resolved: TextureView,
    /// Depth of the samples, to be read.
    pub depth: TextureView,
}

impl Target {
    /// For `tier`.
    pub fn new(device: &Device, tier: &Tier) -> Self {
        let (size_px, samples) = ([2 * tier.width_px, tier.height_px], tier.shading.samples());
        let make = |format, sample_count, usage| {
            let usage = TextureUsages::RENDER_ATTACHMENT | usage;
            let plain = texture_descriptor("picture", format, size_px, usage);
            device.create_texture(&TextureDescriptor { sample_count, ..plain })
        };
        let seen = TextureUsages::TEXTURE_BINDING;
        let texture = make(COLOUR, 1, TextureUsages::COPY_SRC | seen);
        let depth = make(DEPTH, samples, if samples > 1 { seen } else { TextureUsages::empty() });
        let multisampled = || Multisampled {
            samples: view(&make(COLOUR, samples, TextureUsages::empty())),
            resolved: view(&make(COLOUR, 1, seen)),
            depth: view(&depth),
        };
        Self {
            multisampled: (samples > 1).then(multisampled),
            colour: view(&texture),
            depth: view(&depth),
            texture,
            cells: cells(device, tier),
            width_px: tier.width_px,
            height_px: tier.height_px,
        }
    }
}
