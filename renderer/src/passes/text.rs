//! Text over a finished picture, at the resolution at which it is seen: in a window, or in a file.
//! A layer of the size of a channel is drawn over each of them at whole pixels, so both show the
//! same pixels at the same place and text floats in the plane of the target. It is laid out, and
//! what has changed of it is sent to the device, only when text or size change.

use super::{PassDevice, PipelineSpec, UNFILTERED, bind_group, bind_group_layout, buffer, texture_type};
use super::{texture_descriptor, view};
use crate::text::canvas::Canvas;
use crate::text::layout::{Rect, lay_out};
use font::Face;
use protocol::scene_text::Place;
use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, BlendState, Buffer, BufferUsages, Device, Extent3d,
    Origin3d, Queue, RenderPass, RenderPipeline, ShaderStages, TexelCopyBufferLayout, TexelCopyTextureInfo,
    Texture, TextureFormat, TextureUsages, TextureViewDimension,
};

/// Left, top, right and bottom of a block, shares of a channel.
type Block = [f32; 4];

const ATTRIBUTES: [wgpu::VertexAttribute; 1] = wgpu::vertex_attr_array![0 => Float32x4];

/// The pass.
pub struct Text {
    pipeline: RenderPipeline,
    layout: BindGroupLayout,
    layer: Option<(Texture, BindGroup)>,
    blocks: Buffer,
    face: Face,
    canvas: Canvas,
    shown: String,
}

impl Text {
    /// For pictures of `format`.
    pub fn new(device: &Device, format: TextureFormat) -> Self {
        let types = [texture_type(UNFILTERED, TextureViewDimension::D2)];
        let layout = bind_group_layout(device, "text", ShaderStages::FRAGMENT | ShaderStages::VERTEX, &types);
        let groups = [&layout];
        let spec = PipelineSpec {
            fragment: Some(if format.is_srgb() { "fs_linear" } else { "fs_main" }),
            strip: true,
            format: Some(format),
            blend: Some(BlendState::PREMULTIPLIED_ALPHA_BLENDING),
            instances: Some((size_of::<Block>() as u64, &ATTRIBUTES)),
            ..PipelineSpec::new("text", "vs_main", &groups)
        };
        Self {
            pipeline: PassDevice::new(device, 0).pipeline(&spec),
            blocks: buffer(device, "text", Place::ALL.len() * size_of::<Block>(), BufferUsages::VERTEX),
            layout,
            layer: None,
            face: Face::new(),
            canvas: Canvas::default(),
            shown: String::with_capacity(1024),
        }
    }

    /// Chooses the text, lines of `protocol::scene_text`, for channels of `size_px`. To be called
    /// before the commands that draw it are submitted.
    pub fn set(&mut self, device: &Device, queue: &Queue, text: &str, size_px: [u32; 2]) {
        let size_px = size_px.map(|n| n.max(1));
        let resized = self.canvas.size_px() != size_px;
        if self.shown == text && !resized {
            return;
        }
        if resized {
            self.canvas.resize(size_px);
            self.layer = None;
        }
        self.shown.clear();
        self.shown.push_str(text);
        let layout = lay_out(&mut self.face, text, size_px);
        if layout.blocks.is_empty() {
            return self.canvas.show(&mut self.face, layout, |_, _| {});
        }
        let group_layout = &self.layout;
        let (texture, _) = self.layer.get_or_insert_with(|| layer(device, group_layout, size_px));
        self.canvas.show(&mut self.face, layout, |pixels, rect| upload(queue, texture, pixels, rect));
        let [w, h] = size_px.map(|n| n as f32);
        let mut places = [Block::default(); Place::ALL.len()];
        for (place, block) in places.iter_mut().zip(self.canvas.blocks()) {
            let rect = within(block.rect, size_px);
            let [left, right] = [rect.left, rect.right].map(|x| x as f32 / w);
            let [top, bottom] = [rect.top, rect.bottom].map(|y| y as f32 / h);
            *place = [left, top, right, bottom];
        }
        queue.write_buffer(&self.blocks, 0, bytemuck::cast_slice(&places));
    }

    /// Draws it over the channels whose upper left corners lie at `corners_px`, each pixel of the
    /// layer `scale` pixels wide and high.
    pub fn draw(&self, pass: &mut RenderPass<'_>, corners_px: &[[u32; 2]], scale: u32) {
        let count = self.canvas.blocks().len().min(Place::ALL.len()) as u32;
        let Some((_, group)) = self.layer.as_ref().filter(|_| count > 0) else { return };
        let [w, h] = self.canvas.size_px().map(|n| (n * scale) as f32);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, group, &[]);
        pass.set_vertex_buffer(0, self.blocks.slice(..));
        for corner in corners_px {
            let [x, y] = corner.map(|n| n as f32);
            pass.set_viewport(x, y, w, h, 0.0, 1.0);
            pass.draw(0..4, 0..count);
        }
    }
}

/// The part of a rectangle that lies on the layer.
fn within(rect: Rect, size_px: [u32; 2]) -> Rect {
    let [w, h] = size_px.map(|n| n as i32);
    Rect {
        left: rect.left.clamp(0, w),
        top: rect.top.clamp(0, h),
        right: rect.right.clamp(0, w),
        bottom: rect.bottom.clamp(0, h),
    }
}

fn layer(device: &Device, layout: &BindGroupLayout, size_px: [u32; 2]) -> (Texture, BindGroup) {
    let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST;
    let descriptor = texture_descriptor("text", TextureFormat::Rgba8Unorm, size_px, usage);
    let texture = device.create_texture(&descriptor);
    let group = bind_group(device, "text", layout, [BindingResource::TextureView(&view(&texture))]);
    (texture, group)
}

/// Sends a rectangle of the layer to the device.
fn upload(queue: &Queue, texture: &Texture, pixels: &[u8], rect: Rect) {
    let (size, rect) = (texture.size(), within(rect, [texture.width(), texture.height()]));
    if rect.width() <= 0 || rect.height() <= 0 {
        return;
    }
    let (left, top) = (rect.left as u32, rect.top as u32);
    let (bytes_per_row, offset) = (4 * size.width, u64::from(4 * (top * size.width + left)));
    let rows = TexelCopyBufferLayout { offset, bytes_per_row: Some(bytes_per_row), rows_per_image: None };
    let origin = Origin3d { x: left, y: top, z: 0 };
    let to = TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
    let extent =
        Extent3d { width: rect.width() as u32, height: rect.height() as u32, depth_or_array_layers: 1 };
    queue.write_texture(to, pixels, rows, extent);
}
