//! Pixels to weights: how much of a pixel a marker covers, judged by its luma against the lit surface
//! beside it.

use crate::colours::ColourTable;
use std::ops::Range;

/// How far beside a pixel its lit surface is looked for, px: across the blurred edge.
pub const LIT_REACH: usize = 3;
/// Pixels of a line that have to be at hand at once.
pub const WINDOW: usize = 2 * LIT_REACH + 1;
/// Look-up tables: name, words, bits of a word.
pub const MEMORIES: [(&str, usize, u32); 1] = [("reciprocals of contrast", 256, u16::BITS)];

/// Writes the weight (0 to [`super::limits::FULL_WEIGHT`]) of each pixel of `run` in `line` to `out`.
/// The background there is at `background_q4` in 1/16 grey level.
pub fn weights(
    table: &ColourTable,
    line: &[u8],
    run: Range<usize>,
    class: u8,
    background_q4: u16,
    out: &mut Vec<u8>,
) {
    let _ = background_q4;
    let luma = &line[run];
    let least_lit = table.least_lit(class);
    out.clear();
    for (i, &value) in luma.iter().enumerate() {
        let beside = &luma[i.saturating_sub(LIT_REACH)..luma.len().min(i + LIT_REACH + 1)];
        let lit = beside.iter().fold(least_lit, |m, &v| m.max(v));
        out.push(table.weight(value, lit));
    }
}
