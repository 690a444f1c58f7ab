//! The two instruments.

use super::{PipelineSpec, Uniforms, geometry_buffer, pipeline};
use crate::governor::Shading;
use crate::layout::MetalVertex;
use crate::tools::{Mesh, Models, Shaft, TOOLS};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use wgpu::{
    BindGroupLayout, BlendState, Buffer, BufferUsages, CompareFunction, Device, IndexFormat, Queue,
    RenderPass, RenderPipeline,
};

/// Meshes of every tool for each of the two shafts, so that a change of tool costs nothing.
pub struct Meshes {
    vertices: Buffer,
    indices: Buffer,
    /// First index and count, by instrument and tool.
    ranges: [[(u32, u32); TOOLS.len()]; INSTRUMENTS],
}

impl Meshes {
    /// Fits and uploads them.
    pub fn new(device: &Device, queue: &Queue, models: &Models, shafts: &[Shaft; INSTRUMENTS]) -> Self {
        let mut all = Mesh::default();
        let ranges = shafts.map(|shaft| {
            TOOLS.map(|tool| {
                let mesh = models.of(tool).mesh(&shaft);
                let (base, first) = (all.vertices.len() as u32, all.indices.len() as u32);
                all.vertices.extend(&mesh.vertices);
                all.indices.extend(mesh.indices.iter().map(|i| i + base));
                (first, mesh.indices.len() as u32)
            })
        });
        let size = all.vertices.len() * size_of::<MetalVertex>();
        let vertices = geometry_buffer(device, "metal", size, BufferUsages::VERTEX);
        let indices = geometry_buffer(device, "metal", all.indices.len() * 4, BufferUsages::INDEX);
        queue.write_buffer(&vertices, 0, bytemuck::cast_slice(&all.vertices));
        queue.write_buffer(&indices, 0, bytemuck::cast_slice(&all.indices));
        Self { vertices, indices, ranges }
    }

    /// Draws instrument `which` as `tool` with the pipeline that is set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, which: usize, tool: Tool) {
        let Some(index) = TOOLS.iter().position(|&t| t == tool) else { return };
        let (first, count) = self.ranges[which][index];
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_index_buffer(self.indices.slice(..), IndexFormat::Uint32);
        pass.draw_indexed(first..first + count, 0, which as u32..which as u32 + 1);
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
        Self { pipelines: Shading::ALL.map(|shading| pipeline(device, &spec.shaded(shading))) }
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
