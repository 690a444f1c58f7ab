//! Text on the picture. The texture is written only when the text changes.

use super::{PipelinePlan, Uniforms, pipeline};
use crate::font::{self, CELL_H, CELL_W};
use wgpu::{
    BindGroup, BindGroupLayoutEntry, BindingType, BlendState, CompareFunction, Device, Queue, RenderPass,
    RenderPipeline, ShaderStages, Texture, TextureFormat, TextureUsages,
};

/// Characters of a line.
const COLUMNS: usize = 32;
/// Lines.
pub const LINES: usize = 3;
const WIDTH: usize = COLUMNS * CELL_W;
const HEIGHT: usize = LINES * CELL_H;
/// `bytes_per_row` of an upload is a multiple of this.
const ROW_BYTES: usize = 256;
const _: () = assert!(WIDTH <= ROW_BYTES);

/// The pass.
pub struct Overlay {
    pipeline: RenderPipeline,
    group: BindGroup,
    texture: Texture,
    shown: [String; LINES],
    pixels: Vec<u8>,
    rows: Vec<u8>,
}

impl Overlay {
    /// Makes pipeline and texture.
    pub fn new(device: &Device, uniforms: &Uniforms) -> Self {
        let entry = |binding, ty| BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("overlay"),
            entries: &[
                entry(
                    0,
                    BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: true },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                ),
                entry(1, BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
            ],
        });
        let groups = [&uniforms.layout, &layout];
        let plan = PipelinePlan {
            fragment: Some("fs_main"),
            strip: true,
            depth: Some((CompareFunction::Always, false)),
            blend: Some(BlendState::ALPHA_BLENDING),
            ..PipelinePlan::new("overlay", "vs_main", &groups)
        };
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("text"),
            size: wgpu::Extent3d { width: WIDTH as u32, height: HEIGHT as u32, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::R8Unorm,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            min_filter: wgpu::FilterMode::Linear,
            ..wgpu::SamplerDescriptor::default()
        });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("overlay"),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&view) },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Sampler(&sampler) },
            ],
        });
        Self {
            pipeline: pipeline(device, &plan),
            group,
            texture,
            shown: Default::default(),
            pixels: vec![0; WIDTH * HEIGHT],
            rows: vec![0; ROW_BYTES * HEIGHT],
        }
    }

    /// Chooses the text; uploads it if it has changed.
    pub fn set(&mut self, queue: &Queue, lines: [&str; LINES]) {
        if self.shown == lines {
            return;
        }
        self.pixels.fill(0);
        for (row, line) in lines.into_iter().enumerate() {
            self.shown[row].clear();
            self.shown[row].push_str(line);
            font::draw_line(&mut self.pixels, WIDTH, row, line);
        }
        for (to, from) in self.rows.chunks_mut(ROW_BYTES).zip(self.pixels.chunks(WIDTH)) {
            to[..WIDTH].copy_from_slice(from);
        }
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(ROW_BYTES as u32),
            rows_per_image: None,
        };
        queue.write_texture(self.texture.as_image_copy(), &self.rows, layout, self.texture.size());
    }

    /// True if there is no text.
    pub fn is_empty(&self) -> bool {
        self.shown.iter().all(String::is_empty)
    }

    /// Draws the text near the lower end of the channel that begins at `left_px`.
    pub fn draw(&self, pass: &mut RenderPass<'_>, left_px: f32, width_px: f32, height_px: f32) {
        let scale = (width_px * 0.96 / WIDTH as f32).min((height_px / 256.0).max(1.0));
        let (w, h) = (WIDTH as f32 * scale, HEIGHT as f32 * scale);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(1, &self.group, &[]);
        pass.set_viewport(left_px + 0.5 * (width_px - w), height_px * 0.97 - h, w, h, 0.0, 1.0);
        pass.draw(0..4, 0..1);
    }
}
