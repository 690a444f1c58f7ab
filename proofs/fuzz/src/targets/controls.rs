//! Pedals and handles: lines of encoders, mappings, events and reports of devices.

use super::{Kind, Target};
use crate::corpus::shipped as files;
use ::controls::encoder::{Heard, LineReader, Sample};
use ::controls::events::{Event, EventReader};
use ::controls::inputs::Inputs;
use ::controls::mapping::{Mapping, SHIPPED, shipped};
use protocol::handles::Tool;
use protocol::message::Message;

/// Longest input that is made, bytes.
const LONGEST: usize = 4 << 10;

/// The targets.
pub fn targets() -> Vec<Target> {
    let of = |name, kind, run, seeds| Target { name, kind, run, seeds, layout: None, longest: LONGEST };
    vec![
        of("handle-lines", Kind::Text, lines, line_seeds),
        of("pedal-toml", Kind::Text, mapping, || files(&["assets/pedals"], "toml")),
        of("pedal-device", Kind::Recording, device, device_seeds),
    ]
}

fn line_seeds() -> Vec<Vec<u8>> {
    let sample = |seq, count, tool| Sample { seq, handle: u32::from(seq % 2), count, tool }.line();
    let text = [
        sample(65_535, -7, Some(Tool::Forceps)),
        sample(0, i32::MAX, None),
        sample(9, 3, Some(Tool::Needle)),
    ];
    vec![
        [&[0][..], text.concat().as_bytes()].concat(),
        [&[40][..], b"7,0,1*AB\r\n", text[1].as_bytes()].concat(),
    ]
}

/// The first byte is the length of the pieces in which the rest comes; what it says does not depend on it.
fn lines(bytes: &[u8]) {
    let Some((&length, bytes)) = bytes.split_first() else { return };
    let read = |length: usize| {
        let (mut reader, mut all) = (LineReader::default(), Vec::new());
        bytes.chunks(length.max(1)).for_each(|piece| reader.take(piece, |heard| all.push(heard)));
        all
    };
    let all = read(1 + usize::from(length));
    assert_eq!(all, read(bytes.len()));
    for heard in all {
        if let Heard::Sample(sample) = heard {
            let line = sample.line();
            assert_eq!(
                Sample::parse(line.trim_end().as_bytes()),
                Ok(sample),
                "what was read is written alike"
            );
        }
    }
}

/// A mapping that is taken says something valid of any device, and comes back from its own text.
fn mapping(bytes: &[u8]) {
    let Ok(mapping) = Mapping::parse(&String::from_utf8_lossy(bytes), "f") else { return };
    assert_eq!(Mapping::parse(&mapping.to_toml(), "again").expect("it was whole"), mapping);
    let mut inputs = Inputs::default();
    for (i, input) in mapping.inputs().enumerate() {
        inputs.set(input, [i64::from(i32::MIN), 1, i64::from(i32::MAX)][i % 3]);
        inputs.set_range(input, [[0, 255], [5, 5], [i64::from(i32::MAX), i64::from(i32::MIN)]][i % 3]);
    }
    inputs.note_report(&bytes[..bytes.len().min(65)]);
    mapping.pressed(&inputs).state(0, 0).validate().expect("what a pedal says is valid");
}

fn device_seeds() -> Vec<Vec<u8>> {
    let event = |kind, code, value| Event { at_us: 1_700_000_000_000_000, kind, code, value }.to_bytes();
    vec![[event(1, 30, 1), event(3, 2, 200), event(0, 0, 0), event(1, 30, 0)].concat(), vec![4, 0, 1, 0]]
}

/// Bytes as events and as a report: every shipped mapping says something valid.
fn device(bytes: &[u8]) {
    let (mut reader, mut inputs) = (EventReader::default(), Inputs::default());
    reader.take(bytes, |event| {
        inputs.note(event);
    });
    inputs.note_report(bytes);
    for mapping in SHIPPED.iter().filter_map(|(name, _)| shipped(name)) {
        mapping.pressed(&inputs).state(0, 0).validate().expect("what a pedal says is valid");
    }
}
