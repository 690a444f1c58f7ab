//! Where the lines of text stand on a channel, whole pixels from its upper left. Pure.
//!
//! Corners lie outside the round field or at its rim. Notices stand at the upper rim between the
//! corners, what is to be done at the lower rim; the lower corners step above it where it is wide.
//! The working area, a disc about the field's middle, stays free of all of them; only a page covers
//! it. The letters' size follows the channel's height; where not all fits it is reduced, and where
//! that does not help, as in a tiny window, lines are cut.

use super::page::place_page;
use super::wrap::{shortened, wrapped};
use crate::view::FIELD_FILL;
use font::{Face, line_px};
use protocol::scene_text::{Place, lines};

/// Radius of the working area, share of the field's.
pub const WORKING_AREA: f64 = 0.55;
/// Channel's height by size of the letters, and the smallest size that is chosen, px (em): an x of
/// five pixels.
const LETTERS_A_HEIGHT: f32 = 32.0;
const CHOSEN_PX: f32 = 9.0;
/// The smallest size to which crowded text is reduced, px.
const SMALLEST_PX: f32 = 7.0;
/// Distance from the channel's border, share of its height.
const MARGIN: f32 = 0.012;

/// A rectangle of whole pixels; right and bottom are the first beyond it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Rect {
    pub left: i32,
    pub top: i32,
    pub right: i32,
    pub bottom: i32,
}

impl Rect {
    /// From its upper left corner and its size.
    pub fn new(left: i32, top: i32, width: i32, height: i32) -> Self {
        Rect { left, top, right: left + width, bottom: top + height }
    }

    /// px.
    pub fn width(&self) -> i32 {
        self.right - self.left
    }

    /// px.
    pub fn height(&self) -> i32 {
        self.bottom - self.top
    }

    /// True if both have a pixel in common, or lie nearer than `gap` pixels.
    pub fn touches(&self, other: &Rect, gap: i32) -> bool {
        self.left < other.right + gap
            && other.left < self.right + gap
            && self.top < other.bottom + gap
            && other.top < self.bottom + gap
    }

    /// True if it lies outside the disc in which a surgeon works, on a channel of this size.
    pub fn is_beside_work(&self, [width, height]: [u32; 2]) -> bool {
        let middle = [0.5 * f64::from(width), 0.5 * f64::from(height)];
        let nearest = [
            middle[0].clamp(f64::from(self.left), f64::from(self.right)),
            middle[1].clamp(f64::from(self.top), f64::from(self.bottom)),
        ];
        let away = (nearest[0] - middle[0]).hypot(nearest[1] - middle[1]);
        away >= WORKING_AREA * 0.5 * FIELD_FILL * f64::from(height)
    }

    /// True if `other` lies inside.
    pub fn holds(&self, other: &Rect) -> bool {
        self.left <= other.left
            && self.top <= other.top
            && self.right >= other.right
            && self.bottom >= other.bottom
    }
}

/// What stands in a row.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)]
pub enum Content {
    Text(String),
    /// A name, a bar from `bar[0]` to `bar[1]` (px from the row's left) of which a share is filled,
    /// and its figure.
    Bar {
        name: String,
        bar: [i32; 2],
        share: f32,
        value: String,
    },
}

/// A row of a block.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedRow {
    /// On the channel; the letters with their outline lie inside.
    pub rect: Rect,
    /// Size of its letters, px.
    pub size_px: f32,
    /// What it shows.
    pub content: Content,
}

/// The rows of one place.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Where.
    pub place: Place,
    /// On the channel; around all rows, and around the ground of a page.
    pub rect: Rect,
    /// Its rows from the top.
    pub rows: Vec<PlacedRow>,
}

/// All text of a channel.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Layout {
    /// One for each place that has text.
    pub blocks: Vec<Block>,
    /// Size of the letters, px.
    pub size_px: f32,
    /// Lines were cut or left out.
    pub cut: bool,
}

impl Layout {
    /// What a layout on a channel of `size_px` promises: nothing leaves the channel, nothing overlaps,
    /// and nothing but a page reaches into the working area.
    ///
    /// # Errors
    /// The first promise that is not kept.
    pub fn check(&self, [width, height]: [u32; 2]) -> Result<(), String> {
        let channel = Rect::new(0, 0, width as i32, height as i32);
        for (i, block) in self.blocks.iter().enumerate() {
            let meets = |other: &&Block| block.rect.touches(&other.rect, 0);
            if !channel.holds(&block.rect) {
                return Err(format!("leaves the channel: {block:?}"));
            }
            if let Some(other) = self.blocks[..i].iter().find(meets) {
                return Err(format!("overlap: {block:?} and {other:?}"));
            }
            for (k, row) in block.rows.iter().enumerate() {
                let works = block.place == Place::Page || row.rect.is_beside_work([width, height]);
                let meets = |other: &PlacedRow| row.rect.touches(&other.rect, 0);
                if !block.rect.holds(&row.rect) || !works || block.rows[..k].iter().any(meets) {
                    return Err(format!("row {k} is out of its place: {block:?}"));
                }
            }
        }
        Ok(())
    }
}

/// Lays `text`, lines of `protocol::scene_text`, out on a channel of `size_px`.
pub fn lay_out(face: &mut Face, text: &str, size_px: [u32; 2]) -> Layout {
    let chosen = (size_px[1] as f32 / LETTERS_A_HEIGHT).round().max(CHOSEN_PX);
    let mut letters_px = chosen;
    loop {
        let mut layout = Plan::new(face, size_px, letters_px).place_all(text);
        if !layout.cut || letters_px <= SMALLEST_PX {
            layout.blocks.retain(|b| !b.rows.is_empty());
            return layout;
        }
        letters_px = (letters_px - (0.06 * letters_px).round().max(1.0)).max(SMALLEST_PX);
    }
}

/// Width of the outline around letters of a size, px.
pub fn outline_px(size_px: f32) -> i32 {
    (size_px / 14.0).round().max(1.0) as i32
}

/// Text being placed at one size of letters.
pub(super) struct Plan<'a> {
    pub(super) face: &'a mut Face,
    pub(super) size_px: f32,
    pub(super) channel: Rect,
    /// Distance from the border, and between blocks, px.
    pub(super) margin: i32,
    /// Radius of the working area, px.
    radius: i32,
    pub(super) cut: bool,
}

impl<'a> Plan<'a> {
    fn new(face: &'a mut Face, [width, height]: [u32; 2], size_px: f32) -> Self {
        let radius = (0.5 * WORKING_AREA * FIELD_FILL * f64::from(height)).ceil() as i32;
        let margin = (MARGIN * height as f32).round().max(1.0) as i32;
        let channel = Rect::new(0, 0, width as i32, height as i32);
        Plan { face, size_px, channel, margin, radius, cut: false }
    }

    /// Height of a row, px.
    pub(super) fn row_px(&self, size_px: f32) -> i32 {
        line_px(size_px).ceil() as i32 + outline_px(size_px)
    }

    fn place_all(mut self, text: &str) -> Layout {
        let of = |place| lines(text).filter(move |(p, _)| *p == place).map(|(_, line)| line);
        let (m, all) = (self.margin, self.channel);
        let (half_width, half_height) = (all.right / 2, all.bottom / 2);
        // Beside the working area, above it, and below.
        let (strip, band) = (half_width - self.radius - 2 * m, half_height - self.radius - 2 * m);
        let half = half_height - 2 * m;
        let mut corner = |place, tall| self.rows(of(place), strip, tall);
        let [upper_left, upper_right] = [Place::TopLeft, Place::TopRight].map(|p| corner(p, half));
        let side = widest(&upper_left).max(widest(&upper_right));
        let between = all.right - 2 * (if side > 0 { side + 2 * m } else { m });
        let notices = self.rows(of(Place::Top), between, band);
        let tasks = self.rows(of(Place::Bottom), all.right - 2 * m, band);
        let top_left = self.block(Place::TopLeft, &upper_left, m);
        let top_right = self.block(Place::TopRight, &upper_right, m);
        let top = self.block(Place::Top, &notices, m);
        let bottom = self.block(Place::Bottom, &tasks, all.bottom - m - tall(&tasks));
        let mut lower = |place| {
            let rows = self.rows(of(place), strip, half);
            let low = self.block(place, &rows, all.bottom - m - tall(&rows));
            if !low.rect.touches(&bottom.rect, m) || low.rows.is_empty() {
                return low;
            }
            let rows = self.rows(of(place), strip, bottom.rect.top - m - half_height);
            self.block(place, &rows, bottom.rect.top - m - tall(&rows))
        };
        let [left, right] = [Place::BottomLeft, Place::BottomRight].map(&mut lower);
        let high = [&top_left, &top_right, &top].map(|b| b.rect.bottom).into_iter().max().unwrap_or(0);
        let low = [&left, &right, &bottom].into_iter().filter(|b| !b.rows.is_empty());
        let low = low.map(|b| b.rect.top).min().unwrap_or(all.bottom);
        let room = Rect { top: high + m, bottom: low - m, left: m, right: all.right - m };
        let page = place_page(&mut self, of(Place::Page), room);
        let blocks = vec![top, bottom, page, top_left, top_right, left, right];
        Layout { blocks, size_px: self.size_px, cut: self.cut }
    }

    /// `lines` in rows that fit a width, as many as fit a height: text and width of each, outline
    /// included.
    fn rows<'t>(&mut self, lines: impl Iterator<Item = &'t str>, width: i32, height: i32) -> Rows {
        let (size, edge, row_px) = (self.size_px, 2 * outline_px(self.size_px), self.row_px(self.size_px));
        let (room, mut rows) = ((width - edge) as f32, Vec::new());
        for line in lines {
            let parts = wrapped(self.face, line, size, room);
            self.cut |= parts.is_empty() && !line.trim().is_empty();
            rows.extend(parts);
        }
        let fit = (height / row_px).max(0) as usize;
        if rows.len() > fit {
            self.cut = true;
            rows.truncate(fit);
            if let Some(last) = rows.last_mut() {
                *last = shortened(self.face, &format!("{last} …"), size, room);
            }
        }
        let width = |row: &String| self.face.width_px(row, size).ceil() as i32 + edge;
        let widths: Vec<i32> = rows.iter().map(width).collect();
        Rows { texts: rows, widths, row_px }
    }

    /// Rows under each other from `top`, flush or centred as the place wants it.
    fn block(&self, place: Place, rows: &Rows, top: i32) -> Block {
        let (width, right) = (widest(rows), self.channel.right);
        let left = match place {
            Place::TopLeft | Place::BottomLeft => self.margin,
            Place::TopRight | Place::BottomRight => right - self.margin - width,
            Place::Top | Place::Bottom | Place::Page => (right - width) / 2,
        };
        let placed = (0..).zip(rows.texts.iter().zip(&rows.widths)).map(|(i, (text, &own))| {
            let left = match place {
                Place::TopLeft | Place::BottomLeft => left,
                Place::TopRight | Place::BottomRight => right - self.margin - own,
                Place::Top | Place::Bottom | Place::Page => (right - own) / 2,
            };
            PlacedRow {
                rect: Rect::new(left, top + i * rows.row_px, own, rows.row_px),
                size_px: self.size_px,
                content: Content::Text(text.clone()),
            }
        });
        let rows_placed: Vec<PlacedRow> = placed.collect();
        let tall = if rows_placed.is_empty() { 0 } else { tall(rows) };
        Block { place, rect: Rect::new(left, top, width, tall), rows: rows_placed }
    }
}

/// Rows of a block before it has its place.
struct Rows {
    texts: Vec<String>,
    widths: Vec<i32>,
    row_px: i32,
}

fn widest(rows: &Rows) -> i32 {
    rows.widths.iter().copied().max().unwrap_or(0)
}

fn tall(rows: &Rows) -> i32 {
    rows.texts.len() as i32 * rows.row_px
}

#[cfg(test)]
mod tests;
