//! Depth of field of the full tiers: points out of focus are spread over the patches that [`crate::optics::blur_mm`] gives. Two small
//! passes find how far patches reach in each tile of the picture; where nothing is out of focus, the last one only copies.

use super::{PipelinePlan, pipeline};
use crate::target::Fine;
use crate::view::FocusPlane;
use bytemuck::{Pod, Zeroable};
use wgpu::{
    BindGroup, BindGroupLayout, BindGroupLayoutEntry, BindingType, Buffer, BufferUsages, CommandEncoder,
    Device, Queue, RenderPass, RenderPipeline, Sampler, ShaderStages, TextureFormat, TextureUsages,
    TextureView,
};

/// Edge of a tile, px, as in the shader.
const TILE_PX: u32 = 16;
/// How wide patches are in a tile: a share of the largest.
const REACH: TextureFormat = TextureFormat::R8Unorm;

/// What the shader is told.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct FocusUniform {
    /// A and B of distance = B / (A − depth), distance of the plane in focus (mm), half the aperture in pixels of that plane.
    optics: [f32; 4],
}

/// The pass.
pub struct Focus {
    uniform: Buffer,
    layout: BindGroupLayout,
    sampler: Sampler,
    tile: RenderPipeline,
    reach: RenderPipeline,
    spread: RenderPipeline,
}

/// What the pass needs beside a target.
pub struct Tiles {
    views: [TextureView; 2],
    /// For the first pass, which reads no tiles, the second and the last.
    groups: [BindGroup; 3],
}

impl Focus {
    /// Makes the pipelines.
    pub fn new(device: &Device) -> Self {
        let layout = layout(device);
        let groups = [&layout];
        let plan = |fragment, format| PipelinePlan {
            fragment: Some(fragment),
            strip: true,
            format,
            ..PipelinePlan::new("focus", "vs_main", &groups)
        };
        Self {
            tile: pipeline(device, &plan("fs_tile", REACH)),
            reach: pipeline(device, &plan("fs_reach", REACH)),
            spread: pipeline(device, &plan("fs_main", super::COLOUR)),
            uniform: device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("focus"),
                size: size_of::<FocusUniform>() as u64,
                usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..wgpu::SamplerDescriptor::default()
            }),
            layout,
        }
    }

    /// Room for the tiles of a target of `size_px`, both channels.
    pub fn tiles(&self, device: &Device, fine: &Fine, size_px: [u32; 2]) -> Tiles {
        let [width, height] = size_px.map(|n| n.div_ceil(TILE_PX));
        let views = [0, 1].map(|_| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("focus tiles"),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: REACH,
                usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        });
        // The first pass writes tiles 0 and reads none of them; tiles 1 stand in.
        let groups = [1, 0, 1].map(|i: usize| self.group(device, fine, &views[i]));
        Tiles { views, groups }
    }

    fn group(&self, device: &Device, fine: &Fine, tiles: &TextureView) -> BindGroup {
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("focus"),
            layout: &self.layout,
            entries: &[
                entry(0, self.uniform.as_entire_binding()),
                entry(1, wgpu::BindingResource::TextureView(&fine.drawn)),
                entry(2, wgpu::BindingResource::TextureView(&fine.depth)),
                entry(3, wgpu::BindingResource::Sampler(&self.sampler)),
                entry(4, wgpu::BindingResource::TextureView(tiles)),
            ],
        })
    }

    /// Takes in what is in focus, and what a millimetre of its plane is on the picture, px.
    pub fn set(&self, queue: &Queue, plane: &FocusPlane, px_per_mm: f64) {
        let [a, b] = plane.distance_of_depth;
        let half = 0.5 * plane.aperture_mm * px_per_mm;
        let uniform = FocusUniform { optics: [a, b, plane.distance_mm, half].map(|x| x as f32) };
        queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
    }

    /// Finds how far patches reach.
    pub fn find_reach(&self, encoder: &mut CommandEncoder, tiles: &Tiles) {
        for (i, pipeline) in [&self.tile, &self.reach].into_iter().enumerate() {
            let mut pass = begin(encoder, &tiles.views[i], "focus tiles", None);
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &tiles.groups[i], &[]);
            pass.draw(0..3, 0..1);
        }
    }

    /// Draws the picture, spread, into the pass that is begun.
    pub fn draw(&self, pass: &mut RenderPass<'_>, tiles: &Tiles) {
        pass.set_pipeline(&self.spread);
        pass.set_bind_group(0, &tiles.groups[2], &[]);
        pass.draw(0..3, 0..1);
    }
}

/// A pass that writes every pixel of `view`.
pub fn begin<'a>(
    encoder: &'a mut CommandEncoder,
    view: &TextureView,
    label: &str,
    timestamp_writes: Option<wgpu::RenderPassTimestampWrites<'_>>,
) -> RenderPass<'a> {
    let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store };
    let attachment = wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops };
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: &[Some(attachment)],
        timestamp_writes,
        ..wgpu::RenderPassDescriptor::default()
    })
}

fn layout(device: &Device) -> BindGroupLayout {
    let entry =
        |binding, ty| BindGroupLayoutEntry { binding, visibility: ShaderStages::FRAGMENT, ty, count: None };
    let texture = |filterable, multisampled| BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled,
    };
    let uniform = BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("focus"),
        entries: &[
            entry(0, uniform),
            entry(1, texture(true, false)),
            entry(2, texture(false, true)),
            entry(3, BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
            entry(4, texture(true, false)),
        ],
    })
}
