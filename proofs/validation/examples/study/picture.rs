//! Points of every attempt as a picture: a field a module, a column a surgeon.

use crate::numbers::mean;
use crate::{CARELESS_BELOW, EXPERT_FROM, Outcome};
use font::Face;
use image::{Rgb, RgbImage};
use surgeon::skill::Skill;

/// Size of a field, its margins left, above and below, px; fields in a row.
const FIELD: [i64; 2] = [260, 250];
const MARGIN: [i64; 3] = [44, 34, 34];
const IN_A_ROW: usize = 4;
/// Size of letters, px.
const LETTER: f32 = 14.0;

const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
const INK: Rgb<u8> = Rgb([40, 40, 40]);
const GRID: Rgb<u8> = Rgb([228, 228, 228]);
const BOUND: Rgb<u8> = Rgb([150, 150, 150]);
/// Colours that people with any colour vision tell apart (Okabe and Ito 2008).
const COLOURS: [Rgb<u8>; 5] =
    [Rgb([0, 114, 178]), Rgb([0, 158, 115]), Rgb([230, 159, 0]), Rgb([213, 94, 0]), Rgb([120, 120, 120])];

struct Chart {
    picture: RgbImage,
    face: Face,
}

/// Draws the picture.
pub fn draw(outcomes: &[Outcome], surgeons: &[Skill]) -> RgbImage {
    let rows = outcomes.len().div_ceil(IN_A_ROW) as i64;
    let (width, height) = (FIELD[0] * IN_A_ROW as i64, FIELD[1] * rows + 34);
    let mut chart =
        Chart { picture: RgbImage::from_pixel(width as u32, height as u32, PAPER), face: Face::new() };
    for (i, outcome) in outcomes.iter().enumerate() {
        let corner = [FIELD[0] * (i % IN_A_ROW) as i64, FIELD[1] * (i / IN_A_ROW) as i64];
        chart.field(corner, outcome);
    }
    for (i, surgeon) in surgeons.iter().enumerate() {
        let [x, y] = [MARGIN[0] + i as i64 * 200, FIELD[1] * rows + 8];
        chart.block([x, y + 2], [12, 12], COLOURS[i % COLOURS.len()]);
        chart.write([x + 20, y], surgeon.name, INK);
    }
    chart.picture
}

impl Chart {
    fn field(&mut self, [left, top]: [i64; 2], outcome: &Outcome) {
        let (x, width) = (left + MARGIN[0], FIELD[0] - MARGIN[0] - 8);
        let (low, high) = (top + FIELD[1] - MARGIN[2], top + MARGIN[1]);
        let up = |points: f64| low - ((low - high) as f64 * points / 100.0).round() as i64;
        for points in (0..=100).step_by(20) {
            let y = up(f64::from(points));
            self.block([x, y], [width, 1], GRID);
            let text = points.to_string();
            let across = x - 6 - self.face.width_px(&text, LETTER).ceil() as i64;
            self.write([across, y - 8], &text, INK);
        }
        for points in [EXPERT_FROM, CARELESS_BELOW] {
            self.block([x, up(points)], [width, 1], BOUND);
        }
        self.block([x, high], [1, low - high], INK);
        self.write([x, top + 8], &outcome.module, INK);
        let column = width / outcome.scores.len().max(1) as i64;
        for (s, colour) in (0..outcome.scores.len()).zip(COLOURS.iter().cycle()) {
            let (begin, totals) = (x + s as i64 * column, outcome.totals(s));
            for (i, points) in totals.iter().enumerate() {
                // Beside each other by seed, so that equal ones stay visible.
                let across = begin + 6 + (column - 14) * i as i64 / (totals.len() as i64 - 1).max(1);
                self.block([across - 1, up(*points) - 1], [4, 4], *colour);
            }
            self.block([begin + 4, up(mean(&totals)) - 1], [column - 8, 2], INK);
        }
    }

    /// A filled block; what is beyond the picture is left out.
    fn block(&mut self, [left, top]: [i64; 2], [width, height]: [i64; 2], colour: Rgb<u8>) {
        for (y, x) in (top..top + height).flat_map(|y| (left..left + width).map(move |x| (y, x))) {
            if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
                && let Some(pixel) = self.picture.get_pixel_mut_checked(x, y)
            {
                *pixel = colour;
            }
        }
    }

    fn write(&mut self, [x, y]: [i64; 2], text: &str, colour: Rgb<u8>) {
        let width = self.picture.width();
        self.face.write(&mut self.picture, width, [x as f32, y as f32], text, LETTER, colour.0);
    }
}
