//! Dictionaries of square markers, and which marker some bits are, in which orientation.

use super::codes::{CODES_4, CODES_5, CODES_6, MENDED};

/// Markers of one size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dictionary {
    /// Bits of a side, without the black border.
    pub side: usize,
    /// The markers' bits, row by row from the top left, the highest bit first; 1 is white.
    codes: &'static [u64],
    /// Wrong bits that still leave one marker only.
    mended: u32,
}

/// A marker that was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Read {
    /// Which one.
    pub id: usize,
    /// Quarter turns clockwise by which it appears turned.
    pub turns: usize,
    /// Bits that were wrong.
    pub errors: u32,
}

impl Dictionary {
    /// The dictionary of a name of OpenCV, `DICT_4X4_50` to `DICT_6X6_1000`.
    pub fn named(name: &str) -> Option<Self> {
        let name = name.to_ascii_uppercase();
        let of = |&(side, count, mended): &(usize, usize, u32)| {
            let codes = [&CODES_4, &CODES_5, &CODES_6][side - 4];
            let own = Dictionary { side, codes: &codes[..count], mended };
            (own.name() == name).then_some(own)
        };
        MENDED.iter().find_map(of)
    }

    /// Its name.
    pub fn name(&self) -> String {
        format!("DICT_{0}X{0}_{1}", self.side, self.codes.len())
    }

    /// Number of markers.
    pub fn count(&self) -> usize {
        self.codes.len()
    }

    /// True if the bit of a marker is white; beyond its bits lies the black border.
    pub fn is_white(&self, id: usize, column: usize, row: usize) -> bool {
        let inside = column < self.side && row < self.side && id < self.codes.len();
        inside && self.codes[id] >> (self.side * self.side - 1 - row * self.side - column) & 1 == 1
    }

    /// The marker that bits (as in `codes`) are, with as many wrong bits as the dictionary mends.
    pub fn read(&self, bits: u64) -> Option<Read> {
        let mut turned = bits;
        let mut best: Option<Read> = None;
        for turns in 0..4 {
            for (id, code) in self.codes.iter().enumerate() {
                let errors = (code ^ turned).count_ones();
                if errors <= self.mended && best.is_none_or(|b| errors < b.errors) {
                    best = Some(Read { id, turns, errors });
                }
            }
            turned = self.turned_back(turned);
        }
        best
    }

    /// Bits turned by a quarter against the clock.
    fn turned_back(&self, bits: u64) -> u64 {
        let n = self.side;
        let bit = |row: usize, column: usize| bits >> (n * n - 1 - row * n - column) & 1;
        // What was in the last column becomes the first row.
        (0..n * n).fold(0, |out, i| out << 1 | bit(i % n, n - 1 - i / n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any() -> impl Strategy<Value = Dictionary> {
        let name = |i: usize| format!("dict_{0}x{0}_{1}", MENDED[i].0, MENDED[i].1);
        (0..MENDED.len()).prop_map(move |i| Dictionary::named(&name(i)).unwrap())
    }

    proptest! {
        #[test]
        fn a_marker_is_read_in_any_orientation_with_as_many_wrong_bits_as_are_mended(
            dictionary in any(), id in 0usize..50, turns in 0usize..4, flips in prop::array::uniform6(0u32..36),
        ) {
            let mut bits = dictionary.codes[id];
            // Three turns back are one clockwise.
            (0..3 * turns).for_each(|_| bits = dictionary.turned_back(bits));
            prop_assert_eq!(dictionary.read(bits), Some(Read { id, turns, errors: 0 }));
            let size = (dictionary.side * dictionary.side) as u32;
            let mut flips: Vec<u32> = flips.iter().map(|f| f % size).collect();
            flips.sort_unstable();
            flips.dedup();
            flips.truncate(dictionary.mended as usize);
            flips.iter().for_each(|f| bits ^= 1 << f);
            let errors = flips.len() as u32;
            prop_assert_eq!(dictionary.read(bits), Some(Read { id, turns, errors }));
        }

        #[test]
        fn any_bits_are_a_marker_or_none(dictionary in any(), bits in prop::num::u64::ANY) {
            let size = dictionary.side * dictionary.side;
            if let Some(read) = dictionary.read(bits & ((1 << size) - 1)) {
                prop_assert!(read.id < dictionary.count() && read.turns < 4 && read.errors <= dictionary.mended);
            }
        }
    }

    #[test]
    fn names_are_those_of_opencv() {
        assert_eq!(
            Dictionary::named("DICT_5X5_100").map(|d| (d.side, d.count(), d.mended)),
            Some((5, 100, 3))
        );
        assert_eq!(Dictionary::named("DICT_9X9_50"), None);
        // The first marker of 4×4 bits: rows 1011, 0101, 0011, 0010.
        let first = Dictionary::named("DICT_4X4_50").unwrap();
        let row =
            |r: usize| (0..4).map(|c| if first.is_white(0, c, r) { '1' } else { '0' }).collect::<String>();
        assert_eq!([0, 1, 2, 3].map(row), ["1011", "0101", "0011", "0010"]);
    }
}
