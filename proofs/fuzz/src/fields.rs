//! Varying a message's block by its layout: every number of it, to values that a number of its kind
//! seldom has.

use crate::random::Random;
use protocol::wire::{Kind, Layout};

/// A number in a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number {
    offset: usize,
    kind: Kind,
}

impl Number {
    /// Puts the first bytes of `value` into the number's place in `block`.
    pub fn set(self, block: &mut [u8], value: &[u8; 8]) {
        let size = self.kind.size();
        block[self.offset..self.offset + size].copy_from_slice(&value[..size]);
    }
}

/// Every number of a block, those in arrays and structs included.
pub fn numbers(layout: &Layout) -> Vec<Number> {
    let mut all = Vec::new();
    collect(layout, 0, &mut all);
    all
}

fn collect(layout: &Layout, at: usize, all: &mut Vec<Number>) {
    layout.fields.iter().for_each(|field| collect_kind(field.kind, at + field.offset, all));
}

fn collect_kind(kind: Kind, at: usize, all: &mut Vec<Number>) {
    match kind {
        Kind::Struct(inner) => collect(inner, at, all),
        Kind::Array(element, count) => {
            (0..count).for_each(|i| collect_kind(*element, at + i * element.size(), all));
        }
        number => all.push(Number { offset: at, kind: number }),
    }
}

const FLOATS: [f64; 20] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    std::f64::consts::PI,
    1e-3,
    1e3,
    999_999.9,
    -999_999.9,
    1e18,
    -1e18,
    1e300,
    f64::MAX,
    f64::MIN,
    f64::MIN_POSITIVE / 4.0,
    f64::EPSILON,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
];
const WHOLE: [u64; 16] = [
    0,
    1,
    2,
    3,
    7,
    8,
    63,
    64,
    65,
    1_000_000_000,
    u32::MAX as u64 - 1,
    u32::MAX as u64,
    1 << 32,
    i64::MAX as u64,
    u64::MAX - 1,
    u64::MAX,
];

/// Varies one to eight numbers of `block`.
pub fn vary(block: &mut [u8], numbers: &[Number], random: &mut Random) {
    for _ in 0..=random.below(8) {
        let number = numbers[random.below(numbers.len())];
        let place = &mut block[number.offset..number.offset + number.kind.size()];
        match number.kind {
            Kind::F64 => {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(place);
                place.copy_from_slice(&float(f64::from_le_bytes(bytes), random).to_le_bytes());
            }
            Kind::F32 => {
                let mut bytes = [0; 4];
                bytes.copy_from_slice(place);
                let value = float(f64::from(f32::from_le_bytes(bytes)), random) as f32;
                place.copy_from_slice(&value.to_le_bytes());
            }
            _ => {
                let mut bytes = [0; 8];
                bytes[..place.len()].copy_from_slice(place);
                let value = whole(u64::from_le_bytes(bytes), random).to_le_bytes();
                place.copy_from_slice(&value[..place.len()]);
            }
        }
    }
}

fn float(value: f64, random: &mut Random) -> f64 {
    match random.below(6) {
        0 | 1 => random.of(&FLOATS),
        2 => f64::from_bits(random.bits()),
        3 => f64::from_bits(value.to_bits() ^ 1 << random.below(64)),
        4 => value * random.of(&[-1.0, 1.0 + 1e-7, 1.0 - 1e-5, 10.0, 1e-6, 1e6]),
        _ => (random.bits() as f64 / u64::MAX as f64 - 0.5) * random.of(&[1.0, 40.0, 2000.0]),
    }
}

fn whole(value: u64, random: &mut Random) -> u64 {
    match random.below(5) {
        0 | 1 => random.of(&WHOLE),
        2 => value ^ 1 << random.below(64),
        3 => value.wrapping_add(random.of(&[1, u64::MAX, 20_000_000, 1 << 40])),
        _ => random.bits(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::handles::PedalState;
    use protocol::poses::TrackerFrame;
    use protocol::wire::layout_of;

    #[test]
    fn every_byte_of_a_block_is_in_one_number() {
        for layout in [layout_of::<PedalState>(), layout_of::<TrackerFrame>()] {
            let numbers = numbers(layout);
            let mut end = 0;
            for number in &numbers {
                assert_eq!(number.offset, end, "{}", layout.name);
                end += number.kind.size();
            }
            assert_eq!(end, layout.size);
        }
    }

    #[test]
    fn every_number_is_varied() {
        let numbers = numbers(layout_of::<PedalState>());
        let mut random = Random::new(3);
        let mut changed = [false; size_of::<PedalState>()];
        for _ in 0..1000 {
            let mut block = [0; size_of::<PedalState>()];
            vary(&mut block, &numbers, &mut random);
            changed.iter_mut().zip(block).for_each(|(c, byte)| *c |= byte != 0);
        }
        assert!(changed.iter().all(|c| *c), "{changed:?}");
    }
}
