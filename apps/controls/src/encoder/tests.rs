//! Lines of encoders that are whole, torn, noisy, and nothing of the kind.

use super::*;
use proptest::prelude::*;

fn sample(seq: u16, handle: u32, count: i32, tool: u32) -> Sample {
    Sample { seq, handle, count, tool: Tool::from_wire(tool) }
}

fn heard(pieces: &[&[u8]]) -> Vec<Heard> {
    let (mut reader, mut all) = (LineReader::default(), Vec::new());
    pieces.iter().for_each(|piece| reader.take(piece, |h| all.push(h)));
    all
}

/// A line with the right checksum whatever its fields.
fn signed(fields: &str) -> Vec<u8> {
    let inside = format!("VH,{fields}");
    format!("${inside}*{:04X}", crc16(inside.as_bytes())).into_bytes()
}

#[test]
fn the_checksum_is_the_documented_one() {
    assert_eq!(crc16(b"123456789"), 0x29B1, "the check value of CRC-16/CCITT-FALSE");
    // The examples of docs/handles.md.
    let page = include_str!("../../../../docs/handles.md");
    for example in [sample(17, 0, 2047, 1), sample(18, 1, -350, 0)] {
        let line = example.line();
        assert!(page.contains(line.trim_end()), "docs/handles.md lacks {line}");
    }
}

#[test]
fn what_is_wrong_with_a_line_is_named() {
    for (line, bad) in [
        (b"$VX,1,0,5,1*0000".to_vec(), Bad::Head),
        (b"$VH,1,0,5,1".to_vec(), Bad::NoChecksum),
        (b"$VH,1,0,5,1*12".to_vec(), Bad::NoChecksum),
        (b"$VH,1,0,5,1*12G4".to_vec(), Bad::NoChecksum),
        (b"$VH,1,0,5,1*0000".to_vec(), Bad::Checksum),
        (signed("1,0,5"), Bad::Fields),
        (signed("1,0,5,1,9"), Bad::Fields),
        (signed("65536,0,5,1"), Bad::Seq),
        (signed("1,2,5,1"), Bad::Handle),
        (signed("1,0,2147483648,1"), Bad::Count),
        (signed("1,0,5.5,1"), Bad::Count),
        (signed("1,0,+5,1"), Bad::Count),
        (signed("1,0,,1"), Bad::Count),
        (signed("1,0,5,6"), Bad::Tool),
        (signed(&"1".repeat(60)), Bad::Long),
    ] {
        assert_eq!(Sample::parse(&line), Err(bad), "{}", String::from_utf8_lossy(&line));
        assert_eq!(heard(&[&line, b"\n"]), [Heard::Bad(bad)], "{}", String::from_utf8_lossy(&line));
    }
}

#[test]
fn a_stream_that_is_joined_late_or_torn_is_taken_up_at_the_next_line() {
    let (first, second) = (sample(1, 0, 5, 1), sample(2, 1, 6, 2));
    let stream = [b"0,7,1*ABCD\r\n", first.line().as_bytes(), second.line().as_bytes()].concat();
    let samples = [Heard::Sample(first), Heard::Sample(second)];
    assert_eq!(heard(&[&stream]), samples);
    assert_eq!(heard(&stream.chunks(1).collect::<Vec<_>>()), samples);
    let torn = format!("{}{}", &first.line()[..8], second.line());
    assert_eq!(heard(&[torn.as_bytes()]), [Heard::Bad(Bad::NoChecksum), Heard::Sample(second)]);
    let noise = [[b'x'; 500].as_slice(), b"\n", &[0xFF; 500], first.line().as_bytes()].concat();
    assert_eq!(heard(&[&noise]), [Heard::Bad(Bad::Long), Heard::Sample(first)]);
}

#[test]
fn jumps_of_the_numbers_are_told() {
    let numbers = |all: &[u16]| {
        let lines: String = all.iter().map(|&seq| sample(seq, 0, 0, 0).line()).collect();
        let told = heard(&[lines.as_bytes()]).into_iter();
        told.filter(|h| !matches!(h, Heard::Sample(_))).collect::<Vec<_>>()
    };
    assert_eq!(numbers(&[5, 6, 7]), []);
    assert_eq!(numbers(&[65_534, 65_535, 0, 1]), [], "they begin again");
    assert_eq!(numbers(&[5, 9]), [Heard::Gap(3)]);
    assert_eq!(numbers(&[65_535, 2]), [Heard::Gap(2)]);
    assert_eq!(numbers(&[500, 0, 1]), [Heard::Restart]);
    assert_eq!(numbers(&[5, 5]), [Heard::Restart], "one that comes twice");
}

proptest! {
    #[test]
    fn every_sample_comes_back(
        samples in prop::collection::vec((0u32..2, any::<i32>(), 0u32..6), 1..20),
        first in any::<u16>(),
        cut in 1usize..50,
    ) {
        let numbered = samples.into_iter().enumerate();
        let all: Vec<Sample> = numbered
            .map(|(i, (handle, count, tool))| sample(first.wrapping_add(i as u16), handle, count, tool))
            .collect();
        let text: String = all.iter().map(Sample::line).collect();
        let read = heard(&text.as_bytes().chunks(cut).collect::<Vec<_>>());
        prop_assert_eq!(read, all.iter().map(|s| Heard::Sample(*s)).collect::<Vec<_>>());
        prop_assert!(all.iter().all(|s| s.line().len() <= LONGEST + 2));
    }

    #[test]
    fn one_bit_that_is_wrong_is_never_a_sample(
        (handle, count, tool) in (0u32..2, any::<i32>(), 0u32..6),
        bit in any::<prop::sample::Index>(),
    ) {
        let good = sample(9, handle, count, tool);
        let mut line = good.line().into_bytes();
        line.truncate(line.len() - 2);
        let bit = bit.index(line.len() * 8);
        line[bit / 8] ^= 1 << (bit % 8);
        // The case of a hexadecimal digit says nothing.
        let same = line.eq_ignore_ascii_case(good.line().trim_end().as_bytes());
        let read = heard(&[&line, b"\n"]);
        prop_assert!(same || !read.iter().any(|h| matches!(h, Heard::Sample(_))), "{:?}", read);
    }

    #[test]
    fn any_bytes_are_taken(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..10)) {
        let pieces: Vec<&[u8]> = pieces.iter().map(Vec::as_slice).collect();
        let (whole, cut) = (heard(&[&pieces.concat()]), heard(&pieces));
        prop_assert_eq!(whole, cut);
    }
}
