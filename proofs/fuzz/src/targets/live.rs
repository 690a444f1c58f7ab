//! Streams of blobs that are read while they are made: bytes of a writer, cut anyhow.

use super::{Kind, Target};
use crate::corpus;
use blob_stream::live::{Heard, LiveStream};
use protocol::message::Message;
use std::collections::BTreeMap;
use std::convert::Infallible;

/// Bytes in front of a stream: length of a piece, ms between pieces, pieces of a writer.
const HEAD: usize = 3;
/// Longest input that is made, bytes.
const LONGEST: usize = 8 << 10;

/// The target.
pub fn targets() -> Vec<Target> {
    vec![Target { name: "blob-live", kind: Kind::Text, run: live, seeds, layout: None, longest: LONGEST }]
}

fn seeds() -> Vec<Vec<u8>> {
    let lines = corpus::lines_of("tests/data/tracker", "blobs.jsonl", 4);
    let heads = [[0, 1, 0], [63, 20, 9], [255, 250, 3]];
    let streams = lines.into_iter().zip(heads.into_iter().cycle());
    streams.map(|(lines, head)| [&head[..], &lines].concat()).collect()
}

/// What comes out is valid, of cameras of the rig, in order, and not ahead of its arrival.
fn live(bytes: &[u8]) {
    let Some((head, bytes)) = bytes.split_first_chunk::<HEAD>() else { return };
    let [length, wait_ms, of_writer] = head.map(usize::from);
    let mut stream = LiveStream::new("f", 0..3);
    let mut last = BTreeMap::new();
    let mut at = 1_000_000_000u64;
    let mut hear = |heard: Heard<'_>, at: u64| -> Result<(), Infallible> {
        if let Heard::Field(field) = heard {
            field.validate().expect("what was read is valid");
            assert!(field.exposed_ns <= at && field.blobs_out_ns <= at && field.camera < 3);
            let next = (field.field, field.exposed_ns);
            let before = last.insert(field.camera, next).unwrap_or((0, 0));
            assert!(next.1 > before.1 && (before.1 == 0 || next.0 > before.0), "{before:?}, {next:?}");
        }
        Ok(())
    };
    for (i, piece) in bytes.chunks(1 + length).enumerate() {
        at += wait_ms as u64 * 1_000_000;
        if of_writer > 0 && i.is_multiple_of(of_writer) {
            let _ = stream.writer_gone(at, |heard| hear(heard, at));
            stream.writer_came();
        }
        let _ = stream.take(piece, at, |heard| hear(heard, at));
    }
    let _ = stream.writer_gone(at, |heard| hear(heard, at));
    let figures = stream.figures();
    let told = figures.fields + figures.bad + figures.doubtful + figures.out_of_order;
    assert_eq!(told, figures.lines, "{figures:?}");
}
