//! A page over the middle of the field: title, text, and bars in columns.

use super::layout::{Block, Content, PlacedRow, Plan, Rect, outline_px};
use super::wrap::{shortened, wrapped};
use protocol::scene_text::{Place, Row};

/// Size of a title's letters, by that of the others.
const TITLE: f32 = 1.3;
/// Least and usual length of a bar, and the border around the rows, by the letters' size.
const BAR_LEAST: f32 = 3.0;
const BAR_USUAL: f32 = 9.0;
const BORDER: f32 = 0.9;
/// Room between bars, by the letters' size.
const BETWEEN_BARS: f32 = 0.4;

/// A row before it has its place: size of its letters, width and content.
type Loose = (f32, i32, Content);

/// Columns of all bars, px: names, bars, figures.
struct Columns {
    name: i32,
    bar: i32,
    value: i32,
    gap: i32,
}

/// Places the rows of a page in the middle of `room`, those that do not fit left out.
pub(super) fn place_page<'t>(plan: &mut Plan<'_>, lines: impl Iterator<Item = &'t str>, room: Rect) -> Block {
    let rows: Vec<Row<'_>> = lines.map(Row::of).collect();
    let border = (BORDER * plan.size_px).ceil() as i32;
    let inner = room.width() - 2 * border;
    let columns = columns(plan, &rows, inner);
    let mut loose = Vec::new();
    for row in &rows {
        take_row(plan, row, &columns, inner, &mut loose);
    }
    let height = |plan: &Plan<'_>, rows: &[Loose]| rows.iter().map(|r| row_height(plan, r)).sum::<i32>();
    while !loose.is_empty() && height(plan, &loose) + 2 * border > room.height() {
        plan.cut = true;
        loose.pop();
    }
    let width = loose.iter().map(|r| r.1).max().unwrap_or(0);
    let tall = height(plan, &loose);
    let left = (plan.channel.right - width) / 2;
    let top = room.top + (room.height() - tall) / 2;
    let ground = Rect {
        left: left - border,
        top: top - border,
        right: left + width + border,
        bottom: top + tall + border,
    };
    let heights: Vec<i32> = loose.iter().map(|row| row_height(plan, row)).collect();
    let (mut heights, mut next) = (heights.into_iter(), top);
    let placed = loose.into_iter().map(|(size_px, own, content)| {
        // Titles and text are centred, bars stand under each other.
        let own_left = if matches!(content, Content::Text(_)) {
            (plan.channel.right - own) / 2
        } else {
            left + (width - own) / 2
        };
        let rect = Rect::new(own_left, next, own, heights.next().unwrap_or(0));
        next = rect.bottom;
        PlacedRow { rect, size_px, content }
    });
    Block { place: Place::Page, rows: placed.collect(), rect: ground }
}

/// Height of a row, px.
fn row_height(plan: &Plan<'_>, (size_px, _, content): &Loose) -> i32 {
    let between = if matches!(content, Content::Bar { .. }) { BETWEEN_BARS * size_px } else { 0.0 };
    plan.row_px(*size_px) + between.round() as i32
}

/// Widths that hold every bar's name and figure; the bars take what is left.
fn columns(plan: &mut Plan<'_>, rows: &[Row<'_>], inner: i32) -> Columns {
    let (size, mut name, mut value) = (plan.size_px, 0, 0);
    for row in rows {
        if let Row::Bar { name: n, value: v, .. } = row {
            name = name.max(plan.face.width_px(n, size).ceil() as i32);
            value = value.max(plan.face.width_px(v, size).ceil() as i32);
        }
    }
    let gap = size.ceil() as i32;
    let least = (BAR_LEAST * size) as i32;
    let rest = inner - 2 * gap - 2 * outline_px(size);
    if name + value + least > rest && name > 0 {
        plan.cut = true;
        value = value.min(rest / 3).max(0);
        name = (rest - least - value).max(0);
    }
    let bar = (rest - name - value).clamp(0, (BAR_USUAL * size) as i32);
    Columns { name, bar, value, gap }
}

fn take_row(plan: &mut Plan<'_>, row: &Row<'_>, columns: &Columns, inner: i32, out: &mut Vec<Loose>) {
    let (text, size) = match *row {
        Row::Title(text) => (text, (TITLE * plan.size_px).round()),
        Row::Plain(text) => (text, plan.size_px),
        Row::Bar { name, share, value } => {
            let Columns { name: names, bar, value: values, gap } = *columns;
            let size = plan.size_px;
            let edge = outline_px(size);
            let content = Content::Bar {
                name: shortened(plan.face, name, size, names as f32),
                bar: [edge + names + gap, edge + names + gap + bar],
                share,
                value: shortened(plan.face, value, size, values as f32),
            };
            return out.push((size, 2 * edge + names + bar + values + 2 * gap, content));
        }
    };
    let edge = 2 * outline_px(size);
    let parts = wrapped(plan.face, text, size, (inner - edge) as f32);
    plan.cut |= parts.is_empty() && !text.trim().is_empty();
    for part in parts {
        let width = plan.face.width_px(&part, size).ceil() as i32 + edge;
        out.push((size, width, Content::Text(part)));
    }
}
