//! The passes, one file each beside its shader, and what they share: bindings and pipelines.

pub mod bodies;
pub mod dose;
pub mod focus;
pub mod fundus;
pub mod haze;
pub mod instruments;
pub mod marks;
pub mod membrane;
pub mod retina;
pub mod shadow;
pub mod text;

use crate::governor::Shading;
use crate::layout::{FrameUniform, VERTEX_STRIDE, ViewUniform};
use std::num::NonZeroU64;
use wgpu::{
    BindGroup, BindGroupLayout, BindGroupLayoutEntry, BindingType, BlendState, Buffer, BufferUsages,
    ColorWrites, CompareFunction, Device, FilterMode, RenderPipeline, ShaderStages, Texture, TextureFormat,
    TextureUsages, TextureViewDimension,
};

/// Format of the pictures: square roots of linear light, 8 bits.
pub const COLOUR: TextureFormat = TextureFormat::Rgba8Unorm;
/// Format of the depth of pictures and shadow maps.
pub const DEPTH: TextureFormat = TextureFormat::Depth32Float;
/// Distance of the channels' uniforms in their buffer, bytes.
pub const VIEW_STRIDE: u32 = 256;

const COMMON: &str = include_str!("passes/common.wgsl");
const PLACE: &str = include_str!("passes/place.wgsl");
const QUAD: &str = include_str!("passes/quad.wgsl");

/// Whole text of every shader, by name, for the device and for the validation test.
pub fn shader_sources() -> [(&'static str, String); 12] {
    [
        ("shadow", [COMMON, PLACE, include_str!("passes/shadow.wgsl")].concat()),
        ("fundus", [COMMON, include_str!("passes/fundus.wgsl")].concat()),
        ("instruments", [COMMON, PLACE, include_str!("passes/instruments.wgsl")].concat()),
        ("membrane", [COMMON, include_str!("passes/membrane.wgsl")].concat()),
        ("retina", [COMMON, include_str!("passes/retina.wgsl")].concat()),
        ("bodies", [COMMON, include_str!("passes/bodies.wgsl")].concat()),
        ("marks", [COMMON, include_str!("passes/marks.wgsl")].concat()),
        ("haze", [COMMON, include_str!("passes/fundus.wgsl"), include_str!("passes/haze.wgsl")].concat()),
        ("dose", [COMMON, include_str!("passes/fundus.wgsl"), include_str!("passes/dose.wgsl")].concat()),
        ("focus", include_str!("passes/focus.wgsl").to_owned()),
        ("text", include_str!("passes/text.wgsl").to_owned()),
        ("blit", [QUAD, include_str!("present/blit.wgsl")].concat()),
    ]
}

/// The shader called `name`.
///
/// # Panics
/// If there is none of that name.
pub fn shader(device: &Device, name: &str) -> wgpu::ShaderModule {
    let (label, text) =
        shader_sources().into_iter().find(|(n, _)| *n == name).expect("a shader of this crate");
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(text.into()),
    })
}

/// A texture that one pass draws into and a later one samples.
pub fn drawn_and_read(
    device: &Device,
    label: &str,
    format: TextureFormat,
    [width, height]: [u32; 2],
) -> Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })
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
        let buffer = |label, size| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let frame = buffer("frame", size_of::<FrameUniform>() as u64);
        let views = buffer("views", 2 * u64::from(VIEW_STRIDE));
        let entry = |binding, size, has_dynamic_offset| BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::VERTEX_FRAGMENT,
            ty: BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset,
                min_binding_size: NonZeroU64::new(size),
            },
            count: None,
        };
        let view_size = size_of::<ViewUniform>() as u64;
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("uniforms"),
            entries: &[entry(0, size_of::<FrameUniform>() as u64, false), entry(1, view_size, true)],
        });
        let one_view = wgpu::BufferBinding { buffer: &views, offset: 0, size: NonZeroU64::new(view_size) };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("uniforms"),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Buffer(one_view) },
            ],
        });
        Self { frame, views, layout, group }
    }
}

/// Bindings of a texture of floats and its sampler, for a pass of its own.
pub fn sampled_layout(device: &Device, label: &str, view_dimension: TextureViewDimension) -> BindGroupLayout {
    let entry = |binding, ty| {
        let visibility = ShaderStages::VERTEX_FRAGMENT;
        BindGroupLayoutEntry { binding, visibility, ty, count: None }
    };
    let sample_type = wgpu::TextureSampleType::Float { filterable: true };
    let texture = BindingType::Texture { sample_type, view_dimension, multisampled: false };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(label),
        entries: &[entry(0, texture), entry(1, BindingType::Sampler(wgpu::SamplerBindingType::Filtering))],
    })
}

/// A texture and its sampler in a layout of [`sampled_layout`]; minified texels are averaged,
/// magnified ones filtered by `mag_filter`.
pub fn sampled_group(
    device: &Device,
    label: &str,
    layout: &BindGroupLayout,
    texture: &Texture,
    mag_filter: FilterMode,
) -> BindGroup {
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
        mag_filter,
        min_filter: FilterMode::Linear,
        ..wgpu::SamplerDescriptor::default()
    });
    device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(label),
        layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&view) },
            wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&sampler) },
        ],
    })
}

/// The settings in which pipelines of this crate differ.
#[derive(Debug, Clone, Copy)]
pub struct PipelineSpec<'a> {
    /// Name of the shader.
    pub shader: &'a str,
    /// Entry points; without a fragment stage only depth is written.
    pub vertex: &'a str,
    /// Fragment entry point.
    pub fragment: Option<&'a str>,
    /// Groups.
    pub groups: &'a [&'a BindGroupLayout],
    /// True if it takes vertices from a buffer.
    pub vertices: bool,
    /// Drawn as a strip of triangles.
    pub strip: bool,
    /// Closed bodies: back faces are culled.
    pub closed: bool,
    /// Depth: test and write.
    pub depth: Option<(CompareFunction, bool)>,
    /// Blending of the picture.
    pub blend: Option<BlendState>,
    /// Channels of the picture that are written.
    pub writes: ColorWrites,
    /// A buffer of instances: bytes of one, and its attributes.
    pub instances: Option<(u64, &'a [wgpu::VertexAttribute])>,
    /// For shaders that serve both: which.
    pub shading: Shading,
    /// Samples of a pixel of the picture.
    pub samples: u32,
    /// Format of the picture.
    pub format: TextureFormat,
}

impl<'a> PipelineSpec<'a> {
    /// An opaque list of triangles without buffers, tested against nothing.
    pub fn new(shader: &'a str, vertex: &'a str, groups: &'a [&'a BindGroupLayout]) -> Self {
        Self {
            shader,
            vertex,
            fragment: None,
            groups,
            vertices: false,
            strip: false,
            closed: false,
            depth: None,
            blend: None,
            writes: ColorWrites::ALL,
            instances: None,
            shading: Shading::Full,
            samples: 1,
            format: COLOUR,
        }
    }

    /// For the picture of a tier with this shading.
    pub fn shaded(self, shading: Shading) -> Self {
        Self { shading, samples: shading.samples(), ..self }
    }
}

/// Position, normal and two numbers, as in [`crate::layout`].
const ATTRIBUTES: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32, 3 => Float32];

/// Depth state of overlays: lean tiers draw them in the pass of the picture, full tiers after it,
/// without a depth attachment.
pub fn over_everything(shading: Shading) -> Option<(CompareFunction, bool)> {
    (shading == Shading::Lean).then_some((CompareFunction::Always, false))
}

/// Makes a pipeline.
pub fn pipeline(device: &Device, spec: &PipelineSpec<'_>) -> RenderPipeline {
    let module = shader(device, spec.shader);
    let constants = [("LEAN", 1.0)];
    let constants: &[(&str, f64)] = if spec.shading == Shading::Lean { &constants } else { &[] };
    let options = wgpu::PipelineCompilationOptions { constants, ..Default::default() };
    let groups: Vec<_> = spec.groups.iter().map(|&g| Some(g)).collect();
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(spec.shader),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    let buffer = |array_stride, step_mode, attributes| {
        Some(wgpu::VertexBufferLayout { array_stride, step_mode, attributes })
    };
    let mut buffers = Vec::new();
    if spec.vertices {
        buffers.push(buffer(VERTEX_STRIDE, wgpu::VertexStepMode::Vertex, &ATTRIBUTES[..]));
    }
    if let Some((stride, attributes)) = spec.instances {
        buffers.push(buffer(stride, wgpu::VertexStepMode::Instance, attributes));
    }
    let target =
        [Some(wgpu::ColorTargetState { format: spec.format, blend: spec.blend, write_mask: spec.writes })];
    let topology = if spec.strip {
        wgpu::PrimitiveTopology::TriangleStrip
    } else {
        wgpu::PrimitiveTopology::TriangleList
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(spec.shader),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(spec.vertex),
            compilation_options: options.clone(),
            buffers: &buffers,
        },
        primitive: wgpu::PrimitiveState {
            topology,
            cull_mode: spec.closed.then_some(wgpu::Face::Back),
            ..wgpu::PrimitiveState::default()
        },
        depth_stencil: spec.depth.map(|(compare, write)| wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(write),
            depth_compare: Some(compare),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState { count: spec.samples, ..wgpu::MultisampleState::default() },
        fragment: spec.fragment.map(|entry| wgpu::FragmentState {
            module: &module,
            entry_point: Some(entry),
            compilation_options: options.clone(),
            targets: &target,
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A buffer of vertices or indices with room for `size` bytes.
pub fn geometry_buffer(device: &Device, label: &str, size: usize, usage: BufferUsages) -> Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: (size.max(4) as u64).next_multiple_of(4),
        usage: usage | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// A depth attachment that is cleared first and stored where `keep`.
pub fn clear_depth(view: &wgpu::TextureView, keep: bool) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    let store = if keep { wgpu::StoreOp::Store } else { wgpu::StoreOp::Discard };
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store }),
        stencil_ops: None,
    }
}
