//! The map that is laid on the retina, made from the fundus photograph at start-up.
//!
//! The photograph shows a round part of an eye about its fovea ([`crate::photograph`]). The map is
//! in Lambert's azimuthal equal-area projection about the posterior pole, so that the shader finds
//! its coordinates with one inverse square root. What lies beyond the photograph's border is grown by
//! procedure ([`crate::periphery`]).
//!
//! The map's fourth channel is the height of vessels, found as what is darker than its
//! surroundings in green, where blood absorbs most. The same difference sharpens the picture.

use crate::periphery::{Periphery, Place};
use crate::photograph::Photograph;
use scene::Side;

/// Radius of the retina for which the map is made, mm: sizes on it are right in other eyes as angles.
pub const RADIUS_MM: f32 = 11.5;

/// The map reaches to this angle from the pole, rad.
const MAP_ANGLE: f32 = 2.4;
/// Half width of the surroundings with which vessels are compared, share of the retina's radius.
const SURROUNDINGS: f32 = 0.030;
/// Difference to the surroundings (of 255) at which a vessel has its full height.
const FULL_HEIGHT: f32 = 26.0;
/// How much more strongly the picture shows its differences to the surroundings.
const SHARPER: [f32; 3] = [0.20, 0.35, 0.25];

/// Map coordinates (0 to 1) per unit of equal-area radius: the shader's scale.
pub fn map_scale() -> f32 {
    0.5 / equal_area(MAP_ANGLE)
}

/// Map coordinates (0 to 1) of the direction of `position` from the eye's centre, as the shader
/// finds them.
pub fn coordinates(position: [f32; 3]) -> [f32; 2] {
    let [x, y, z] = position;
    let length = (x * x + y * y + z * z).sqrt().max(1e-6);
    let scale = map_scale() / (length * (0.5 - 0.5 * z / length).max(1e-4).sqrt());
    [x, y].map(|c| 0.5 + c * scale)
}

/// Radius 2 sin(θ/2) at which the projection shows the angle θ from the pole.
fn equal_area(theta: f32) -> f32 {
    2.0 * (0.5 * theta).sin()
}

/// A square map of `size` pixels, RGBA, rows from eye −y to +y, columns from eye −x to +x.
pub fn bake(photograph: &Photograph, size: u32, side: Side) -> Vec<u8> {
    let periphery = Periphery::grow(photograph, size as usize, side);
    let temporal = if side == Side::Left { 1.0 } else { -1.0 };
    let mut out = Vec::with_capacity((size * size * 4) as usize);
    for row in 0..size {
        for column in 0..size {
            let at = |i: u32| ((i as f32 + 0.5) / size as f32 - 0.5) / map_scale();
            let (x, y) = (at(column), at(row));
            let rho = (x * x + y * y).sqrt().min(2.0);
            let canonical = [temporal * x, -y].map(|c| c / rho.max(1e-6));
            let place = Place { canonical, theta: 2.0 * (0.5 * rho).asin() };
            let (border, border_rad) = photograph.border(photograph.towards(canonical));
            let inside = photograph.colour(canonical, border * (place.theta / border_rad).min(1.0));
            let rgb = periphery.colour(inside, place, border_rad, (row * size + column) as usize);
            out.extend(rgb.map(|c| (c + 0.5) as u8));
            out.push(0);
        }
    }
    raise_vessels(&mut out, size as usize);
    out
}

/// Fills the fourth channel with the height of vessels, and sharpens the others.
fn raise_vessels(pixels: &mut [u8], size: usize) {
    let half = (SURROUNDINGS * map_scale() * size as f32).round().max(1.0) as usize;
    let means: [Vec<f32>; 3] = std::array::from_fn(|c| {
        let mut plane: Vec<f32> = pixels.chunks_exact(4).map(|p| f32::from(p[c])).collect();
        // Twice along rows, with rows and columns exchanged in between: a square of means.
        for _ in 0..2 {
            plane = means_along_rows(&plane, size, half);
        }
        plane
    });
    for (i, pixel) in pixels.chunks_exact_mut(4).enumerate() {
        let darker: [f32; 3] = std::array::from_fn(|c| means[c][i] - f32::from(pixel[c]));
        for c in 0..3 {
            pixel[c] = (f32::from(pixel[c]) - SHARPER[c] * darker[c]).clamp(0.0, 255.0) as u8;
        }
        pixel[3] = (darker[1] / FULL_HEIGHT * 255.0).clamp(0.0, 255.0) as u8;
    }
}

/// Means over `half` pixels to both sides along each row, given back with rows and columns
/// exchanged.
fn means_along_rows(plane: &[f32], size: usize, half: usize) -> Vec<f32> {
    let mut out = vec![0.0; plane.len()];
    for (y, row) in plane.chunks_exact(size).enumerate() {
        let at = |i: isize| row[i.clamp(0, size as isize - 1) as usize];
        let reach = half as isize;
        let mut sum: f32 = (-reach..=reach).map(at).sum();
        for x in 0..size {
            out[x * size + y] = sum / (2 * half + 1) as f32;
            sum += at(x as isize + reach + 1) - at(x as isize - reach);
        }
    }
    out
}

/// The next smaller mip level of a square RGBA picture of `size` pixels.
pub fn half(pixels: &[u8], size: u32) -> Vec<u8> {
    let (n, stride) = ((size / 2).max(1) as usize, size as usize * 4);
    let mut out = Vec::with_capacity(n * n * 4);
    for y in 0..n {
        for x in 0..n * 4 {
            let at = 2 * y * stride + (x / 4) * 8 + x % 4;
            let sum =
                [at, at + 4, at + stride, at + stride + 4].map(|i| u16::from(pixels[i])).iter().sum::<u16>();
            out.push(((sum + 2) / 4) as u8);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::shipped_photograph;
    use crate::periphery::ORA_ANGLE;
    use crate::photograph::{FIELD_ANGLE, FIELD_RADIUS};
    use image::RgbImage;

    fn shipped() -> Photograph {
        Photograph::new(shipped_photograph().unwrap())
    }

    /// Brightest place of the green channel, smoothed: the optic disc. Map coordinates −1 to 1.
    fn disc(side: Side) -> [f32; 2] {
        let size = 128u32;
        let map = bake(&shipped(), size, side);
        let green = |x: u32, y: u32| u32::from(map[((y * size + x) * 4 + 1) as usize]);
        let score = |x: u32, y: u32| {
            (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| green(x + i, y + j)).sum::<u32>()
        };
        // The sclera is bright too, but lies at the border.
        let places = (size / 4..size * 3 / 4).flat_map(|y| (size / 4..size * 3 / 4).map(move |x| (x, y)));
        let (x, y) = places.max_by_key(|&(x, y)| score(x, y)).unwrap();
        [x, y].map(|c| (c as f32 + 1.5) / size as f32 * 2.0 - 1.0)
    }

    #[test]
    fn optic_disc_is_nasal_at_its_distance() {
        let right = disc(Side::Right);
        assert!(right[0] > 0.15, "nasal is +x in a right eye: {right:?}");
        assert!(disc(Side::Left)[0] < -0.15, "and −x in a left one");
        let rho = (right[0] * right[0] + right[1] * right[1]).sqrt() * equal_area(MAP_ANGLE);
        let arc_mm = 11.5 * 2.0 * (0.5 * rho).asin();
        assert!((3.6..5.4).contains(&arc_mm), "disc to fovea {arc_mm} mm");
    }

    /// Red, green, blue and height at the angle `theta` from the pole towards eye (x, y).
    fn at(map: &[u8], size: u32, theta: f32, unit: [f32; 2]) -> [u8; 4] {
        let place = unit.map(|c| ((0.5 + c * equal_area(theta) * map_scale()) * size as f32) as u32);
        let i = ((place[1] * size + place[0]) * 4) as usize;
        [map[i], map[i + 1], map[i + 2], map[i + 3]]
    }

    #[test]
    fn the_retina_ends_at_the_ora_serrata() {
        let size = 256;
        let map = bake(&shipped(), size, Side::Right);
        for unit in [[1.0, 0.0], [0.0, 1.0], [-0.6, 0.8], [0.6, -0.8]] {
            let [retina, plana, sclera] =
                [-0.15, 0.15, 0.36].map(|past| at(&map, size, ORA_ANGLE + past, unit));
            assert!(retina[0] > 130 && retina[0] > 2 * retina[1], "orange: {retina:?}");
            assert!((60..130).contains(&plana[0]) && plana[1] < 80, "brown: {plana:?}");
            assert!(sclera[1] > 140, "white: {sclera:?}");
        }
    }

    #[test]
    fn vessels_stand_out_and_flat_colour_does_not() {
        // A dark line on an even ground, away from the fovea.
        let mut photograph = RgbImage::from_pixel(1024, 1024, image::Rgb([180, 80, 50]));
        (0..1024)
            .for_each(|y| (700..706).for_each(|x| photograph.put_pixel(x, y, image::Rgb([140, 40, 35]))));
        let photograph = Photograph::new(photograph);
        let (size, map) = (1024, bake(&photograph, 1024, Side::Left));
        let theta = (702.5 / 1024.0 - photograph.fovea[0]) / FIELD_RADIUS * FIELD_ANGLE;
        let heights: Vec<u8> = [-0.05, -0.02, 0.0].map(|d| at(&map, size, theta + d, [1.0, 0.0])[3]).to_vec();
        assert!(heights[0] < 30 && heights[2] > 180, "{heights:?}");
        let vessel = at(&map, size, theta, [1.0, 0.0]);
        assert!(vessel[1] < 40, "sharper than the photograph: {vessel:?}");
    }

    #[test]
    fn half_averages_four() {
        let pixels: Vec<u8> = (0..16u8).flat_map(|i| [i * 10, 0, 0, 255]).collect();
        assert_eq!(&half(&pixels, 4)[..4], &[25, 0, 0, 255]);
        assert_eq!(half(&pixels, 4).len(), 16);
    }
}
