//! Reads still images: PNG and JPEG, grey or colour, 8 or 16 bits a sample.
//!
//! Opacity and the orientation noted by a photo camera are ignored: the scanner gets the samples as
//! stored. Samples of 16 bits have more range than the scanner's 8: [`Levels`] maps a part of it to
//! black to white.

use super::{Picture, bin_of_rank, check_size};
use crate::colours::convert::{GREY, luma_of_full, ycc_of_rgb};
use anyhow::{Result, anyhow, ensure};
use image::{ColorType, DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use protocol::contain::contain;
use std::io::{BufRead, Seek};
use std::path::Path;

/// Memory limit of a decoder, bytes: the largest picture with 4 samples of 16 bits, and half as
/// much again.
const MAX_DECODER_BYTES: u64 = 384 << 20;
/// Samples of 16 bits without given levels: from the darkest hundredth up to this multiple of the
/// spread between it and the brightest hundredth.
const AUTO_SPREADS: u32 = 8;

/// Samples that become black and white.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Levels {
    /// Largest sample that becomes black.
    pub black: u16,
    /// Least sample that becomes white.
    pub white: u16,
}

impl Levels {
    /// Parses `BLACK:WHITE`.
    ///
    /// # Errors
    /// Where the text is not two numbers from 0 to 65535 in ascending order.
    pub fn parse(text: &str) -> Result<Self, String> {
        let parsed = text.split_once(':').and_then(|(black, white)| {
            Some(Levels { black: black.parse().ok()?, white: white.parse().ok()? })
        });
        parsed.filter(|levels| levels.black < levels.white).ok_or_else(|| {
            format!("expected BLACK:WHITE, two numbers from 0 to 65535, the first lower; found {text:?}")
        })
    }

    /// Levels of samples whose range is unknown: from the 1 % quantile `a` to `a + 8·(b − a)`, with
    /// the 99 % quantile `b`, but at most to the brightest sample. The noise of a dark frame then
    /// has a few grey levels, and what stands out of it is not cut off at once.
    fn of_samples(samples: &[u16]) -> Self {
        let mut counts = vec![0u32; 1 << 16];
        samples.iter().for_each(|&s| counts[usize::from(s)] += 1);
        let quantile = |share: u64| {
            let rank = (samples.len() as u64 * share / 100).min(samples.len() as u64 - 1);
            bin_of_rank(&counts, rank).unwrap_or(0) as u32
        };
        let [low, high, most] = [1, 99, 100].map(quantile);
        let white = (low + AUTO_SPREADS * (high - low).max(1)).min(most).max(low + 1);
        // Only a picture of nothing but 65535 has no room above its darkest sample.
        Levels { black: low.min(65_534) as u16, white: white.min(65_535) as u16 }
    }

    /// Maps a 16-bit sample to 8 bits.
    fn apply(self, sample: u16) -> u8 {
        let range = u32::from(self.white - self.black);
        let above = u32::from(sample.saturating_sub(self.black)).min(range);
        ((above * 255 + range / 2) / range) as u8
    }
}

/// Reads an image into `into`. `levels` are in the file's own samples: 0–255 for 8 bits, 0–65535
/// for 16.
///
/// # Errors
/// A file that cannot be opened, is no PNG or JPEG, is damaged, or exceeds the limits of size.
pub fn read(path: &Path, levels: Option<Levels>, into: &mut Picture) -> Result<()> {
    let opened = protocol::file::open(path).map_err(anyhow::Error::from);
    let decoded = opened.and_then(|file| decode(file, levels, into));
    decoded.map_err(|problem| anyhow!("{}: {problem}", path.display()))
}

/// Decodes an image, as [`read`] does.
///
/// # Errors
/// As [`read`], without the file's name.
pub fn decode(input: impl BufRead + Seek, levels: Option<Levels>, into: &mut Picture) -> Result<()> {
    let mut reader = ImageReader::new(input).with_guessed_format()?;
    ensure!(
        matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)),
        "expected a PNG, a JPEG or a Y4M clip, found something else"
    );
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODER_BYTES);
    reader.limits(limits);
    let damaged = |problem: String| anyhow!("expected a whole PNG or JPEG: {problem}");
    let unreadable = |error: ImageError| damaged(error.to_string());
    let decoder = contain(|| reader.into_decoder()).map_err(damaged)?.map_err(unreadable)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    let colour = decoder.color_type();
    let image = contain(|| DynamicImage::from_decoder(decoder)).map_err(damaged)?.map_err(unreadable)?;
    (into.width, into.height) = (width as usize, height as usize);
    into.as_read.clear();
    if colour.has_color() {
        fill_colour(image, colour, levels, into);
    } else {
        fill_grey(image, colour, levels, into);
    }
    Ok(())
}

fn is_deep(colour: ColorType) -> bool {
    !matches!(colour, ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8)
}

/// Levels of samples of 8 bits, brought to 16 as the decoder does it.
fn deepened(levels: Levels) -> Levels {
    let deep = |level: u16| level.min(255) * 257;
    let black = deep(levels.black).min(254 * 257);
    Levels { black, white: deep(levels.white).max(black + 257) }
}

fn fill_grey(image: DynamicImage, colour: ColorType, levels: Option<Levels>, into: &mut Picture) {
    into.luma.clear();
    if is_deep(colour) || levels.is_some() {
        let samples = image.into_luma16().into_raw();
        let given = levels.map(|l| if is_deep(colour) { l } else { deepened(l) });
        let levels = given.unwrap_or_else(|| Levels::of_samples(&samples));
        into.luma.extend(samples.iter().map(|&s| luma_of_full(levels.apply(s))));
    } else {
        into.luma.extend(image.into_luma8().iter().map(|&s| luma_of_full(s)));
    }
    for plane in [&mut into.blue, &mut into.red] {
        plane.clear();
        plane.resize(into.width.div_ceil(2) * into.height, GREY);
    }
}

fn fill_colour(image: DynamicImage, colour: ColorType, levels: Option<Levels>, into: &mut Picture) {
    let rgb = match levels {
        None => image.into_rgb8().into_raw(),
        Some(levels) => {
            let levels = if is_deep(colour) { levels } else { deepened(levels) };
            image.into_rgb16().iter().map(|&s| levels.apply(s)).collect()
        }
    };
    for plane in [&mut into.luma, &mut into.blue, &mut into.red] {
        plane.clear();
    }
    for line in rgb.chunks_exact(3 * into.width) {
        for pair in line.chunks(6) {
            let pixels = pair.as_chunks().0.iter().map(|&p| ycc_of_rgb(p));
            let (mut sums, n) = ([0u32; 2], pair.len() as u32 / 3);
            for [y, cb, cr] in pixels {
                into.luma.push(y);
                sums = [sums[0] + u32::from(cb), sums[1] + u32::from(cr)];
            }
            into.blue.push(sums[0].div_ceil(n) as u8);
            into.red.push(sums[1].div_ceil(n) as u8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;

    fn read_bytes(bytes: &[u8], levels: Option<Levels>) -> Result<Picture> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        let mut picture = Picture::default();
        read(file.path(), levels, &mut picture).map(|()| picture)
    }

    fn encoded(image: impl Into<DynamicImage>, format: image::ImageFormat) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.into().write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    fn png(image: impl Into<DynamicImage>) -> Vec<u8> {
        encoded(image, image::ImageFormat::Png)
    }

    #[test]
    fn colours_grey_and_opacity_are_read_as_they_lie_in_the_file() {
        let red = image::RgbaImage::from_pixel(3, 2, image::Rgba([255, 0, 0, 7]));
        let picture = read_bytes(&png(red), None).unwrap();
        assert_eq!((picture.width, picture.height, picture.blue.len()), (3, 2, 4));
        assert_eq!(picture.pixel(2, 1), [81, 90, 240]);
        let grey = image::GrayImage::from_pixel(2, 2, image::Luma([255]));
        assert_eq!(read_bytes(&png(grey), None).unwrap().pixel(1, 1), [235, 128, 128]);
        let photo =
            encoded(image::RgbImage::from_pixel(16, 16, image::Rgb([0, 255, 0])), image::ImageFormat::Jpeg);
        let found = read_bytes(&photo, None).unwrap().pixel(5, 5);
        assert!(found.iter().zip([145, 54, 34]).all(|(a, b)| a.abs_diff(b) <= 2), "{found:?}");
    }

    #[test]
    fn sixteen_bits_are_stretched_by_given_levels_or_their_own() {
        let samples: Vec<u16> = (0..10_000).map(|i| 2_000 + (i % 100) as u16).collect();
        let mut star = samples.clone();
        star[5] = 60_000;
        let of = |samples: Vec<u16>| {
            png(image::ImageBuffer::<image::Luma<u16>, _>::from_raw(100, 100, samples).unwrap())
        };
        let picture = read_bytes(&of(star), None).unwrap();
        assert_eq!((picture.luma[5], picture.luma[0]), (235, 16), "the star is white, the ground black");
        let level = picture.luma[99];
        assert!((30..60).contains(&level), "the ground's own spread is an eighth of the range: {level}");
        let given = Levels::parse("2000:2099").unwrap();
        let picture = read_bytes(&of(samples), Some(given)).unwrap();
        assert_eq!([0, 99].map(|i| picture.luma[i]), [16, 235]);
        let flat = read_bytes(&of(vec![65_535; 10_000]), None).unwrap();
        assert!(flat.luma.iter().all(|&s| s == 235));
        assert!(
            Levels::parse("9:9").is_err() && Levels::parse("1").is_err() && Levels::parse("0:70000").is_err()
        );
    }

    #[test]
    fn levels_of_eight_bits_are_in_their_own_samples() {
        let grey = image::GrayImage::from_fn(4, 1, |x, _| image::Luma([10 + 10 * x as u8]));
        let picture = read_bytes(&png(grey), Some(Levels { black: 20, white: 30 })).unwrap();
        assert_eq!(picture.luma, [16, 16, 235, 235]);
    }

    #[test]
    fn a_header_that_claims_too_much_is_refused_before_anything_is_decoded() {
        let mut bytes = png(image::GrayImage::new(2, 2));
        // Width and height follow the signature, the length and the name of the first chunk.
        bytes[16..24].copy_from_slice(&[0, 0, 0x80, 0, 0, 0, 0x80, 0]);
        let checksum = crc32(&bytes[12..29]).to_be_bytes();
        bytes[29..33].copy_from_slice(&checksum);
        let error = read_bytes(&bytes, None).unwrap_err().to_string();
        assert!(error.contains("found 32768x32768"), "{error}");
        for text in ["", "plain text", "YUV4MPEG2"] {
            let error = read_bytes(text.as_bytes(), None).unwrap_err().to_string();
            assert!(error.contains("expected a PNG"), "{error}");
        }
    }

    /// CRC-32 of ISO 3309, bit by bit.
    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ (0xEDB8_8320 & (c & 1).wrapping_neg()))
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn damaged_images_are_read_or_refused(
            jpeg in any::<bool>(), cut in 0usize..2000,
            damage in prop::collection::vec((0usize..2000, any::<u8>()), 0..4),
        ) {
            let image = image::RgbImage::from_fn(17, 13, |x, y| image::Rgb([(x * 15) as u8, (y * 19) as u8, 99]));
            let format = if jpeg { image::ImageFormat::Jpeg } else { image::ImageFormat::Png };
            let mut bytes = encoded(image, format);
            for (at, with) in damage {
                let length = bytes.len();
                bytes[at % length] = with;
            }
            bytes.truncate(bytes.len().saturating_sub(cut % 200));
            if let Ok(picture) = read_bytes(&bytes, None) {
                prop_assert_eq!(picture.luma.len(), picture.width * picture.height);
                prop_assert_eq!(picture.red.len(), picture.chroma_width() * picture.height);
            }
        }
    }
}
