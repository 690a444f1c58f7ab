//! `fields`: the pixels of one camera-field, written by its source straight into shared memory.
//!
//! A block has the [`FieldHeader`] as its header and the pixels as its payload, 8 bits a sample. Those of a
//! camera that gives YUYV are planes of YCbCr 4:2:2 in the studio range of ITU-R BT.601: all of Y, then all of
//! Cb, then all of Cr. The others are as their sensor gives them, line after line ([`PixelFormat`]). A
//! source that knows the lines in which markers can appear (`region` of crate `rig`) may leave the lines
//! below them out.

use crate::blobs::WHOLE_FRAME;
use crate::limits::MAX_CAMERAS;
use crate::message::{Invalid, Message, require};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};
use std::ops::{Deref, DerefMut};

/// Luma of the unlit inside of the mechanical eye.
pub const DARK: u8 = 30;
/// Cb and Cr without colour.
const NEUTRAL: u8 = 128;
/// Sides that a sensor may have, px.
pub const SENSOR_PX: std::ops::RangeInclusive<u32> = 16..=8192;
/// Planes of YCbCr 4:2:2, 8 bits a sample: [`PixelFormat::Yuyv`] on the wire.
pub const FORMAT_YCBCR_422: u32 = PixelFormat::Yuyv as u32;

/// How a camera gives its pixels. Names are those of V4L2 (`YUYV`) and GenICam (the others).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[repr(u32)]
pub enum PixelFormat {
    /// YCbCr 4:2:2, in planes.
    #[default]
    #[serde(rename = "YUYV")]
    Yuyv = 1,
    /// Brightness alone, 0 to 255: no colours.
    Y8 = 2,
    /// Red, green, blue of a pixel, then of the next, 0 to 255.
    #[serde(rename = "RGB8")]
    Rgb8 = 3,
    /// One sample a pixel behind a mosaic of filters; the first line begins red, green.
    #[serde(rename = "BayerRG8")]
    BayerRg8 = 4,
    /// The first line begins blue, green.
    #[serde(rename = "BayerBG8")]
    BayerBg8 = 5,
    /// The first line begins green, red.
    #[serde(rename = "BayerGR8")]
    BayerGr8 = 6,
    /// The first line begins green, blue.
    #[serde(rename = "BayerGB8")]
    BayerGb8 = 7,
}

impl PixelFormat {
    /// Every format.
    pub const ALL: [PixelFormat; 7] = {
        use PixelFormat::*;
        [Yuyv, Y8, Rgb8, BayerRg8, BayerBg8, BayerGr8, BayerGb8]
    };

    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&f| f as u32 == code)
    }

    /// Name as in rig files.
    pub fn name(self) -> &'static str {
        match self {
            PixelFormat::Yuyv => "YUYV",
            PixelFormat::Y8 => "Y8",
            PixelFormat::Rgb8 => "RGB8",
            PixelFormat::BayerRg8 => "BayerRG8",
            PixelFormat::BayerBg8 => "BayerBG8",
            PixelFormat::BayerGr8 => "BayerGR8",
            PixelFormat::BayerGb8 => "BayerGB8",
        }
    }

    /// Bytes of a payload of `width` × `lines` pixels.
    pub const fn bytes(self, width: usize, lines: usize) -> usize {
        match self {
            PixelFormat::Yuyv => 2 * width * lines,
            PixelFormat::Rgb8 => 3 * width * lines,
            _ => width * lines,
        }
    }

    /// Column and line of the first red filter of a mosaic; `None` of a format without one.
    pub fn first_red(self) -> Option<[usize; 2]> {
        match self {
            PixelFormat::BayerRg8 => Some([0, 0]),
            PixelFormat::BayerGr8 => Some([1, 0]),
            PixelFormat::BayerGb8 => Some([0, 1]),
            PixelFormat::BayerBg8 => Some([1, 1]),
            _ => None,
        }
    }

    /// False of brightness alone.
    pub fn has_colour(self) -> bool {
        self != PixelFormat::Y8
    }
}

/// What a field is and when it was taken.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct FieldHeader {
    /// Field number of this camera; stamped at the camera.
    pub field: u64,
    /// Middle of the exposure.
    pub exposed_ns: Nanos,
    /// The first pixel of the first line leaves the sensor. A block may come before that instant.
    pub first_line_ns: Nanos,
    /// From one line to the next, ns.
    pub line_period_ns: u64,
    /// Camera id of the rig.
    pub camera: u32,
    /// 0: even lines, 1: odd lines, 2: all lines ([`WHOLE_FRAME`]).
    pub parity: u32,
    /// [`PixelFormat`] on the wire.
    pub format: u32,
    /// Pixels a line; even.
    pub width: u32,
    /// Lines of the field.
    pub height: u32,
    /// Lines in the payload, from the top; at most `height`.
    pub lines: u32,
}

impl FieldHeader {
    /// Bytes of the payload.
    pub fn bytes(&self) -> usize {
        let format = PixelFormat::from_wire(self.format).unwrap_or_default();
        format.bytes(self.width as usize, self.lines as usize)
    }

    /// When the last line has left the sensor.
    pub fn read_out_ns(&self) -> Nanos {
        self.first_line_ns.saturating_add(self.line_period_ns.saturating_mul(u64::from(self.height)))
    }
}

impl Message for FieldHeader {
    const CHANNEL: &'static str = "fields";
    const VERSION: u32 = 1;
    const QUEUE: usize = 2 * MAX_CAMERAS;

    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected, found: u32| {
            require(holds, "FieldHeader", field, expected, f64::from(found))
        };
        check((self.camera as usize) < MAX_CAMERAS, "camera", "0 to 7", self.camera)?;
        let whole = self.parity <= WHOLE_FRAME;
        check(whole, "parity", "0 or 1, or 2 of a whole frame", self.parity)?;
        let known = PixelFormat::from_wire(self.format).is_some();
        check(known, "format", "1 (YCbCr 4:2:2) to 7", self.format)?;
        let sensor = |n: u32| (1..=*SENSOR_PX.end()).contains(&n);
        check(sensor(self.width) && self.width.is_multiple_of(2), "width", "even, 2 to 8192", self.width)?;
        check(sensor(self.height), "height", "1 to 8192", self.height)?;
        check(self.lines <= self.height, "lines", "at most height", self.lines)?;
        check(self.exposed_ns > 0, "exposed_ns", "an instant", 0)?;
        check((1..=1_000_000_000).contains(&self.line_period_ns), "line_period_ns", "1 ns to 1 s", 0)
    }
}

/// Pixels of a field as planes of YCbCr 4:2:2, in a buffer `B` of their own or in a block.
#[derive(Debug, Clone)]
pub struct FieldPicture<B = Vec<u8>> {
    /// Pixels a line; even.
    pub width: usize,
    /// Lines.
    pub height: usize,
    /// `width × height`.
    pub luma: B,
    /// `width/2 × height`, Cb.
    pub blue: B,
    /// `width/2 × height`, Cr.
    pub red: B,
}

impl FieldPicture {
    /// A black field for interlaced frames of `frame_px`; an odd width loses its last column.
    pub fn new(frame_px: [u32; 2]) -> Self {
        Self::of_size([frame_px[0] as usize & !1, frame_px[1] as usize / 2])
    }

    /// A black field of this many pixels a line (even) and lines.
    pub fn of_size([width, height]: [usize; 2]) -> Self {
        let chroma = vec![NEUTRAL; width / 2 * height];
        FieldPicture { width, height, luma: vec![DARK; width * height], blue: chroma.clone(), red: chroma }
    }

    /// Bytes of the planes of `height` lines.
    pub const fn bytes(width: usize, height: usize) -> usize {
        2 * width * height
    }
}

impl<'a> FieldPicture<&'a [u8]> {
    /// The planes in the payload of a block; `None` if it is shorter than its header says, or of another
    /// format.
    pub fn in_payload(header: &FieldHeader, payload: &'a [u8]) -> Option<Self> {
        let (width, height) = (header.width as usize, header.lines as usize);
        let planes = header.format == FORMAT_YCBCR_422;
        let payload = payload.get(..FieldPicture::bytes(width, height)).filter(|_| planes)?;
        let (luma, chroma) = payload.split_at(width * height);
        let (blue, red) = chroma.split_at(chroma.len() / 2);
        Some(FieldPicture { width, height, luma, blue, red })
    }
}

impl<'a> FieldPicture<&'a mut [u8]> {
    /// The planes in a payload to be written.
    ///
    /// # Panics
    /// If the payload is shorter than [`FieldHeader::bytes`].
    pub fn in_payload_mut(header: &FieldHeader, payload: &'a mut [u8]) -> Self {
        let (width, height) = (header.width as usize, header.lines as usize);
        let (luma, chroma) = payload[..FieldPicture::bytes(width, height)].split_at_mut(width * height);
        let (blue, red) = chroma.split_at_mut(chroma.len() / 2);
        FieldPicture { width, height, luma, blue, red }
    }
}

impl<B: Deref<Target = [u8]>> FieldPicture<B> {
    /// A line of the field: luma, Cb, Cr.
    pub fn line(&self, y: usize) -> (&[u8], &[u8], &[u8]) {
        let (w, c) = (self.width, self.width / 2);
        (&self.luma[y * w..(y + 1) * w], &self.blue[y * c..(y + 1) * c], &self.red[y * c..(y + 1) * c])
    }
}

impl<B: DerefMut<Target = [u8]>> FieldPicture<B> {
    /// Copies lines from another picture of the same width.
    pub fn copy_lines<C: Deref<Target = [u8]>>(
        &mut self,
        lines: std::ops::Range<usize>,
        from: &FieldPicture<C>,
    ) {
        let (w, c) = (self.width, self.width / 2);
        let [pixels, samples] = [w, c].map(|width| lines.start * width..lines.end * width);
        self.luma[pixels.clone()].copy_from_slice(&from.luma[pixels]);
        self.blue[samples.clone()].copy_from_slice(&from.blue[samples.clone()]);
        self.red[samples.clone()].copy_from_slice(&from.red[samples]);
    }

    /// Fills lines with one luma and no colour.
    pub fn blank_lines(&mut self, lines: std::ops::Range<usize>, luma: u8) {
        let (w, c) = (self.width, self.width / 2);
        let [pixels, samples] = [w, c].map(|width| lines.start * width..lines.end * width);
        self.luma[pixels].fill(luma);
        self.blue[samples.clone()].fill(NEUTRAL);
        self.red[samples].fill(NEUTRAL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> FieldHeader {
        FieldHeader {
            field: 3,
            exposed_ns: 1_000,
            first_line_ns: 2_000,
            line_period_ns: 64_000,
            camera: 1,
            parity: 1,
            format: FORMAT_YCBCR_422,
            width: 8,
            height: 6,
            lines: 4,
        }
    }

    #[test]
    fn planes_lie_one_after_the_other_in_the_payload() {
        let header = header();
        assert_eq!((header.bytes(), header.read_out_ns()), (64, 2_000 + 6 * 64_000));
        let mut payload = [0; 80];
        let mut picture = FieldPicture::in_payload_mut(&header, &mut payload);
        picture.blank_lines(0..4, DARK);
        picture.luma[8 * 3 + 7] = 9;
        (picture.blue[4 * 3 + 3], picture.red[0]) = (7, 5);
        assert_eq!((payload[31], payload[47], payload[48], payload[64]), (9, 7, 5, 0));
        let read = FieldPicture::in_payload(&header, &payload).unwrap();
        let (luma, blue, red) = read.line(3);
        assert_eq!((luma[7], blue[3], red[3], read.height), (9, 7, NEUTRAL, 4));
        assert!(FieldPicture::in_payload(&header, &payload[..63]).is_none());
        let mut whole = FieldPicture::new([8, 12]);
        whole.copy_lines(3..4, &read);
        assert_eq!((whole.luma[31], whole.luma[23], whole.blue[15]), (9, DARK, 7));
    }

    #[test]
    fn every_format_has_its_bytes_and_name() {
        let expected = [64, 32, 96, 32, 32, 32, 32];
        for (format, bytes) in PixelFormat::ALL.into_iter().zip(expected) {
            let header = FieldHeader { format: format as u32, ..header() };
            assert!(header.validate().is_ok() && header.bytes() == bytes, "{format:?}");
            assert_eq!(serde_json::to_string(&format).unwrap(), format!("\"{}\"", format.name()));
            let planes = FieldPicture::in_payload(&header, &[0; 96]).is_some();
            assert_eq!(planes, format == PixelFormat::Yuyv);
        }
        let whole = FieldHeader { parity: WHOLE_FRAME, ..header() };
        assert!(whole.validate().is_ok());
    }

    #[test]
    fn odd_headers_are_refused_by_name() {
        assert!(header().validate().is_ok());
        for (header, field) in [
            (FieldHeader { camera: 8, ..header() }, "camera"),
            (FieldHeader { parity: 3, ..header() }, "parity"),
            (FieldHeader { format: 0, ..header() }, "format"),
            (FieldHeader { format: 8, ..header() }, "format"),
            (FieldHeader { width: 7, ..header() }, "width"),
            (FieldHeader { height: 8193, ..header() }, "height"),
            (FieldHeader { lines: 7, ..header() }, "lines"),
            (FieldHeader { exposed_ns: 0, ..header() }, "exposed_ns"),
            (FieldHeader { line_period_ns: 0, ..header() }, "line_period_ns"),
        ] {
            assert_eq!(header.validate().unwrap_err().field, field);
        }
    }
}
