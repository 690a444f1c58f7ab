//! Streams that are read while they are made: bytes of a writer of blobs, or of OpenIGTLink, cut anyhow.

use super::{Kind, Target};
use crate::corpus;
use blob_stream::live::{Heard, LiveStream};
use igtl::{Content, HEADER_BYTES, HeaderVersion, Message as IgtlMessage, Reader};
use protocol::message::Message;
use std::collections::BTreeMap;
use std::convert::Infallible;

/// Bytes in front of a stream: length of a piece, ms between pieces, pieces of a writer.
const HEAD: usize = 3;
/// Longest input that is made, bytes.
const LONGEST: usize = 8 << 10;

/// The targets.
pub fn targets() -> Vec<Target> {
    let target = |name, kind, run, seeds| Target { name, kind, run, seeds, layout: None, longest: LONGEST };
    vec![
        target("blob-live", Kind::Text, live, seeds),
        target("igtl", Kind::Recording, messages, messages_to_begin_with),
    ]
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
    let counted = figures.fields + figures.bad + figures.doubtful + figures.out_of_order;
    assert_eq!(counted, figures.lines, "{figures:?}");
}

/// A transform and a status, each as both versions write it.
fn messages_to_begin_with() -> Vec<Vec<u8>> {
    let status = |code| {
        let (name, text) = ("Code".into(), "in words".into());
        Content::Status { code, subcode: -1, name, text }
    };
    let contents = [Content::Transform([[1.0, 2.0, 3.0, 4.0]; 3]), status(1)];
    let versions = [HeaderVersion::One, HeaderVersion::Two];
    let written = contents.into_iter().flat_map(|content| {
        let metadata = vec![("Status".into(), "OK".into()), ("Frame".into(), "7".into())];
        let message = IgtlMessage { device: "Tool".into(), unix_ns: 1, id: 2, metadata, content };
        versions.map(|version| {
            let mut bytes = vec![16];
            message.write(version, &mut bytes).expect("names are short");
            bytes
        })
    });
    written.collect()
}

/// What is read can be written, and is read again as it was. The first message is given its true checksum, so
/// that more than the checksum is tried.
fn messages(bytes: &[u8]) {
    let Some((length, bytes)) = bytes.split_first() else { return };
    let mut bytes = bytes.to_vec();
    let body_bytes = bytes.get(42..50).map(|size| u64::from_be_bytes(size.try_into().expect("eight")));
    let end = body_bytes.and_then(|body| usize::try_from(body).ok()?.checked_add(HEADER_BYTES));
    if let Some(body) = end.and_then(|end| bytes.get(HEADER_BYTES..end)) {
        let crc = igtl::checksum(body);
        bytes[50..58].copy_from_slice(&crc.to_be_bytes());
    }
    let mut reader = Reader::default();
    for piece in bytes.chunks(1 + usize::from(*length)) {
        let heard = reader.take(piece, |message| {
            let Ok(message) = message else { return };
            let mut again = Vec::new();
            // A text that was no UTF-8 may have become longer.
            if message.write(HeaderVersion::Two, &mut again).is_ok() {
                let mut same = None;
                Reader::default().take(&again, |read| same = Some(read)).expect("our own");
                assert_eq!(same, Some(Ok(message)));
            }
        });
        if heard.is_err() {
            return;
        }
    }
}
