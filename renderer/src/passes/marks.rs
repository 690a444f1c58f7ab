//! Marks on retina and tissue: bleeding, burns.

use super::{PassDevice, PipelineSpec, Uniforms, buffer};
use crate::governor::Shading;
use protocol::scene::SceneMark;
use wgpu::{
    BindGroupLayout, BlendState, Buffer, BufferUsages, CompareFunction, Queue, RenderPass, RenderPipeline,
};

/// Marks drawn at most; the simulation keeps fewer.
const MAX_MARKS: usize = 1024;
/// Centre, radius, colour: a [`SceneMark`] as it is.
const ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32, 2 => Float32x4];
const _: () = assert!(size_of::<SceneMark>() == 32);

/// The pass.
pub struct Marks {
    pipelines: [RenderPipeline; 2],
    marks: Buffer,
    count: u32,
}

impl Marks {
    /// Makes pipelines and room.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = PipelineSpec {
            fragment: Some("fs_main"),
            strip: true,
            depth: Some((CompareFunction::Less, false)),
            blend: Some(BlendState::ALPHA_BLENDING),
            instances: Some((size_of::<SceneMark>() as u64, &ATTRIBUTES)),
            ..PipelineSpec::new("marks", "vs_main", &groups)
        };
        let marks = buffer(device, "marks", MAX_MARKS * size_of::<SceneMark>(), BufferUsages::VERTEX);
        Self { pipelines: device.pipelines(&spec), marks, count: 0 }
    }

    /// Takes the marks of a scene in.
    pub fn set(&mut self, queue: &Queue, marks: &[SceneMark]) {
        let marks = &marks[..marks.len().min(MAX_MARKS)];
        queue.write_buffer(&self.marks, 0, bytemuck::cast_slice(marks));
        self.count = marks.len() as u32;
    }

    /// Draws; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        if self.count > 0 {
            pass.set_pipeline(&self.pipelines[shading as usize]);
            pass.set_vertex_buffer(0, self.marks.slice(..));
            pass.draw(0..4, 0..self.count);
        }
    }
}
