//! Lines of text on the picture, at the places of [`protocol::scene_text`]. Both channels show a
//! line at the same place, so it floats in the plane of the target. Letters are sent to the device
//! only when the text changes.

use super::{
    PipelineSpec, Uniforms, buffer, overlay_pipelines, sampled_group, sampled_layout, texture_descriptor,
};
use crate::governor::Shading;
use bytemuck::{Pod, Zeroable};
use font::{self, CELL_H, CELL_W};
use protocol::scene_text::{Place, lines};
use wgpu::util::{DeviceExt, TextureDataOrder};
use wgpu::{
    BindGroup, BindGroupLayout, BlendState, Buffer, BufferUsages, Device, FilterMode, Queue, RenderPass,
    RenderPipeline, TextureFormat, TextureUsages, TextureViewDimension,
};

/// Letters drawn at most; what comes after is left out.
const MAX_LETTERS: usize = 2048;
/// Height of a channel at which a letter is drawn as large as in the font, px; at twice as much
/// twice as large.
const PLAIN_PX: f32 = 256.0;
/// Widest block, share of a channel's width.
const WIDEST: f32 = 0.96;
/// Distance from the picture's edge, share of its height.
const MARGIN: f32 = 0.02;

/// A letter of a block.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct Letter {
    /// Left, top, width, height in the block, 0 to 1.
    place: [f32; 4],
    /// Number in the font.
    letter: f32,
}

const ATTRIBUTES: [wgpu::VertexAttribute; 2] = wgpu::vertex_attr_array![0 => Float32x4, 1 => Float32];

/// The lines of one place.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Block {
    place: Place,
    columns: usize,
    rows: usize,
    first: u32,
    count: u32,
}

/// The pass.
pub struct Text {
    pipelines: [RenderPipeline; 2],
    group: BindGroup,
    buffer: Buffer,
    shown: String,
    letters: Vec<Letter>,
    blocks: Vec<Block>,
}

impl Text {
    /// Makes pipeline and font.
    pub fn new(device: &Device, queue: &Queue, uniforms: &Uniforms) -> Self {
        let layout = sampled_layout(device, "text", TextureViewDimension::D2);
        let groups = [&uniforms.layout, &layout];
        let spec = PipelineSpec {
            fragment: Some("fs_main"),
            strip: true,
            blend: Some(BlendState::ALPHA_BLENDING),
            instances: Some((size_of::<Letter>() as u64, &ATTRIBUTES)),
            ..PipelineSpec::new("text", "vs_main", &groups)
        };
        Self {
            pipelines: overlay_pipelines(device, &spec),
            group: font_group(device, queue, &layout),
            buffer: buffer(device, "text", MAX_LETTERS * size_of::<Letter>(), BufferUsages::VERTEX),
            shown: String::with_capacity(256),
            letters: Vec::with_capacity(MAX_LETTERS),
            blocks: Vec::with_capacity(Place::ALL.len()),
        }
    }

    /// Chooses the text; uploads it if it has changed.
    pub fn set(&mut self, queue: &Queue, text: &str) {
        if self.shown == text {
            return;
        }
        self.shown.clear();
        self.shown.push_str(text);
        lay_out(text, &mut self.letters, &mut self.blocks);
        queue.write_buffer(&self.buffer, 0, bytemuck::cast_slice(&self.letters));
    }

    /// Draws into the channel that begins at `left_px`.
    pub fn draw(&self, pass: &mut RenderPass<'_>, left_px: f32, size_px: [f32; 2], shading: Shading) {
        if self.blocks.is_empty() {
            return;
        }
        pass.set_pipeline(&self.pipelines[shading as usize]);
        pass.set_bind_group(1, &self.group, &[]);
        pass.set_vertex_buffer(0, self.buffer.slice(..));
        for block in &self.blocks {
            let [x, y, w, h] = rectangle(block, size_px);
            pass.set_viewport(left_px + x, y, w, h, 0.0, 1.0);
            pass.draw(0..4, block.first..block.first + block.count);
        }
    }
}

/// Letters and blocks of `text`, one block a place.
fn lay_out(text: &str, letters: &mut Vec<Letter>, blocks: &mut Vec<Block>) {
    letters.clear();
    blocks.clear();
    for place in Place::ALL {
        let of_place = || lines(text).filter(|(p, _)| *p == place).map(|(_, line)| line);
        let rows = of_place().count();
        if rows == 0 {
            continue;
        }
        let columns = of_place().map(|l| l.chars().count()).max().unwrap_or(0);
        let first = letters.len();
        for (row, line) in of_place().enumerate() {
            let indent = match place {
                Place::Bottom | Place::Middle => 0.5 * (columns - line.chars().count()) as f32,
                Place::TopLeft | Place::BottomLeft => 0.0,
                Place::TopRight | Place::BottomRight => (columns - line.chars().count()) as f32,
            };
            let [w, h] = [1.0 / columns as f32, 1.0 / rows as f32];
            for (column, character) in line.chars().enumerate().take(MAX_LETTERS - letters.len()) {
                let place = [(indent + column as f32) * w, row as f32 * h, w, h];
                letters.push(Letter { place, letter: font::number(character) as f32 });
            }
        }
        let (first, count) = (first as u32, (letters.len() - first) as u32);
        blocks.push(Block { place, columns, rows, first, count });
    }
}

/// Where a block lies on a channel of `size_px`: left, top, width, height, whole pixels wherever it
/// fits.
fn rectangle(block: &Block, [width, height]: [f32; 2]) -> [f32; 4] {
    let cells = [(block.columns * CELL_W) as f32, (block.rows * CELL_H) as f32];
    let wanted = (height / PLAIN_PX).floor().max(1.0);
    let scale = wanted.min(WIDEST * width / cells[0]).min(WIDEST * height / cells[1]);
    let [w, h] = cells.map(|c| c * scale);
    let margin = MARGIN * height;
    let x = match block.place {
        Place::Bottom | Place::Middle => 0.5 * (width - w),
        Place::TopLeft | Place::BottomLeft => margin,
        Place::TopRight | Place::BottomRight => width - margin - w,
    };
    let y = match block.place {
        Place::TopLeft | Place::TopRight => margin,
        Place::Middle => 0.5 * (height - h),
        Place::Bottom | Place::BottomLeft | Place::BottomRight => height - margin - h,
    };
    // A wide block keeps its margin as long as there is room for one.
    [x.floor().clamp(0.0, width - w), y.floor().clamp(0.0, height - h), w, h]
}

/// The font as a strip of cells on the device.
fn font_group(device: &Device, queue: &Queue, layout: &BindGroupLayout) -> BindGroup {
    let (strip, width) = font::strip();
    let size_px = [width, CELL_H as u32];
    let letters = texture_descriptor("font", TextureFormat::R8Unorm, size_px, TextureUsages::TEXTURE_BINDING);
    let texture = device.create_texture_with_data(queue, &letters, TextureDataOrder::LayerMajor, &strip);
    sampled_group(device, "text", layout, &texture, FilterMode::Nearest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_a_place_form_a_block_and_are_centred_or_flush() {
        let (mut letters, mut blocks) = (Vec::new(), Vec::new());
        lay_out("<TIER 6\n<NOW\nHOLD\n_AND STAY\n", &mut letters, &mut blocks);
        let shapes: Vec<_> = blocks.iter().map(|b| (b.place, b.columns, b.rows, b.count)).collect();
        assert_eq!(shapes, [(Place::Bottom, 8, 2, 12), (Place::TopLeft, 6, 2, 9)]);
        assert_eq!(letters[0].place, [0.25, 0.0, 0.125, 0.5], "two columns of eight are left on both sides");
        assert_eq!(letters[12 + 6].place[..2], [0.0, 0.5], "the second line begins at the left");
    }

    #[test]
    fn too_much_text_is_cut() {
        let (mut letters, mut blocks) = (Vec::new(), Vec::new());
        lay_out(&"A LONG LINE\n".repeat(400), &mut letters, &mut blocks);
        assert_eq!((letters.len(), blocks[0].count), (MAX_LETTERS, MAX_LETTERS as u32));
    }

    #[test]
    fn every_block_stays_on_the_picture() {
        for place in Place::ALL {
            for (columns, rows) in [(1, 1), (26, 2), (70, 5), (200, 90)] {
                for size in [[160.0, 128.0], [400.0, 320.0], [1280.0, 1024.0]] {
                    let block = Block { place, columns, rows, first: 0, count: 0 };
                    let [x, y, w, h] = rectangle(&block, size);
                    assert!(
                        x >= 0.0 && y >= 0.0 && x + w <= size[0] && y + h <= size[1],
                        "{block:?} {size:?}"
                    );
                    assert!(w > 0.0 && h > 0.0);
                }
            }
        }
    }
}
