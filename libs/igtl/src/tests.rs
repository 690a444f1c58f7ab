//! Checks of what is written and read, of messages of another implementation, and of hostile bytes.

use super::*;
use proptest::prelude::*;

/// A transform as pyigtl 0.3.4 writes it: `TransformMessage(matrix, device_name="Tool", timestamp=1.5)` with
/// header version 2, message id 7 and the metadata {"Status": "OK"}.
const OF_PYIGTL: &str = include_str!("../tests/data/pyigtl-transform.hex");

fn bytes_of(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    digits.chunks_exact(2).map(byte).collect()
}

fn tool() -> Message {
    Message {
        device: "Tool".into(),
        unix_ns: 1_500_000_000,
        id: 7,
        metadata: vec![("Status".into(), "OK".into())],
        content: Content::Transform([[0.0, -1.0, 0.0, 1.5], [1.0, 0.0, 0.0, -2.25], [0.0, 0.0, 1.0, 1024.0]]),
    }
}

fn written(message: &Message, version: HeaderVersion) -> Vec<u8> {
    let mut bytes = Vec::new();
    message.write(version, &mut bytes).unwrap();
    bytes
}

fn read(reader: &mut Reader, bytes: &[u8]) -> Vec<Result<Message, Refused>> {
    let mut heard = Vec::new();
    reader.take(bytes, |message| heard.push(message)).unwrap();
    heard
}

#[test]
fn another_implementation_writes_the_same_bytes() {
    let theirs = bytes_of(OF_PYIGTL);
    assert_eq!(theirs.len(), 58 + 12 + 48 + 10 + 8);
    assert_eq!(written(&tool(), HeaderVersion::Two), theirs);
    assert_eq!(read(&mut Reader::default(), &theirs), [Ok(tool())]);
}

#[test]
fn version_one_has_neither_id_nor_metadata() {
    let bytes = written(&tool(), HeaderVersion::One);
    assert_eq!(bytes.len(), 58 + 48);
    let plain = Message { id: 0, metadata: Vec::new(), ..tool() };
    assert_eq!(read(&mut Reader::default(), &bytes), [Ok(plain)]);
}

#[test]
fn what_is_damaged_is_named_and_the_next_is_read() {
    let good = written(&tool(), HeaderVersion::Two);
    let changed = |at: usize, value: u8| {
        let mut bytes = good.clone();
        bytes[at] = value;
        // The checksum is right but where the body alone is to be damaged.
        let crc = checksum(&bytes[HEADER_BYTES..]);
        bytes[50..58].copy_from_slice(&crc.to_be_bytes());
        bytes
    };
    let mut reader = Reader::default();
    let mut told = |mut bytes: Vec<u8>| {
        bytes.extend(&good);
        let heard = read(&mut reader, &bytes);
        assert_eq!((heard.len(), &heard[1]), (2, &Ok(tool())));
        heard[0].clone().unwrap_err().to_string()
    };
    let mut wrong = good.clone();
    wrong[80] ^= 1;
    assert_eq!(told(wrong), "TRANSFORM of \"Tool\": the CRC does not match the body");
    // The first number becomes NaN, sizes of parts become those of another message.
    let mut nan = good.clone();
    nan[70..74].copy_from_slice(&f32::NAN.to_be_bytes());
    let crc = checksum(&nan[HEADER_BYTES..]);
    nan[50..58].copy_from_slice(&crc.to_be_bytes());
    assert!(told(nan).ends_with("expected numbers, found NaN"));
    assert!(told(changed(58, 200)).contains("do not fit into a body of 78"));
    assert!(told(changed(59, 0)).contains("do not fit"));
    assert!(told(changed(61, 2)).contains("values of metadata in 2 bytes"));
    assert!(told(changed(121, 255)).contains("metadata is longer"), "a key of 255 bytes");
}

#[test]
fn a_stream_of_something_else_is_given_up() {
    let good = written(&tool(), HeaderVersion::One);
    let told = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = good.clone();
        change(&mut bytes);
        let mut reader = Reader::default();
        let broken = reader.take(&bytes, |_| panic!("nothing can be read")).unwrap_err();
        assert_eq!(reader.take(&good, |_| panic!("its place is lost")), Err(broken.clone()));
        broken.to_string()
    };
    assert_eq!(told(&|b| b[1] = 9), "header version 9: expected 1 to 3");
    assert!(told(&|b| b[2..8].copy_from_slice(b"GET / ")).contains("GET / "));
    assert!(told(&|b| b[2..14].fill(0)).contains("type \"\""));
    let four_gb = u64::from(u32::MAX).to_be_bytes();
    assert!(told(&|b| b[42..50].copy_from_slice(&four_gb)).contains("TRANSFORM of 4294967295 bytes"));
    let image = |b: &mut Vec<u8>| {
        b[2..14].copy_from_slice(b"IMAGE\0\0\0\0\0\0\0");
        b[42..50].copy_from_slice(&u64::MAX.to_be_bytes());
    };
    assert!(told(&image).contains("IMAGE of 18446744073709551615 bytes: expected up to 268435456"));
}

#[test]
fn names_that_do_not_fit_are_refused_and_nothing_is_written() {
    let mut bytes = vec![1, 2, 3];
    let long = Message { device: "TwentyOneBytesAreLong".into(), ..tool() };
    let told = long.write(HeaderVersion::One, &mut bytes).unwrap_err().to_string();
    assert_eq!(told, "device name \"TwentyOneBytesAreLong\": expected up to 20 bytes, found 21");
    assert_eq!(bytes, [1, 2, 3]);
}

fn contents() -> impl Strategy<Value = Content> {
    let number = prop::num::f32::NORMAL | prop::num::f32::ZERO;
    let transform = prop::array::uniform3(prop::array::uniform4(number)).prop_map(Content::Transform);
    let status = (any::<u16>(), any::<i64>(), "[a-zA-Z0-9 ]{0,20}", "[^\0]{0,60}");
    let status = status.prop_map(|(code, subcode, name, text)| Content::Status { code, subcode, name, text });
    prop_oneof![transform, status]
}

fn messages() -> impl Strategy<Value = Message> {
    let metadata = prop::collection::vec(("[a-zA-Z]{0,9}", "[^\0]{0,20}"), 0..4);
    // To the microsecond, which 2⁻³² s keep.
    let device = "[a-zA-Z0-9_]{0,20}";
    (device, 0u64..4_000_000_000_000_000, any::<u32>(), metadata, contents()).prop_map(
        |(device, us, id, metadata, content)| Message { device, unix_ns: us * 1_000, id, metadata, content },
    )
}

proptest! {
    /// Whatever the messages and however the bytes are cut, they are read as they were written; others in
    /// between are passed over.
    #[test]
    fn messages_are_read_as_they_were_written(
        all in prop::collection::vec(messages(), 1..6),
        cuts in prop::collection::vec(1usize..90, 1..9),
        image in 0usize..300,
    ) {
        let mut bytes = Vec::new();
        for message in &all {
            let mut other = written(&tool(), HeaderVersion::One);
            other[2..14].copy_from_slice(b"IMAGE\0\0\0\0\0\0\0");
            other[42..50].copy_from_slice(&(image as u64).to_be_bytes());
            other.resize(HEADER_BYTES + image, 0xff);
            bytes.extend(other);
            bytes.extend(written(message, HeaderVersion::Two));
        }
        let (mut reader, mut heard, mut rest) = (Reader::default(), Vec::new(), &bytes[..]);
        for cut in cuts.iter().cycle() {
            let (piece, after) = rest.split_at(rest.len().min(*cut));
            reader.take(piece, |message| heard.push(message.unwrap())).unwrap();
            rest = after;
            if rest.is_empty() { break; }
        }
        prop_assert_eq!(heard, all.clone());
        prop_assert_eq!(reader.passed_over(), all.len() as u64);
    }

    /// No bytes make the reader panic or keep more than a message.
    #[test]
    fn hostile_bytes_are_survived(
        message in messages(),
        changes in prop::collection::vec((0usize..200, any::<u8>()), 1..6),
        fix_crc in any::<bool>(),
    ) {
        let mut bytes = written(&message, HeaderVersion::Two);
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        if fix_crc {
            let crc = checksum(&bytes[HEADER_BYTES..]);
            bytes[50..58].copy_from_slice(&crc.to_be_bytes());
        }
        let mut reader = Reader::default();
        let _ = reader.take(&bytes, |_| {});
        let _ = reader.take(&bytes, |_| {});
        prop_assert!(reader.buffer.len() as u64 <= HEADER_BYTES as u64 + 65_536);
    }
}
