//! Samples as cameras of this machine pack them (Video4Linux2), made planes.

use super::{Picture, check_size};
use crate::pixels;
use anyhow::{Result, ensure};
use protocol::fields::{FieldHeader, FieldPicture, PixelFormat};

/// How samples are packed, by the kernel's names of four letters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// Y Cb Y Cr.
    Yuyv,
    /// Cb Y Cr Y.
    Uyvy,
    /// One of the formats of a rig that has one or three samples a pixel.
    Plain(PixelFormat),
}

impl Packing {
    /// Every packing that is understood.
    pub const ALL: [Packing; 8] = {
        use PixelFormat::*;
        let plain = Packing::Plain;
        let (rg, bg, gr, gb) = (plain(BayerRg8), plain(BayerBg8), plain(BayerGr8), plain(BayerGb8));
        [Packing::Yuyv, Packing::Uyvy, plain(Y8), plain(Rgb8), rg, bg, gr, gb]
    };

    /// Its four letters.
    pub fn fourcc(self) -> [u8; 4] {
        *match self {
            Packing::Yuyv => b"YUYV",
            Packing::Uyvy => b"UYVY",
            Packing::Plain(PixelFormat::Yuyv) => b"422P",
            Packing::Plain(PixelFormat::Y8) => b"GREY",
            Packing::Plain(PixelFormat::Rgb8) => b"RGB3",
            Packing::Plain(PixelFormat::BayerRg8) => b"RGGB",
            Packing::Plain(PixelFormat::BayerBg8) => b"BA81",
            Packing::Plain(PixelFormat::BayerGr8) => b"GRBG",
            Packing::Plain(PixelFormat::BayerGb8) => b"GBRG",
        }
    }

    /// By its four letters.
    pub fn of_fourcc(letters: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.fourcc() == letters)
    }

    /// What a camera whose rig says `format` is asked for, the best first.
    pub fn wanted(format: PixelFormat) -> &'static [Packing] {
        const YUV: [Packing; 2] = [Packing::Yuyv, Packing::Uyvy];
        match format {
            PixelFormat::Yuyv => &YUV,
            other => {
                let at = Self::ALL.iter().position(|p| *p == Packing::Plain(other)).unwrap_or(0);
                &Self::ALL_STATIC[at..=at]
            }
        }
    }

    const ALL_STATIC: &'static [Packing] = &Self::ALL;

    /// Bytes that a line has at least.
    fn line_bytes(self, width: usize) -> usize {
        match self {
            Packing::Yuyv | Packing::Uyvy => width.div_ceil(2) * 4,
            Packing::Plain(format) => format.bytes(width, 1),
        }
    }
}

/// How the samples of a picture lie in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Pixels a line.
    pub width: usize,
    /// Lines.
    pub height: usize,
    packing: Packing,
    bytes_per_line: usize,
}

impl Layout {
    /// As a driver says it; `bytes_per_line` 0 is that of lines without padding.
    ///
    /// # Errors
    /// A size that is no picture's, or lines that do not hold their samples.
    pub fn of(packing: Packing, width: u32, height: u32, bytes_per_line: u32) -> Result<Self> {
        check_size(width.into(), height.into())?;
        let [width, height, bytes] = [width, height, bytes_per_line].map(|v| v as usize);
        let least = packing.line_bytes(width);
        let bytes = if bytes == 0 { least } else { bytes };
        ensure!(bytes >= least, "expected at least {least} bytes a line, found {bytes}");
        let pairs = matches!(packing, Packing::Yuyv | Packing::Uyvy);
        ensure!(pairs || width.is_multiple_of(2), "expected an even width, found {width} px");
        Ok(Layout { width, height, packing, bytes_per_line: bytes })
    }

    /// Bytes of a picture.
    pub fn bytes(&self) -> usize {
        self.bytes_per_line * self.height
    }

    /// Fills `into`.
    ///
    /// # Errors
    /// Fewer bytes than a picture has.
    pub fn unpack(&self, bytes: &[u8], into: &mut Picture) -> Result<()> {
        // The padding of the last line may be absent.
        let least = self.bytes() - self.bytes_per_line + self.packing.line_bytes(self.width);
        let (expected, found) = (self.bytes(), bytes.len());
        ensure!(found >= least, "expected {expected} bytes of samples, found {found}");
        into.as_read.clear();
        (into.width, into.height) = (self.width, self.height);
        match self.packing {
            Packing::Yuyv => self.unpack_pairs(bytes, into, |[y0, blue, y1, red]| [y0, y1, blue, red]),
            Packing::Uyvy => self.unpack_pairs(bytes, into, |[blue, y0, red, y1]| [y0, y1, blue, red]),
            Packing::Plain(format) => self.unpack_plain(format, bytes, into),
        }
        Ok(())
    }

    fn unpack_pairs(&self, bytes: &[u8], into: &mut Picture, order: impl Fn([u8; 4]) -> [u8; 4]) {
        for plane in [&mut into.luma, &mut into.blue, &mut into.red] {
            plane.clear();
        }
        for line in bytes.chunks(self.bytes_per_line).take(self.height) {
            let pairs = line.as_chunks::<4>().0.iter().take(self.width.div_ceil(2));
            for (i, &pair) in pairs.enumerate() {
                let [y0, y1, blue, red] = order(pair);
                into.luma.push(y0);
                if 2 * i + 1 < self.width {
                    into.luma.push(y1);
                }
                into.blue.push(blue);
                into.red.push(red);
            }
        }
    }

    fn unpack_plain(&self, format: PixelFormat, bytes: &[u8], into: &mut Picture) {
        let least = self.packing.line_bytes(self.width);
        let without_padding;
        let samples = if self.bytes_per_line == least {
            bytes
        } else {
            let lines = bytes.chunks(self.bytes_per_line).take(self.height);
            without_padding = lines.flat_map(|line| &line[..least]).copied().collect::<Vec<u8>>();
            &without_padding
        };
        let [width, height] = [self.width, self.height].map(|n| n as u32);
        let (pixels, format) = (self.width * self.height, format as u32);
        let header = FieldHeader { format, width, height, lines: height, ..bytemuck::Zeroable::zeroed() };
        into.luma.resize(pixels, 0);
        into.blue.resize(pixels / 2, 0);
        into.red.resize(pixels / 2, 0);
        let [luma, blue, red] = [&mut into.luma, &mut into.blue, &mut into.red].map(std::mem::take);
        let mut planes = FieldPicture { width: self.width, height: self.height, luma, blue, red };
        let decoded = pixels::decode(&header, samples, &mut planes);
        debug_assert_eq!(decoded, Some(self.height), "the bytes were counted");
        (into.luma, into.blue, into.red) = (planes.luma, planes.blue, planes.red);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colours::convert::{GREY, WHITE, ycc_of_rgb};
    use proptest::prelude::*;

    #[test]
    fn lines_are_taken_apart_without_their_padding() {
        let layout = Layout::of(Packing::Yuyv, 3, 2, 10).unwrap();
        let bytes: Vec<u8> = (0..20).collect();
        let mut picture = Picture::default();
        layout.unpack(&bytes, &mut picture).unwrap();
        assert_eq!(picture.luma, [0, 2, 4, 10, 12, 14]);
        assert_eq!((&picture.blue[..], &picture.red[..]), (&[1, 5, 11, 15][..], &[3, 7, 13, 17][..]));
        let told = layout.unpack(&bytes[..17], &mut picture).unwrap_err().to_string();
        assert!(told.contains("expected 20 bytes of samples, found 17"), "{told}");
        let of = |width, height, bytes| Layout::of(Packing::Yuyv, width, height, bytes);
        assert!(of(3, 2, 7).is_err() && of(0, 2, 8).is_err());
        assert!(Layout::of(Packing::Plain(PixelFormat::Y8), 3, 2, 3).is_err());
    }

    #[test]
    fn every_packing_shows_the_same_picture() {
        let mut picture = Picture::default();
        Layout::of(Packing::Uyvy, 2, 1, 0).unwrap().unpack(&[90, 40, 200, 50], &mut picture).unwrap();
        assert_eq!((&picture.luma[..], picture.blue[0], picture.red[0]), (&[40, 50][..], 90, 200));
        let grey = Layout::of(Packing::Plain(PixelFormat::Y8), 2, 2, 3).unwrap();
        grey.unpack(&[255, 0, 7, 0, 255], &mut picture).unwrap();
        assert_eq!((picture.luma[0], picture.luma[3], &picture.blue[..]), (WHITE, WHITE, &[GREY; 2][..]));
        let rgb = Layout::of(Packing::Plain(PixelFormat::Rgb8), 2, 1, 0).unwrap();
        rgb.unpack(&[200, 90, 30, 200, 90, 30], &mut picture).unwrap();
        assert_eq!([picture.luma[1], picture.blue[0], picture.red[0]], ycc_of_rgb([200, 90, 30]));
        let bayer = Layout::of(Packing::Plain(PixelFormat::BayerGr8), 2, 2, 0).unwrap();
        bayer.unpack(&[90, 200, 30, 90], &mut picture).unwrap();
        assert_eq!([picture.luma[1], picture.blue[0], picture.red[0]], ycc_of_rgb([200, 90, 30]));
    }

    #[test]
    fn letters_name_one_packing_each() {
        for packing in Packing::ALL {
            assert_eq!(Packing::of_fourcc(packing.fourcc()), Some(packing));
        }
        assert_eq!(Packing::of_fourcc(*b"MJPG"), None);
        for format in PixelFormat::ALL {
            let wanted = Packing::wanted(format)[0];
            let plain = if format == PixelFormat::Yuyv { Packing::Yuyv } else { Packing::Plain(format) };
            assert_eq!(wanted, plain);
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_unpacked_or_refused(
            packing in prop::sample::select(Packing::ALL.to_vec()),
            width in 0u32..12, height in 0u32..8, stride in 0u32..40,
            bytes in prop::collection::vec(any::<u8>(), 0..400),
        ) {
            let Ok(layout) = Layout::of(packing, width, height, stride) else { return Ok(()) };
            let mut picture = Picture::default();
            let unpacked = layout.unpack(&bytes, &mut picture);
            prop_assert!(unpacked.is_ok() || bytes.len() < layout.bytes());
            if unpacked.is_ok() {
                let chroma = picture.chroma_width() * picture.height;
                prop_assert_eq!(picture.luma.len(), picture.width * picture.height);
                prop_assert_eq!([picture.blue.len(), picture.red.len()], [chroma; 2]);
            }
        }
    }
}
