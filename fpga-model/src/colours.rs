//! Colour classification: a look-up table of chroma.
//!
//! Luma gives positions, chroma gives classes, because PAL chroma is band-limited and its edges are
//! blurred over several pixels. Samples are 8-bit YCbCr (ITU-R BT.601); RGB is converted
//! ([`convert`]). Classes come from a file ([`file`]) or are learnt from pictures ([`learn`]).

pub mod convert;
pub mod file;
pub mod learn;

pub use crate::scan::sums::SATURATED;

use protocol::blobs::Colour;

/// Class of a sample with too little chroma.
pub const UNSURE: u8 = 0;

/// Least chroma (distance from grey) of a class: half of the palest reference.
const LEAST_CHROMA: u8 = 24;
/// Bits of Cb and Cr that address the table.
const CHROMA_BITS: u32 = 6;
const SHIFT: u32 = 8 - CHROMA_BITS;
const SIDE: usize = 1 << CHROMA_BITS;
/// Words of the table of classes.
pub const TABLE_DEPTH: usize = SIDE * SIDE;
/// Classes, with [`UNSURE`] as class 0.
pub const CLASSES: usize = 8;

/// The table that the hardware holds: a class for each of 4,096 cells of the chroma plane.
#[derive(Clone)]
pub struct ColourTable {
    classes: [u8; SIDE * SIDE],
}

/// A colour class: reference and tolerances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Class {
    /// Colour of the class.
    pub colour: Colour,
    /// Y, Cb, Cr of a well lit marker.
    pub reference: [u8; 3],
    /// Least distance from grey of its samples; not used by white.
    pub least_chroma: u8,
    /// Greatest difference of hue from the reference, degrees, up to 180; not used by white.
    pub tolerance_deg: f64,
}

impl Class {
    /// The class of a colour's reference marker, without a limit of hue: the nearest class decides.
    pub fn of_reference(colour: Colour) -> Self {
        let least_chroma = LEAST_CHROMA;
        Class { colour, reference: colour.reference(), least_chroma, tolerance_deg: 180.0 }
    }

    /// Similarity of a chroma sample (relative to grey) to the class: the signed square of the
    /// cosine between the two hues, times the sample's squared chroma. `None` if it is not of the
    /// class.
    fn fit(&self, cb: i64, cr: i64) -> Option<i64> {
        let square = cb * cb + cr * cr;
        let least = i64::from(self.least_chroma);
        if self.colour == Colour::White || square < least * least {
            return None;
        }
        let [_, rb, rr] = self.reference.map(|v| i64::from(v) - 128);
        let (dot, own) = (rb * cb + rr * cr, rb * rb + rr * rr);
        let cosine = libm::cos(self.tolerance_deg.to_radians());
        let limit_q20 = libm::round(cosine * cosine.abs() * (1 << 20) as f64) as i64;
        // Numbers stay below 2¹⁵ · 2¹⁵ · 2²⁰.
        let within = (dot * dot.abs()) << 20 >= limit_q20 * (own * square);
        within.then(|| ((dot * dot.abs()) << 8) / own.max(1))
    }
}

impl Default for ColourTable {
    /// The table of the reference colours.
    fn default() -> Self {
        Self::of_classes(&Colour::ALL.map(Class::of_reference))
    }
}

impl ColourTable {
    /// The table of some classes.
    pub fn of_classes(classes: &[Class]) -> Self {
        let middle = |cell: usize| ((cell << SHIFT) + (1 << (SHIFT - 1))) as i64 - 128;
        let class = |i: usize| best_class(classes, middle(i / SIDE), middle(i % SIDE));
        ColourTable { classes: std::array::from_fn(class) }
    }

    /// Class of a chroma sample: a [`Colour`] on the wire, or [`UNSURE`].
    #[inline]
    pub fn class(&self, cb: u8, cr: u8) -> u8 {
        self.classes[(usize::from(cb >> SHIFT) << CHROMA_BITS) | usize::from(cr >> SHIFT)]
    }
}

/// The class of the most similar hue, the first of equals; integers only.
fn best_class(classes: &[Class], cb: i64, cr: i64) -> u8 {
    let mut best = (UNSURE, i64::MIN);
    for class in classes {
        if let Some(fit) = class.fit(cb, cr).filter(|&fit| fit > best.1) {
            best = (class.colour as u8, fit);
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_colours_are_their_own_class() {
        let table = ColourTable::default();
        for colour in Colour::ALL {
            let [_, cb, cr] = colour.reference();
            let expected = if colour == Colour::White { UNSURE } else { colour as u8 };
            assert_eq!(table.class(cb, cr), expected, "{colour:?}");
        }
        assert_eq!(table.class(128, 128), UNSURE);
    }

    #[test]
    fn half_the_chroma_is_still_the_same_class() {
        let table = ColourTable::default();
        for colour in Colour::ALL.into_iter().filter(|&c| c != Colour::White) {
            let [_, cb, cr] = colour.reference().map(|v| (128 + (i32::from(v) - 128) * 5 / 10) as u8);
            assert_eq!(table.class(cb, cr), colour as u8, "{colour:?}");
        }
    }
}
