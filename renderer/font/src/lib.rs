//! Text for pictures and plots: one font (see the README beside it) with Latin, Greek and Cyrillic,
//! shaped with kerning and rasterised with grey edges.
//!
//! Glyphs stand at quarters of a pixel along the line and are hinted across it, so that letters of
//! nine pixels are sharp and yet kerned. What the font lacks is drawn as a box. Pure: the same text
//! gives the same pixels.

use std::collections::HashMap;
use swash::scale::image::Image;
use swash::scale::{Render, ScaleContext, Source};
use swash::shape::ShapeContext;
use swash::text::{Codepoint, Script};
use swash::zeno::Vector;
use swash::{FontRef, GlyphId};

/// The font, as it lies in the program.
const FILE: &[u8] = include_bytes!("../DejaVuSans.ttf");
/// From the baseline to the top of an accented capital, and to the foot of a letter, em.
const ASCENT: f32 = 0.93;
const DESCENT: f32 = 0.24;
/// Places along a pixel at which a glyph may stand.
const PLACES: f32 = 4.0;
/// Rasters kept; a picture's text at one size needs some 80 letters at four places.
const MOST_RASTERS: usize = 4096;
/// Largest size, px: larger than any picture needs, and small enough for memory.
const MOST_PX: f32 = 400.0;

/// The font as a TrueType file, for libraries that draw text by themselves.
pub fn truetype() -> &'static [u8] {
    FILE
}

/// Height of a line that holds accents and feet, px.
pub fn line_px(size_px: f32) -> f32 {
    (ASCENT + DESCENT) * size_px
}

/// From a line's top to its baseline, px.
pub fn baseline_px(size_px: f32) -> f32 {
    ASCENT * size_px
}

/// True if the font has a character.
pub fn has(character: char) -> bool {
    file().charmap().map(character) != 0
}

fn file() -> FontRef<'static> {
    FontRef::from_index(FILE, 0).expect("the shipped font")
}

/// A glyph of a line: its number and its place from the line's begin, px to the right and up.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Glyph {
    id: GlyphId,
    at: [f32; 2],
}

/// A rasterised glyph: grey values, rows from the top.
#[derive(Debug)]
struct Raster {
    /// From the glyph's whole pixel to the raster's left, and from the baseline up to its top, px.
    left: i32,
    top: i32,
    width: i32,
    grey: Vec<u8>,
}

/// Glyph, size's bits, place.
type Key = (GlyphId, u32, u8);

/// The font, ready to shape and rasterise; keeps what it has rasterised.
pub struct Face {
    font: FontRef<'static>,
    shaping: ShapeContext,
    scaling: ScaleContext,
    rasters: HashMap<Key, Raster>,
    line: Vec<Glyph>,
}

impl Default for Face {
    fn default() -> Self {
        Self::new()
    }
}

impl Face {
    /// Reads the font.
    pub fn new() -> Self {
        Face {
            font: file(),
            shaping: ShapeContext::new(),
            scaling: ScaleContext::new(),
            rasters: HashMap::with_capacity(256),
            line: Vec::with_capacity(128),
        }
    }

    /// Width of a line, px.
    pub fn width_px(&mut self, text: &str, size_px: f32) -> f32 {
        self.shape(text, size_px)
    }

    /// Draws a line from `left` along the baseline, px from the upper left: `ink` gets every pixel
    /// that is touched and its grey, 1 to 255; where glyphs touch, a pixel comes more than once.
    /// Returns the line's width, px.
    pub fn draw(
        &mut self,
        text: &str,
        size_px: f32,
        [left, baseline]: [f32; 2],
        mut ink: impl FnMut(i32, i32, u8),
    ) -> f32 {
        let size_px = size_px.clamp(1.0, MOST_PX);
        let width = self.shape(text, size_px);
        for i in 0..self.line.len() {
            let glyph = self.line[i];
            let quarters = ((left + glyph.at[0]) * PLACES).round() as i32;
            let (x, place) = (quarters.div_euclid(PLACES as i32), quarters.rem_euclid(PLACES as i32) as u8);
            let y = (baseline - glyph.at[1]).round() as i32;
            let raster = self.raster((glyph.id, size_px.to_bits(), place));
            for (row, greys) in raster.grey.chunks(raster.width.max(1) as usize).enumerate() {
                for (column, &grey) in greys.iter().enumerate().filter(|(_, grey)| **grey > 0) {
                    ink(x + raster.left + column as i32, y - raster.top + row as i32, grey);
                }
            }
        }
        width
    }

    /// Writes a line with its upper left corner at `at` into a picture: red, green, blue, `width` pixels
    /// a row. What lies beyond the picture is left out.
    pub fn write(
        &mut self,
        picture: &mut [u8],
        width: u32,
        [left, top]: [f32; 2],
        text: &str,
        size_px: f32,
        colour: [u8; 3],
    ) {
        let base = top + baseline_px(size_px).round();
        self.draw(text, size_px, [left, base], |x, y, grey| {
            let inside = u32::try_from(x).is_ok_and(|x| x < width) && y >= 0;
            let at = 3 * (i64::from(y) * i64::from(width) + i64::from(x));
            if let Some(pixel) = picture.get_mut(at.max(0) as usize..).and_then(|p| p.get_mut(..3))
                && inside
            {
                pixel.iter_mut().zip(colour).for_each(|(under, over)| *under = mixed(*under, over, grey));
            }
        });
    }

    /// Places the glyphs of a line; returns its width, px. Each run of one script is shaped by itself;
    /// digits and signs belong to the run before them.
    fn shape(&mut self, text: &str, size_px: f32) -> f32 {
        let size_px = size_px.clamp(1.0, MOST_PX);
        self.line.clear();
        let (mut pen, mut rest) = (0.0, text);
        while !rest.is_empty() {
            let (script, run) = first_run(rest);
            rest = &rest[run.len()..];
            let mut shaper =
                self.shaping.builder(self.font).script(script).size(size_px).features(&[("kern", 1)]).build();
            shaper.add_str(run);
            let line = &mut self.line;
            shaper.shape_with(|cluster| {
                for glyph in cluster.glyphs {
                    line.push(Glyph { id: glyph.id, at: [pen + glyph.x, glyph.y] });
                    pen += glyph.advance;
                }
            });
        }
        pen
    }

    /// A rasterised glyph, from what is kept or made now.
    fn raster(&mut self, key: Key) -> &Raster {
        if self.rasters.len() >= MOST_RASTERS {
            self.rasters.clear();
        }
        let (font, scaling) = (self.font, &mut self.scaling);
        self.rasters.entry(key).or_insert_with(|| {
            let (id, size, place) = key;
            let mut scaler = scaling.builder(font).size(f32::from_bits(size)).hint(true).build();
            let aside = Vector::new(f32::from(place) / PLACES, 0.0);
            let image = Render::new(&[Source::Outline]).offset(aside).render(&mut scaler, id);
            let Image { placement, data, .. } = image.unwrap_or_default();
            Raster { left: placement.left, top: placement.top, width: placement.width as i32, grey: data }
        })
    }
}

/// `over` laid over `under`, by its grey.
fn mixed(under: u8, over: u8, grey: u8) -> u8 {
    let [under, over, grey] = [under, over, grey].map(u32::from);
    ((under * (255 - grey) + over * grey + 127) / 255) as u8
}

/// The longest beginning of `text` in one script.
fn first_run(text: &str) -> (Script, &str) {
    let mut known = None;
    for (at, character) in text.char_indices() {
        let script = character.script();
        if matches!(script, Script::Common | Script::Inherited | Script::Unknown) {
            continue;
        }
        match known {
            Some(before) if before != script => return (before, &text[..at]),
            _ => known = Some(script),
        }
    }
    (known.unwrap_or(Script::Latin), text)
}

#[cfg(test)]
mod tests;
