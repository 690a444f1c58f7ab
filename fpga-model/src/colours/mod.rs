//! What the cameras take for which colour: chroma look-up table and luma ramp.
//!
//! Luma gives positions, chroma gives classes, because PAL chroma is band-limited and its edges are
//! blurred over several pixels. Samples are 8-bit YCbCr (ITU-R BT.601); RGB is converted ([`convert`]).
//! Classes come from a file ([`file`]) or are learnt from pictures ([`learn`]).

pub mod convert;
pub mod file;
pub mod learn;

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
const LEAST_CHROMA: u8 = 24;
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

/// A class: a colour and what counts as it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Class {
    /// Its name.
    pub colour: Colour,
    /// Y, Cb, Cr of a well lit marker.
    pub reference: [u8; 3],
    /// Least distance from grey of its samples; not used by white.
    pub least_chroma: u8,
    /// Greatest difference of hue from the reference, degrees, up to 180; not used by white.
    pub tolerance_deg: f64,
}

impl Class {
    /// The reference marker of a colour, with every hue that is nearer to it than to another one.
    pub fn of_reference(colour: Colour) -> Self {
        let least_chroma = LEAST_CHROMA;
        Class { colour, reference: reference(colour), least_chroma, tolerance_deg: 180.0 }
    }

    /// How well a chroma sample, as a distance from grey, fits: the signed square of the cosine between
    /// the two hues, times the sample's own square. `None` if it does not belong to the class.
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
    /// From the reference colours.
    fn default() -> Self {
        Self::of_classes(&Colour::ALL.map(Class::of_reference), DARK)
    }
}

impl ColourTable {
    /// The tables for some classes, before a background of luma `black`.
    pub fn of_classes(classes: &[Class], black: u8) -> Self {
        let reciprocal = |luma: usize| ((1 << 16) / luma.saturating_sub(usize::from(black)).max(2)) as u16;
        let mut table = ColourTable {
            classes: [UNSURE; SIDE * SIDE],
            least_lit: [u8::MAX; CLASSES],
            reciprocals: std::array::from_fn(reciprocal),
        };
        for (i, cell) in table.classes.iter_mut().enumerate() {
            let middle = |cell: usize| ((cell << SHIFT) + (1 << (SHIFT - 1))) as i64 - 128;
            *cell = best_class(classes, middle(i / SIDE), middle(i % SIDE));
        }
        for class in classes {
            let contrast = u16::from(class.reference[0].saturating_sub(black));
            table.least_lit[class.colour as usize] = black + (contrast * LEAST_CONTRAST_16 / 16) as u8;
        }
        table
    }

    /// Takes every surface from luma `lit` on for a lit one, whatever the references say: for blobs that
    /// nobody knows the brightness of.
    pub fn lit_from(&mut self, lit: u8) {
        self.least_lit = [lit; CLASSES];
    }

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

/// The class of the most similar hue, integers only; of equals the first.
fn best_class(classes: &[Class], cb: i64, cr: i64) -> u8 {
    let mut best = (UNSURE, i64::MIN);
    for class in classes {
        if let Some(fit) = class.fit(cb, cr).filter(|&fit| fit > best.1) {
            best = (class.colour as u8, fit);
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
