//! Pictures of residuals: vectors over the sensor, enlarged, with a bar for scale.

use crate::median;
use crate::target_problem::Residual;
use image::{Rgb, RgbImage};
use nalgebra::Vector2;

/// Colours: ground, sensor's frame, grid, vectors and their ends.
const GROUND: Rgb<u8> = Rgb([255, 255, 255]);
const FRAME: Rgb<u8> = Rgb([90, 90, 90]);
const GRID: Rgb<u8> = Rgb([228, 228, 228]);
const VECTOR: Rgb<u8> = Rgb([200, 40, 30]);
const POINT: Rgb<u8> = Rgb([30, 60, 160]);
/// Height of the strip with the bar, px.
const STRIP: u32 = 28;
/// Width of the picture of a sensor, px.
const WIDTH: f64 = 720.0;
/// A vector of median length is drawn this long, px.
const TYPICAL: f64 = 14.0;

/// Draws the residuals of one camera. Vectors lead from where a point was seen to where it should
/// have been, `scale`-fold enlarged; the bar below tells the scale.
pub fn residual_picture(size_px: [u32; 2], residuals: &[Residual]) -> RgbImage {
    let [w, h] = size_px.map(|n| f64::from(n.max(1)));
    let shrink = WIDTH / w;
    let (width, height) = (WIDTH as u32, (h * shrink) as u32);
    let mut picture = RgbImage::from_pixel(width, height + STRIP, GROUND);
    for tenth in 1..10 {
        let (x, y) = (f64::from(width * tenth) / 10.0, f64::from(height * tenth) / 10.0);
        line(&mut picture, [Vector2::new(x, 0.0), Vector2::new(x, f64::from(height))], GRID);
        line(&mut picture, [Vector2::new(0.0, y), Vector2::new(f64::from(width), y)], GRID);
    }
    let enlarge = enlargement(residuals);
    for r in residuals {
        let from = r.pixel * shrink;
        // Computed less seen: towards where it should have been.
        line(&mut picture, [from, from - r.error * enlarge], VECTOR);
    }
    for r in residuals {
        let at = r.pixel * shrink;
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            dot(&mut picture, at + Vector2::new(dx - 0.5, dy - 0.5), POINT);
        }
    }
    let corners = [(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)];
    let corners = corners.map(|(x, y)| Vector2::new(f64::from(x), f64::from(y)));
    (0..4).for_each(|i| line(&mut picture, [corners[i], corners[(i + 1) % 4]], FRAME));
    scale_bar(&mut picture, height, enlarge);
    picture
}

/// Picture pixels per px of residual: the median length becomes [`TYPICAL`].
fn enlargement(residuals: &[Residual]) -> f64 {
    let median = median(residuals.iter().map(|r| r.error.norm())).unwrap_or(1.0);
    TYPICAL / median.clamp(1e-9, 1e6)
}

/// The longest of 1, 2, 5·10ⁿ px that fits into 150 px, with its length written beside it.
fn scale_bar(picture: &mut RgbImage, top: u32, enlarge: f64) {
    let limit = 150.0 / enlarge;
    let ten = 10f64.powf(limit.log10().floor());
    let length = [5.0, 2.0, 1.0].into_iter().map(|n| n * ten).find(|l| *l <= limit).unwrap_or(ten);
    let (x, y) = (12.0, f64::from(top) + f64::from(STRIP) / 2.0);
    let end = x + length * enlarge;
    line(picture, [Vector2::new(x, y), Vector2::new(end, y)], VECTOR);
    for at in [x, end] {
        line(picture, [Vector2::new(at, y - 4.0), Vector2::new(at, y + 4.0)], VECTOR);
    }
    let digits = (-length.log10().floor()).max(0.0) as usize;
    write(picture, end + 10.0, y - 7.0, &format!("{length:.digits$} px"));
}

fn dot(picture: &mut RgbImage, at: Vector2<f64>, colour: Rgb<u8>) {
    let inside = |v: f64, n: u32| v >= 0.0 && v < f64::from(n);
    if inside(at.x, picture.width()) && inside(at.y, picture.height()) {
        picture.put_pixel(at.x as u32, at.y as u32, colour);
    }
}

fn line(picture: &mut RgbImage, [from, to]: [Vector2<f64>; 2], colour: Rgb<u8>) {
    // An outlier's vector may be long; nothing outside of the picture need be drawn.
    let steps = (to - from).amax().clamp(1.0, 4000.0).ceil() as usize;
    for i in 0..=steps {
        dot(picture, from + (to - from) * (i as f64 / steps as f64), colour);
    }
}

/// Glyphs of 3×5, a row an octal digit from the top; no font is needed for a number.
const GLYPHS: [(char, u32); 13] = [
    ('0', 0o75557),
    ('1', 0o26227),
    ('2', 0o71747),
    ('3', 0o71717),
    ('4', 0o55711),
    ('5', 0o74717),
    ('6', 0o74757),
    ('7', 0o71122),
    ('8', 0o75757),
    ('9', 0o75717),
    ('.', 0o00002),
    ('p', 0o07574),
    ('x', 0o05225),
];
/// Size of a glyph's cell on the picture, px.
const CELL: u32 = 3;

fn write(picture: &mut RgbImage, x: f64, y: f64, text: &str) {
    for (i, c) in text.chars().enumerate() {
        let Some((_, rows)) = GLYPHS.iter().find(|g| g.0 == c) else { continue };
        for bit in (0..15).filter(|b| rows >> (14 - b) & 1 == 1) {
            let (column, row) = (bit % 3, bit / 3);
            let left = x + f64::from(CELL * (4 * i as u32 + column));
            for cell in 0..CELL * CELL {
                let at = Vector2::new(left + f64::from(cell % CELL), y + f64::from(CELL * row + cell / CELL));
                dot(picture, at, FRAME);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn residual(x: f64, y: f64, ex: f64) -> Residual {
        Residual { camera: 0, sheet: 0, pixel: Vector2::new(x, y), error: Vector2::new(ex, 0.0) }
    }

    #[test]
    fn vectors_lead_from_the_seen_to_the_computed_point() {
        let picture =
            residual_picture([720, 576], &[residual(300.0, 200.0, 0.1), residual(100.0, 400.0, 0.1)]);
        assert_eq!((picture.width(), picture.height()), (720, 576 + STRIP));
        assert_eq!(*picture.get_pixel(290, 200), VECTOR, "seen right of where it should be");
        assert_ne!(*picture.get_pixel(310, 200), VECTOR);
        let bar = (0..720).filter(|&x| *picture.get_pixel(x, 576 + STRIP / 2) == VECTOR).count();
        // 14 px stand for 0.1 px: the bar of 1 px is 140 px long.
        assert!((bar as i64 - 141).abs() <= 2, "{bar}");
    }

    #[test]
    fn no_residual_breaks_it() {
        let odd =
            [residual(-5.0, 1e9, 1e12), residual(f64::NAN, 0.0, f64::INFINITY), residual(0.0, 0.0, 0.0)];
        for n in 0..=odd.len() {
            assert!(residual_picture([640, 480], &odd[..n]).width() > 0);
        }
    }
}
