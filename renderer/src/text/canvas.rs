//! The pixels of laid out text: a channel's layer of premultiplied colours, redrawn only where a
//! block has changed.

use super::layout::{Block, Content, Layout, PlacedRow, Rect, outline_px};
use font::{Face, baseline_px, line_px};
use protocol::scene_text::Place;

/// Colours as they are displayed: letters, letters of notices, filled part of a bar.
const INK: [u8; 3] = [255, 246, 226];
const NOTICE: [u8; 3] = [255, 208, 92];
const FILLED: [u8; 3] = [240, 178, 60];
/// Opacity of the dark outline around letters, of a page's ground, and of an empty bar.
const OUTLINE: u8 = 215;
const GROUND: u8 = 185;
const EMPTY: u8 = 70;

/// A channel's layer of text.
#[derive(Debug, Default)]
pub struct Canvas {
    size_px: [u32; 2],
    /// Red, green, blue, opacity of each pixel, rows from the top.
    pixels: Vec<u8>,
    drawn: Vec<Block>,
    /// Greys of a row and of its outline.
    grey: Vec<u8>,
    edge: Vec<u8>,
}

impl Canvas {
    /// px.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// What it shows.
    pub fn blocks(&self) -> &[Block] {
        &self.drawn
    }

    /// The pixels, four bytes each, rows from the top.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Becomes an empty layer of another size.
    pub fn resize(&mut self, size_px: [u32; 2]) {
        self.size_px = size_px;
        self.pixels.clear();
        self.pixels.resize(4 * size_px[0] as usize * size_px[1] as usize, 0);
        self.drawn.clear();
    }

    /// Shows `layout`, which was made for this size; `changed` receives what changes.
    pub fn show(&mut self, face: &mut Face, layout: Layout, mut changed: impl FnMut(&[u8], Rect)) {
        let before = std::mem::take(&mut self.drawn);
        for block in before.iter().filter(|b| !layout.blocks.contains(b)) {
            self.fill(block.rect, [0; 4]);
        }
        for block in layout.blocks.iter().filter(|b| !before.contains(b)) {
            self.draw(face, block);
            changed(&self.pixels, block.rect);
        }
        self.drawn = layout.blocks;
    }

    fn draw(&mut self, face: &mut Face, block: &Block) {
        let ink = if block.place == Place::Top { NOTICE } else { INK };
        if block.place == Place::Page {
            self.fill(block.rect, [0, 0, 0, GROUND]);
        }
        for row in &block.rows {
            match &row.content {
                Content::Text(text) => self.write(face, row, 0, text, ink),
                Content::Bar { name, bar, share, value } => {
                    self.write(face, row, 0, name, ink);
                    let width = face.width_px(value, row.size_px).ceil() as i32 + 2 * outline_px(row.size_px);
                    self.write(face, row, row.rect.width() - width, value, ink);
                    self.bar(row, *bar, *share);
                }
            }
        }
    }

    /// A bar along the letters' height.
    fn bar(&mut self, row: &PlacedRow, [from, to]: [i32; 2], share: f32) {
        let base = row.rect.top + baseline(row) as i32;
        let height = (0.6 * row.size_px).round().max(3.0) as i32;
        let whole = Rect::new(row.rect.left + from, base - height, to - from, height);
        self.fill(whole, [EMPTY, EMPTY, EMPTY, GROUND]);
        let filled = (share * whole.width() as f32).round() as i32;
        let [r, g, b] = FILLED;
        self.fill(Rect { right: whole.left + filled, ..whole }, [r, g, b, 255]);
    }

    /// Sets every pixel of a rectangle; what lies beyond the layer is left out.
    fn fill(&mut self, rect: Rect, colour: [u8; 4]) {
        let [width, height] = self.size_px.map(|n| n as i32);
        let (left, right) = (rect.left.max(0), rect.right.min(width));
        for y in rect.top.max(0)..rect.bottom.min(height) {
            for x in left..right {
                self.pixels[4 * (y * width + x) as usize..][..4].copy_from_slice(&colour);
            }
        }
    }

    /// Letters with a dark outline into a row, `aside` px from its left.
    fn write(&mut self, face: &mut Face, row: &PlacedRow, aside: i32, text: &str, ink: [u8; 3]) {
        let (rect, reach) = (row.rect, outline_px(row.size_px));
        let [width, height] = [rect.width().max(0), rect.height().max(0)];
        self.grey.clear();
        self.grey.resize((width * height) as usize, 0);
        let grey = &mut self.grey;
        face.draw(text, row.size_px, [(aside + reach) as f32, baseline(row)], |x, y, value| {
            if (0..width).contains(&x) && (0..height).contains(&y) {
                let pixel = &mut grey[(y * width + x) as usize];
                *pixel = (*pixel).max(value);
            }
        });
        self.outline(width, height, reach);
        let row_px = self.size_px[0] as usize;
        for (i, (&grey, &edge)) in self.grey.iter().zip(&self.edge).enumerate().filter(|(_, (_, e))| **e > 0)
        {
            let (x, y) = (rect.left as usize + i % width as usize, rect.top as usize + i / width as usize);
            if x < row_px && y < self.size_px[1] as usize {
                let pixel = &mut self.pixels[4 * (y * row_px + x)..][..4];
                over(pixel, [0; 3], scaled(edge, OUTLINE));
                over(pixel, ink, strong(grey));
            }
        }
    }

    /// Grows the greys by `reach` px into `edge`: each pixel has the largest grey of the disc about
    /// it.
    fn outline(&mut self, width: i32, height: i32, reach: i32) {
        self.edge.clear();
        self.edge.resize(self.grey.len(), 0);
        let (far, near) = (reach * reach + reach, |d: i32| -reach.min(d)..=reach);
        for (i, &grey) in self.grey.iter().enumerate().filter(|(_, grey)| **grey > 0) {
            let (x, y) = (i as i32 % width, i as i32 / width);
            for (dy, dx) in near(y).flat_map(|dy| near(x).map(move |dx| (dy, dx))) {
                if dx * dx + dy * dy <= far && x + dx < width && y + dy < height {
                    let pixel = &mut self.edge[((y + dy) * width + x + dx) as usize];
                    *pixel = (*pixel).max(grey);
                }
            }
        }
    }
}

/// From a row's top to the baseline of letters in its middle, whole px.
fn baseline(row: &PlacedRow) -> f32 {
    (0.5 * (row.rect.height() as f32 - line_px(row.size_px)) + baseline_px(row.size_px)).round()
}

/// The grey of a letter's stem, which at these sizes is narrower than a pixel, as strong as the eye
/// needs it.
fn strong(grey: u8) -> u8 {
    (u32::from(grey) * 4 / 3).min(255) as u8
}

/// `a` times `b`, where 255 is one.
fn scaled(a: u8, b: u8) -> u8 {
    ((u32::from(a) * u32::from(b) + 127) / 255) as u8
}

/// Lays `colour` over a pixel.
fn over(pixel: &mut [u8], colour: [u8; 3], opacity: u8) {
    for (under, c) in pixel.iter_mut().zip([colour[0], colour[1], colour[2], 255]) {
        *under = scaled(*under, 255 - opacity).saturating_add(scaled(c, opacity));
    }
}

#[cfg(test)]
mod tests;
