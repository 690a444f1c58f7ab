//! Pictures as others want them: RGB, scaled, JPEG.

use crate::readback::Picture;
use image::codecs::jpeg::JpegEncoder;

/// Widest small picture, both channels, px.
const SMALL_WIDTH_PX: u32 = 640;
/// Quality of small pictures.
const JPEG_QUALITY: u8 = 80;

/// Without the fourth channel.
pub fn rgb(picture: &Picture) -> Vec<u8> {
    picture.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect()
}

/// `picture` scaled to `width` × `height`, three bytes a pixel, into `out`: bilinear, so that a
/// change of tier changes sharpness and nothing else.
pub fn scale_rgb(picture: &Picture, width: u32, height: u32, out: &mut Vec<u8>) {
    out.clear();
    if (width, height) == (picture.width_px, picture.height_px) {
        return out.extend(picture.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]));
    }
    // Sample positions in 1/256 px of the source.
    let at = |i: u32, n: u32, m: u32| {
        let p =
            (i64::from(2 * i + 1) * i64::from(m) * 128 / i64::from(n) - 128).clamp(0, i64::from(m - 1) * 256);
        ((p >> 8) as u32, (p & 255) as u32)
    };
    for y in 0..height {
        let (y0, fy) = at(y, height, picture.height_px);
        let y1 = (y0 + 1).min(picture.height_px - 1);
        for x in 0..width {
            let (x0, fx) = at(x, width, picture.width_px);
            let x1 = (x0 + 1).min(picture.width_px - 1);
            let (a, b) = (picture.rgb(x0, y0), picture.rgb(x1, y0));
            let (c, d) = (picture.rgb(x0, y1), picture.rgb(x1, y1));
            for i in 0..3 {
                let mix = |p: u8, q: u8| u32::from(p) * (256 - fx) + u32::from(q) * fx;
                let sum = mix(a[i], b[i]) * (256 - fy) + mix(c[i], d[i]) * fy;
                out.push(((sum + 32_768) >> 16) as u8);
            }
        }
    }
}

/// A JPEG of at most [`SMALL_WIDTH_PX`] into `out`.
///
/// # Errors
/// If the encoder refuses the picture.
pub fn small_jpeg(picture: &Picture, out: &mut Vec<u8>) -> Result<(), image::ImageError> {
    let width = picture.width_px.min(SMALL_WIDTH_PX);
    let height = (picture.height_px * width / picture.width_px).max(1);
    let mut pixels = Vec::new();
    scale_rgb(picture, width, height, &mut pixels);
    out.clear();
    JpegEncoder::new_with_quality(out, JPEG_QUALITY).encode(
        &pixels,
        width,
        height,
        image::ExtendedColorType::Rgb8,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width_px: u32, height_px: u32) -> Picture {
        let pixel = |i: u32| [(i % width_px * 10) as u8, (i / width_px * 10) as u8, 7, 255];
        Picture { width_px, height_px, rgba: (0..width_px * height_px).flat_map(pixel).collect() }
    }

    #[test]
    fn the_same_size_is_the_same_picture() {
        let picture = ramp(9, 7);
        let mut out = Vec::new();
        scale_rgb(&picture, 9, 7, &mut out);
        assert_eq!(out, rgb(&picture));
    }

    #[test]
    fn doubling_keeps_ramp_and_ends() {
        let mut out = Vec::new();
        scale_rgb(&ramp(4, 4), 8, 8, &mut out);
        let reds: Vec<u8> = out.chunks(3).take(8).map(|p| p[0]).collect();
        assert_eq!(reds, [0, 3, 8, 13, 18, 23, 28, 30]);
    }

    #[test]
    fn small_pictures_are_jpegs_of_limited_width() {
        let mut out = Vec::new();
        small_jpeg(&ramp(1600, 640), &mut out).unwrap();
        let back = image::load_from_memory(&out).unwrap();
        assert_eq!((back.width(), back.height()), (640, 256));
    }
}
