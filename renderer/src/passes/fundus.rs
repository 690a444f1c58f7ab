//! The retina: fundus photograph on the inside of a sphere, lit by the lamp, with its shadows.
//! This module owns group 1, the map and the shadow map, which the other lit passes share.

use super::shadow::ShadowMap;
use super::{
    FILTERED, IndexList, PassDevice, PipelineSpec, SAMPLER, UNFILTERED, Uniforms, bind_group,
    bind_group_layout, sampler, texture_descriptor, texture_type,
};
use crate::fundus_map;
use crate::governor::Shading;
use wgpu::util::{DeviceExt, TextureDataOrder};
use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, BindingType, CompareFunction, Device, FilterMode, Queue,
    RenderPass, RenderPipeline, SamplerBindingType, ShaderStages, TextureDescriptor, TextureFormat,
    TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
};

/// Segments of a ring, as in the shader.
const SEGMENTS: u32 = 48;

/// The pass.
pub struct Fundus {
    retina: [RenderPipeline; 2],
    frames: [RenderPipeline; 2],
    rings: [RenderPipeline; 2],
    ring: IndexList,
}

impl Fundus {
    /// Makes the pipelines and a ring.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = |vertex, fragment| PipelineSpec {
            fragment: Some(fragment),
            depth: Some((CompareFunction::Less, true)),
            ..PipelineSpec::new("fundus", vertex, &groups)
        };
        let ring =
            PipelineSpec { blend: Some(wgpu::BlendState::ALPHA_BLENDING), ..spec("vs_ring", "fs_ring") };
        let frame = PipelineSpec { writes: wgpu::ColorWrites::empty(), ..spec("vs_frame", "fs_ring") };
        Self {
            retina: device
                .shadings(|shading| device.pipeline(&spec("vs_main", "fs_main").shaded_apart(shading))),
            frames: device.pipelines(&frame),
            rings: device.overlay_pipelines(&ring),
            ring: IndexList::new(device, "ring", &ring_triangles()),
        }
    }

    /// Draws into the present viewport; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, cells: &IndexList, shading: Shading) {
        cells.draw(pass, &self.retina[shading as usize]);
    }

    /// Closes everything outside the round field; first in a channel.
    pub fn draw_field_mask(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        self.ring.draw(pass, &self.frames[shading as usize]);
    }

    /// The ring that says that tracking is lost.
    pub fn draw_lost_ring(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        self.ring.draw(pass, &self.rings[shading as usize]);
    }
}

/// Indices of a ring's triangles: inner corners first, then outer ones.
fn ring_triangles() -> Vec<u32> {
    let corners = |a| {
        let b = (a + 1) % SEGMENTS;
        let (c, d) = (SEGMENTS + a, SEGMENTS + b);
        [a, c, d, a, d, b]
    };
    (0..SEGMENTS).flat_map(corners).collect()
}

/// The map of the retina on the device.
pub struct FundusMap {
    /// Each of its mip levels, the finest first.
    levels: Vec<TextureView>,
    /// Edge, px.
    pub size: u32,
}

impl FundusMap {
    /// Uploads a map of `size` pixels, as [`fundus_map::bake`] makes it, with its mip levels.
    pub fn new(device: &Device, queue: &Queue, mut level: Vec<u8>, size: u32) -> Self {
        let mip_level_count = size.ilog2() + 1;
        let mut pixels = level.clone();
        for finer in 0..mip_level_count - 1 {
            level = fundus_map::half(&level, size >> finer);
            pixels.extend_from_slice(&level);
        }
        let (format, usage) = (TextureFormat::Rgba8Unorm, TextureUsages::TEXTURE_BINDING);
        let plain = texture_descriptor("fundus map", format, [size; 2], usage);
        let map = TextureDescriptor { mip_level_count, ..plain };
        let texture = device.create_texture_with_data(queue, &map, TextureDataOrder::LayerMajor, &pixels);
        let one = |base_mip_level| {
            let mip_level_count = Some(1);
            let one = TextureViewDescriptor { base_mip_level, mip_level_count, ..Default::default() };
            texture.create_view(&one)
        };
        Self { levels: (0..mip_level_count).map(one).collect(), size }
    }

    /// Mip level at which a texel is about as large as a pixel of `px_per_mm`, or `coarser` by so many
    /// levels.
    pub fn level(&self, px_per_mm: f32, retina_radius_mm: f32, coarser: usize) -> usize {
        let texels_per_mm = self.size as f32 * fundus_map::map_scale() / retina_radius_mm;
        let level = (texels_per_mm / px_per_mm).log2().round().max(0.0) as usize;
        (level + coarser).min(self.levels.len() - 1)
    }
}

/// Layout of group 1: a level of the map, shadow map with their samplers, shadow mask, the shadow map's depths.
pub fn light_layout(device: &Device) -> BindGroupLayout {
    let texture = |sample_type| texture_type(sample_type, TextureViewDimension::D2);
    let comparison = BindingType::Sampler(SamplerBindingType::Comparison);
    let depth = texture(TextureSampleType::Depth);
    let types = [texture(FILTERED), SAMPLER, depth, comparison, texture(FILTERED), texture(UNFILTERED)];
    bind_group_layout(device, "light", ShaderStages::VERTEX_FRAGMENT, &types)
}

/// Group 1 for a shadow map, one for each level of the map.
pub fn light_groups(
    device: &Device,
    layout: &BindGroupLayout,
    map: &FundusMap,
    shadow: &ShadowMap,
) -> Vec<BindGroup> {
    let linear = sampler(device, FilterMode::Linear);
    let comparison = device.create_sampler(&wgpu::SamplerDescriptor {
        mag_filter: FilterMode::Linear,
        min_filter: FilterMode::Linear,
        compare: Some(CompareFunction::LessEqual),
        ..wgpu::SamplerDescriptor::default()
    });
    let group = |level| {
        let resources = [
            BindingResource::TextureView(level),
            BindingResource::Sampler(&linear),
            BindingResource::TextureView(&shadow.depth),
            BindingResource::Sampler(&comparison),
            BindingResource::TextureView(&shadow.mask),
            BindingResource::TextureView(&shadow.depth),
        ];
        bind_group(device, "light", layout, resources)
    };
    map.levels.iter().map(group).collect()
}
