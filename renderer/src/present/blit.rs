//! Copies a finished picture onto a surface, as large as fits, its channels arranged.

use crate::gpu::Gpu;
use crate::passes::{
    FILTERED, PipelineSpec, SAMPLER, UNIFORM, bind_group, bind_group_layout, buffer, clear_colour, pipeline,
    sampler, texture_type,
};
use crate::stereo::Arrangement;
use crate::target::Target;
use bytemuck::{Pod, Zeroable};
use wgpu::{
    BindGroupLayout, BindingResource, Buffer, BufferUsages, FilterMode, RenderPipeline, Sampler,
    ShaderStages, TextureView, TextureViewDimension,
};

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
        let types = [texture_type(FILTERED, TextureViewDimension::D2), SAMPLER, UNIFORM];
        let layout = bind_group_layout(device, "blit", ShaderStages::FRAGMENT, &types);
        let groups = [&layout];
        let spec = PipelineSpec {
            fragment: Some(if format.is_srgb() { "fs_linear" } else { "fs_main" }),
            strip: true,
            format: Some(format),
            ..PipelineSpec::new("blit", "vs_main", &groups)
        };
        Self {
            pipeline: pipeline(device, &spec),
            sampler: sampler(device, FilterMode::Linear),
            uniform: buffer(device, "blit", size_of::<BlitUniform>(), BufferUsages::UNIFORM),
            layout,
        }
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
        let picture = BindingResource::TextureView(&target.colour);
        let resources = [picture, BindingResource::Sampler(&self.sampler), self.uniform.as_entire_binding()];
        let group = bind_group(&gpu.device, "blit", &self.layout, resources);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("blit"),
            color_attachments: &[clear_colour(surface, wgpu::Color::BLACK)],
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
}

/// Rectangle (x, y, width, height) of a picture in the middle of a window, its shape kept.
fn fit(picture: [u32; 2], window: [u32; 2]) -> [f32; 4] {
    let [pw, ph, ww, wh] = [picture[0], picture[1], window[0], window[1]].map(|n| n.max(1) as f32);
    let scale = (ww / pw).min(wh / ph);
    let (w, h) = ((pw * scale).min(ww), (ph * scale).min(wh));
    [0.5 * (ww - w), 0.5 * (wh - h), w, h]
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
