//! The dose of light on the retina, drawn over it on request: the cells of `protocol::dose` as a
//! small texture.

use super::{
    IndexList, PassDevice, PipelineSpec, Uniforms, sampled_group, sampled_layout, texture_descriptor,
};
use crate::governor::Shading;
use protocol::dose::{ALONG, CELLS};
use wgpu::{
    BindGroup, BindGroupLayout, BlendState, CompareFunction, FilterMode, Queue, RenderPass, RenderPipeline,
    Texture, TextureFormat, TextureUsages, TextureViewDimension,
};

/// Dose at which the scale ends, mJ/mm²: where the score has no points left for light.
const WORST_MJ_MM2: f32 = 600.0;

/// Place of a dose on the scale, of 255: by its logarithm, since a minute gives 10 mJ/mm² from afar
/// and 1,000 from near.
fn on_scale(mj_mm2: f32) -> u8 {
    ((1.0 + mj_mm2.max(0.0)).ln() / (1.0 + WORST_MJ_MM2).ln() * 255.0).min(255.0) as u8
}

/// The pass.
pub struct Dose {
    pipelines: [RenderPipeline; 2],
    texture: Texture,
    group: BindGroup,
    /// Of the newest scene, mJ/mm².
    doses: [f32; CELLS],
    shown: bool,
}

impl Dose {
    /// Makes pipelines and texture.
    pub fn new(device: &PassDevice<'_>, uniforms: &Uniforms, light: &BindGroupLayout) -> Self {
        let layout = sampled_layout(device, "dose", TextureViewDimension::D2);
        let groups = [&uniforms.layout, light, &layout];
        let spec = PipelineSpec {
            fragment: Some("fs_dose"),
            depth: Some((CompareFunction::Less, false)),
            blend: Some(BlendState::ALPHA_BLENDING),
            ..PipelineSpec::new("dose", "vs_dose", &groups)
        };
        let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
        let (format, size_px) = (TextureFormat::R8Unorm, [ALONG as u32; 2]);
        let texture = device.create_texture(&texture_descriptor("dose", format, size_px, usage));
        let group = sampled_group(device, "dose", &layout, &texture, FilterMode::Linear);
        Self { pipelines: device.pipelines(&spec), texture, group, doses: [0.0; CELLS], shown: false }
    }

    /// Shows it from now on, or no longer.
    pub fn show(&mut self, queue: &Queue, shown: bool) {
        let fresh = shown && !self.shown;
        self.shown = shown;
        if fresh {
            self.upload(queue);
        }
    }

    /// Takes the doses of a scene in, mJ/mm²; only while they are shown they go to the device.
    pub fn set(&mut self, queue: &Queue, doses: &[f32]) {
        self.doses.fill(0.0);
        let known = doses.len().min(CELLS);
        self.doses[..known].copy_from_slice(&doses[..known]);
        if self.shown {
            self.upload(queue);
        }
    }

    fn upload(&self, queue: &Queue) {
        let rows = wgpu::TexelCopyBufferLayout { bytes_per_row: Some(ALONG as u32), ..Default::default() };
        let (bytes, size) = (self.doses.map(on_scale), self.texture.size());
        queue.write_texture(self.texture.as_image_copy(), &bytes, rows, size);
    }

    /// Draws where it is shown; groups 0 and 1 are set.
    pub fn draw(&self, pass: &mut RenderPass<'_>, cells: &IndexList, shading: Shading) {
        if self.shown {
            pass.set_bind_group(2, &self.group, &[]);
            cells.draw(pass, &self.pipelines[shading as usize]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_rises_from_no_light_to_far_too_much() {
        assert_eq!(on_scale(0.0), 0);
        assert_eq!([on_scale(WORST_MJ_MM2), on_scale(1e9), on_scale(f32::INFINITY)], [255; 3]);
        assert_eq!([on_scale(f32::NAN), on_scale(-5.0)], [0; 2]);
        let rising: Vec<u8> = [0.1, 1.0, 10.0, 60.0, 200.0].map(on_scale).into();
        assert!(rising.windows(2).all(|w| w[0] < w[1]), "{rising:?}");
    }
}
