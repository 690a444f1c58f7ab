//! Rigid bodies of abstract tasks: spheres, boxes and capsules, which also cast shadows.

use super::{MeshBuffers, PassDevice, PipelineSpec, Uniforms, buffer};
use crate::governor::Shading;
use crate::layout::MetalVertex;
use crate::tools::Mesh;
use protocol::scene::SceneBody;
use std::f32::consts::{FRAC_PI_2, TAU};
use std::ops::Range;
use wgpu::{
    BindGroupLayout, BlendState, Buffer, BufferUsages, ColorWrites, CompareFunction, Queue, RenderPass,
    RenderPipeline,
};

/// Bodies drawn at most.
const MAX_BODIES: usize = 512;
/// Shapes on the wire: sphere, box, capsule.
const SHAPES: usize = 3;
/// Parts of a round shape round its axis, and from the equator to a pole.
const ROUND: [u32; 2] = [20, 6];
const STRIDE: u64 = size_of::<SceneBody>() as u64;
/// Of a [`SceneBody`] as it is: position, rotation, half extents, colour.
const ATTRIBUTES: [wgpu::VertexAttribute; 4] = [
    attribute(4, 0, wgpu::VertexFormat::Float32x3),
    attribute(5, 16, wgpu::VertexFormat::Float32x4),
    attribute(6, 32, wgpu::VertexFormat::Float32x3),
    attribute(7, 48, wgpu::VertexFormat::Float32x4),
];
const _: () = assert!(STRIDE == 64 && std::mem::offset_of!(SceneBody, rgba) == 48);

const fn attribute(shader_location: u32, offset: u64, format: wgpu::VertexFormat) -> wgpu::VertexAttribute {
    wgpu::VertexAttribute { format, offset, shader_location }
}

/// The pass.
pub struct Bodies {
    pipelines: [RenderPipeline; 2],
    casters: [RenderPipeline; 2],
    shapes: MeshBuffers,
    /// Indices of each shape.
    ranges: [Range<u32>; SHAPES],
    instances: Buffer,
    sorted: Vec<SceneBody>,
    counts: [u32; SHAPES],
}

impl Bodies {
    /// Makes pipelines, meshes and room.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let groups = [&uniforms.layout, light];
        let spec = PipelineSpec {
            fragment: Some("fs_main"),
            depth: Some((CompareFunction::Less, true)),
            blend: Some(BlendState::ALPHA_BLENDING),
            ..bodies_spec("vs_main", &groups)
        };
        let mut all = Mesh::default();
        let ranges = [round_mesh(0.0), box_mesh(), round_mesh(1.0)].map(|mesh| all.append(mesh));
        Self {
            pipelines: device.pipelines(&spec),
            casters: casters(device, uniforms),
            shapes: MeshBuffers::new(device, "shapes", &all),
            ranges,
            instances: buffer(device, "bodies", MAX_BODIES * STRIDE as usize, BufferUsages::VERTEX),
            sorted: Vec::with_capacity(MAX_BODIES),
            counts: [0; SHAPES],
        }
    }

    /// Takes the bodies of a scene in, sorted by shape; unknown shapes are not drawn.
    pub fn set(&mut self, queue: &Queue, bodies: &[SceneBody]) {
        self.sorted.clear();
        for shape in 0..SHAPES {
            let before = self.sorted.len();
            let of_shape = bodies.iter().filter(|b| b.shape == shape as u32);
            self.sorted.extend(of_shape.take(MAX_BODIES - before));
            self.counts[shape] = (self.sorted.len() - before) as u32;
        }
        queue.write_buffer(&self.instances, 0, bytemuck::cast_slice(&self.sorted));
    }

    /// Draws; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        self.draw_with(pass, &self.pipelines[shading as usize]);
    }

    /// Draws into the shadow map; group 0 is set.
    pub fn cast(&self, pass: &mut RenderPass<'_>, shading: Shading) {
        self.draw_with(pass, &self.casters[shading as usize]);
    }

    fn draw_with(&self, pass: &mut RenderPass<'_>, pipeline: &RenderPipeline) {
        if self.sorted.is_empty() {
            return;
        }
        pass.set_pipeline(pipeline);
        self.shapes.bind(pass);
        pass.set_vertex_buffer(1, self.instances.slice(..));
        let mut first = 0;
        for (range, &count) in self.ranges.iter().zip(&self.counts) {
            if count > 0 {
                pass.draw_indexed(range.clone(), 0, first..first + count);
            }
            first += count;
        }
    }
}

/// Bodies may be translucent: then their backs are seen too.
fn bodies_spec<'a>(vertex: &'a str, groups: &'a [&'a BindGroupLayout]) -> PipelineSpec<'a> {
    let instances = Some((STRIDE, &ATTRIBUTES[..]));
    PipelineSpec { vertices: true, instances, ..PipelineSpec::new("bodies", vertex, groups) }
}

/// Depth for full tiers, the mask for lean ones.
fn casters(device: &PassDevice<'_>, uniforms: &Uniforms) -> [RenderPipeline; 2] {
    let groups = [&uniforms.layout];
    let spec = PipelineSpec { closed: true, ..bodies_spec("vs_shadow", &groups) };
    let depth = PipelineSpec { depth: Some((CompareFunction::Less, true)), ..spec };
    let writes = ColorWrites::RED | ColorWrites::GREEN;
    let mask = PipelineSpec { fragment: Some("fs_solid"), writes, ..spec };
    [device.pipeline(&depth), device.pipeline(&mask)]
}

/// A unit sphere; `cap` marks its halves for capsules, each with an equator of its own.
fn round_mesh(cap: f32) -> Mesh {
    let [around, up] = ROUND;
    let mut mesh = Mesh::default();
    for half in [-1.0f32, 1.0] {
        let first = mesh.vertices.len() as u32;
        for (i, k) in (0..=up).flat_map(|i| (0..around).map(move |k| (i, k))) {
            let (sin, cos) = (i as f32 / up as f32 * FRAC_PI_2).sin_cos();
            let (y, x) = (k as f32 / around as f32 * TAU).sin_cos();
            let n = [cos * x, cos * y, half * sin];
            mesh.vertices.push(MetalVertex { position: n, normal: n, part: cap * half, material: 0.0 });
        }
        let at = |i: u32, k: u32| first + i * around + k % around;
        for (i, k) in (0..up).flat_map(|i| (0..around).map(move |k| (i, k))) {
            mesh.quad([at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)], half < 0.0);
        }
    }
    if cap != 0.0 {
        // The straight part, between the two equators.
        let second = (up + 1) * around;
        for k in 0..around {
            let next = (k + 1) % around;
            mesh.quad([k, next, second + next, second + k], false);
        }
    }
    mesh
}

/// The box from −1 to 1, its corners once for each face.
fn box_mesh() -> Mesh {
    let mut mesh = Mesh::default();
    for (axis, side) in (0..3).flat_map(|axis| [(axis, -1.0f32), (axis, 1.0)]) {
        let first = mesh.vertices.len() as u32;
        for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let (mut position, mut normal) = ([0.0; 3], [0.0; 3]);
            (position[axis], position[(axis + 1) % 3], position[(axis + 2) % 3]) = (side, u, v);
            normal[axis] = side;
            mesh.vertices.push(MetalVertex { position, normal, part: 0.0, material: 0.0 });
        }
        mesh.quad([first, first + 1, first + 2, first + 3], side < 0.0);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use std::f32::consts::PI;

    #[test]
    fn shapes_are_turned_outwards_and_have_their_volume() {
        let ball = 4.0 / 3.0 * PI;
        // A capsule with a straight part of length 1.
        for (mesh, volume) in [(round_mesh(0.0), ball), (box_mesh(), 8.0), (round_mesh(1.0), ball + PI)] {
            let place = |i: u32| {
                let v = &mesh.vertices[i as usize];
                Vec3::from(v.position) + Vec3::Z * (v.part * 0.5)
            };
            let mut sum = 0.0;
            for t in mesh.indices.chunks(3) {
                let p = [0, 1, 2].map(|i| place(t[i]));
                let normal = Vec3::from(mesh.vertices[t[0] as usize].normal);
                let face = (p[1] - p[0]).cross(p[2] - p[0]);
                assert!(face.length() < 1e-6 || face.dot(normal) > 0.0);
                sum += p[0].dot(p[1].cross(p[2])) / 6.0;
            }
            assert!((sum / volume - 1.0).abs() < 0.05, "{sum} for {volume}");
        }
    }
}
