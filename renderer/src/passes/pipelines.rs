//! Pipelines of the passes: each shader is compiled once for all of its pipelines, and nothing for a
//! shading that no tier has, because a renderer that starts is waited for.

use super::{COLOUR, DEPTH, shader_sources};
use crate::governor::{Shading, TIERS};
use crate::layout::{TissueHome, VERTEX_STRIDE};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Deref;
use wgpu::{
    BindGroupLayout, BlendState, ColorWrites, CompareFunction, Device, RenderPipeline, ShaderModule,
    TextureFormat,
};

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
    /// True if a second buffer says where the vertices lay at the start.
    pub homes: bool,
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
    /// Format of the picture; `None` where only depth is written.
    pub format: Option<TextureFormat>,
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
            homes: false,
            strip: false,
            closed: false,
            depth: None,
            blend: None,
            writes: ColorWrites::ALL,
            instances: None,
            shading: Shading::Full,
            samples: 1,
            format: Some(COLOUR),
        }
    }

    /// For the picture of a tier with this shading.
    pub fn shaded(self, shading: Shading) -> Self {
        Self { shading, samples: shading.samples(), ..self }
    }

    /// As [`Self::shaded`], for shaders with entry points of their own for each shading.
    pub fn shaded_apart(self, shading: Shading) -> Self {
        let (vertex, fragment) = match shading {
            Shading::Full => ("vs_main", "fs_main"),
            Shading::Lean => ("vs_lean", "fs_lean"),
        };
        Self { vertex, fragment: Some(fragment), ..self.shaded(shading) }
    }
}

/// Position, normal and two numbers, as in [`crate::layout`].
const ATTRIBUTES: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32, 3 => Float32];

/// Place in the map and way to the edge.
const HOME_ATTRIBUTES: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![4 => Float32x3];

/// The device, with the shaders that are compiled already.
pub struct PassDevice<'a> {
    device: &'a Device,
    /// Whether tiers of full shading are drawn.
    full: bool,
    modules: RefCell<BTreeMap<String, ShaderModule>>,
}

impl Deref for PassDevice<'_> {
    type Target = Device;

    fn deref(&self) -> &Device {
        self.device
    }
}

impl PipelineSpec<'_> {
    /// Its vertex buffers, in the order of their slots.
    fn buffers(&self) -> Vec<Option<wgpu::VertexBufferLayout<'_>>> {
        let buffer = |array_stride, step_mode, attributes| {
            Some(wgpu::VertexBufferLayout { array_stride, step_mode, attributes })
        };
        let mut buffers = Vec::new();
        if self.vertices {
            buffers.push(buffer(VERTEX_STRIDE, wgpu::VertexStepMode::Vertex, &ATTRIBUTES[..]));
        }
        if self.homes {
            let stride = size_of::<TissueHome>() as u64;
            buffers.push(buffer(stride, wgpu::VertexStepMode::Vertex, &HOME_ATTRIBUTES[..]));
        }
        if let Some((stride, attributes)) = self.instances {
            buffers.push(buffer(stride, wgpu::VertexStepMode::Instance, attributes));
        }
        buffers
    }
}

/// Depth that is compared so, and written where `write` is set.
fn depth_state(compare: CompareFunction, write: bool) -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        format: DEPTH,
        depth_write_enabled: Some(write),
        depth_compare: Some(compare),
        stencil: wgpu::StencilState::default(),
        bias: wgpu::DepthBiasState::default(),
    }
}

impl<'a> PassDevice<'a> {
    /// For tiers from `first_tier` on.
    pub fn new(device: &'a Device, first_tier: usize) -> Self {
        let full = TIERS[first_tier..].iter().any(|tier| tier.shading == Shading::Full);
        PassDevice { device, full, modules: RefCell::default() }
    }

    /// Makes what only full shading needs.
    pub fn for_full<T>(&self, make: impl FnOnce() -> T) -> Option<T> {
        self.full.then(make)
    }

    /// Makes something for each shading. Where no tier has full shading, nothing is made for it: the
    /// lean one stands in its place.
    pub fn shadings<T: Clone>(&self, make: impl Fn(Shading) -> T) -> [T; 2] {
        let lean = make(Shading::Lean);
        let full = self.for_full(|| make(Shading::Full)).unwrap_or_else(|| lean.clone());
        Shading::ALL.map(|shading| if shading == Shading::Full { full.clone() } else { lean.clone() })
    }

    /// The pipelines of a pass that draws into the picture, for each shading.
    pub fn pipelines(&self, spec: &PipelineSpec<'_>) -> [RenderPipeline; 2] {
        self.shadings(|shading| self.pipeline(&spec.shaded(shading)))
    }

    /// The pipelines of an overlay: lean tiers draw it in the pass of the picture, full tiers after it,
    /// without a depth attachment.
    pub fn overlay_pipelines(&self, spec: &PipelineSpec<'_>) -> [RenderPipeline; 2] {
        let always = (CompareFunction::Always, false);
        let depth = |shading| (shading == Shading::Lean).then_some(always);
        self.shadings(|shading| self.pipeline(&PipelineSpec { depth: depth(shading), ..*spec }))
    }

    /// Makes a pipeline.
    pub fn pipeline(&self, spec: &PipelineSpec<'_>) -> RenderPipeline {
        let (device, module) = (self.device, self.module(spec.shader));
        let constants = [("LEAN", 1.0)];
        let constants: &[(&str, f64)] = if spec.shading == Shading::Lean { &constants } else { &[] };
        let options = wgpu::PipelineCompilationOptions { constants, ..Default::default() };
        let groups: Vec<_> = spec.groups.iter().map(|&g| Some(g)).collect();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(spec.shader),
            bind_group_layouts: &groups,
            immediate_size: 0,
        });
        let target = spec.format.map(|format| {
            Some(wgpu::ColorTargetState { format, blend: spec.blend, write_mask: spec.writes })
        });
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
                buffers: &spec.buffers(),
            },
            primitive: wgpu::PrimitiveState {
                topology,
                cull_mode: spec.closed.then_some(wgpu::Face::Back),
                ..wgpu::PrimitiveState::default()
            },
            depth_stencil: spec.depth.map(|(compare, write)| depth_state(compare, write)),
            multisample: wgpu::MultisampleState { count: spec.samples, ..wgpu::MultisampleState::default() },
            fragment: spec.fragment.map(|entry| wgpu::FragmentState {
                module: &module,
                entry_point: Some(entry),
                compilation_options: options.clone(),
                targets: target.as_slice(),
            }),
            multiview_mask: None,
            cache: None,
        })
    }

    /// The shader called `name`.
    fn module(&self, name: &str) -> ShaderModule {
        let mut modules = self.modules.borrow_mut();
        modules.entry(name.to_owned()).or_insert_with(|| compiled(self.device, name)).clone()
    }
}

/// Compiles the shader called `name`.
///
/// # Panics
/// If there is none of that name.
fn compiled(device: &Device, name: &str) -> ShaderModule {
    let (label, text) =
        shader_sources().into_iter().find(|(n, _)| *n == name).expect("a shader of this crate");
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(text.into()),
    })
}
