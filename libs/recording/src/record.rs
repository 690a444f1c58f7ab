//! Items to message bytes and back.

use super::protobuf;
use super::{Item, MessageError, Note};
use protocol::message::Message;
use protocol::wire::layout_of;

/// The item's message, appended to `out`.
pub(super) fn encode(item: &Item, out: &mut Vec<u8>) {
    match (item, item.block()) {
        (Item::Note(note), _) => note.encode(out),
        (_, Some(block)) => protobuf::encode(block.layout, block.bytes, block.payload, out),
        (_, None) => unreachable!("every item but a note is a block"),
    }
}

/// The item of a message on `topic`, validated; `None` for a topic that is no item.
///
/// # Errors
/// Where the bytes are no such message, or its numbers make no sense.
pub(super) fn decode(topic: &str, message: &[u8]) -> Result<Option<Item>, MessageError> {
    let item = match topic {
        "blobs" => Item::Blobs(Box::new(block(message)?.0)),
        "handles" => Item::Handle(block(message)?.0),
        "pedal" => Item::Pedal(block(message)?.0),
        "poses" => Item::Poses(Box::new(block(message)?.0)),
        "steps" => Item::Step(block(message)?.0),
        "events" => Item::Event(block(message)?.0),
        "frames" => Item::Frame(block(message)?.0),
        "checkpoints" => block(message).map(|(header, state)| Item::Checkpoint(header, state))?,
        "pictures" => block(message).map(|(header, jpeg)| Item::Picture(header, jpeg))?,
        "notes" => Item::Note(Note::decode(message)?),
        "tracker-checkpoints" => {
            block(message).map(|(header, state)| Item::TrackerCheckpoint(header, state))?
        }
        "matches" => Item::Matches(boxed(message)?),
        _ => return Ok(None),
    };
    Ok(Some(item))
}

/// A block with its payload, validated.
fn block<B: Message>(message: &[u8]) -> Result<(B, Vec<u8>), MessageError> {
    let (mut block, mut payload) = (B::zeroed(), Vec::new());
    protobuf::decode(layout_of::<B>(), message, bytemuck::bytes_of_mut(&mut block), &mut payload)?;
    block.validate().map_err(MessageError::Invalid)?;
    Ok((block, payload))
}

/// A block without a payload that is too large for the stack of every caller, validated.
fn boxed<B: Message>(message: &[u8]) -> Result<Box<B>, MessageError> {
    let mut block = Box::new(B::zeroed());
    protobuf::decode(layout_of::<B>(), message, bytemuck::bytes_of_mut(&mut *block), &mut Vec::new())?;
    block.validate().map_err(MessageError::Invalid)?;
    Ok(block)
}

#[cfg(test)]
mod tests {
    use super::super::Recording;
    use super::super::samples::{any_item, bits};
    use super::*;
    use crate::protobuf::{put_message, put_uint};
    use proptest::prelude::*;
    use std::path::PathBuf;

    fn encoded(item: &Item) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(item, &mut bytes);
        bytes
    }

    proptest! {
        #[test]
        fn every_item_comes_back_to_the_bit(item in any_item()) {
            let back = decode(item.topic(), &encoded(&item)).unwrap().unwrap();
            prop_assert_eq!(back.topic(), item.topic());
            prop_assert_eq!(bits(&back), bits(&item));
        }

        #[test]
        fn foreign_bytes_are_refused_or_read_but_never_panic(
            topic in prop::sample::select(&Item::TOPICS[..]),
            bytes in prop::collection::vec(any::<u8>(), 0..300),
        ) {
            if let Ok(Some(item)) = decode(topic, &bytes) {
                prop_assert_eq!(item.topic(), topic);
            }
        }

        #[test]
        fn damaged_messages_never_panic(item in any_item(), at in any::<prop::sample::Index>(), xor in 1u8..) {
            let mut bytes = encoded(&item);
            if !bytes.is_empty() {
                let at = at.index(bytes.len());
                bytes[at] ^= xor;
                let _ = decode(item.topic(), &bytes);
            }
        }
    }

    fn data(path: &str) -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(path)
    }

    /// Recordings that former versions made with a protobuf library.
    fn former_recordings() -> Vec<PathBuf> {
        let corpus = std::fs::read_dir(data("corpus")).unwrap().map(|f| f.unwrap().path());
        let files: Vec<_> = corpus.filter(|p| p.extension().is_some_and(|e| e == "mcap")).collect();
        assert!(files.len() >= 4, "{files:?}");
        files
    }

    #[test]
    fn every_message_of_former_recordings_is_encoded_to_the_same_bytes() {
        for file in former_recordings() {
            let bytes = std::fs::read(&file).unwrap();
            let mut seen = std::collections::BTreeMap::new();
            for message in mcap::MessageStream::new(&bytes).unwrap() {
                let message = message.unwrap();
                let topic = message.channel.topic.as_str();
                let Some(item) = decode(topic, &message.data).unwrap() else { continue };
                assert!(encoded(&item) == *message.data, "{}: {topic}", file.display());
                *seen.entry(item.topic()).or_insert(0u32) += 1;
            }
            assert!(seen["blobs"] > 100 && seen["poses"] > 50 && seen["steps"] > 50, "{seen:?}");
            assert_eq!(Recording::open(&file).unwrap().items().count(), seen.values().sum::<u32>() as usize);
        }
    }

    /// The messages of a file's schema, by name, each as its encoded descriptor.
    fn messages(set: &[u8]) -> std::collections::BTreeMap<Vec<u8>, Vec<u8>> {
        use crate::protobuf::{Fields, Value};
        let fields = |bytes| Fields(bytes).map(|f| f.unwrap());
        let inner = |bytes, tag| {
            fields(bytes).filter_map(move |(t, v)| match v {
                Value::Delimited(inner) if t == tag => Some(inner),
                _ => None,
            })
        };
        let file = inner(set, 1).next().expect("a file");
        let name = |message| inner(message, 1).next().expect("a name").to_vec();
        inner(file, 4).map(|message| (name(message), message.to_vec())).collect()
    }

    /// The phases of a step were divided since: the first four tags are the former ones.
    const DIVIDED: &[u8] = b"StepTimes";

    #[test]
    fn descriptors_are_those_of_former_recordings() {
        let of_topic = |topic| messages(&crate::descriptors::file_descriptor_set(topic));
        let ours: std::collections::BTreeMap<_, _> = (0..Item::TOPICS.len()).flat_map(of_topic).collect();
        for file in former_recordings() {
            let bytes = std::fs::read(&file).unwrap();
            let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
            let own = summary.schemas.values().filter(|s| s.name.starts_with("vitreo."));
            let mut names = Vec::new();
            for schema in own {
                let theirs = messages(&schema.data);
                let same = theirs.iter().filter(|(name, _)| &name[..] != DIVIDED);
                for (name, message) in same {
                    // Fields may have been added since, behind the former ones.
                    let kept = ours.get(name).is_some_and(|own| own.starts_with(message));
                    assert!(kept, "{}", String::from_utf8_lossy(name));
                }
                // Messages may have been added too.
                assert!(ours.len() >= theirs.len());
                names.push(schema.name.clone());
            }
            assert_eq!(names.len(), crate::FIRST_TOPICS);
            assert!((0..names.len()).all(|i| names.contains(&crate::message_name(i))), "{names:?}");
        }
    }

    #[test]
    fn arrays_of_another_length_are_refused() {
        let mut pedal = Vec::new();
        put_message(&mut pedal, 3, |out| out.extend_from_slice(&[0; 24]));
        let refused = decode("pedal", &pedal).unwrap_err();
        assert_eq!(refused, MessageError::Shape { expected: 2, found: 3 });
        let refused = decode("pedal", &[]).unwrap_err();
        assert_eq!(refused, MessageError::Shape { expected: 2, found: 0 });
        let refused = decode("steps", &[]).unwrap_err();
        assert_eq!(refused, MessageError::Shape { expected: 1, found: 0 });
        let mut blobs = Vec::new();
        (0..65).for_each(|_| put_message(&mut blobs, 8, |_| {}));
        let refused = decode("blobs", &blobs).unwrap_err();
        assert_eq!(refused, MessageError::Shape { expected: 64, found: 65 });
    }

    #[test]
    fn poisoned_numbers_are_refused() {
        let mut handle = Vec::new();
        put_uint(&mut handle, 5, 1);
        handle.push(6 << 3 | 1);
        handle.extend_from_slice(&f64::NAN.to_le_bytes());
        let refused = decode("handles", &handle).unwrap_err().to_string();
        assert!(refused.contains("jaw_rad"), "{refused}");
    }

    #[test]
    fn fields_of_later_versions_are_skipped() {
        let handle = protocol::handles::HandleState { tool: 1, ..bytemuck::Zeroable::zeroed() };
        let mut message = encoded(&Item::Handle(handle));
        put_uint(&mut message, 99, 7);
        put_message(&mut message, 98, |out| out.push(1));
        let back = decode("handles", &message).unwrap().unwrap();
        assert_eq!(bits(&back), bits(&Item::Handle(handle)));
    }
}
