//! Pictures of residuals: vectors over the sensor, enlarged, with a bar for scale.

use crate::median;
use crate::target_problem::Residual;
use nalgebra::Vector2;
use plots::{Area, COLOURS, Drawn, FONT, Figure};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

/// Vectors, and the points where they begin.
const VECTOR: RGBColor = COLOURS[1];
const POINT: RGBColor = COLOURS[0];
/// Height of the strip with the bar, px.
const STRIP_PX: u32 = 28;
/// Width of the picture of a sensor, px.
const WIDTH_PX: u32 = 720;
/// A vector of median length is drawn this long, px.
const TYPICAL_PX: f64 = 14.0;

/// The residuals of one camera. Vectors lead from where a point was seen to where it should have been, enlarged;
/// the bar below gives their scale.
pub struct ResidualPicture<'a> {
    /// Of the camera, px.
    pub size_px: [u32; 2],
    /// Those that are drawn.
    pub residuals: &'a [Residual],
}

impl ResidualPicture<'_> {
    /// Picture pixels per pixel of the sensor.
    fn shrink(&self) -> f64 {
        f64::from(WIDTH_PX) / f64::from(self.size_px[0].max(1))
    }

    /// Height of the sensor's picture, px.
    fn height_px(&self) -> u32 {
        // A file may claim any size; a picture is at most ten times as high as wide.
        ((f64::from(self.size_px[1]) * self.shrink()) as u32).clamp(1, 10 * WIDTH_PX)
    }

    /// Picture pixels per px of residual: the median length becomes [`TYPICAL_PX`].
    fn enlargement(&self) -> f64 {
        let median = median(self.residuals.iter().map(|r| r.error.norm())).unwrap_or(1.0);
        TYPICAL_PX / median.clamp(1e-9, 1e6)
    }
}

impl Figure for ResidualPicture<'_> {
    fn size_px(&self) -> (u32, u32) {
        (WIDTH_PX, self.height_px() + STRIP_PX)
    }

    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
        let (sensor, strip) = area.split_vertically(self.height_px());
        let [width, height] = [WIDTH_PX, self.height_px()].map(f64::from);
        let place = Cartesian2d::<RangedCoordf64, RangedCoordf64>::new(
            0.0..width,
            0.0..height,
            (0..WIDTH_PX as i32, 0..self.height_px() as i32),
        );
        let grid = RGBColor(228, 228, 228);
        let sensor = sensor.apply_coord_spec(place);
        for tenth in (1..10).map(|n| f64::from(n) / 10.0) {
            let [x, y] = [width * tenth, height * tenth];
            sensor.draw(&PathElement::new(vec![(x, 0.0), (x, height)], grid))?;
            sensor.draw(&PathElement::new(vec![(0.0, y), (width, y)], grid))?;
        }
        // An outlier's vector may be long; nothing far outside of the picture need be drawn.
        let inside = |p: Vector2<f64>| (p.x.clamp(-width, 2.0 * width), p.y.clamp(-height, 2.0 * height));
        let enlarge = self.enlargement();
        for r in self.residuals.iter().filter(|r| r.pixel.iter().chain(&r.error).all(|v| v.is_finite())) {
            let from = r.pixel * self.shrink();
            // Computed less seen: towards where it should have been.
            let ends = vec![inside(from), inside(from - r.error * enlarge)];
            sensor.draw(&PathElement::new(ends, VECTOR))?;
            sensor.draw(&Circle::new(inside(from), 2, POINT.filled()))?;
        }
        sensor.draw(&Rectangle::new([(0.0, 0.0), (width - 1.0, height - 1.0)], BLACK))?;
        draw_scale(&strip, enlarge)
    }
}

/// The longest of 1, 2, 5·10ⁿ px that fits into 150 px, with its length written beside it.
fn draw_scale<B: DrawingBackend>(strip: &Area<B>, enlarge: f64) -> Drawn<B> {
    let limit = 150.0 / enlarge;
    let ten = 10f64.powf(limit.log10().floor());
    let length = [5.0, 2.0, 1.0].into_iter().map(|n| n * ten).find(|l| *l <= limit).unwrap_or(ten);
    let (x, y) = (12, STRIP_PX as i32 / 2);
    let end = x + (length * enlarge).round() as i32;
    for ends in [[(x, y), (end, y)], [(x, y - 4), (x, y + 4)], [(end, y - 4), (end, y + 4)]] {
        strip.draw(&PathElement::new(ends.to_vec(), VECTOR))?;
    }
    let digits = (-length.log10().floor()).max(0.0) as usize;
    strip.draw(&Text::new(format!("{length:.digits$} px"), (end + 10, y - 7), (FONT, 14)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use plots::{Format, bytes};

    fn residual(x: f64, y: f64, ex: f64) -> Residual {
        Residual { camera: 0, sheet: 0, pixel: Vector2::new(x, y), error: Vector2::new(ex, 0.0) }
    }

    fn drawn(size_px: [u32; 2], residuals: &[Residual]) -> image::RgbImage {
        let png = bytes(&ResidualPicture { size_px, residuals }, Format::Png).unwrap();
        image::load_from_memory(&png).unwrap().to_rgb8()
    }

    #[test]
    fn vectors_lead_from_the_seen_to_the_computed_point() {
        let picture = drawn([720, 576], &[residual(300.0, 200.0, 0.1), residual(100.0, 400.0, 0.1)]);
        assert_eq!(picture.dimensions(), (720, 576 + STRIP_PX));
        let vector = [VECTOR.0, VECTOR.1, VECTOR.2];
        let is_vector = |x: u32, y: u32| picture.get_pixel(x, y).0 == vector;
        assert!(is_vector(290, 200), "seen right of where it should be");
        assert!(!is_vector(310, 200));
        let bar = (0..720).filter(|&x| is_vector(x, 576 + STRIP_PX / 2)).count();
        // 14 px stand for 0.1 px: the bar of 1 px is 140 px long.
        assert!((bar as i64 - 141).abs() <= 2, "{bar}");
    }

    #[test]
    fn no_residual_breaks_it() {
        let odd =
            [residual(-5.0, 1e9, 1e12), residual(f64::NAN, 0.0, f64::INFINITY), residual(0.0, 0.0, 0.0)];
        for n in 0..=odd.len() {
            assert!(drawn([640, 480], &odd[..n]).width() > 0);
        }
        assert_eq!(drawn([1, 4_000_000], &odd).height(), 10 * WIDTH_PX + STRIP_PX);
    }
}
