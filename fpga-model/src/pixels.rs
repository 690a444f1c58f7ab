//! Pixels of other formats as the planes that the scanner reads: brightness, RGB, mosaics of colours.
//!
//! A camera that gives YUYV is scanned as it comes. The others are converted first, line by line: samples of 0 to 255
//! become those of the studio range ([`crate::colours::convert`]), a chroma sample is the mean of two pixels, and a pixel of
//! a mosaic takes the colours that it lacks from those around it, whose mean they are.

use crate::colours::convert::{GREY, luma_of_full, ycc_of_rgb};
use protocol::fields::{FieldHeader, FieldPicture, PixelFormat};

/// Fills `picture`, which is as wide as the field and at least as high as its payload, and returns the lines that it
/// has; `None` where the payload is shorter than its header says, or its format is unknown.
pub fn decode(header: &FieldHeader, payload: &[u8], picture: &mut FieldPicture) -> Option<usize> {
    let (format, width) = (PixelFormat::from_wire(header.format)?, header.width as usize);
    let lines = header.lines as usize;
    let payload = payload.get(..format.bytes(width, lines))?;
    if picture.width != width || picture.height < lines {
        return None;
    }
    for y in 0..lines {
        let luma = &mut picture.luma[y * width..][..width];
        let chroma = y * (width / 2)..(y + 1) * (width / 2);
        let (blue, red) = (&mut picture.blue[chroma.clone()], &mut picture.red[chroma]);
        match format {
            PixelFormat::Yuyv => {
                let planes = FieldPicture::in_payload(header, payload)?;
                let (l, b, r) = planes.line(y);
                luma.copy_from_slice(l);
                blue.copy_from_slice(b);
                red.copy_from_slice(r);
            }
            PixelFormat::Y8 => {
                let row = &payload[y * width..][..width];
                luma.iter_mut().zip(row).for_each(|(to, &from)| *to = luma_of_full(from));
                blue.fill(GREY);
                red.fill(GREY);
            }
            PixelFormat::Rgb8 => {
                let row = payload[3 * y * width..][..3 * width].as_chunks::<3>().0;
                fill([luma, blue, red], |x| row[x]);
            }
            _ => {
                let mosaic = Mosaic::new(format, payload, [width, lines]);
                fill_from_mosaic([luma, blue, red], &mosaic, y);
            }
        }
    }
    Some(lines)
}

/// A line of planes from the colours of its pixels.
fn fill([luma, blue, red]: [&mut [u8]; 3], rgb: impl Fn(usize) -> [u8; 3]) {
    for pair in 0..blue.len() {
        let both = [2 * pair, 2 * pair + 1].map(|x| ycc_of_rgb(rgb(x)));
        (luma[2 * pair], luma[2 * pair + 1]) = (both[0][0], both[1][0]);
        blue[pair] = both[0][1].midpoint(both[1][1]);
        red[pair] = both[0][2].midpoint(both[1][2]);
    }
}

/// A line of planes from a mosaic: as [`Mosaic::rgb`] of each pixel, and some ten times as fast where pixels lie on all
/// sides.
fn fill_from_mosaic([luma, blue, red]: [&mut [u8]; 3], mosaic: &Mosaic<'_>, y: usize) {
    let [width, height] = mosaic.size;
    if y == 0 || y + 1 == height || width < 6 {
        return fill([luma, blue, red], |x| mosaic.rgb(x, y));
    }
    let (from, to) = (2, width - 2);
    for edge in [0..from, to..width] {
        let halves = edge.start / 2..edge.end / 2;
        let parts = [&mut luma[edge.clone()], &mut blue[halves.clone()], &mut red[halves]];
        fill(parts, |x| mosaic.rgb(edge.start + x, y));
    }
    let inner = mosaic.inner_line(y);
    let parts = [&mut luma[from..to], &mut blue[from / 2..to / 2], &mut red[from / 2..to / 2]];
    fill(parts, |x| inner.rgb(from + x));
}

/// A line of a mosaic with those above and below it.
struct InnerLine<'a> {
    above: &'a [u8],
    own: &'a [u8],
    below: &'a [u8],
    /// 0 where the first pixel is not green, else 1.
    first_coloured: usize,
    /// Its pixels are red and green, not blue and green.
    is_red: bool,
}

impl InnerLine<'_> {
    /// The colour of a pixel that is neither the first nor the last.
    fn rgb(&self, x: usize) -> [u8; 3] {
        let InnerLine { above, own, below, .. } = *self;
        let of = |line: &[u8], x: usize| u16::from(line[x]);
        let [beside, between] = [of(own, x - 1) + of(own, x + 1), of(above, x) + of(below, x)];
        let (along, green, across) = if x % 2 == self.first_coloured {
            let corners = of(above, x - 1) + of(above, x + 1) + of(below, x - 1) + of(below, x + 1);
            (own[x], ((beside + between + 2) / 4) as u8, ((corners + 2) / 4) as u8)
        } else {
            (beside.div_ceil(2) as u8, own[x], between.div_ceil(2) as u8)
        };
        if self.is_red { [along, green, across] } else { [across, green, along] }
    }
}

/// One sample a pixel, behind filters of red, green and blue.
struct Mosaic<'a> {
    samples: &'a [u8],
    size: [usize; 2],
    /// Column and line of the first red.
    red: [usize; 2],
}

impl<'a> Mosaic<'a> {
    fn new(format: PixelFormat, samples: &'a [u8], size: [usize; 2]) -> Self {
        Mosaic { samples, size, red: format.first_red().unwrap_or([0, 0]) }
    }

    /// The filter at a place: 0 red, 1 green, 2 blue. Red and blue lie on one diagonal of each two by two pixels.
    fn filter(&self, x: usize, y: usize) -> usize {
        (x + self.red[0]) % 2 + (y + self.red[1]) % 2
    }

    /// A line that is neither the first nor the last.
    fn inner_line(&self, y: usize) -> InnerLine<'_> {
        let line = |y: usize| &self.samples[y * self.size[0]..][..self.size[0]];
        let is_red = (y + self.red[1]).is_multiple_of(2);
        let first_coloured = usize::from(self.filter(0, y) == 1);
        InnerLine { above: line(y - 1), own: line(y), below: line(y + 1), first_coloured, is_red }
    }

    /// The colour of a pixel: its own sample, and the means of the nearest of the two others.
    fn rgb(&self, x: usize, y: usize) -> [u8; 3] {
        let [width, height] = self.size;
        let (mut sums, mut counts) = ([0u16; 3], [0u16; 3]);
        for v in y.saturating_sub(1)..(y + 2).min(height) {
            for u in x.saturating_sub(1)..(x + 2).min(width) {
                // Greens at the corners of a green are farther than those beside it, and are not needed.
                let own = (u, v) == (x, y);
                let filter = self.filter(u, v);
                if own || filter != self.filter(x, y) {
                    sums[filter] += u16::from(self.samples[v * width + u]);
                    counts[filter] += 1;
                }
            }
        }
        std::array::from_fn(|c| ((sums[c] + counts[c] / 2) / counts[c].max(1)) as u8)
    }
}

/// True of planes that need no conversion.
pub fn is_planar(header: &FieldHeader) -> bool {
    header.format == PixelFormat::Yuyv as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn header(format: PixelFormat, [width, lines]: [u32; 2]) -> FieldHeader {
        let format = format as u32;
        FieldHeader { format, width, height: lines, lines, ..bytemuck::Zeroable::zeroed() }
    }

    #[test]
    fn one_colour_comes_out_of_every_format_alike() {
        let colour = [200, 90, 30];
        let expected = ycc_of_rgb(colour);
        for format in PixelFormat::ALL.into_iter().filter(|f| f.has_colour() && *f != PixelFormat::Yuyv) {
            let header = header(format, [6, 4]);
            let mut payload = vec![0; format.bytes(6, 4)];
            for (i, sample) in payload.iter_mut().enumerate() {
                let filter = match format.first_red() {
                    Some([right, down]) => (i % 6 + right) % 2 + (i / 6 + down) % 2,
                    None => i % 3,
                };
                *sample = colour[filter];
            }
            let mut picture = FieldPicture::of_size([6, 4]);
            assert_eq!(decode(&header, &payload, &mut picture), Some(4));
            assert!(picture.luma.iter().all(|v| *v == expected[0]), "{format:?} {:?}", picture.luma);
            assert!(picture.blue.iter().all(|v| *v == expected[1]), "{format:?}");
            assert!(picture.red.iter().all(|v| *v == expected[2]), "{format:?}");
        }
        let mut picture = FieldPicture::of_size([6, 4]);
        let grey = header(PixelFormat::Y8, [6, 4]);
        assert_eq!(decode(&grey, &[255; 24], &mut picture), Some(4));
        assert_eq!(
            (picture.luma[5], picture.blue[2], picture.red[1]),
            (crate::colours::convert::WHITE, GREY, GREY)
        );
    }

    proptest! {
        #[test]
        fn a_mosaic_is_decoded_as_pixel_by_pixel(
            pairs in 1usize..9, lines in 1usize..7, seed in any::<u64>(), which in 0usize..4,
        ) {
            let mosaics = PixelFormat::ALL.into_iter().filter(|f| f.first_red().is_some());
            let format = mosaics.collect::<Vec<_>>()[which];
            let (width, mut random) = (2 * pairs, seed);
            let payload: Vec<u8> = (0..width * lines)
                .map(|_| {
                    random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (random >> 56) as u8
                })
                .collect();
            let mut picture = FieldPicture::of_size([width, lines]);
            let header = header(format, [width, lines].map(|n| n as u32));
            prop_assert_eq!(decode(&header, &payload, &mut picture), Some(lines));
            let mosaic = Mosaic::new(format, &payload, [width, lines]);
            for (y, x) in (0..lines).flat_map(|y| (0..width).map(move |x| (y, x))) {
                let [first, second] = [x & !1, x | 1].map(|x| ycc_of_rgb(mosaic.rgb(x, y)));
                let own = if x % 2 == 0 { first } else { second };
                let found = [picture.luma[y * width + x], picture.blue[(y * width + x) / 2]];
                prop_assert_eq!(found, [own[0], first[1].midpoint(second[1])]);
                prop_assert_eq!(picture.red[(y * width + x) / 2], first[2].midpoint(second[2]));
            }
        }

        #[test]
        fn any_payload_is_decoded_or_refused(
            code in 0u32..9, width in 0u32..9, lines in 0u32..6,
            payload in prop::collection::vec(any::<u8>(), 0..130),
        ) {
            let header = FieldHeader { format: code, ..header(PixelFormat::Y8, [2 * (width / 2), lines]) };
            let mut picture = FieldPicture::of_size([2 * (width as usize / 2), 6]);
            let known = PixelFormat::from_wire(code);
            let whole = known.is_some_and(|f| payload.len() >= f.bytes(header.width as usize, lines as usize));
            prop_assert_eq!(decode(&header, &payload, &mut picture).is_some(), whole);
        }
    }
}
