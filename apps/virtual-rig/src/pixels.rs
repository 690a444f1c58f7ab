//! Fields as a sensor gives them: brightness, RGB, or a mosaic of colours, from the planes that are painted.

use protocol::fields::{FieldPicture, PixelFormat};
use std::ops::Deref;

/// Writes the lines of a picture into a payload of [`PixelFormat::bytes`]. YUYV is painted in place and is not for
/// this function: it is written as planes all the same.
///
/// # Panics
/// If the payload is shorter.
pub fn encode<B: Deref<Target = [u8]>>(format: PixelFormat, picture: &FieldPicture<B>, payload: &mut [u8]) {
    let (width, mosaic) = (picture.width, format.first_red());
    for y in 0..picture.height {
        let (luma, blue, red) = picture.line(y);
        let rgb = |x: usize| rgb_of([luma[x], blue[x / 2], red[x / 2]]);
        match format {
            PixelFormat::Yuyv => {
                let (pixels, samples) = (width * picture.height, width / 2 * picture.height);
                payload[y * width..][..width].copy_from_slice(luma);
                payload[pixels + y * width / 2..][..width / 2].copy_from_slice(blue);
                payload[pixels + samples + y * width / 2..][..width / 2].copy_from_slice(red);
            }
            PixelFormat::Y8 => {
                let row = &mut payload[y * width..][..width];
                row.iter_mut().zip(luma).for_each(|(to, &from)| *to = rgb_of([from, 128, 128])[1]);
            }
            PixelFormat::Rgb8 => {
                let row = payload[3 * y * width..][..3 * width].as_chunks_mut::<3>().0;
                row.iter_mut().enumerate().for_each(|(x, to)| *to = rgb(x));
            }
            _ => {
                let [right, down] = mosaic.unwrap_or([0, 0]);
                let row = &mut payload[y * width..][..width];
                for (x, to) in row.iter_mut().enumerate() {
                    // Red and blue lie on one diagonal of each two by two pixels, green on the other.
                    let filter = (x + right) % 2 + (y + down) % 2;
                    *to = rgb_of([luma[x], chroma_at(blue, x), chroma_at(red, x)])[filter];
                }
            }
        }
    }
}

/// Chroma at a pixel: samples lie on every second one. A filter of the mosaic has a column of its own, and its colour
/// would be beside its place with the sample of the pair.
fn chroma_at(samples: &[u8], x: usize) -> u8 {
    let next = samples[(x / 2 + x % 2).min(samples.len() - 1)];
    samples[x / 2].midpoint(next)
}

/// Red, green, blue (0 to 255) of a studio-range sample of ITU-R BT.601; colours out of range are clamped.
fn rgb_of([y, cb, cr]: [u8; 3]) -> [u8; 3] {
    const FRACTION: u32 = 16;
    // 255/219; 1.402, 0.344136, 0.714136 and 1.772 times 255/224; in 2⁻¹⁶.
    let y = (i32::from(y) - 16) * 76_309;
    let [cb, cr] = [cb, cr].map(|c| i32::from(c) - 128);
    let sums = [y + 104_597 * cr, y - 25_675 * cb - 53_279 * cr, y + 132_202 * cb];
    sums.map(|s| ((s + (1 << (FRACTION - 1))) >> FRACTION).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six by two pixels: two red pairs and a grey pair.
    fn picture() -> FieldPicture {
        let mut picture = FieldPicture::of_size([6, 2]);
        picture.luma = [81, 81, 81, 81, 126, 126].repeat(2);
        (picture.blue, picture.red) = ([90, 90, 128].repeat(2), [240, 240, 128].repeat(2));
        picture
    }

    fn encoded(format: PixelFormat) -> Vec<u8> {
        let mut payload = vec![0; format.bytes(6, 2)];
        encode(format, &picture(), &mut payload);
        payload
    }

    /// Colour that rises along a line rises as evenly behind filters of odd columns as behind those of even ones.
    #[test]
    fn the_colours_of_a_mosaic_are_those_of_its_own_pixels() {
        let mut picture = FieldPicture::of_size([16, 2]);
        picture.luma.fill(126);
        picture.blue = (0..16).map(|i| 100 + 8 * (i as u8 % 8)).collect();
        picture.red.fill(128);
        let blues = |format: PixelFormat, line: usize, first: usize| -> Vec<u8> {
            let mut payload = vec![0; format.bytes(16, 2)];
            encode(format, &picture, &mut payload);
            payload[16 * line..][first..16].iter().step_by(2).copied().collect()
        };
        let (even, odd) = (blues(PixelFormat::BayerBg8, 0, 0), blues(PixelFormat::BayerRg8, 1, 1));
        for (pair, between) in even.windows(2).zip(&odd) {
            assert!(between.abs_diff(pair[0].midpoint(pair[1])) <= 1, "{even:?} {odd:?}");
            assert!(pair[0] < *between && *between < pair[1], "{even:?} {odd:?}");
        }
    }

    #[test]
    fn red_and_grey_come_out_in_every_format() {
        let [red, grey] = [[254, 0, 0], [128, 128, 128]];
        let rgb: Vec<u8> = [red, red, red, red, grey, grey].repeat(2).concat();
        let found = encoded(PixelFormat::Rgb8);
        assert!(found.iter().zip(&rgb).all(|(a, b)| a.abs_diff(*b) <= 1), "{found:?}");
        assert_eq!(encoded(PixelFormat::Y8), [76, 76, 76, 76, 128, 128].repeat(2));
        let mosaics = [
            (PixelFormat::BayerRg8, [1, 0, 9, 9, 0, 0, 9, 9]),
            (PixelFormat::BayerGr8, [0, 1, 9, 9, 0, 0, 9, 9]),
            (PixelFormat::BayerGb8, [0, 0, 9, 9, 1, 0, 9, 9]),
            (PixelFormat::BayerBg8, [0, 0, 9, 9, 0, 1, 9, 9]),
        ];
        for (format, bright) in mosaics {
            // Between red and grey, the fourth pixel has a colour of both.
            let pixels = encoded(format).into_iter().enumerate().filter(|(i, _)| ![2, 3].contains(&(i % 6)));
            let found = pixels.map(|(_, v)| match v {
                250.. => 1,
                0 => 0,
                _ => 9,
            });
            assert!(found.eq(bright), "{format:?}: {:?}", encoded(format));
        }
        let planes = encoded(PixelFormat::Yuyv);
        assert_eq!((&planes[..12], &planes[12..18]), (&picture().luma[..], &picture().blue[..]));
    }
}
