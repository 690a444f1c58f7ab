//! The two instruments.

use super::{MeshBuffers, PassDevice, PipelineSpec, Uniforms};
use crate::governor::Shading;
use crate::tools::{Mesh, Models, Shaft, TOOLS, angular, outline};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use std::ops::Range;
use wgpu::{BindGroupLayout, BlendState, CompareFunction, Device, RenderPass, RenderPipeline};

/// Meshes of every tool for each of the two shafts, so that a change of tool costs nothing.
pub struct Meshes {
    buffers: MeshBuffers,
    /// Indices, by instrument and tool.
    ranges: [[Range<u32>; TOOLS.len()]; INSTRUMENTS],
    /// The same of the strips along their edges.
    edges: [[Range<u32>; TOOLS.len()]; INSTRUMENTS],
    /// The same of the parts that are not round.
    angular: [[Range<u32>; TOOLS.len()]; INSTRUMENTS],
}

impl Meshes {
    /// Fits and uploads them.
    pub fn new(device: &Device, models: &Models, shafts: &[Shaft; INSTRUMENTS]) -> Self {
        let mut all = Mesh::default();
        let ranges = shafts.map(|shaft| TOOLS.map(|tool| all.append(models.of(tool).mesh(&shaft))));
        let edges = shafts.map(|shaft| TOOLS.map(|tool| all.append(outline(models.of(tool), tool, &shaft))));
        let angular = shafts.map(|shaft| TOOLS.map(|tool| all.append(angular(models.of(tool), &shaft))));
        Self { buffers: MeshBuffers::new(device, "metal", &all), ranges, edges, angular }
    }

    /// Draws instrument `which` as `tool` with the pipeline that is set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, which: usize, tool: Tool) {
        self.draw_of(&self.ranges, pass, which, tool);
    }

    /// Draws the strips along its edges with the pipeline that is set.
    pub fn draw_edges(&self, pass: &mut RenderPass<'_>, which: usize, tool: Tool) {
        self.draw_of(&self.edges, pass, which, tool);
    }

    /// Draws the parts that are not round with the pipeline that is set.
    pub fn draw_angular(&self, pass: &mut RenderPass<'_>, which: usize, tool: Tool) {
        self.draw_of(&self.angular, pass, which, tool);
    }

    fn draw_of(
        &self,
        ranges: &[[Range<u32>; TOOLS.len()]; INSTRUMENTS],
        pass: &mut RenderPass<'_>,
        which: usize,
        tool: Tool,
    ) {
        let Some(index) = TOOLS.iter().position(|&t| t == tool) else { return };
        let range = ranges[which][index].clone();
        if range.is_empty() {
            return;
        }
        self.buffers.bind(pass);
        pass.draw_indexed(range, 0, which as u32..which as u32 + 1);
    }
}

/// The pass.
pub struct Instruments {
    pipelines: [RenderPipeline; 2],
    /// Of the smoothed edges, which full shading has by its samples.
    edges: RenderPipeline,
}

impl Instruments {
    /// Makes a pipeline for each shading. Blending serves instruments that fade because they are
    /// lost; a faded one is drawn after the retina, a solid one before it.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = PipelineSpec {
            fragment: Some("fs_main"),
            vertices: true,
            closed: true,
            depth: Some((CompareFunction::Less, true)),
            blend: Some(BlendState::ALPHA_BLENDING),
            ..PipelineSpec::new("instruments", "vs_main", &groups)
        };
        let edges = PipelineSpec {
            vertex: "vs_edge",
            fragment: Some("fs_edge"),
            closed: false,
            depth: Some((CompareFunction::Less, false)),
            ..spec
        };
        let edges = device.pipeline(&edges.shaded(Shading::Lean));
        Self { pipelines: device.pipelines(&spec), edges }
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

    /// Draws the edges of round parts of instrument `which`, over everything behind it; groups 0 and 1
    /// are set.
    pub fn draw_edges(&self, pass: &mut RenderPass<'_>, meshes: &Meshes, which: usize, tool: Tool) {
        pass.set_pipeline(&self.edges);
        meshes.draw_edges(pass, which, tool);
    }
}
