//! Varying bytes: a new input from those that are kept.

use crate::random::Random;

/// Pieces of our files, which chance does not find.
const PIECES: &[&str] = &[
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "0",
    "-0",
    "-1",
    "0.5",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "-9223372036854775808",
    "999999999999999999999",
    "true",
    "null",
    "\"\"",
    "[]",
    "{}",
    "[[",
    "]]",
    "{",
    "}",
    ",",
    "\n",
    "\r\n",
    "\u{feff}",
    "\0",
    "#",
    "=",
    ":",
    ";",
    "\t",
    " ",
    "é",
    "µ",
    "//",
    "..",
    "format = ",
    "vitreo-scene-1",
    "vitreo-module-1",
    "vitreo-rig-1",
    "FRAME\n",
    "YUV4MPEG2 ",
    "W8192",
    "H8192",
    "C420jpeg",
    "f 1 2 3\n",
    "v 0 0 -11\n",
    "--",
    "-=",
];
/// Bytes at which something often begins or ends.
const BYTES: [u8; 10] = [0, 1, 0x7f, 0x80, 0xff, b'0', b'9', b'-', b'"', b'\n'];

/// Makes a new input in `out` from `kept[from]`, perhaps with parts of others; at most `longest`
/// bytes.
pub fn vary(kept: &[Vec<u8>], from: usize, longest: usize, random: &mut Random, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(&kept[from][..kept[from].len().min(longest)]);
    for _ in 0..1 << random.below(5) {
        let at = random.below(out.len() + 1);
        match random.below(12) {
            0 => flip(out, random),
            1 => set(out, random),
            2 => delete(out, at, random),
            3 => repeat(out, at, random),
            4 => insert(out, at, random.of(PIECES).as_bytes()),
            5 => splice(out, at, &kept[random.below(kept.len())], random),
            6 => replace_number(out, at, random),
            7 => overwrite(out, at, random),
            8 => insert(out, at, &[random.bits() as u8]),
            9 => delete_line(out, at),
            10 => swap(out, random),
            _ => out.truncate(if random.below(8) == 0 { at } else { out.len() }),
        }
        out.truncate(longest);
    }
}

fn flip(out: &mut [u8], random: &mut Random) {
    if !out.is_empty() {
        let at = random.below(out.len());
        out[at] ^= 1 << random.below(8);
    }
}

fn set(out: &mut [u8], random: &mut Random) {
    if !out.is_empty() {
        let at = random.below(out.len());
        out[at] = if random.below(2) == 0 { random.of(&BYTES) } else { random.bits() as u8 };
    }
}

fn delete(out: &mut Vec<u8>, at: usize, random: &mut Random) {
    let most = 1 << random.below(9);
    let length = random.below(most).min(out.len() - at);
    out.drain(at..at + length);
}

fn repeat(out: &mut Vec<u8>, at: usize, random: &mut Random) {
    let most = 1 << random.below(9);
    let length = random.below(most).min(out.len() - at);
    let part = out[at..at + length].to_vec();
    let most = 1 << random.below(6);
    for _ in 0..=random.below(most) {
        insert(out, at, &part);
    }
}

fn insert(out: &mut Vec<u8>, at: usize, part: &[u8]) {
    out.splice(at..at, part.iter().copied());
}

fn splice(out: &mut Vec<u8>, at: usize, other: &[u8], random: &mut Random) {
    let from = random.below(other.len() + 1);
    let most = 1 << random.below(12);
    let length = random.below(most).min(other.len() - from);
    insert(out, at, &other[from..from + length]);
}

/// Numbers of other sizes over what stands there: lengths and counts of binary files.
fn overwrite(out: &mut [u8], at: usize, random: &mut Random) {
    let value = match random.below(3) {
        0 => random.bits(),
        1 => random.below(300) as u64,
        _ => u64::MAX >> random.below(64),
    };
    let size = random.of(&[1, 2, 4, 8]);
    let mut bytes = value.to_le_bytes();
    if random.below(4) == 0 {
        bytes[..size].reverse();
    }
    let room = size.min(out.len() - at);
    out[at..at + room].copy_from_slice(&bytes[..room]);
}

/// The first number of a text at or after a place, by another.
fn replace_number(out: &mut Vec<u8>, at: usize, random: &mut Random) {
    let Some(start) = out[at..].iter().position(u8::is_ascii_digit).map(|i| at + i) else { return };
    let is_number = |b: &u8| b.is_ascii_digit() || b".eE-+".contains(b);
    let end = out[start..].iter().position(|b| !is_number(b)).map_or(out.len(), |i| start + i);
    let by = match random.below(4) {
        0 => random.of(&PIECES[..15]).to_owned(),
        1 => (random.below(20_000) as i64 - 10_000).to_string(),
        2 => format!("{:e}", f64::from_bits(random.bits())),
        _ => format!("{}", random.below(2000) as f64 / 100.0),
    };
    out.splice(start..end, by.bytes());
}

fn delete_line(out: &mut Vec<u8>, at: usize) {
    let start = out[..at].iter().rposition(|b| *b == b'\n').map_or(0, |i| i + 1);
    let end = out[at..].iter().position(|b| *b == b'\n').map_or(out.len(), |i| at + i + 1);
    out.drain(start..end);
}

fn swap(out: &mut [u8], random: &mut Random) {
    if !out.is_empty() {
        let (a, b) = (random.below(out.len()), random.below(out.len()));
        out.swap(a, b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn inputs_are_varied_within_their_length_and_by_the_seed() {
        let kept = [b"radius = 11.5\nside = \"left\"\n".to_vec(), Vec::new()];
        let made = |seed| {
            let (mut random, mut out) = (Random::new(seed), Vec::new());
            let all = (0..500).map(|i| {
                vary(&kept, i % 2, 64, &mut random, &mut out);
                assert!(out.len() <= 64);
                out.clone()
            });
            all.collect::<Vec<_>>()
        };
        assert_eq!(made(1), made(1));
        assert_ne!(made(1), made(2));
        assert!(made(1).iter().collect::<BTreeSet<_>>().len() > 300);
    }
}
