//! Faults of sensor and read-out: torn fields, hot pixels.

use super::{FaultInjector, FaultKind};
use crate::painter::BLACK;
use protocol::fields::FieldPicture;
use std::ops::DerefMut;

/// Most missing lines of a torn field.
const MOST_MISSING: u64 = 32;
/// Luma of the dimmest hot pixel, and how much brighter the brightest is.
const HOT_LUMA: [u64; 2] = [150, 100];
/// A field is torn between these shares of its lines, in 1/8.
const TORN_WITHIN_8: [usize; 2] = [1, 7];

/// Place and kind of a tear.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tear {
    /// First torn line.
    pub line: usize,
    /// Missing lines from there on; 0: everything from there on is of the previous field.
    pub missing: usize,
}

impl Tear {
    /// True if `line` is not torn, nor a blob with its centre there.
    pub fn is_intact(&self, line: f64) -> bool {
        line < self.line as f64 || (self.missing > 0 && line >= (self.line + self.missing) as f64)
    }

    /// Tears `picture`: blanks the missing lines, or copies the torn ones from `before`.
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

impl FaultInjector {
    /// Tear of a field of `lines` lines, if it is torn. Field 0 has no previous one and stays
    /// whole.
    pub fn tear(&self, camera: u32, field: u64, lines: usize) -> Option<Tear> {
        let torn = self.of(&self.spec.torn, FaultKind::Torn, camera).filter(|_| field > 0)?;
        let draw = self.sampler.draw(FaultKind::Torn, camera, field);
        if draw.uniform(0) >= torn.rate {
            return None;
        }
        let [from, to] = TORN_WITHIN_8.map(|share| lines * share / 8);
        let line = from + draw.below(1, (to - from) as u64) as usize;
        let missing = if draw.below(2, 2) == 0 { 0 } else { 1 + draw.below(3, MOST_MISSING) as usize };
        Some(Tear { line, missing })
    }

    /// Adds the camera's hot pixels to a picture of a field of `height` lines. Their places are the
    /// same in every field; those below the picture's last line are left out.
    pub fn add_hot_pixels<B: DerefMut<Target = [u8]>>(
        &self,
        camera: u32,
        height: usize,
        picture: &mut FieldPicture<B>,
    ) {
        let hot = self.of(&self.spec.hot_pixels, FaultKind::HotPixels, camera);
        let pixels = (picture.width * height) as u64;
        for i in 0..hot.map_or(0, |h| u64::from(h.count)) {
            let draw = self.sampler.draw(FaultKind::HotPixels, camera, i);
            if let Some(pixel) = picture.luma.get_mut(draw.below(0, pixels) as usize) {
                *pixel = (*pixel).max((HOT_LUMA[0] + draw.below(1, HOT_LUMA[1])) as u8);
            }
        }
    }
}
