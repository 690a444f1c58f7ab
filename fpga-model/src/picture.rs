//! Draws what a camera sees in one field: noise in the dark, and markers as soft-edged, shaded discs.
//!
//! Pixels are YCbCr 4:2:2 in planes. A noise tile is drawn once from the seed; a field copies a
//! stretch of it that changes from field to field, and draws only around the markers.

use crate::colours::{DARK, reference};
use crate::sight::MarkerImage;
use nalgebra::{Matrix2, Vector2};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Noise of luma and chroma, grey levels (σ).
const NOISE: [f64; 2] = [2.5, 1.5];
/// How far the stretch of noise can be shifted, samples.
const SHIFTS: usize = 1 << 14;
/// Width of a marker's edge in luma, px of the field: a pixel's own size and the lens's blur.
const EDGE_PX: f64 = 2.4;
/// Width of a marker's edge in chroma, px: PAL carries colour with about 1.3 MHz, a tenth of the clock.
const CHROMA_EDGE_PX: f64 = 7.0;
/// Share by which a marker is darker at its rim than in its middle.
const RIM_SHADE: f64 = 0.05;
/// Share by which the side towards the lamp is brighter.
const SIDE_SHADE: f64 = 0.03;

/// One field's pixels.
#[derive(Debug, Clone)]
pub struct FieldPicture {
    /// Pixels a line; even.
    pub width: usize,
    /// Lines of the field.
    pub height: usize,
    /// `width × height`.
    pub luma: Vec<u8>,
    /// `width/2 × height`, Cb.
    pub blue: Vec<u8>,
    /// `width/2 × height`, Cr.
    pub red: Vec<u8>,
}

impl FieldPicture {
    /// A black field for frames of `frame_px`; an odd width loses its last column.
    pub fn new(frame_px: [u32; 2]) -> Self {
        let (width, height) = (frame_px[0] as usize & !1, frame_px[1] as usize / 2);
        let chroma = vec![128; width / 2 * height];
        FieldPicture { width, height, luma: vec![DARK; width * height], blue: chroma.clone(), red: chroma }
    }

    /// A line of the field: luma, Cb, Cr.
    pub fn line(&self, y: usize) -> (&[u8], &[u8], &[u8]) {
        let (w, c) = (self.width, self.width / 2);
        (&self.luma[y * w..(y + 1) * w], &self.blue[y * c..(y + 1) * c], &self.red[y * c..(y + 1) * c])
    }
}

/// Draws fields of one size.
pub struct Painter {
    /// Noise about 0, long enough for every shift.
    luma_noise: Vec<i8>,
    chroma_noise: Vec<i8>,
    /// The same over the dark background.
    luma_tile: Vec<u8>,
    chroma_tile: Vec<u8>,
    seed: u64,
}

impl Painter {
    /// Prepares the noise for frames of `frame_px`.
    pub fn new(frame_px: [u32; 2], seed: u64) -> Self {
        let luma = (frame_px[0] * frame_px[1] / 2) as usize + SHIFTS;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let luma_noise = noise(&mut random, luma, NOISE[0]);
        let chroma_noise = noise(&mut random, luma, NOISE[1]);
        let over =
            |ground: u8, noise: &[i8]| noise.iter().map(|&n| ground.saturating_add_signed(n)).collect();
        Painter {
            luma_tile: over(DARK, &luma_noise),
            chroma_tile: over(128, &chroma_noise),
            luma_noise,
            chroma_noise,
            seed,
        }
    }

    /// Draws field `number` of camera `camera`: the lines `2·y + parity` of the frame. Markers come
    /// farthest first, so that near ones hide far ones.
    pub fn draw(&self, markers: &[MarkerImage], camera: u32, number: u64, picture: &mut FieldPicture) {
        let shift = |salt: u64| {
            let key = self.seed ^ number.wrapping_mul(3) ^ (u64::from(camera) << 40) ^ (salt << 50);
            (scatter(key) as usize) % SHIFTS
        };
        let shifts = [shift(0), shift(1), shift(2)];
        let copy = |to: &mut [u8], tile: &[u8], from: usize| to.copy_from_slice(&tile[from..from + to.len()]);
        copy(&mut picture.luma, &self.luma_tile, shifts[0]);
        copy(&mut picture.blue, &self.chroma_tile, shifts[1]);
        copy(&mut picture.red, &self.chroma_tile, shifts[2]);
        for marker in markers {
            if let Some(disc) = Disc::of(marker, (number & 1) as f64) {
                self.draw_luma(&disc, shifts[0], picture);
                self.draw_chroma(&disc, [shifts[1], shifts[2]], picture);
            }
        }
    }

    fn draw_luma(&self, disc: &Disc, shift: usize, picture: &mut FieldPicture) {
        let (width, height) = (picture.width, picture.height);
        let light = f64::from(disc.colour[0]);
        let [xs, ys] = disc.box_px(EDGE_PX, width, height);
        for y in ys {
            for x in xs.clone() {
                let seen = disc.at(x as f64, y as f64, EDGE_PX);
                if seen.cover > 0.0 {
                    let i = y * width + x;
                    let grain = f64::from(self.luma_noise[shift + i]);
                    picture.luma[i] = over(picture.luma[i], light * seen.shade + grain, seen.cover);
                }
            }
        }
    }

    fn draw_chroma(&self, disc: &Disc, shifts: [usize; 2], picture: &mut FieldPicture) {
        let width = picture.width / 2;
        let [xs, ys] = disc.box_px(CHROMA_EDGE_PX, picture.width, picture.height);
        for y in ys {
            // A chroma sample lies on every second pixel.
            for x in xs.start / 2..xs.end.div_ceil(2).min(width) {
                let cover = disc.at(2.0 * x as f64, y as f64, CHROMA_EDGE_PX).cover;
                let i = y * width + x;
                let planes = [&mut picture.blue[i], &mut picture.red[i]];
                for ((pixel, shift), colour) in planes.into_iter().zip(shifts).zip(&disc.colour[1..]) {
                    let grain = f64::from(self.chroma_noise[shift + i]);
                    *pixel = over(*pixel, f64::from(*colour) + grain, cover);
                }
            }
        }
    }
}

/// A pixel with a share `cover` of it under `colour`.
fn over(pixel: u8, colour: f64, cover: f64) -> u8 {
    let ground = f64::from(pixel);
    // `as` saturates at 0 and 255, as the converter does.
    (ground + (colour - ground) * cover + 0.5) as u8
}

/// Gaussian noise as the sum of twelve uniform bytes (Irwin–Hall), which is fast and bounded.
fn noise(random: &mut ChaCha8Rng, n: usize, sigma: f64) -> Vec<i8> {
    // Twelve uniform bytes have variance 12·(256² − 1)/12.
    let unit = sigma / 255.998;
    let one = |_| {
        let sum: u32 =
            (0..3).map(|_| random.next_u32().to_le_bytes().map(u32::from).iter().sum::<u32>()).sum();
        ((f64::from(sum) - 12.0 * 127.5) * unit).round() as i8
    };
    (0..n).map(one).collect()
}

/// A well mixed number from any number (SplitMix64's finaliser, Steele et al. 2014).
fn scatter(key: u64) -> u64 {
    let mut z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// How much of a pixel a disc covers, and how bright it is there.
struct Seen {
    cover: f64,
    shade: f64,
}

/// A marker in pixels of one field.
struct Disc {
    colour: [u8; 3],
    centre: Vector2<f64>,
    half: Vector2<f64>,
    /// Inverse shape: `dᵀ·metric·d = 1` on the outline.
    metric: Matrix2<f64>,
}

impl Disc {
    fn of(marker: &MarkerImage, parity: f64) -> Option<Self> {
        // Lines of the field lie two lines of the frame apart.
        let squeeze = Matrix2::new(1.0, 0.0, 0.0, 0.5);
        let shape = squeeze * marker.shape_px2 * squeeze;
        Some(Disc {
            colour: reference(marker.colour),
            centre: Vector2::new(marker.centre_px.x, (marker.centre_px.y - parity) / 2.0),
            half: Vector2::new(shape.m11.sqrt(), shape.m22.sqrt()),
            metric: shape.try_inverse()?,
        })
    }

    /// Columns and lines that the disc with its edge can reach.
    fn box_px(&self, edge: f64, width: usize, height: usize) -> [std::ops::Range<usize>; 2] {
        let range = |centre: f64, half: f64, n: usize| {
            let from = (centre - half - edge).floor().max(0.0) as usize;
            let to = (centre + half + edge).ceil().max(0.0) as usize + 1;
            from.min(n)..to.min(n)
        };
        [range(self.centre.x, self.half.x, width), range(self.centre.y, self.half.y, height)]
    }

    /// The disc at a pixel of the field, its edge `edge` px wide.
    fn at(&self, x: f64, y: f64, edge: f64) -> Seen {
        let d = Vector2::new(x, y) - self.centre;
        let slope = self.metric * d;
        let q = d.dot(&slope);
        // Distance from the outline in px to first order: (ρ − 1)/|∇ρ| with ρ² = q, ∇ρ = slope/ρ.
        let steep = slope.norm_squared();
        let outside = if steep > 0.0 { (q - q.sqrt()) / steep.sqrt() } else { -edge };
        let s = (0.5 - outside / edge).clamp(0.0, 1.0);
        let shade = 1.0 - RIM_SHADE * q.min(1.0) + SIDE_SHADE * (d.x / self.half.x).clamp(-1.0, 1.0);
        Seen { cover: s * s * (3.0 - 2.0 * s), shade }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::blobs::Colour;

    fn marker(x: f64, y: f64) -> MarkerImage {
        MarkerImage {
            body: 0,
            marker: 0,
            colour: Colour::Green,
            centre_px: Vector2::new(x, y),
            shape_px2: Matrix2::new(100.0, 5.0, 5.0, 110.0),
            depth_mm: 80.0,
        }
    }

    #[test]
    fn background_is_dark_noise_that_changes() {
        let painter = Painter::new([720, 576], 5);
        let mut picture = FieldPicture::new([720, 576]);
        painter.draw(&[], 0, 0, &mut picture);
        let first = picture.luma.clone();
        let mean = first.iter().map(|&v| f64::from(v)).sum::<f64>() / first.len() as f64;
        let variance = first.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / first.len() as f64;
        assert!((mean - f64::from(DARK)).abs() < 0.1 && (variance.sqrt() - NOISE[0]).abs() < 0.2);
        painter.draw(&[], 0, 2, &mut picture);
        assert_ne!(first, picture.luma);
        painter.draw(&[], 0, 0, &mut picture);
        assert_eq!(first, picture.luma, "the same field looks the same");
    }

    #[test]
    fn parity_decides_the_lines() {
        let painter = Painter::new([720, 576], 5);
        let mut picture = FieldPicture::new([720, 576]);
        for number in [4u64, 5] {
            let parity = (number & 1) as f64;
            painter.draw(&[marker(300.0, 200.0 + parity)], 0, number, &mut picture);
            let rows: Vec<usize> = (0..288).filter(|y| picture.luma[y * 720 + 300] > 90).collect();
            assert_eq!((rows[0] + rows[rows.len() - 1]) / 2, 100, "line (200 + parity − parity)/2");
        }
    }

    #[test]
    fn markers_at_and_beyond_every_border_do_not_panic() {
        let painter = Painter::new([64, 48], 5);
        let mut picture = FieldPicture::new([64, 48]);
        for x in -40..110 {
            for y in -40..90 {
                painter.draw(&[marker(f64::from(x), f64::from(y))], 0, 1, &mut picture);
            }
        }
    }
}
