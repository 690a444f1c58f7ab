//! The retina: fundus photograph on the inside of a sphere, lit by the lamp, with its shadows.
//! This module owns group 1, the map and the shadow map, which the other lit passes share.

use super::shadow::ShadowMap;
use super::{PipelineSpec, Uniforms, geometry_buffer, pipeline};
use crate::cells::Cells;
use crate::fundus_map;
use crate::governor::Shading;
use image::RgbImage;
use scene::Side;
use wgpu::{
    BindGroup, BindGroupLayout, BindGroupLayoutEntry, BindingType, Buffer, BufferUsages, CompareFunction,
    Device, IndexFormat, Queue, RenderPass, RenderPipeline, ShaderStages, TextureFormat, TextureUsages,
    TextureView,
};

/// Segments of a ring, as in the shader.
const SEGMENTS: u32 = 48;

/// The pass.
pub struct Fundus {
    full: RenderPipeline,
    lean: RenderPipeline,
    frames: [RenderPipeline; 2],
    rings: [RenderPipeline; 2],
    ring: Buffer,
}

impl Fundus {
    /// Makes the pipelines and a ring.
    pub fn new(device: &Device, queue: &Queue, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = |vertex, fragment| PipelineSpec {
            fragment: Some(fragment),
            depth: Some((CompareFunction::Less, true)),
            ..PipelineSpec::new("fundus", vertex, &groups)
        };
        let ring =
            PipelineSpec { blend: Some(wgpu::BlendState::ALPHA_BLENDING), ..spec("vs_ring", "fs_ring") };
        let frame = PipelineSpec { writes: wgpu::ColorWrites::empty(), ..spec("vs_frame", "fs_ring") };
        // Over everything; in full tiers over the finished picture.
        let over = |shading| PipelineSpec { depth: super::over_everything(shading), ..ring };
        let triangles = ring_triangles();
        let indices = geometry_buffer(device, "ring", triangles.len() * 4, BufferUsages::INDEX);
        queue.write_buffer(&indices, 0, bytemuck::cast_slice(&triangles));
        Self {
            full: pipeline(device, &spec("vs_main", "fs_main").shaded(Shading::Full)),
            lean: pipeline(device, &spec("vs_lean", "fs_lean").shaded(Shading::Lean)),
            frames: Shading::ALL.map(|shading| pipeline(device, &frame.shaded(shading))),
            rings: Shading::ALL.map(|shading| pipeline(device, &over(shading))),
            ring: indices,
        }
    }

    /// Draws into the present viewport; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, cells: &Cells, shading: Shading) {
        self.draw_with(pass, cells, if shading == Shading::Lean { &self.lean } else { &self.full });
    }

    /// Draws the cells with a pipeline of another pass.
    pub fn draw_with(&self, pass: &mut RenderPass<'_>, cells: &Cells, pipeline: &RenderPipeline) {
        pass.set_pipeline(pipeline);
        pass.set_index_buffer(cells.indices.slice(..), IndexFormat::Uint32);
        pass.draw_indexed(0..cells.count, 0, 0..1);
    }

    /// Closes everything outside the round field; first in a channel.
    pub fn draw_field_mask(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        self.draw_ring(pass, &self.frames[shading as usize]);
    }

    /// The ring that says that tracking is lost.
    pub fn draw_lost_ring(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        self.draw_ring(pass, &self.rings[shading as usize]);
    }

    fn draw_ring(&self, pass: &mut RenderPass<'_>, pipeline: &RenderPipeline) {
        pass.set_pipeline(pipeline);
        pass.set_index_buffer(self.ring.slice(..), IndexFormat::Uint32);
        pass.draw_indexed(0..SEGMENTS * 6, 0, 0..1);
    }
}

/// Indices of a ring's triangles: inner corners first, then outer ones.
fn ring_triangles() -> Vec<u32> {
    let corners = (0..SEGMENTS).flat_map(|segment| {
        let (a, b) = (segment, (segment + 1) % SEGMENTS);
        let (c, d) = (SEGMENTS + a, SEGMENTS + b);
        [a, c, d, a, d, b]
    });
    corners.collect()
}

/// The map of the retina on the device.
pub struct FundusMap {
    view: TextureView,
    /// Edge, px.
    pub size: u32,
}

impl FundusMap {
    /// Bakes and uploads a map of `size` pixels with its mip levels.
    pub fn new(device: &Device, queue: &Queue, photograph: &RgbImage, size: u32, side: Side) -> Self {
        let levels = size.ilog2() + 1;
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("fundus map"),
            size: wgpu::Extent3d { width: size, height: size, depth_or_array_layers: 1 },
            mip_level_count: levels,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::Rgba8Unorm,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let mut pixels = fundus_map::bake(photograph, size, side);
        for level in 0..levels {
            let edge = size >> level;
            let at = wgpu::TexelCopyTextureInfo { mip_level: level, ..texture.as_image_copy() };
            let rows = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(edge * 4),
                rows_per_image: None,
            };
            let extent = wgpu::Extent3d { width: edge, height: edge, depth_or_array_layers: 1 };
            queue.write_texture(at, &pixels, rows, extent);
            if edge > 1 {
                pixels = fundus_map::half(&pixels, edge);
            }
        }
        Self { view: texture.create_view(&wgpu::TextureViewDescriptor::default()), size }
    }

    /// Mip level at which a texel is about as large as a pixel of `px_per_mm`.
    pub fn level(&self, px_per_mm: f32, retina_radius_mm: f32) -> f32 {
        let texels_per_mm = self.size as f32 * fundus_map::map_scale() / retina_radius_mm;
        (texels_per_mm / px_per_mm).log2().round().max(0.0)
    }
}

/// Layout of group 1: map, shadow map with their samplers, shadow mask, the shadow map's depths.
pub fn light_layout(device: &Device) -> BindGroupLayout {
    let entry =
        |binding, ty| BindGroupLayoutEntry { binding, visibility: ShaderStages::FRAGMENT, ty, count: None };
    let texture = |sample_type| BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("light"),
        entries: &[
            entry(0, texture(wgpu::TextureSampleType::Float { filterable: true })),
            entry(1, BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
            entry(2, texture(wgpu::TextureSampleType::Depth)),
            entry(3, BindingType::Sampler(wgpu::SamplerBindingType::Comparison)),
            entry(4, texture(wgpu::TextureSampleType::Float { filterable: true })),
            entry(5, texture(wgpu::TextureSampleType::Float { filterable: false })),
        ],
    })
}

/// Group 1 for a shadow map.
pub fn light_group(
    device: &Device,
    layout: &BindGroupLayout,
    map: &FundusMap,
    shadow: &ShadowMap,
) -> BindGroup {
    let linear = wgpu::SamplerDescriptor {
        label: Some("map"),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..wgpu::SamplerDescriptor::default()
    };
    let compare = wgpu::SamplerDescriptor {
        label: Some("shadow"),
        compare: Some(CompareFunction::LessEqual),
        ..linear.clone()
    };
    let (sampler, comparison) = (device.create_sampler(&linear), device.create_sampler(&compare));
    let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("light"),
        layout,
        entries: &[
            entry(0, wgpu::BindingResource::TextureView(&map.view)),
            entry(1, wgpu::BindingResource::Sampler(&sampler)),
            entry(2, wgpu::BindingResource::TextureView(&shadow.depth)),
            entry(3, wgpu::BindingResource::Sampler(&comparison)),
            entry(4, wgpu::BindingResource::TextureView(&shadow.mask)),
            entry(5, wgpu::BindingResource::TextureView(&shadow.depth)),
        ],
    })
}
