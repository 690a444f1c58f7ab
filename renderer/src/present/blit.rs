//! Copies a finished picture onto a surface, as large as fits, its channels arranged.

use crate::gpu::Gpu;
use crate::passes::shader;
use crate::stereo::Arrangement;
use crate::target::Target;
use bytemuck::{Pod, Zeroable};
use wgpu::{BindGroupLayout, Buffer, BufferUsages, RenderPipeline, Sampler, ShaderStages, TextureView};

/// Uniform of the shader.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct BlitUniform {
    arrangement: u32,
    channel: u32,
    padding: [u32; 2],
}

/// The pass.
pub struct Blit {
    layout: BindGroupLayout,
    pipeline: RenderPipeline,
    sampler: Sampler,
    uniform: Buffer,
}

impl Blit {
    /// For surfaces of `format`.
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let layout = layout(device);
        let pipeline = pipeline(device, &layout, format);
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        let uniform = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("blit"),
            size: size_of::<BlitUniform>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self { layout, pipeline, sampler, uniform }
    }

    /// Draws `target` into the middle of `surface` of `size_px`; `channel` is the one whose turn it
    /// is where they alternate.
    pub fn draw(
        &self,
        gpu: &Gpu,
        target: &Target,
        surface: &TextureView,
        size_px: [u32; 2],
        arrangement: Arrangement,
        channel: u32,
    ) {
        let uniform = BlitUniform { arrangement: arrangement as u32, channel, padding: [0; 2] };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
        let group = self.group(gpu, target);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let ops =
            wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store };
        let attachment =
            wgpu::RenderPassColorAttachment { view: surface, depth_slice: None, resolve_target: None, ops };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("blit"),
            color_attachments: &[Some(attachment)],
            ..wgpu::RenderPassDescriptor::default()
        });
        let [x, y, w, h] = fit(arrangement.size_px(target.width_px, target.height_px), size_px);
        pass.set_viewport(x, y, w, h, 0.0, 1.0);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..4, 0..1);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
    }

    fn group(&self, gpu: &Gpu, target: &Target) -> wgpu::BindGroup {
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("blit"),
            layout: &self.layout,
            entries: &[
                entry(0, wgpu::BindingResource::TextureView(&target.colour)),
                entry(1, wgpu::BindingResource::Sampler(&self.sampler)),
                entry(2, self.uniform.as_entire_binding()),
            ],
        })
    }
}

/// Rectangle (x, y, width, height) of a picture in the middle of a window, its shape kept.
fn fit(picture: [u32; 2], window: [u32; 2]) -> [f32; 4] {
    let [pw, ph, ww, wh] = [picture[0], picture[1], window[0], window[1]].map(|n| n.max(1) as f32);
    let scale = (ww / pw).min(wh / ph);
    let (w, h) = ((pw * scale).min(ww), (ph * scale).min(wh));
    [0.5 * (ww - w), 0.5 * (wh - h), w, h]
}

fn layout(device: &wgpu::Device) -> BindGroupLayout {
    let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: ShaderStages::FRAGMENT,
        ty,
        count: None,
    };
    let texture = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let uniform = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("blit"),
        entries: &[
            entry(0, texture),
            entry(1, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
            entry(2, uniform),
        ],
    })
}

fn pipeline(device: &wgpu::Device, layout: &BindGroupLayout, format: wgpu::TextureFormat) -> RenderPipeline {
    let module = shader(device, "blit");
    let groups = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("blit"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    let entry = if format.is_srgb() { "fs_linear" } else { "fs_main" };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("blit"),
        layout: Some(&groups),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vs_main"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState {
            topology: wgpu::PrimitiveTopology::TriangleStrip,
            ..wgpu::PrimitiveState::default()
        },
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_keep_their_shape() {
        assert_eq!(fit([640, 256], [1280, 512]), [0.0, 0.0, 1280.0, 512.0]);
        assert_eq!(fit([640, 256], [640, 512]), [0.0, 128.0, 640.0, 256.0]);
        assert_eq!(fit([640, 256], [0, 0])[2..], [1.0, 0.4]);
    }
}
