//! Pictures for the scanner: lines of YCbCr 4:2:2 in the studio range.
//!
//! A picture comes from a still image ([`still`]), a clip ([`y4m`]), a recording of pixels ([`recorded`]) or a camera ([`camera`]);
//! [`source`] orders pictures and assigns numbers and instants. One picture at a time is held,
//! never a clip. Memory grows with the bytes read, not with the size in a header, up to one picture
//! of [`MAX_PIXELS`].

pub mod camera;
pub mod overlay;
pub mod packed;
pub mod recorded;
pub mod source;
pub mod still;
pub mod whole;
pub mod y4m;

use crate::colours::convert::{BLACK, GREY, WHITE};
use crate::colours::{ColourTable, UNSURE};
use crate::scan::limits::PICTURE;
use anyhow::{Result, ensure};

/// Most pixels of a picture: 32 Mi, about what photo cameras have.
pub const MAX_PIXELS: u64 = 32 << 20;

/// Field order of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Interlace {
    /// One field of all lines.
    Progressive,
    /// Two fields, the even lines first.
    Top,
    /// Two fields, the odd lines first.
    Bottom,
}

impl Interlace {
    /// Parity of the earlier and the later field; a progressive picture has one field, of parity 0.
    pub fn parities(self) -> &'static [u32] {
        match self {
            Interlace::Progressive => &[0],
            Interlace::Top => &[0, 1],
            Interlace::Bottom => &[1, 0],
        }
    }
}

/// A picture: planes of luma, and of Cb and Cr at half the width, rounded up.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Picture {
    /// Pixels a line.
    pub width: usize,
    /// Lines.
    pub height: usize,
    /// `width × height`, 16 to 235.
    pub luma: Vec<u8>,
    /// `⌈width/2⌉ × height`, 16 to 240.
    pub blue: Vec<u8>,
    /// `⌈width/2⌉ × height`, 16 to 240.
    pub red: Vec<u8>,
    /// Luma as read, if it was changed since; otherwise empty.
    pub as_read: Vec<u8>,
}

impl Picture {
    /// Chroma samples a line.
    pub fn chroma_width(&self) -> usize {
        self.width.div_ceil(2)
    }

    /// Luma, Cb and Cr of a line.
    pub fn line(&self, y: usize) -> (&[u8], &[u8], &[u8]) {
        let (w, c) = (self.width, self.chroma_width());
        (&self.luma[y * w..(y + 1) * w], &self.blue[y * c..(y + 1) * c], &self.red[y * c..(y + 1) * c])
    }

    /// Y, Cb, Cr of a pixel.
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        let c = y * self.chroma_width() + x / 2;
        [self.luma[y * self.width + x], self.blue[c], self.red[c]]
    }

    /// Y, Cb, Cr of a pixel as it was read.
    pub fn pixel_as_read(&self, x: usize, y: usize) -> [u8; 3] {
        let [luma, cb, cr] = self.pixel(x, y);
        [self.as_read.get(y * self.width + x).copied().unwrap_or(luma), cb, cr]
    }

    /// Keeps the luma as read before a change.
    fn keep_luma(&mut self) {
        if self.as_read.is_empty() {
            self.as_read.extend_from_slice(&self.luma);
        }
    }

    /// Inverts luma within its range; chroma stays.
    pub fn invert(&mut self) {
        self.keep_luma();
        self.luma.iter_mut().for_each(|sample| *sample = inverted(*sample));
    }

    /// Chroma keying: makes every pixel black whose chroma has no class.
    pub fn key(&mut self, table: &ColourTable) {
        self.keep_luma();
        let chroma = self.chroma_width();
        for (y, line) in self.luma.chunks_exact_mut(self.width).enumerate() {
            let samples = self.blue[y * chroma..].iter().zip(&self.red[y * chroma..]);
            for (pair, (&blue, &red)) in line.chunks_mut(2).zip(samples) {
                if table.class(blue, red) == UNSURE {
                    pair.fill(BLACK);
                }
            }
        }
    }

    /// Removes chroma.
    pub fn desaturate(&mut self) {
        self.blue.fill(GREY);
        self.red.fill(GREY);
    }

    /// One field of it: every line, or every second one.
    pub fn view(&self, interlace: Interlace, parity: u32) -> FieldView<'_> {
        match interlace {
            Interlace::Progressive => FieldView { picture: self, first: 0, step: 1 },
            _ => FieldView { picture: self, first: parity as usize, step: 2 },
        }
    }
}

/// Luma inverted within its range.
pub fn inverted(luma: u8) -> u8 {
    BLACK + WHITE - luma.clamp(BLACK, WHITE)
}

/// One field of a picture.
#[derive(Debug, Clone, Copy)]
pub struct FieldView<'a> {
    /// The picture.
    pub picture: &'a Picture,
    first: usize,
    step: usize,
}

impl<'a> FieldView<'a> {
    /// Lines of the field.
    pub fn height(&self) -> usize {
        self.picture.height.saturating_sub(self.first).div_ceil(self.step)
    }

    /// Line `y` of the field: luma, Cb, Cr.
    pub fn line(&self, y: usize) -> (&'a [u8], &'a [u8], &'a [u8]) {
        self.picture.line(self.first + y * self.step)
    }

    /// Y, Cb, Cr of a pixel of the field, as it was read.
    pub fn pixel_as_read(&self, x: usize, y: usize) -> [u8; 3] {
        self.picture.pixel_as_read(x, self.first + y * self.step)
    }
}

/// Checks the size of a picture.
///
/// # Errors
/// No pixels, a side that is longer than the scanner's tables, or too many pixels.
pub fn check_size(width: u64, height: u64) -> Result<()> {
    let [widest, highest] = [PICTURE.width, PICTURE.lines];
    ensure!(
        (1..=widest as u64).contains(&width) && (1..=highest as u64).contains(&height),
        "expected a size from 1x1 to {widest}x{highest} pixels, found {width}x{height}"
    );
    let pixels = width * height;
    ensure!(pixels <= MAX_PIXELS, "expected at most {MAX_PIXELS} pixels, found {pixels}");
    Ok(())
}

/// The first bin of a histogram up to which more than `rank` samples lie.
pub fn bin_of_rank(counts: &[u32], rank: u64) -> Option<usize> {
    let mut sum = 0;
    counts.iter().position(|&n| {
        sum += u64::from(n);
        sum > rank
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colours::Class;
    use protocol::blobs::Colour;

    fn numbered(width: usize, height: usize) -> Picture {
        let chroma = vec![128; width.div_ceil(2) * height];
        let luma = (0..width * height).map(|i| 16 + (i % 200) as u8).collect();
        Picture { width, height, luma, blue: chroma.clone(), red: chroma, as_read: Vec::new() }
    }

    #[test]
    fn fields_share_the_lines_of_a_picture() {
        let picture = numbered(3, 5);
        let fields = [0, 1].map(|parity| picture.view(Interlace::Top, parity));
        assert_eq!(fields.map(|f| f.height()), [3, 2]);
        assert_eq!(fields[1].line(1), picture.line(3));
        assert_eq!(fields[1].line(0).1.len(), 2, "the last column has its own chroma");
        assert_eq!(picture.view(Interlace::Progressive, 0).height(), 5);
    }

    #[test]
    fn inverting_twice_changes_nothing_within_the_range() {
        let picture = numbered(8, 8);
        let mut twice = picture.clone();
        twice.invert();
        assert_eq!(twice.luma[0], WHITE);
        twice.invert();
        assert_eq!(twice.luma, picture.luma);
        assert_eq!(twice.pixel_as_read(7, 7), picture.pixel(7, 7));
    }

    #[test]
    fn what_has_no_class_is_keyed_out_up_to_an_odd_end() {
        let [red, blue] = [Colour::Red, Colour::Blue].map(Colour::reference);
        let table =
            ColourTable::of_classes(&[Class { tolerance_deg: 30.0, ..Class::of_reference(Colour::Red) }]);
        let mut picture = Picture {
            width: 5,
            height: 1,
            luma: vec![100; 5],
            blue: vec![red[1], blue[1], red[1]],
            red: vec![red[2], blue[2], red[2]],
            as_read: Vec::new(),
        };
        picture.key(&table);
        assert_eq!(picture.luma, [100, 100, BLACK, BLACK, 100]);
    }

    #[test]
    fn sizes_are_bounded_on_both_sides() {
        assert!(check_size(1, 1).is_ok() && check_size(720, 288).is_ok());
        for (w, h) in [(0, 5), (5, 0), (PICTURE.width as u64 + 1, 1), (1, u64::MAX)] {
            assert!(check_size(w, h).unwrap_err().to_string().contains(&format!("{w}x{h}")));
        }
        assert!(check_size(8192, 8192).unwrap_err().to_string().contains("found 67108864"));
    }
}
