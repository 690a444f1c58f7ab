//! Runs: neighbouring bright pixels of one colour in one line.

use crate::colours::{ColourTable, LOW, UNSURE, WHITE_FROM};
use protocol::blobs::Colour;

/// Runs held for one line; more are counted as lost. The shipped rig shows 14 markers.
pub const MAX_RUNS: usize = 128;
/// Luma is looked at in groups of this many pixels, which the compiler turns into one comparison.
const GROUP: usize = 16;

/// A run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Run {
    /// First column.
    pub start: u16,
    /// One past the last column.
    pub end: u16,
    /// Colour class.
    pub class: u8,
    /// Component it belongs to, once known.
    pub label: u8,
}

/// The runs of a line, from left to right.
#[derive(Debug, Clone)]
pub struct Runs {
    runs: [Run; MAX_RUNS],
    count: usize,
    /// Runs that found no room, since the beginning of the field.
    pub lost: u32,
}

impl Default for Runs {
    fn default() -> Self {
        Runs { runs: [Run::default(); MAX_RUNS], count: 0, lost: 0 }
    }
}

impl Runs {
    /// Forgets the runs, not the count of lost ones.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// The runs.
    pub fn all(&self) -> &[Run] {
        &self.runs[..self.count]
    }

    /// The runs, to be labelled.
    pub fn all_mut(&mut self) -> &mut [Run] {
        &mut self.runs[..self.count]
    }

    /// Finds the runs of a line.
    pub fn find(&mut self, table: &ColourTable, luma: &[u8], blue: &[u8], red: &[u8]) {
        self.clear();
        let mut x = 0;
        while let Some(start) = next_bright(luma, x) {
            let end = luma[start..].iter().position(|&v| v < LOW).map_or(luma.len(), |n| start + n);
            self.split(table, luma, blue, red, start..end);
            x = end;
        }
    }

    /// Cuts a bright stretch where the colour changes; unsure pixels belong to what is left of them,
    /// or, at the beginning, to what follows.
    fn split(
        &mut self,
        table: &ColourTable,
        luma: &[u8],
        blue: &[u8],
        red: &[u8],
        stretch: std::ops::Range<usize>,
    ) {
        let mut run = Run { start: stretch.start as u16, ..Run::default() };
        let mut brightest = 0;
        for x in stretch.clone() {
            let class = table.class(blue[x / 2], red[x / 2]);
            if class != UNSURE && class != run.class {
                if run.class != UNSURE {
                    self.push(Run { end: x as u16, ..run });
                    run.start = x as u16;
                }
                run.class = class;
            }
            brightest = brightest.max(luma[x]);
        }
        run.end = stretch.end as u16;
        if run.class == UNSURE && brightest >= WHITE_FROM {
            run.class = Colour::White as u8;
        }
        if run.class != UNSURE {
            self.push(run);
        }
    }

    fn push(&mut self, run: Run) {
        if self.count < MAX_RUNS {
            self.runs[self.count] = run;
            self.count += 1;
        } else {
            self.lost = self.lost.saturating_add(1);
        }
    }
}

/// First column from `x` on that is not dark.
fn next_bright(luma: &[u8], x: usize) -> Option<usize> {
    let rest = luma.get(x..)?;
    let (groups, tail) = rest.as_chunks::<GROUP>();
    let dark = groups.iter().take_while(|g| g.iter().fold(0, |m, &v| m.max(v)) < LOW).count();
    let from = dark * GROUP;
    let within = groups.get(dark).map_or(tail, |g| &g[..]);
    within.iter().position(|&v| v >= LOW).map(|n| x + from + n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colours::{DARK, reference};
    use proptest::prelude::*;

    fn runs_of(line: &[Option<Colour>]) -> Vec<(u16, u16, u8)> {
        let pixel = |c: &Option<Colour>| c.map_or([DARK, 128, 128], reference);
        let luma: Vec<u8> = line.iter().map(|c| pixel(c)[0]).collect();
        let half = |k: usize| line.iter().step_by(2).map(|c| pixel(c)[k]).collect::<Vec<u8>>();
        let mut runs = Runs::default();
        runs.find(&ColourTable::default(), &luma, &half(1), &half(2));
        runs.all().iter().map(|r| (r.start, r.end, r.class)).collect()
    }

    #[test]
    fn runs_end_at_dark_and_at_another_colour() {
        use Colour::*;
        let mut line = vec![None; 64];
        line[3..9].fill(Some(Red));
        line[20..30].fill(Some(Green));
        line[30..40].fill(Some(Blue));
        line[50..56].fill(Some(White));
        line[60..].fill(Some(Red));
        let expected = [(4, 9, Red), (20, 30, Green), (30, 40, Blue), (50, 56, White), (60, 64, Red)];
        let mut expected: Vec<_> = expected.map(|(a, b, c)| (a, b, c as u8)).to_vec();
        expected[0].0 = 3;
        assert_eq!(runs_of(&line), expected);
    }

    proptest! {
        #[test]
        fn bright_pixels_are_found_one_by_one(luma in prop::collection::vec(any::<u8>(), 0..100), x in 0usize..110) {
            let expected = (x..luma.len()).find(|&i| luma[i] >= LOW);
            prop_assert_eq!(next_bright(&luma, x), expected);
        }
    }
}
