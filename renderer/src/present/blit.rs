//! Copies a finished picture onto a surface, as large as fits, its channels arranged, and writes the
//! text over it.

use crate::gpu::Gpu;
use crate::passes::text::Text;
use crate::passes::{
    FILTERED, PassDevice, PipelineSpec, SAMPLER, UNIFORM, bind_group, bind_group_layout, buffer,
    clear_colour, sampler, texture_type,
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
    text: Text,
}

/// What is shown of a picture.
#[derive(Debug, Clone, Copy)]
pub struct Shown<'a> {
    /// How the channels share the surface.
    pub arrangement: Arrangement,
    /// The channel whose turn it is where they alternate.
    pub channel: u32,
    /// Lines of `protocol::scene_text` over it.
    pub text: &'a str,
    /// Pixels of the surface for one of the text; see [`Arrangement::text_scale`].
    pub text_scale: u32,
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
            pipeline: PassDevice::new(device, 0).pipeline(&spec),
            sampler: sampler(device, FilterMode::Linear),
            uniform: buffer(device, "blit", size_of::<BlitUniform>(), BufferUsages::UNIFORM),
            text: Text::new(device, format),
            layout,
        }
    }

    /// Draws `target` into the middle of `surface` of `size_px`.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        target: &Target,
        surface: &TextureView,
        size_px: [u32; 2],
        shown: Shown<'_>,
    ) {
        let (arrangement, channel) = (shown.arrangement, shown.channel);
        let uniform = BlitUniform { arrangement: arrangement as u32, channel, padding: [0; 2] };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&uniform));
        let rect = fit(arrangement.size_px(target.width_px, target.height_px), size_px, arrangement);
        let places = TextPlaces::new(rect, arrangement, shown.text_scale);
        self.text.set(&gpu.device, &gpu.queue, shown.text, places.layer_px);
        let picture = BindingResource::TextureView(&target.colour);
        let resources = [picture, BindingResource::Sampler(&self.sampler), self.uniform.as_entire_binding()];
        let group = bind_group(&gpu.device, "blit", &self.layout, resources);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("blit"),
            color_attachments: &[clear_colour(surface, wgpu::Color::BLACK)],
            ..wgpu::RenderPassDescriptor::default()
        });
        let [x, y, w, h] = rect.map(|n| n as f32);
        pass.set_viewport(x, y, w, h, 0.0, 1.0);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..4, 0..1);
        self.text.draw(&mut pass, &places.corners_px[..places.channels], places.scale);
        drop(pass);
        gpu.queue.submit([encoder.finish()]);
    }
}

/// Where the text of a picture stands on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TextPlaces {
    /// Size of a channel's layer, px of its own.
    layer_px: [u32; 2],
    /// Corners of the channels on the surface.
    corners_px: [[u32; 2]; 2],
    /// How many of them there are: one where both channels share every place.
    channels: usize,
    /// Pixels of the surface for one of the layer.
    scale: u32,
}

impl TextPlaces {
    fn new([x, y, w, h]: [u32; 4], arrangement: Arrangement, scale: u32) -> Self {
        let side_by_side = arrangement == Arrangement::SideBySide;
        let width = if side_by_side { w / 2 } else { w };
        TextPlaces {
            layer_px: [width / scale, h / scale],
            corners_px: [[x, y], [x + width, y]],
            channels: if side_by_side { 2 } else { 1 },
            scale,
        }
    }
}

/// Rectangle (x, y, width, height) of a picture in the middle of a window, its shape kept, in whole
/// pixels: two channels beside each other are equally wide, and interleaved lines begin with an even
/// one, so that each pixel of text is one of the display.
fn fit(picture: [u32; 2], window: [u32; 2], arrangement: Arrangement) -> [u32; 4] {
    let [pw, ph, ww, wh] = [picture[0], picture[1], window[0], window[1]].map(|n| u64::from(n.max(1)));
    let scaled = |n: u64, by: u64, of: u64, most: u64| ((n * by + of / 2) / of).clamp(1, most);
    let (w, h) = if ww * ph <= wh * pw { (ww, scaled(ww, ph, pw, wh)) } else { (scaled(wh, pw, ph, ww), wh) };
    let even = |n: u64, wanted: bool| if wanted && n > 1 { n & !1 } else { n };
    let lines = arrangement == Arrangement::Interleaved;
    let (w, h) = (even(w, arrangement == Arrangement::SideBySide), even(h, lines));
    let y = (wh - h) / 2;
    [(ww - w) / 2, if lines { y & !1 } else { y }, w, h].map(|n| n as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_keep_their_shape() {
        let fit = |picture, window| fit(picture, window, Arrangement::SideBySide);
        assert_eq!(fit([640, 256], [1280, 512]), [0, 0, 1280, 512]);
        assert_eq!(fit([640, 256], [640, 512]), [0, 128, 640, 256]);
        assert_eq!(fit([640, 256], [0, 0])[2..], [1, 1]);
        assert_eq!(fit([1600, 640], [u32::MAX, 100])[2..], [250, 100]);
    }

    #[test]
    fn both_channels_of_any_window_have_the_same_text_at_whole_pixels() {
        for window in (1..900).step_by(7).flat_map(|w| (1..700).step_by(13).map(move |h| [w, h])) {
            for arrangement in [Arrangement::SideBySide, Arrangement::Anaglyph, Arrangement::Interleaved] {
                let rect = fit(arrangement.size_px(400, 320), window, arrangement);
                let [x, y, w, h] = rect;
                assert!(w > 0 && h > 0 && x + w <= window[0] && y + h <= window[1], "{window:?}: {rect:?}");
                let text = TextPlaces::new(rect, arrangement, arrangement.text_scale());
                let last = text.corners_px[text.channels - 1];
                assert!(last[0] + text.layer_px[0] * text.scale <= x + w, "{window:?}");
                assert!(last[1] + text.layer_px[1] * text.scale <= y + h, "{window:?}");
                if arrangement == Arrangement::SideBySide && w > 1 {
                    assert_eq!(text.corners_px[1][0] - x, x + w - text.corners_px[1][0]);
                }
                let pairs = arrangement == Arrangement::Interleaved && h > 1;
                assert!(!pairs || (y % 2, h % 2) == (0, 0), "{window:?}: {rect:?}");
            }
        }
    }
}
