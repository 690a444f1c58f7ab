//! The bounded table of open components: allocation, union and release of labels.

use super::sums::Sums;

/// Components that are open, by label.
#[derive(Debug, Clone)]
pub struct Labels {
    sums: Vec<Sums>,
    /// One bit a label, set while it is in use.
    used: Vec<u64>,
}

impl Labels {
    /// Room for `capacity` components.
    pub fn new(capacity: usize) -> Self {
        let mut labels =
            Labels { sums: vec![Sums::default(); capacity], used: vec![0; capacity.div_ceil(64)] };
        labels.clear();
        labels
    }

    /// Frees every label.
    pub fn clear(&mut self) {
        self.used.fill(0);
        // Bits of the last word beyond the table are never free.
        let rest = self.sums.len() % 64;
        if rest > 0 {
            *self.used.last_mut().expect("a table has a word") = u64::MAX << rest;
        }
    }

    /// Allocates the lowest free label with empty sums; `None` where all are in use.
    pub fn open(&mut self) -> Option<u16> {
        let word = self.used.iter().position(|w| *w != u64::MAX)?;
        let bit = self.used[word].trailing_ones() as usize;
        self.used[word] |= 1 << bit;
        let label = word * 64 + bit;
        self.sums[label] = Sums::default();
        Some(label as u16)
    }

    /// Adds the sums of a run to a component.
    pub fn add(&mut self, label: u16, part: &Sums) {
        let own = &mut self.sums[usize::from(label)];
        if own.area == 0 {
            *own = *part;
        } else {
            own.add(part);
        }
    }

    /// The sums of a component.
    pub fn sums_mut(&mut self, label: u16) -> &mut Sums {
        &mut self.sums[usize::from(label)]
    }

    /// Adds the sums of `freed` to `kept` and frees it.
    pub fn unite(&mut self, kept: u16, freed: u16) {
        let part = self.sums[usize::from(freed)];
        self.add(kept, &part);
        self.free(freed);
    }

    /// Frees the first label whose component is `complete` and returns both.
    pub fn take(&mut self, complete: impl Fn(&Sums) -> bool) -> Option<(u16, Sums)> {
        for word in 0..self.used.len() {
            let mut waiting = self.used[word];
            while waiting != 0 {
                let label = word * 64 + waiting.trailing_zeros() as usize;
                waiting &= waiting - 1;
                let Some(sums) = self.sums.get(label) else { break };
                if complete(sums) {
                    let sums = *sums;
                    self.free(label as u16);
                    return Some((label as u16, sums));
                }
            }
        }
        None
    }

    fn free(&mut self, label: u16) {
        self.used[usize::from(label) / 64] &= !(1 << (label % 64));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(area: u32) -> Sums {
        Sums { area, ..Sums::default() }
    }

    #[test]
    fn labels_are_bounded_and_used_again() {
        for capacity in [1usize, 63, 64, 65, 128, 1000] {
            let mut labels = Labels::new(capacity);
            let all: Vec<_> = std::iter::from_fn(|| labels.open()).collect();
            assert_eq!(all, (0..capacity as u16).collect::<Vec<_>>());
            all.iter().for_each(|&label| labels.add(label, &part(u32::from(label) + 1)));
            let odd = |sums: &Sums| sums.area % 2 == 1;
            let taken: Vec<_> = std::iter::from_fn(|| labels.take(odd)).collect();
            assert_eq!(taken.len(), capacity.div_ceil(2));
            assert!(taken.iter().all(|(label, sums)| sums.area == u32::from(*label) + 1));
            assert_eq!(labels.open(), Some(0), "the lowest free label comes first");
        }
    }

    #[test]
    fn united_components_have_both_sums() {
        let mut labels = Labels::new(4);
        let [a, b] = [labels.open().unwrap(), labels.open().unwrap()];
        labels.add(a, &part(3));
        labels.add(b, &part(4));
        labels.unite(a, b);
        assert_eq!(labels.open(), Some(b), "free at once");
        assert_eq!(labels.take(|s| s.area > 0).map(|(label, sums)| (label, sums.area)), Some((a, 7)));
    }
}
