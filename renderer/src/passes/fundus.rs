//! The retina: fundus photograph on the inside of a sphere, lit by the lamp, with its shadows.
//! This module owns group 1, the map and the shadow map, which the other lit passes share.

use super::{PipelinePlan, Uniforms, pipeline};
use crate::fundus_map;
use crate::governor::SHADINGS;
use image::RgbImage;
use protocol::scene_file::Side;
use wgpu::{
    BindGroup, BindGroupLayout, BindGroupLayoutEntry, BindingType, CompareFunction, Device, Queue,
    RenderPass, RenderPipeline, ShaderStages, TextureFormat, TextureUsages, TextureView,
};

/// Corners drawn: 48 triangles, as in the shader.
const CORNERS: u32 = 48 * 3;

/// The pass.
pub struct Fundus {
    pipelines: [RenderPipeline; SHADINGS.len()],
}

impl Fundus {
    /// Makes a pipeline for each shading.
    pub fn new(device: &Device, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let plan = |shading| PipelinePlan {
            shader: "fundus",
            vertex: "vs_main",
            fragment: Some("fs_main"),
            groups: &groups,
            vertices: false,
            strip: false,
            // At the far plane, after the instruments: what they cover is not shaded.
            depth: Some((CompareFunction::LessEqual, false)),
            blend: None,
            shading: Some(shading),
        };
        Self { pipelines: SHADINGS.each_ref().map(|shading| pipeline(device, &plan(shading))) }
    }

    /// Draws into the present viewport; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, shading: usize) {
        pass.set_pipeline(&self.pipelines[shading]);
        pass.draw(0..CORNERS, 0..1);
    }
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

/// Layout of group 1: map and shadow map with their samplers.
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
        ],
    })
}

/// Group 1 for a shadow map.
pub fn light_group(
    device: &Device,
    layout: &BindGroupLayout,
    map: &FundusMap,
    shadow: &TextureView,
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
            entry(2, wgpu::BindingResource::TextureView(shadow)),
            entry(3, wgpu::BindingResource::Sampler(&comparison)),
        ],
    })
}
