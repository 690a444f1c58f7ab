//! Assignment of pixels to components for weighing.
//!
//! Runs hold the pixels that stand out from the background; a marker's blurred edge extends
//! further. A run also owns up to [`SKIRT`] columns beside it, though no more than half of the gap
//! to the next run, and the pixels directly below and above it that no run of their own line owns.
//! These pixels are weighed with the run; they do not connect components.
//!
//! The owner of a pixel is the first of: the coloured run of its line, skirt included; the run of
//! the line above that covers its column; that of the line below; the white run of its line. White
//! comes last because the faint first and last line of a marker show no colour of their own.

use super::runs::{NO_LABEL, Run, Runs};
use protocol::blobs::Colour;
use std::ops::Range;

/// Columns beside a run that belong to it.
pub const SKIRT: u16 = 2;

/// Pixels of one line that belong to one component.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claim {
    /// Columns.
    pub columns: Range<u16>,
    /// Label of the component.
    pub label: u16,
    /// True for a run with its skirt.
    pub run: bool,
}

/// The assignment with its scratch registers.
#[derive(Debug, Clone)]
pub struct Owners {
    /// Coloured runs of the line, with their skirts.
    own: Vec<Run>,
    labels: Vec<u16>,
}

impl Owners {
    /// Room for `runs` runs a line.
    pub fn new(runs: usize) -> Self {
        Owners { own: Vec::with_capacity(runs), labels: Vec::with_capacity(runs) }
    }

    /// Calls `claim` for every owned stretch of a line of `width` px, given its runs and those of
    /// the lines above and below.
    pub fn each(
        &mut self,
        width: u16,
        line: &Runs,
        above: &Runs,
        below: &Runs,
        mut claim: impl FnMut(Claim),
    ) {
        self.add_skirts(width, line);
        let mut emit = |columns: Range<u16>, label: u16, run: bool| {
            if label != NO_LABEL && !columns.is_empty() {
                claim(Claim { columns, label, run });
            }
        };
        for (run, &label) in self.own.iter().zip(&self.labels) {
            emit(run.start..run.end, label, true);
        }
        for (run, &label) in above.all().iter().zip(above.labels()) {
            uncovered(run.start..run.end, &self.own, &mut |free| emit(free, label, false));
        }
        for (run, &label) in below.all().iter().zip(below.labels()) {
            uncovered(run.start..run.end, &self.own, &mut |free| {
                uncovered(free, above.all(), &mut |free| emit(free, label, false));
            });
        }
        for (run, &label) in line.all().iter().zip(line.labels()).filter(|(run, _)| is_white(run)) {
            uncovered(run.start..run.end, above.all(), &mut |free| {
                uncovered(free, below.all(), &mut |free| emit(free, label, false));
            });
        }
    }

    /// Fills `own` with the coloured runs and their skirts.
    fn add_skirts(&mut self, width: u16, line: &Runs) {
        self.own.clear();
        self.labels.clear();
        let all = line.all();
        for (i, run) in all.iter().enumerate().filter(|(_, run)| !is_white(run)) {
            let left = match i.checked_sub(1).map(|i| run.start - all[i].end) {
                Some(gap) => SKIRT.min(gap / 2),
                None => SKIRT.min(run.start),
            };
            let right = match all.get(i + 1).map(|next| next.start - run.end) {
                Some(gap) => SKIRT.min(gap - gap / 2),
                None => SKIRT.min(width - run.end),
            };
            self.own.push(Run { start: run.start - left, end: run.end + right, class: run.class });
            self.labels.push(line.labels()[i]);
        }
    }
}

fn is_white(run: &Run) -> bool {
    run.class == Colour::White as u8
}

/// Calls `free` for each part of `columns` that no run covers; `runs` are sorted from left to
/// right.
fn uncovered(columns: Range<u16>, runs: &[Run], free: &mut impl FnMut(Range<u16>)) {
    let mut from = columns.start;
    let first = runs.partition_point(|run| run.end <= from);
    for run in runs[first..].iter().take_while(|run| run.start < columns.end) {
        if run.start > from {
            free(from..run.start);
        }
        from = from.max(run.end);
    }
    if from < columns.end {
        free(from..columns.end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WIDTH: usize = 40;

    /// Runs from a line of letters; the label of a run is its class and its place in the line.
    fn runs_of(line: &[u8]) -> Runs {
        let mut runs = Runs::new(WIDTH);
        let mut start = 0;
        for (i, stretch) in line.chunk_by(|a, b| a == b).enumerate() {
            let end = start + stretch.len() as u16;
            if stretch[0] > 0 {
                runs.push(Run { start, end, class: stretch[0] });
                runs.set_label(runs.all().len() - 1, u16::from(stretch[0]) * 100 + i as u16);
            }
            start = end;
        }
        runs
    }

    /// The owner of a pixel by the definition.
    fn owner(x: u16, [above, line, below]: &[Runs; 3]) -> u16 {
        let covering = |runs: &Runs| runs.all().iter().position(|r| r.start <= x && x < r.end);
        let label = |runs: &Runs, i: Option<usize>| i.map(|i| runs.labels()[i]);
        let own = covering(line);
        if let Some(i) = own.filter(|&i| line.all()[i].class != 7) {
            return line.labels()[i];
        }
        let skirt = |i: usize, distance: u16, gap: u16, left_side: bool| {
            let half = if left_side { gap / 2 } else { gap - gap / 2 };
            line.all()[i].class != 7 && distance <= SKIRT.min(half)
        };
        if own.is_none() {
            let after = line.all().iter().position(|r| r.start > x);
            let before = line.all().iter().rposition(|r| r.end <= x);
            let gap = match (before, after) {
                (Some(b), Some(a)) => line.all()[a].start - line.all()[b].end,
                _ => u16::MAX,
            };
            if let Some(b) = before.filter(|&b| skirt(b, x - line.all()[b].end + 1, gap, false)) {
                return line.labels()[b];
            }
            if let Some(a) = after.filter(|&a| skirt(a, line.all()[a].start - x, gap, true)) {
                return line.labels()[a];
            }
        }
        label(above, covering(above))
            .or_else(|| label(below, covering(below)))
            .or_else(|| label(line, own))
            .unwrap_or(NO_LABEL)
    }

    proptest! {
        #[test]
        fn every_pixel_has_the_owner_of_the_rule(
            lines in prop::array::uniform3(prop::collection::vec(prop::sample::select(vec![0u8, 0, 0, 1, 2, 7]), WIDTH)),
        ) {
            let runs = lines.map(|line| runs_of(&line));
            let mut found = [NO_LABEL; WIDTH];
            let [above, line, below] = &runs;
            Owners::new(WIDTH).each(WIDTH as u16, line, above, below, |claim| {
                for x in claim.columns {
                    assert_eq!(std::mem::replace(&mut found[usize::from(x)], claim.label), NO_LABEL, "owned twice");
                }
            });
            for (x, &found) in (0..).zip(&found) {
                prop_assert_eq!(found, owner(x, &runs), "column {}", x);
            }
        }
    }
}
