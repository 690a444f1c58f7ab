//! The translucent membrane, and the buffers that it shares with lifted retina.

use super::{PassDevice, PipelineSpec, Uniforms, buffer};
use crate::governor::Shading;
use crate::layout::{TissueHome, TissueVertex};
use std::ops::Range;
use wgpu::{
    BindGroupLayout, BlendState, Buffer, BufferUsages, CompareFunction, Device, IndexFormat, Queue,
    RenderPass, RenderPipeline,
};

/// Vertices and triangles of membrane and retina on the device.
pub struct TissueBuffers {
    vertices: Buffer,
    homes: Buffer,
    indices: Buffer,
    /// Corners of membrane triangles, which come first, of retina, and of retina that is gone.
    corners: [u32; 3],
}

impl TissueBuffers {
    /// With room for `nodes` and `triangles`.
    pub fn new(device: &Device, nodes: usize, triangles: usize) -> Self {
        let vertices = buffer(device, "sheet", nodes * size_of::<TissueVertex>(), BufferUsages::VERTEX);
        let homes = buffer(device, "sheet", nodes * size_of::<TissueHome>(), BufferUsages::VERTEX);
        let indices = buffer(device, "sheet", triangles * 12, BufferUsages::INDEX);
        Self { vertices, homes, indices, corners: [0; 3] }
    }

    /// Makes room where a scene brings more than was foreseen.
    pub fn reserve(&mut self, device: &Device, nodes: usize, triangles: usize) {
        let fits = self.vertices.size() >= (nodes * size_of::<TissueVertex>()) as u64
            && self.indices.size() >= (triangles * 12) as u64;
        if !fits {
            *self = Self::new(device, 2 * nodes, 2 * triangles);
        }
    }

    /// Sets the triangles: those of the membrane, of the retina (both counted), then those of
    /// retina that is gone.
    pub fn set_triangles(&mut self, queue: &Queue, triangles: &[[u32; 3]], [membrane, retina]: [usize; 2]) {
        queue.write_buffer(&self.indices, 0, bytemuck::cast_slice(triangles));
        self.corners = [membrane, retina, triangles.len() - membrane - retina].map(|n| 3 * n as u32);
    }

    /// Sets where the nodes lay at the start.
    pub fn set_homes(&self, queue: &Queue, homes: &[TissueHome]) {
        queue.write_buffer(&self.homes, 0, bytemuck::cast_slice(homes));
    }

    /// Takes the vertices in.
    pub fn set_vertices(&self, queue: &Queue, vertices: &[TissueVertex]) {
        queue.write_buffer(&self.vertices, 0, bytemuck::cast_slice(vertices));
    }

    /// Draws the membrane with the pipeline that is set.
    pub fn draw(&self, pass: &mut RenderPass<'_>) {
        self.draw_range(pass, 0..self.corners[0]);
    }

    /// Draws lifted retina with the pipeline that is set.
    pub fn draw_retina(&self, pass: &mut RenderPass<'_>) {
        self.draw_range(pass, self.corners[0]..self.corners[0] + self.corners[1]);
    }

    /// Draws the places at which retina lay that is lifted, moved or gone, with the pipeline that
    /// is set.
    pub fn draw_bare(&self, pass: &mut RenderPass<'_>) {
        self.draw_range(pass, self.corners[0]..self.corners.iter().sum());
    }

    fn draw_range(&self, pass: &mut RenderPass<'_>, range: Range<u32>) {
        if !range.is_empty() {
            pass.set_vertex_buffer(0, self.vertices.slice(..));
            pass.set_vertex_buffer(1, self.homes.slice(..));
            pass.set_index_buffer(self.indices.slice(..), IndexFormat::Uint32);
            pass.draw_indexed(range, 0, 0..1);
        }
    }
}

/// The pass.
pub struct Membrane {
    pipelines: [RenderPipeline; 2],
    /// None where no tier has full shading.
    depth: Option<RenderPipeline>,
}

impl Membrane {
    /// Makes a pipeline for each shading: both sides, tested against the instruments, blended.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = PipelineSpec {
            fragment: Some("fs_main"),
            vertices: true,
            homes: true,
            depth: Some((CompareFunction::Less, false)),
            blend: Some(BlendState::ALPHA_BLENDING),
            ..PipelineSpec::new("membrane", "vs_main", &groups)
        };
        let depth = PipelineSpec {
            depth: Some((CompareFunction::Less, true)),
            writes: wgpu::ColorWrites::empty(),
            fragment: Some("fs_depth"),
            ..spec
        };
        Self {
            pipelines: device.shadings(|shading| device.pipeline(&spec.shaded_apart(shading))),
            depth: device.for_full(|| device.pipeline(&depth.shaded(Shading::Full))),
        }
    }

    /// Writes the depth of its opaque parts, for the depth of field.
    pub fn draw_depth(&self, pass: &mut RenderPass<'_>, tissue: &TissueBuffers) {
        if let Some(depth) = &self.depth {
            pass.set_pipeline(depth);
            tissue.draw(pass);
        }
    }

    /// Draws; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, tissue: &TissueBuffers, shading: Shading) {
        pass.set_pipeline(&self.pipelines[shading as usize]);
        tissue.draw(pass);
    }
}
