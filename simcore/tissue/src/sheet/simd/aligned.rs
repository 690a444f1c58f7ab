//! Lists of numbers that begin on a cache line, so that no block of sixteen crosses two.

use super::WIDE;
use std::ops::{Deref, DerefMut};

/// One cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; WIDE]);

/// A list of a fixed length.
#[derive(Debug, Clone, Default)]
pub struct Aligned {
    lines: Vec<Line>,
    len: usize,
}

impl Aligned {
    /// `n` times the same number.
    pub fn new(len: usize, value: f32) -> Self {
        Aligned { lines: vec![Line([value; WIDE]); len.div_ceil(WIDE)], len }
    }
}

impl Deref for Aligned {
    type Target = [f32];

    #[inline(always)]
    fn deref(&self) -> &[f32] {
        // SAFETY: a line is sixteen numbers without padding, and there are lines for `len` of them.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above, and the lines are borrowed alone.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_begin_on_a_line_and_keep_their_length() {
        for len in [0, 1, 15, 16, 17, 1000] {
            let mut list = Aligned::new(len, 2.5);
            assert_eq!((list.len(), list.as_ptr() as usize % 64), (len, 0));
            if let Some(last) = list.last_mut() {
                *last = 7.0;
                assert_eq!(list.iter().sum::<f32>(), 2.5 * (len - 1) as f32 + 7.0);
            }
        }
    }
}
