//! What the cameras take for which colour: chroma look-up table and luma ramp.
//!
//! Luma gives positions, chroma gives classes, because PAL chroma is band-limited and its edges are
//! blurred over several pixels. Samples are 8-bit YCbCr (ITU-R BT.601).

pub mod convert;

use protocol::blobs::Colour;

/// Luma of the unlit inside of the mechanical eye.
pub const DARK: u8 = 30;
/// Pixels below this luma never belong to a marker. The darkest marker (blue) has about 95, the
/// background stays below 42 with 4 σ of noise.
pub const LOW: u8 = 46;
/// Peak white of BT.601; from here on a pixel counts as saturated.
pub const SATURATED: u8 = 235;
/// Weight of a pixel that lies wholly inside a marker; weights have 7 bits.
pub const FULL_WEIGHT: u8 = 64;
/// Class of a pixel without enough chroma.
pub const UNSURE: u8 = 0;

/// A colour as the camera sees a well lit marker: Y, Cb, Cr.
pub const fn reference(colour: Colour) -> [u8; 3] {
    match colour {
        Colour::Red => [114, 100, 194],
        Colour::Yellow => [184, 63, 145],
        Colour::Green => [141, 82, 73],
        Colour::Cyan => [165, 151, 64],
        Colour::Blue => [95, 197, 108],
        Colour::Magenta => [118, 168, 190],
        Colour::White => [200, 128, 128],
    }
}

/// The ramp starts and ends at these shares of the local contrast, in 1/256: about one half,
/// so that a blurred edge has nearly its half weight where the marker's outline is, and wide, so that
/// the few lines that cross a marker sample its outline without steps.
const RAMP_FROM_256: u32 = 64;
const RAMP_TO_256: u32 = 224;
/// A marker is taken to be at least this bright, as a share of its reference contrast in 1/16: lines
/// that only graze a marker show no lit surface to compare with.
const LEAST_CONTRAST_16: u16 = 15;
/// Least chroma (distance from grey) that tells a class. Half of the palest reference.
const LEAST_CHROMA: i32 = 24;
/// Luma from which a region without any chroma is white.
pub const WHITE_FROM: u8 = 150;
/// Bits of Cb and Cr that address the table.
const CHROMA_BITS: u32 = 6;
const SHIFT: u32 = 8 - CHROMA_BITS;
const SIDE: usize = 1 << CHROMA_BITS;
/// Words of the table of classes.
pub const TABLE_DEPTH: usize = SIDE * SIDE;
/// Classes, with [`UNSURE`] as class 0.
pub const CLASSES: usize = 8;

/// The tables the hardware would hold: 4,096 classes, 8 brightnesses, 256 reciprocals of 16 bits.
#[derive(Clone)]
pub struct ColourTable {
    classes: [u8; SIDE * SIDE],
    least_lit: [u8; CLASSES],
    /// 2¹⁶ over the contrast of a lit surface of this luma.
    reciprocals: [u16; 256],
}

impl Default for ColourTable {
    /// From the reference colours.
    fn default() -> Self {
        let reciprocal = |luma: usize| ((1 << 16) / luma.saturating_sub(usize::from(DARK)).max(2)) as u16;
        let mut table = ColourTable {
            classes: [UNSURE; SIDE * SIDE],
            least_lit: [u8::MAX; CLASSES],
            reciprocals: std::array::from_fn(reciprocal),
        };
        for (i, class) in table.classes.iter_mut().enumerate() {
            let middle = |cell: usize| ((cell << SHIFT) + (1 << (SHIFT - 1))) as i32 - 128;
            *class = nearest_hue(middle(i / SIDE), middle(i % SIDE));
        }
        for colour in Colour::ALL {
            let contrast = u16::from(reference(colour)[0] - DARK);
            table.least_lit[colour as usize] = DARK + (contrast * LEAST_CONTRAST_16 / 16) as u8;
        }
        table
    }
}

impl ColourTable {
    /// Class of a chroma sample: a [`Colour`] on the wire, or [`UNSURE`].
    #[inline]
    pub fn class(&self, cb: u8, cr: u8) -> u8 {
        self.classes[(usize::from(cb >> SHIFT) << CHROMA_BITS) | usize::from(cr >> SHIFT)]
    }

    /// Luma of the darkest lit surface of a class.
    #[inline]
    pub fn least_lit(&self, class: u8) -> u8 {
        self.least_lit[usize::from(class) % CLASSES]
    }

    /// Weight of a pixel beside a lit surface of luma `lit`: 0 to [`FULL_WEIGHT`]. The brightness
    /// beside it decides, so that a marker lit from one side is not drawn to that side.
    #[inline]
    pub fn weight(&self, luma: u8, lit: u8) -> u8 {
        let above = u32::from(luma.saturating_sub(DARK));
        let share_256 = (above * u32::from(self.reciprocals[usize::from(lit)])) >> 8;
        let on_ramp = share_256.clamp(RAMP_FROM_256, RAMP_TO_256) - RAMP_FROM_256;
        ((on_ramp * u32::from(FULL_WEIGHT)) / (RAMP_TO_256 - RAMP_FROM_256)) as u8
    }
}

/// The class whose reference has the most similar hue, integers only: the largest cosine.
fn nearest_hue(cb: i32, cr: i32) -> u8 {
    if cb * cb + cr * cr < LEAST_CHROMA * LEAST_CHROMA {
        return UNSURE;
    }
    let mut best = (UNSURE, i64::MIN);
    for colour in Colour::ALL.into_iter().filter(|&c| c != Colour::White) {
        let [_, rb, rr] = reference(colour).map(|v| i64::from(v) - 128);
        let dot = rb * i64::from(cb) + rr * i64::from(cr);
        // Signed square of the cosine, times the pixel's own square, which is the same for all.
        let cosine = ((dot * dot.abs()) << 8) / (rb * rb + rr * rr);
        if cosine > best.1 {
            best = (colour as u8, cosine);
        }
    }
    best.0
}

const _: () = assert!(LOW > DARK && WHITE_FROM < SATURATED);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_colours_are_their_own_class() {
        let table = ColourTable::default();
        for colour in Colour::ALL {
            let [_, cb, cr] = reference(colour);
            let expected = if colour == Colour::White { UNSURE } else { colour as u8 };
            assert_eq!(table.class(cb, cr), expected, "{colour:?}");
        }
        assert_eq!(table.class(128, 128), UNSURE);
    }

    #[test]
    fn half_the_chroma_is_still_the_same_class() {
        let table = ColourTable::default();
        for colour in Colour::ALL.into_iter().filter(|&c| c != Colour::White) {
            let [_, cb, cr] = reference(colour).map(|v| (128 + (i32::from(v) - 128) * 5 / 10) as u8);
            assert_eq!(table.class(cb, cr), colour as u8, "{colour:?}");
        }
    }

    #[test]
    fn weights_rise_from_nothing_to_full() {
        let table = ColourTable::default();
        for colour in Colour::ALL {
            let lit = reference(colour)[0];
            let weights: Vec<u8> = (0..=255).map(|luma| table.weight(luma, lit)).collect();
            assert!(weights.is_sorted());
            assert_eq!((weights[usize::from(LOW)], weights[255]), (0, FULL_WEIGHT), "{colour:?}");
            assert_eq!(weights[usize::from(lit) - 8], FULL_WEIGHT, "room for shading");
            let half = weights[usize::from((lit + DARK) / 2)];
            assert!(half.abs_diff(FULL_WEIGHT / 2) <= 8, "{colour:?}: {half} at half the contrast");
            assert!(table.least_lit(colour as u8) < lit);
        }
    }
}
