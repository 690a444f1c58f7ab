//! Runs: neighbouring pixels of one line that stand out from the background and have one colour.

use crate::colours::{ColourTable, UNSURE};
use protocol::blobs::Colour;
use std::ops::Range;

/// Pixels compared at a time; the compiler makes one vector comparison of them.
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
}

/// The runs of a line, from left to right, and the label of each.
#[derive(Debug, Clone)]
pub struct Runs {
    runs: Vec<Run>,
    /// One a run; apart from the runs, because a union rewrites labels only.
    labels: Vec<u16>,
    capacity: usize,
    /// Runs beyond the capacity since the beginning of the field.
    pub lost: u32,
}

/// The label of a run that has none.
pub const NO_LABEL: u16 = u16::MAX;

impl Runs {
    /// Room for `capacity` runs.
    pub fn new(capacity: usize) -> Self {
        let (runs, labels) = (Vec::with_capacity(capacity), Vec::with_capacity(capacity));
        Runs { runs, labels, capacity, lost: 0 }
    }

    /// Removes the runs and keeps the count of lost ones.
    pub fn clear(&mut self) {
        self.runs.clear();
        self.labels.clear();
    }

    /// The runs.
    pub fn all(&self) -> &[Run] {
        &self.runs
    }

    /// The labels, one a run; [`NO_LABEL`] until it is set.
    pub fn labels(&self) -> &[u16] {
        &self.labels
    }

    /// Gives run `i` its label.
    pub fn set_label(&mut self, i: usize, label: u16) {
        self.labels[i] = label;
    }

    /// Gives all runs of label `from` the label `to`.
    pub fn relabel(&mut self, from: u16, to: u16) {
        for label in &mut self.labels {
            *label = if *label == from { to } else { *label };
        }
    }

    /// Finds the runs of a line: `foreground[x]` is the least luma of a pixel that stands out
    /// there.
    pub fn find(&mut self, table: &ColourTable, foreground: &[u8], luma: &[u8], chroma: [&[u8]; 2]) {
        self.clear();
        let mut x = 0;
        while let Some(start) = next_bright(luma, foreground, x) {
            let rest = luma[start..].iter().zip(&foreground[start..]);
            let length = rest.take_while(|(v, least)| v >= least).count();
            self.split(table, chroma, start..start + length);
            x = start + length;
        }
    }

    /// Cuts a bright stretch where the colour changes. Unclassified pixels belong to the run on
    /// their left, or, at the beginning, to the one on their right; a stretch without any class is
    /// white, and its component needs the brightness of white (`Settings::high`).
    fn split(&mut self, table: &ColourTable, [blue, red]: [&[u8]; 2], stretch: Range<usize>) {
        let mut run = Run { start: stretch.start as u16, end: stretch.end as u16, class: UNSURE };
        // A chroma sample serves two pixels: it is looked up once.
        let mut x = stretch.start;
        while x < stretch.end {
            let class = table.class(blue[x / 2], red[x / 2]);
            if class != UNSURE && class != run.class {
                if run.class != UNSURE {
                    self.push(Run { end: x as u16, ..run });
                    run.start = x as u16;
                }
                run.class = class;
            }
            x = (x / 2 + 1) * 2;
        }
        if run.class == UNSURE {
            run.class = Colour::White as u8;
        }
        self.push(run);
    }

    /// Adds a run to the right of all others, or counts it as lost.
    pub(super) fn push(&mut self, run: Run) {
        if self.runs.len() < self.capacity {
            self.runs.push(run);
            self.labels.push(NO_LABEL);
        } else {
            self.lost = self.lost.saturating_add(1);
        }
    }
}

/// First column from `x` on that stands out.
fn next_bright(luma: &[u8], foreground: &[u8], x: usize) -> Option<usize> {
    let (luma, foreground) = (luma.get(x..)?, foreground.get(x..)?);
    let (groups, _) = luma.as_chunks::<GROUP>();
    let (least, _) = foreground.as_chunks::<GROUP>();
    let stands_out = |group: &[u8; GROUP], least: &[u8; GROUP]| {
        group.iter().zip(least).fold(0, |any, (v, l)| any | u8::from(v >= l)) != 0
    };
    let dark = groups.iter().zip(least).take_while(|(group, least)| !stands_out(group, least)).count();
    let from = dark * GROUP;
    let rest = luma[from..].iter().zip(&foreground[from..]);
    let found = rest.take(GROUP).position(|(v, l)| v >= l);
    found.map(|n| x + from + n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::fields::DARK;

    use proptest::prelude::*;

    fn runs_of(line: &[Option<Colour>]) -> Vec<(u16, u16, u8)> {
        let pixel = |c: &Option<Colour>| c.map_or([DARK, 128, 128], Colour::reference);
        let luma: Vec<u8> = line.iter().map(|c| pixel(c)[0]).collect();
        let half = |k: usize| line.iter().step_by(2).map(|c| pixel(c)[k]).collect::<Vec<u8>>();
        let mut runs = Runs::new(128);
        let foreground = vec![DARK + 16; luma.len()];
        runs.find(&ColourTable::default(), &foreground, &luma, [&half(1), &half(2)]);
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
        let expected = [(3, 9, Red), (20, 30, Green), (30, 40, Blue), (50, 56, White), (60, 64, Red)];
        assert_eq!(runs_of(&line), expected.map(|(a, b, c)| (a, b, c as u8)).to_vec());
    }

    #[test]
    fn runs_beyond_the_table_are_counted() {
        let luma: Vec<u8> = (0..64).map(|x| if x % 2 == 0 { 200 } else { 0 }).collect();
        let mut runs = Runs::new(5);
        runs.find(&ColourTable::default(), &[46; 64], &luma, [&[128; 32], &[128; 32]]);
        assert_eq!((runs.all().len(), runs.lost), (5, 27));
    }

    proptest! {
        #[test]
        fn bright_pixels_are_found_one_by_one(
            pixels in prop::collection::vec(any::<(u8, u8)>(), 0..100), x in 0usize..110,
        ) {
            let (luma, least): (Vec<u8>, Vec<u8>) = pixels.into_iter().unzip();
            let expected = (x..luma.len()).find(|&i| luma[i] >= least[i]);
            prop_assert_eq!(next_bright(&luma, &least, x), expected);
        }
    }
}
