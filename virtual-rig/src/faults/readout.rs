//! Faults of sensor and read-out: torn fields and hot pixels.

use super::{Faults, Kind};
use crate::painter::BLACK;
use protocol::fields::FieldPicture;
use std::ops::DerefMut;

/// Most lines that go missing.
const MOST_MISSING: u64 = 32;
/// Luma of the dimmest hot pixel, and how much brighter the brightest is.
const HOT_LUMA: [u64; 2] = [150, 100];
/// A field is torn between these shares of its lines, in 1/8.
const TORN_WITHIN_8: [usize; 2] = [1, 7];

/// Where and how a field is torn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tear {
    /// First line concerned.
    pub line: usize,
    /// Lines missing from there on; 0: everything from there on is of the field before.
    pub missing: usize,
}

impl Tear {
    /// True if this line, or a blob with its centre there, is as it should be.
    pub fn spares(&self, line: f64) -> bool {
        line < self.line as f64 || (self.missing > 0 && line >= (self.line + self.missing) as f64)
    }

    /// Does to `picture` what happened: lines go missing or come from `before`.
    pub fn apply<B: DerefMut<Target = [u8]>>(&self, picture: &mut FieldPicture<B>, before: &FieldPicture) {
        let end = if self.missing > 0 { self.line + self.missing } else { picture.height };
        let lines = self.line.min(picture.height)..end.min(picture.height);
        if self.missing > 0 {
            picture.blank_lines(lines, BLACK as u8);
        } else {
            picture.copy_lines(lines, before);
        }
    }
}

impl Faults {
    /// How a field of so many lines is torn. The first field has nothing before it and stays whole.
    pub fn tear(&self, camera: u32, field: u64, lines: usize) -> Option<Tear> {
        let torn = self.spec.torn.as_ref().filter(|_| self.concerns(Kind::Torn, camera) && field > 0)?;
        let throw = self.dice.throw(Kind::Torn, camera, field);
        if throw.uniform(0) >= torn.rate {
            return None;
        }
        let [from, to] = TORN_WITHIN_8.map(|share| lines * share / 8);
        let line = from + throw.below(1, (to - from) as u64) as usize;
        let missing = if throw.below(2, 2) == 0 { 0 } else { 1 + throw.below(3, MOST_MISSING) as usize };
        Some(Tear { line, missing })
    }

    /// Puts a camera's hot pixels into a picture of a field of `height` lines. Their places stay as long
    /// as the camera lives; those below the picture's last line are left out.
    pub fn heat<B: DerefMut<Target = [u8]>>(
        &self,
        camera: u32,
        height: usize,
        picture: &mut FieldPicture<B>,
    ) {
        let hot = self.spec.hot_pixels.as_ref().filter(|_| self.concerns(Kind::HotPixels, camera));
        let pixels = (picture.width * height) as u64;
        for i in 0..hot.map_or(0, |h| u64::from(h.count)) {
            let throw = self.dice.throw(Kind::HotPixels, camera, i);
            if let Some(pixel) = picture.luma.get_mut(throw.below(0, pixels) as usize) {
                *pixel = (*pixel).max((HOT_LUMA[0] + throw.below(1, HOT_LUMA[1])) as u8);
            }
        }
    }
}
