//! Grey pictures: reading, smoothing, sampling between pixels.

use anyhow::{Result, anyhow, ensure};
use image::{ImageReader, Limits};
use nalgebra::Vector2;
use protocol::contain::contain;
use protocol::file::{MAX_TABLE_BYTES, looks_like, read_bytes};
use std::io::Cursor;
use std::path::Path;

/// Greatest width and height of a picture, px.
const MAX_PX: u32 = 8192;
/// Memory limit of a decoder, bytes: the largest picture with 8 bits a sample.
const MAX_DECODER_BYTES: u64 = 256 << 20;

/// A grey picture, 0 to 255; the centre of the top-left pixel is (0, 0).
#[derive(Debug, Clone, PartialEq)]
pub struct GreyImage {
    /// Columns.
    pub width: usize,
    /// Lines.
    pub height: usize,
    data: Vec<f32>,
}

impl GreyImage {
    /// From values line by line; missing ones are 0.
    pub fn new(width: usize, height: usize, mut data: Vec<f32>) -> Self {
        data.resize(width * height, 0.0);
        GreyImage { width, height, data }
    }

    /// Reads a PNG or JPEG file.
    ///
    /// # Errors
    /// A file that cannot be read or decoded, or is too small to hold a target.
    pub fn load(path: &Path) -> Result<Self> {
        let file = path.display().to_string();
        let bytes = read_bytes(path, MAX_TABLE_BYTES).map_err(|e| anyhow!("picture {file}: {e}"))?;
        Self::decode(&bytes, &file)
    }

    /// Decodes the bytes of a PNG or JPEG file; `file` is its name in messages.
    ///
    /// # Errors
    /// Bytes that cannot be decoded, or a picture that is too small to hold a target or too large.
    pub fn decode(bytes: &[u8], file: &str) -> Result<Self> {
        let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
        let mut limits = Limits::default();
        (limits.max_image_width, limits.max_image_height) = (Some(MAX_PX), Some(MAX_PX));
        limits.max_alloc = Some(MAX_DECODER_BYTES);
        reader.limits(limits);
        let found = looks_like(bytes);
        let refused = |problem: String| {
            anyhow!(
                "picture {file}: expected a PNG or JPEG of at most {MAX_PX} px per side, found {found}: {problem}"
            )
        };
        ensure!(
            reader.format().is_some(),
            "picture {file}: expected a PNG or JPEG of at most {MAX_PX} px per side, found {found}"
        );
        let picture = contain(|| reader.decode()).map_err(refused)?.map_err(|e| refused(e.to_string()))?;
        let picture = picture.to_luma32f();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        ensure!(
            width >= 16 && height >= 16,
            "picture {file}: expected at least 16×16 pixels, found {width}×{height}"
        );
        Ok(GreyImage::new(width, height, picture.into_raw().into_iter().map(|v| v * 255.0).collect()))
    }

    /// Value of a pixel; beyond the border that of the nearest one.
    pub fn at(&self, x: isize, y: isize) -> f32 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.data[y * self.width + x]
    }

    /// Value between pixels, bilinear.
    pub fn between(&self, p: Vector2<f64>) -> f32 {
        let (x, y) = (p.x.floor(), p.y.floor());
        let (u, v) = ((p.x - x) as f32, (p.y - y) as f32);
        let (x, y) = (x as isize, y as isize);
        let top = self.at(x, y) * (1.0 - u) + self.at(x + 1, y) * u;
        let bottom = self.at(x, y + 1) * (1.0 - u) + self.at(x + 1, y + 1) * u;
        top * (1.0 - v) + bottom * v
    }

    /// Smoothed by a Gaussian of this standard deviation, px.
    pub fn blurred(&self, sigma: f64) -> Self {
        let reach = (3.0 * sigma).ceil() as isize;
        let weight = |i: isize| (-0.5 * (i as f64 / sigma).powi(2)).exp();
        let total: f64 = (-reach..=reach).map(weight).sum();
        let kernel: Vec<f32> = (-reach..=reach).map(|i| (weight(i) / total) as f32).collect();
        let across = self.filtered(&kernel, reach, |picture, x, y, i| picture.at(x + i, y));
        across.filtered(&kernel, reach, |picture, x, y, i| picture.at(x, y + i))
    }

    fn filtered(&self, kernel: &[f32], reach: isize, at: impl Fn(&Self, isize, isize, isize) -> f32) -> Self {
        let mut data = Vec::with_capacity(self.data.len());
        for y in 0..self.height as isize {
            for x in 0..self.width as isize {
                let terms = kernel.iter().zip(-reach..=reach).map(|(k, i)| k * at(self, x, y, i));
                data.push(terms.sum());
            }
        }
        GreyImage { data, ..*self }
    }

    /// Smoothed by a wide Gaussian (standard deviation in px), by way of a smaller picture.
    pub fn ground(&self, sigma: f64) -> Self {
        let (mut level, mut scale) = (self.clone(), 1.0);
        while sigma / scale > 4.0 && level.width.min(level.height) > 32 {
            level = level.halved();
            scale *= 2.0;
        }
        let smooth = level.blurred(sigma / scale);
        let at = |i: usize| Vector2::new((i % self.width) as f64, (i / self.width) as f64);
        let in_level = |p: Vector2<f64>| (p - Vector2::repeat((scale - 1.0) / 2.0)) / scale;
        let data = (0..self.data.len()).map(|i| smooth.between(in_level(at(i)))).collect();
        GreyImage { data, ..*self }
    }

    /// Half as large, each pixel the mean of four.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height as isize {
            for x in 0..width as isize {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
                data.push(four.map(|(i, j)| self.at(2 * x + i, 2 * y + j)).iter().sum::<f32>() / 4.0);
            }
        }
        GreyImage { width, height, data }
    }

    /// Twice as large, between pixels bilinear; pixel k of this one is the mean of 2k and 2k+1.
    pub fn doubled(&self) -> Self {
        let (width, height) = (2 * self.width, 2 * self.height);
        let at = |i: usize| Vector2::new((i % width) as f64, (i / width) as f64) / 2.0;
        let data = (0..width * height).map(|i| self.between(at(i) - Vector2::repeat(0.25))).collect();
        GreyImage { width, height, data }
    }

    /// True if a disc around `p` lies inside.
    pub fn holds(&self, p: Vector2<f64>, radius: f64) -> bool {
        let inside = |v: f64, n: usize| v - radius >= 0.0 && v + radius <= n as f64 - 1.0;
        inside(p.x, self.width) && inside(p.y, self.height)
    }

    /// Slope at a pixel by central differences, per px.
    pub fn slope(&self, x: isize, y: isize) -> Vector2<f64> {
        let across = self.at(x + 1, y) - self.at(x - 1, y);
        let down = self.at(x, y + 1) - self.at(x, y - 1);
        Vector2::new(f64::from(across), f64::from(down)) / 2.0
    }

    /// Grey levels below which (0…1) shares of the pixels lie.
    pub fn quantiles(&self, shares: [f64; 2]) -> [f32; 2] {
        let mut sorted = self.data.clone();
        sorted.sort_by(f32::total_cmp);
        shares.map(|s| sorted[((sorted.len() - 1) as f64 * s.clamp(0.0, 1.0)) as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_stays_a_ramp() {
        let data = (0..40 * 30).map(|i| (2 * (i % 40) + 3 * (i / 40)) as f32).collect();
        let ramp = GreyImage::new(40, 30, data);
        let p = Vector2::new(17.25, 12.5);
        assert!((ramp.between(p) - 72.0).abs() < 1e-4);
        assert!((ramp.blurred(1.5).between(p) - 72.0).abs() < 1e-3);
        let wide = GreyImage::new(200, 160, (0..200 * 160).map(|i| (i % 200) as f32).collect()).ground(10.0);
        assert!((wide.between(Vector2::new(100.0, 80.0)) - 100.0).abs() < 0.1);
        assert!((ramp.slope(20, 15) - Vector2::new(2.0, 3.0)).norm() < 1e-6);
        // The centre of a halved pixel lies half a pixel beside that of its first one.
        assert!((ramp.doubled().between(Vector2::new(16.5, 12.5)) - (2.0 * 8.0 + 3.0 * 6.0)).abs() < 1e-4);
        assert!((ramp.halved().between(Vector2::new(8.0, 6.0)) - (2.0 * 16.5 + 3.0 * 12.5)).abs() < 1e-4);
    }

    #[test]
    fn what_is_no_picture_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.png");
        std::fs::write(&path, b"nothing of the kind").unwrap();
        assert!(GreyImage::load(&path).unwrap_err().to_string().contains("x.png"));
        image::GrayImage::new(4, 4).save(&path).unwrap();
        assert!(GreyImage::load(&path).unwrap_err().to_string().contains("found 4×4"));
    }
}
