//! The two instruments.

use super::{MeshBuffers, PipelineSpec, Uniforms, pipelines};
use crate::governor::Shading;
use crate::tools::{Mesh, Models, Shaft, TOOLS};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use std::ops::Range;
use wgpu::{BindGroupLayout, BlendState, CompareFunction, Device, RenderPass, RenderPipeline};

/// Meshes of every tool for each of the two shafts, so that a change of tool costs nothing.
pub struct Meshes {
    buffers: MeshBuffers,
    /// Indices, by instrument and tool.
    ranges: [[Range<u32>; TOOLS.len()]; INSTRUMENTS],
}

impl Meshes {
    /// Fits and uploads them.
    pub fn new(device: &Device, models: &Models, shafts: &[Shaft; INSTRUMENTS]) -> Self {
        let mut all = Mesh::default();
        let ranges = shafts.map(|shaft| TOOLS.map(|tool| all.append(models.of(tool).mesh(&shaft))));
        Self { buffers: MeshBuffers::new(device, "metal", &all), ranges }
    }

    /// Draws instrument `which` as `tool` with the pipeline that is set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, which: usize, tool: Tool) {
        let Some(index) = TOOLS.iter().position(|&t| t == tool) else { return };
        self.buffers.bind(pass);
        pass.draw_indexed(self.ranges[which][index].clone(), 0, which as u32..which as u32 + 1);
    }
}

/// The pass.
pub struct Instruments {
    pipelines: [RenderPipeline; 2],
}

impl Instruments {
    /// Makes a pipeline for each shading. Blending serves instruments that fade because they are
    /// lost; a faded one is drawn after the retina, a solid one before it.
    pub fn new(device: &Device, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = PipelineSpec {
            fragment: Some("fs_main"),
            vertices: true,
            closed: true,
            depth: Some((CompareFunction::Less, true)),
            blend: Some(BlendState::ALPHA_BLENDING),
            ..PipelineSpec::new("instruments", "vs_main", &groups)
        };
        Self { pipelines: pipelines(device, &spec) }
    }

    /// Draws instrument `which`; groups 0 and 1 are set.
    pub fn draw(
        &self,
        pass: &mut RenderPass<'_>,
        meshes: &Meshes,
        which: usize,
        tool: Tool,
        shading: Shading,
    ) {
        pass.set_pipeline(&self.pipelines[shading as usize]);
        meshes.draw(pass, which, tool);
    }
}
