//! The passes, one file each beside its shader, and what they share: bindings and pipelines.

pub mod bodies;
pub mod dose;
pub mod focus;
pub mod fundus;
pub mod haze;
pub mod instruments;
pub mod marks;
pub mod membrane;
mod pipelines;
pub mod retina;
pub mod shadow;
pub mod text;

pub use pipelines::{PassDevice, PipelineSpec};

use crate::layout::{FrameUniform, ViewUniform};
use crate::tools::Mesh;
use std::num::NonZeroU64;
use wgpu::util::{BufferInitDescriptor, DeviceExt};
use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, BindingType, Buffer, BufferUsages, Device, FilterMode,
    IndexFormat, RenderPass, RenderPipeline, Sampler, SamplerBindingType, ShaderStages, Texture,
    TextureDescriptor, TextureFormat, TextureSampleType, TextureUsages, TextureView, TextureViewDimension,
};

/// Format of the pictures: square roots of linear light, 8 bits.
pub const COLOUR: TextureFormat = TextureFormat::Rgba8Unorm;
/// Format of the depth of pictures and shadow maps.
pub const DEPTH: TextureFormat = TextureFormat::Depth32Float;
/// Distance of the channels' uniforms in their buffer, bytes.
pub const VIEW_STRIDE: u32 = 256;

const COMMON: &str = include_str!("passes/common.wgsl");
const PLACE: &str = include_str!("passes/place.wgsl");
const CASTER: &str = include_str!("passes/caster.wgsl");
const SHEET: &str = include_str!("passes/sheet.wgsl");
const FUNDUS: &str = include_str!("passes/fundus.wgsl");
const QUAD: &str = include_str!("passes/quad.wgsl");

/// Whole text of every shader, by name, for the device and for the validation test.
pub fn shader_sources() -> [(&'static str, String); 12] {
    [
        ("shadow", [COMMON, PLACE, CASTER, SHEET, include_str!("passes/shadow.wgsl")].concat()),
        ("fundus", [COMMON, FUNDUS].concat()),
        ("instruments", [COMMON, PLACE, include_str!("passes/instruments.wgsl")].concat()),
        ("membrane", [COMMON, SHEET, include_str!("passes/membrane.wgsl")].concat()),
        ("retina", [COMMON, FUNDUS, include_str!("passes/retina.wgsl")].concat()),
        ("bodies", [COMMON, PLACE, CASTER, include_str!("passes/bodies.wgsl")].concat()),
        ("marks", [COMMON, include_str!("passes/marks.wgsl")].concat()),
        ("haze", [COMMON, FUNDUS, include_str!("passes/haze.wgsl")].concat()),
        ("dose", [COMMON, FUNDUS, include_str!("passes/dose.wgsl")].concat()),
        ("focus", include_str!("passes/focus.wgsl").to_owned()),
        ("text", include_str!("passes/text.wgsl").to_owned()),
        ("blit", [QUAD, include_str!("present/blit.wgsl")].concat()),
    ]
}

/// A texture of two dimensions with one level and one sample a pixel.
pub fn texture_descriptor(
    label: &str,
    format: TextureFormat,
    [width, height]: [u32; 2],
    usage: TextureUsages,
) -> TextureDescriptor<'_> {
    TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    }
}

/// All of a texture.
pub fn view(texture: &Texture) -> TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// A texture that one pass draws into and a later one samples.
pub fn drawn_and_read(device: &Device, label: &str, format: TextureFormat, size_px: [u32; 2]) -> TextureView {
    let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
    view(&device.create_texture(&texture_descriptor(label, format, size_px, usage)))
}

/// Group 0 of every pass: the uniforms.
pub struct Uniforms {
    /// [`FrameUniform`].
    pub frame: Buffer,
    /// Two [`ViewUniform`]s, [`VIEW_STRIDE`] apart.
    pub views: Buffer,
    /// Layout of the group; the view has a dynamic offset.
    pub layout: BindGroupLayout,
    /// The group.
    pub group: BindGroup,
}

impl Uniforms {
    /// Makes buffers and group.
    pub fn new(device: &Device) -> Self {
        let frame = buffer(device, "frame", size_of::<FrameUniform>(), BufferUsages::UNIFORM);
        let views = buffer(device, "views", 2 * VIEW_STRIDE as usize, BufferUsages::UNIFORM);
        let uniform = |size, has_dynamic_offset| BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset,
            min_binding_size: size,
        };
        let view_size = NonZeroU64::new(size_of::<ViewUniform>() as u64);
        let types =
            [uniform(NonZeroU64::new(size_of::<FrameUniform>() as u64), false), uniform(view_size, true)];
        let layout = bind_group_layout(device, "uniforms", ShaderStages::VERTEX_FRAGMENT, &types);
        let one_view = wgpu::BufferBinding { buffer: &views, offset: 0, size: view_size };
        let resources = [frame.as_entire_binding(), BindingResource::Buffer(one_view)];
        let group = bind_group(device, "uniforms", &layout, resources);
        Self { frame, views, layout, group }
    }
}

/// A layout in which the bindings 0, 1, … have these types.
pub fn bind_group_layout(
    device: &Device,
    label: &str,
    visibility: ShaderStages,
    types: &[BindingType],
) -> BindGroupLayout {
    let entry = |(binding, &ty)| wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(label),
        entries: &(0..).zip(types).map(entry).collect::<Vec<_>>(),
    })
}

/// A group of such a layout.
pub fn bind_group<const N: usize>(
    device: &Device,
    label: &str,
    layout: &BindGroupLayout,
    resources: [BindingResource<'_>; N],
) -> BindGroup {
    let entry = |(binding, resource)| wgpu::BindGroupEntry { binding, resource };
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(label),
        layout,
        entries: &(0..).zip(resources).map(entry).collect::<Vec<_>>(),
    })
}

/// A uniform buffer, all of it.
pub const UNIFORM: BindingType = BindingType::Buffer {
    ty: wgpu::BufferBindingType::Uniform,
    has_dynamic_offset: false,
    min_binding_size: None,
};
/// Texels that are filtered.
pub const FILTERED: TextureSampleType = TextureSampleType::Float { filterable: true };
/// Texels that are read as they are.
pub const UNFILTERED: TextureSampleType = TextureSampleType::Float { filterable: false };
/// What filters them.
pub const SAMPLER: BindingType = BindingType::Sampler(SamplerBindingType::Filtering);

/// A texture with one sample a pixel.
pub fn texture_type(sample_type: TextureSampleType, view_dimension: TextureViewDimension) -> BindingType {
    BindingType::Texture { sample_type, view_dimension, multisampled: false }
}

/// A sampler that averages minified texels, and filters magnified ones by `mag_filter`.
pub fn sampler(device: &Device, mag_filter: FilterMode) -> Sampler {
    device.create_sampler(&wgpu::SamplerDescriptor {
        mag_filter,
        min_filter: FilterMode::Linear,
        ..wgpu::SamplerDescriptor::default()
    })
}

/// Bindings of a texture of floats and its sampler, for a pass of its own.
pub fn sampled_layout(device: &Device, label: &str, view_dimension: TextureViewDimension) -> BindGroupLayout {
    let types = [texture_type(FILTERED, view_dimension), SAMPLER];
    bind_group_layout(device, label, ShaderStages::VERTEX_FRAGMENT, &types)
}

/// A texture and its sampler in a layout of [`sampled_layout`]; see [`sampler`].
pub fn sampled_group(
    device: &Device,
    label: &str,
    layout: &BindGroupLayout,
    texture: &Texture,
    mag_filter: FilterMode,
) -> BindGroup {
    let (view, sampler) = (view(texture), sampler(device, mag_filter));
    let resources = [BindingResource::TextureView(&view), BindingResource::Sampler(&sampler)];
    bind_group(device, label, layout, resources)
}

/// A buffer with room for `size` bytes, which the queue can write.
pub fn buffer(device: &Device, label: &str, size: usize, usage: BufferUsages) -> Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: (size.max(4) as u64).next_multiple_of(4),
        usage: usage | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// A buffer that never changes.
fn filled_buffer(device: &Device, label: &str, contents: &[u8], usage: BufferUsages) -> Buffer {
    device.create_buffer_init(&BufferInitDescriptor { label: Some(label), contents, usage })
}

/// Triangles whose corners a shader places by their numbers.
pub struct IndexList {
    indices: Buffer,
    count: u32,
}

impl IndexList {
    /// Uploads three indices for each triangle.
    pub fn new(device: &Device, label: &str, indices: &[u32]) -> Self {
        let count = indices.len() as u32;
        let indices = filled_buffer(device, label, bytemuck::cast_slice(indices), BufferUsages::INDEX);
        Self { indices, count }
    }

    /// Draws them.
    pub fn draw(&self, pass: &mut RenderPass<'_>, pipeline: &RenderPipeline) {
        pass.set_pipeline(pipeline);
        pass.set_index_buffer(self.indices.slice(..), IndexFormat::Uint32);
        pass.draw_indexed(0..self.count, 0, 0..1);
    }
}

/// A mesh of [`crate::layout::MetalVertex`].
pub struct MeshBuffers {
    vertices: Buffer,
    indices: Buffer,
}

impl MeshBuffers {
    /// Uploads it.
    pub fn new(device: &Device, label: &str, mesh: &Mesh) -> Self {
        let indices = bytemuck::cast_slice(&mesh.indices);
        Self {
            vertices: filled_buffer(
                device,
                label,
                bytemuck::cast_slice(&mesh.vertices),
                BufferUsages::VERTEX,
            ),
            indices: filled_buffer(device, label, indices, BufferUsages::INDEX),
        }
    }

    /// Takes vertices (buffer 0) and indices from it from now on.
    pub fn bind(&self, pass: &mut RenderPass<'_>) {
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_index_buffer(self.indices.slice(..), IndexFormat::Uint32);
    }
}

/// A colour attachment that is cleared first and stored.
pub fn clear_colour(view: &TextureView, to: wgpu::Color) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(to), store: wgpu::StoreOp::Store };
    Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops })
}

/// A depth attachment that is cleared first and stored where `keep`.
pub fn clear_depth(view: &TextureView, keep: bool) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    let store = if keep { wgpu::StoreOp::Store } else { wgpu::StoreOp::Discard };
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store }),
        stencil_ops: None,
    }
}
