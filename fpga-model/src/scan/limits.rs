//! Sizes of the extractor's tables, and the register widths that follow.
//!
//! Every width follows from [`Limits`] by counting; the relations that the code relies on are
//! asserted at compile time for both sets of limits, so that a larger table cannot quietly overflow
//! a register.

/// Sizes of the extractor's tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Longest line, px.
    pub width: usize,
    /// Most lines of a field.
    pub lines: usize,
    /// Runs in one line; more are counted as lost.
    pub runs: usize,
    /// Components open at a time; runs that find no label are counted as lost.
    pub labels: usize,
    /// Blobs of one field: the first to be complete; more are counted as lost.
    pub blobs: usize,
}

/// The camera hardware: PAL fields of 720 × 288, and the 64 blobs of the wire. The shipped rig
/// shows 14 markers, each crossed by one run a line.
pub const CAMERA: Limits =
    Limits { width: 720, lines: 288, runs: 128, labels: 128, blobs: protocol::limits::MAX_BLOBS };
/// Pictures and rigs with other sensors: sides up to 8,192 px, as many blobs as a star field has.
pub const PICTURE: Limits = Limits { width: 8192, lines: 8192, runs: 1024, labels: 1024, blobs: 65_536 };

/// Weight of a pixel that lies wholly inside a marker.
pub const FULL_WEIGHT: u8 = 64;
/// Fixed point of background levels: 1/16 grey level.
pub const LEVEL_BITS: u32 = 4;

/// Pixel clocks of one line, blanking included: 64 µs at 13.5 MHz.
pub const LINE_CLOCKS: u64 = 864;
/// Pixel clock, Hz (ITU-R BT.601).
pub const PIXEL_CLOCK_HZ: u64 = 13_500_000;

/// Bits that hold every number from 0 to `max`.
pub const fn bits(max: u128) -> u32 {
    u128::BITS - max.leading_zeros()
}

/// Widths of the registers, bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Widths {
    /// A column.
    pub x: u32,
    /// A line.
    pub y: u32,
    /// A label.
    pub label: u32,
    /// Pixels of a component.
    pub area: u32,
    /// Σ w.
    pub w: u32,
    /// Σ w·x.
    pub wx: u32,
    /// Σ w·y.
    pub wy: u32,
    /// Σ w·x².
    pub wxx: u32,
    /// Σ w·x·y.
    pub wxy: u32,
    /// Σ w·y².
    pub wyy: u32,
    /// Σ w·x³.
    pub wxxx: u32,
    /// Σ w·x²·y.
    pub wxxy: u32,
    /// Σ w·x·y².
    pub wxyy: u32,
    /// Σ w·y³.
    pub wyyy: u32,
    /// Σ of rises of the lit surface, with its sign.
    pub rise: u32,
    /// Σ of spans times contrasts.
    pub span: u32,
    /// Σ of squared differences.
    pub grain: u32,
}

/// Largest luma in quarters of a level.
const RISE: u128 = 4 * 255;

/// Sums of k⁰, k¹, k² and k³ over all k below `n`.
const fn power_sums(n: u128) -> [u128; 4] {
    let last = n - 1;
    let triangle = last * n / 2;
    [n, triangle, triangle * (2 * last + 1) / 3, triangle * triangle]
}

impl Limits {
    /// Widths that hold any component of a field of this size, up to the whole field at full
    /// weight.
    pub const fn widths(&self) -> Widths {
        let full = FULL_WEIGHT as u128;
        let [x0, x1, x2, x3] = power_sums(self.width as u128);
        let [y0, y1, y2, y3] = power_sums(self.lines as u128);
        Widths {
            x: bits(self.width as u128 - 1),
            y: bits(self.lines as u128 - 1),
            label: bits(self.labels as u128 - 1),
            area: bits(x0 * y0),
            w: bits(full * x0 * y0),
            wx: bits(full * x1 * y0),
            wy: bits(full * x0 * y1),
            wxx: bits(full * x2 * y0),
            wxy: bits(full * x1 * y1),
            wyy: bits(full * x0 * y2),
            wxxx: bits(full * x3 * y0),
            wxxy: bits(full * x2 * y1),
            wxyy: bits(full * x1 * y2),
            wyyy: bits(full * x0 * y3),
            // At most one run in two columns, each with a rise of up to 255 levels in quarters.
            rise: bits(RISE * x0 * y0 / 2) + 1,
            span: bits(RISE * x0 * y0),
            grain: bits(255 * 255 * x0 * y0),
        }
    }
}

/// Clocks to read one run and add it to its component: every register has its own adder.
pub const RUN_CLOCKS: u64 = 2;
/// Clocks to unite two components: one to read, one to write; the runs' labels change in the same
/// clock, each beside its own comparator.
pub const UNION_CLOCKS: u64 = 2;
/// Quotients and roots of one component: nine moments, the shift by the illumination's slope, two
/// variances, and three for the decision whether it is more than one marker.
const QUOTIENTS: u64 = 15;
/// Further ones of two markers that touch: six for axis and places, three rounds of six for the
/// lens and one before, and seven for the shares (`split`).
const SPLIT_QUOTIENTS: u64 = 6 + 1 + 3 * 6 + 7;
/// Bits of a quotient or root; the divider yields one a clock.
const QUOTIENT_BITS: u64 = 32;
/// Clocks of the divider for one component.
pub const DIVIDER_CLOCKS: u64 = QUOTIENTS * QUOTIENT_BITS;
/// Further clocks for two markers that touch.
pub const SPLIT_CLOCKS: u64 = SPLIT_QUOTIENTS * QUOTIENT_BITS;

// A line's runs are labelled while the next line is read: at worst all of them, uniting all
// components above, and a search of every label.
const _: () = assert!(
    CAMERA.runs as u64 * (RUN_CLOCKS + UNION_CLOCKS) + CAMERA.labels as u64 <= LINE_CLOCKS,
    "labelling keeps up with the pixels"
);
// One component is divided in less than a line, so that those of different lines do not wait for
// each other, unless two markers touch; then in less than two.
const _: () = assert!(DIVIDER_CLOCKS <= LINE_CLOCKS && DIVIDER_CLOCKS + SPLIT_CLOCKS <= 2 * LINE_CLOCKS);
// The twin's own registers (`sums`) hold what the hardware's hold.
const _: () = {
    let [camera, picture] = [CAMERA.widths(), PICTURE.widths()];
    assert!(camera.x <= 10 && camera.y <= 9 && camera.w <= 24 && camera.wyyy <= u64::BITS);
    assert!(picture.x <= u16::BITS && picture.y <= u16::BITS && picture.label <= u16::BITS);
    assert!(picture.area <= u32::BITS && picture.wxx <= u64::BITS && picture.wyy <= u64::BITS);
    assert!(picture.wxxx <= u128::BITS && picture.wyyy <= u128::BITS);
    assert!(picture.rise < i64::BITS && picture.span <= u64::BITS && picture.grain <= u64::BITS);
    // Products of a second or third moment with Σ w², as the central moments need them, in 128
    // bits.
    assert!(picture.wxx + picture.w < 127 && camera.wxxx + 2 * camera.w < 127);
};
// A component of every label and a run of every pixel pair can exist.
const _: () = assert!(CAMERA.runs <= CAMERA.width / 2 && CAMERA.blobs <= CAMERA.labels);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_are_those_of_the_brightest_possible_field() {
        for limits in [CAMERA, Limits { width: 17, lines: 5, ..CAMERA }] {
            let mut sums = [0u128; 10];
            for y in 0..limits.lines as u128 {
                for x in 0..limits.width as u128 {
                    let w = u128::from(FULL_WEIGHT);
                    let terms = [1, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
                        .map(|m| m * w);
                    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                }
            }
            let w = limits.widths();
            let widths = [w.w, w.wx, w.wy, w.wxx, w.wxy, w.wyy, w.wxxx, w.wxxy, w.wxyy, w.wyyy];
            assert_eq!(widths, sums.map(|s| 128 - s.leading_zeros()));
            assert_eq!(w.area, bits((limits.width * limits.lines) as u128));
        }
    }
}
