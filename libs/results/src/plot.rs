//! Learning curves as a picture.

use crate::curve::{Curve, by_module, longest};
use font::{Face, line_px};
use image::{Rgb, RgbImage};

/// Size of the field of a module, px; the fields of several stand below each other.
pub const SIZE: [u32; 2] = [960, 600];
/// The field of the plot: left, top, right, bottom, px.
const FIELD: [f64; 4] = [70.0, 40.0, 930.0, 470.0];
/// Size of letters, px.
const LETTER: f32 = 14.0;
/// Rows and columns of the legend below.
const LEGEND: [usize; 2] = [4, 2];

const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
const INK: Rgb<u8> = Rgb([40, 40, 40]);
const GRID: Rgb<u8> = Rgb([222, 222, 222]);
/// Colours that people with any colour vision tell apart (Okabe and Ito 2008, without yellow).
const COLOURS: [Rgb<u8>; 7] = [
    Rgb([0, 114, 178]),
    Rgb([213, 94, 0]),
    Rgb([0, 158, 115]),
    Rgb([204, 121, 167]),
    Rgb([86, 180, 233]),
    Rgb([230, 159, 0]),
    Rgb([0, 0, 0]),
];

/// A picture of the curves, a field for each module: a point an attempt, its deviation as a bar, joined by lines.
pub fn png(curves: &[Curve]) -> image::ImageResult<Vec<u8>> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    plot(curves).write_to(&mut bytes, image::ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// As [`png`], the pixels.
pub fn plot(curves: &[Curve]) -> RgbImage {
    let panels: Vec<RgbImage> = by_module(curves).map(panel).collect();
    let height = SIZE[1] * panels.len().max(1) as u32;
    let mut picture = RgbImage::from_pixel(SIZE[0], height, PAPER);
    for (number, panel) in panels.iter().enumerate() {
        image::imageops::replace(&mut picture, panel, 0, i64::from(SIZE[1]) * number as i64);
    }
    picture
}

/// The curves of a module.
fn panel(curves: &[Curve]) -> RgbImage {
    let mut chart = Chart { picture: RgbImage::from_pixel(SIZE[0], SIZE[1], PAPER), face: Face::new() };
    let most = longest(curves);
    chart.frame(most);
    chart.write(FIELD[0] as i64 + 20, 12, &curves[0].module, INK);
    for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        let place = |(i, (score, _)): (usize, &(f64, f64))| [across(i, most), up(*score)];
        let points: Vec<[f64; 2]> = curve.scores.iter().enumerate().map(place).collect();
        for pair in points.windows(2) {
            chart.line(pair[0], pair[1], 2, *colour);
        }
        for ([x, y], (score, sigma)) in points.iter().zip(&curve.scores) {
            chart.line([*x, up(score - sigma)], [*x, up(score + sigma)], 2, *colour);
            chart.block(*x as i64 - 4, *y as i64 - 4, 9, 9, *colour);
        }
    }
    chart.legend(curves);
    chart.picture
}

/// Where an attempt stands, px.
fn across(attempt: usize, most: usize) -> f64 {
    let [left, _, right, _] = FIELD;
    left + (right - left) * (attempt as f64 + 0.5) / most.max(1) as f64
}

/// Where a score stands, px.
fn up(score: f64) -> f64 {
    let [_, top, _, bottom] = FIELD;
    bottom - (bottom - top) * score.clamp(0.0, 100.0) / 100.0
}

struct Chart {
    picture: RgbImage,
    face: Face,
}

impl Chart {
    /// A filled block; what is beyond the picture is left out.
    fn block(&mut self, left: i64, top: i64, width: i64, height: i64, colour: Rgb<u8>) {
        for y in top..top + height {
            for x in left..left + width {
                if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
                    && let Some(pixel) = self.picture.get_pixel_mut_checked(x, y)
                {
                    *pixel = colour;
                }
            }
        }
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2], thick: i64, colour: Rgb<u8>) {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let steps = dx.abs().max(dy.abs()).ceil().max(1.0);
        for s in 0..=steps as u32 {
            let along = f64::from(s) / steps;
            let [x, y] = [from[0] + dx * along, from[1] + dy * along];
            self.block(x.round() as i64 - thick / 2, y.round() as i64 - thick / 2, thick, thick, colour);
        }
    }

    /// Writes with the upper left corner at (x, y).
    fn write(&mut self, x: i64, y: i64, text: &str, colour: Rgb<u8>) {
        let width = self.picture.width();
        self.face.write(&mut self.picture, width, [x as f32, y as f32], text, LETTER, colour.0);
    }

    /// Width of a text, px.
    fn width(&mut self, text: &str) -> i64 {
        self.face.width_px(text, LETTER).ceil() as i64
    }

    /// Axes, grid and their numbers.
    fn frame(&mut self, most: usize) {
        let [left, top, right, bottom] = FIELD;
        let letter_h = line_px(LETTER) as i64;
        for points in (0..=100).step_by(10) {
            let y = up(f64::from(points));
            self.line([left, y], [right, y], 1, GRID);
            if points % 20 == 0 {
                let text = points.to_string();
                let x = left as i64 - 10 - self.width(&text);
                self.write(x, y as i64 - letter_h / 2 + 1, &text, INK);
            }
        }
        let every = most.div_ceil(20).max(1);
        for attempt in (0..most).step_by(every) {
            let (x, text) = (across(attempt, most), (attempt + 1).to_string());
            let half = self.width(&text) / 2;
            self.line([x, bottom], [x, bottom + 5.0], 1, INK);
            self.write(x as i64 - half + 1, bottom as i64 + 9, &text, INK);
        }
        self.line([left, top], [left, bottom], 2, INK);
        self.line([left, bottom], [right, bottom], 2, INK);
        self.write(left as i64 - 46, 12, "Points", INK);
        let width = self.width("Attempt");
        self.write(right as i64 - width, bottom as i64 + 30, "Attempt", INK);
    }

    /// Names of the curves; where there are more than fit, the last line says how many are not
    /// named.
    fn legend(&mut self, curves: &[Curve]) {
        let [rows, columns] = LEGEND;
        let (places, width) = (rows * columns, (SIZE[0] as i64 - 40) / columns as i64);
        let named = if curves.len() > places { places - 1 } else { curves.len() };
        for (i, (curve, colour)) in curves.iter().zip(COLOURS.iter().cycle()).take(named).enumerate() {
            let (x, y) = place_in_legend(i, width);
            self.block(x, y + 2, 12, 12, *colour);
            let mut label = curve.label.clone();
            while self.width(&label) > width - 40 && label.pop().is_some() {}
            self.write(x + 20, y, &label, INK);
        }
        if named < curves.len() {
            let (x, y) = place_in_legend(named, width);
            self.write(x + 20, y, &format!("and {} more", curves.len() - named), INK);
        }
    }
}

fn place_in_legend(i: usize, width: i64) -> (i64, i64) {
    let [rows, _] = LEGEND;
    (20 + (i / rows) as i64 * width, FIELD[3] as i64 + 52 + (i % rows) as i64 * 20)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(label: &str, scores: &[f64]) -> Curve {
        Curve {
            module: "shadow".into(),
            label: label.into(),
            scores: scores.iter().map(|s| (*s, 3.0)).collect(),
        }
    }

    #[test]
    fn points_stand_where_their_scores_are() {
        let picture = plot(&[curve("a", &[0.0, 60.0, 100.0])]);
        for (i, score) in [0.0, 60.0, 100.0].into_iter().enumerate() {
            let (x, y) = (across(i, 3) as u32, up(score) as u32);
            assert_eq!(*picture.get_pixel(x + 3, y + 3), COLOURS[0], "attempt {i}");
        }
        assert_eq!(up(50.0), (FIELD[1] + FIELD[3]) / 2.0);
        assert_eq!(*picture.get_pixel(across(0, 3) as u32, 60), PAPER, "nothing above a score of 0");
        let inked = picture.pixels().filter(|p| **p == COLOURS[1]).count();
        assert_eq!(inked, 0, "one curve, one colour");
    }

    #[test]
    fn each_module_has_a_field_of_its_own() {
        let other = Curve { module: "forceps".into(), ..curve("a", &[20.0]) };
        let two = [curve("a", &[0.0, 60.0]), curve("b", &[90.0])];
        let picture = plot(&[std::slice::from_ref(&other), &two[..]].concat());
        assert_eq!(picture.dimensions(), (SIZE[0], 2 * SIZE[1]));
        let half = |top| image::imageops::crop_imm(&picture, 0, top, SIZE[0], SIZE[1]).to_image();
        assert!(half(0) == plot(&[other]) && half(SIZE[1]) == plot(&two));
        let inked = |picture: &RgbImage| picture.pixels().filter(|p| **p == COLOURS[1]).count();
        assert!(inked(&half(0)) == 0 && inked(&half(SIZE[1])) > 80, "a colour for each trainee");
    }

    #[test]
    fn odd_numbers_and_crowds_are_drawn_too() {
        let crowd: Vec<Curve> =
            (0..40).map(|i| curve(&"wide name ".repeat(12), &[f64::from(i); 300])).collect();
        plot(&crowd);
        plot(&[]);
        plot(&[curve("a", &[f64::NAN, f64::INFINITY, -1e300])]);
    }
}
