//! Items to message bytes and back.

use super::mirror::{Mirror, Shape, filled};
use super::{Item, MessageError, Note, NoteKind, wire};
use prost::Message;
use protocol::blobs::BlobField;
use protocol::frames::PictureHeader;
use protocol::health::Process;
use protocol::message::Message as Block;
use protocol::poses::TrackerFrame;
use protocol::steps::CheckpointHeader;

/// The item's message, appended to `out`.
pub(super) fn encode(item: &Item, out: &mut Vec<u8>) {
    let grown = match item {
        Item::Blobs(field) => blob_field(field).encode(out),
        Item::Handle(handle) => handle.to_wire().encode(out),
        Item::Pedal(pedal) => pedal.to_wire().encode(out),
        Item::Poses(frame) => tracker_frame(frame).encode(out),
        Item::Step(step) => step.to_wire().encode(out),
        Item::Event(event) => event.to_wire().encode(out),
        Item::Frame(frame) => frame.to_wire().encode(out),
        Item::Checkpoint(header, state) => checkpoint(header, state).encode(out),
        Item::Picture(header, jpeg) => picture(header, jpeg).encode(out),
        Item::Note(note) => note_message(note).encode(out),
    };
    grown.expect("a vector has room");
}

/// The item of a message on `topic`, validated; `None` for a topic that is no item.
pub(super) fn decode(topic: &str, bytes: &[u8]) -> Result<Option<Item>, MessageError> {
    let item = match topic {
        "blobs" => Item::Blobs(Box::new(valid(blob_field_back(&message(bytes)?)?)?)),
        "handles" => Item::Handle(plain::<_, wire::HandleState>(bytes)?),
        "pedal" => Item::Pedal(plain::<_, wire::PedalState>(bytes)?),
        "poses" => Item::Poses(Box::new(valid(tracker_frame_back(&message(bytes)?)?)?)),
        "steps" => Item::Step(plain::<_, wire::StepRecord>(bytes)?),
        "events" => Item::Event(plain::<_, wire::Event>(bytes)?),
        "frames" => Item::Frame(plain::<_, wire::FrameRecord>(bytes)?),
        "checkpoints" => checkpoint_back(message(bytes)?),
        "pictures" => picture_back(message(bytes)?),
        "notes" => Item::Note(note_back(message(bytes)?)?),
        _ => return Ok(None),
    };
    Ok(Some(item))
}

fn message<W: Message + Default>(bytes: &[u8]) -> Result<W, MessageError> {
    W::decode(bytes).map_err(|e| MessageError::Encoding(e.to_string()))
}

fn valid<B: Block>(block: B) -> Result<B, MessageError> {
    block.validate().map(|()| block).map_err(MessageError::Invalid)
}

fn plain<B: Block + Mirror<W>, W: Message + Default>(bytes: &[u8]) -> Result<B, MessageError> {
    valid(B::from_wire(&message(bytes)?)?)
}

impl From<Shape> for MessageError {
    fn from(shape: Shape) -> Self {
        MessageError::Shape(shape)
    }
}

fn blob_field(block: &BlobField) -> wire::BlobField {
    wire::BlobField {
        field: block.field,
        exposed_ns: block.exposed_ns,
        read_out_ns: block.read_out_ns,
        blobs_out_ns: block.blobs_out_ns,
        camera: block.camera,
        parity: block.parity,
        blobs_left_out: block.blobs_left_out,
        blobs: block.blobs().iter().map(Mirror::to_wire).collect(),
    }
}

fn blob_field_back(wire: &wire::BlobField) -> Result<BlobField, Shape> {
    let (blobs, count) = filled(&wire.blobs)?;
    Ok(BlobField {
        field: wire.field,
        exposed_ns: wire.exposed_ns,
        read_out_ns: wire.read_out_ns,
        blobs_out_ns: wire.blobs_out_ns,
        camera: wire.camera,
        parity: wire.parity,
        count,
        blobs_left_out: wire.blobs_left_out,
        blobs,
    })
}

fn tracker_frame(block: &TrackerFrame) -> wire::TrackerFrame {
    wire::TrackerFrame {
        field: block.field,
        frame: block.frame,
        instants: Some(block.instants.to_wire()),
        waited_ns: block.waited_ns,
        camera: block.camera,
        closed_by: block.closed_by,
        fields_refused: block.fields_refused,
        used: block.used().iter().map(Mirror::to_wire).collect(),
        bodies: block.bodies.to_wire(),
    }
}

fn tracker_frame_back(wire: &wire::TrackerFrame) -> Result<TrackerFrame, Shape> {
    let (used, used_count) = filled(&wire.used)?;
    let instants = wire.instants.as_ref().ok_or(Shape { expected: 1, found: 0 })?;
    Ok(TrackerFrame {
        field: wire.field,
        frame: wire.frame,
        instants: Mirror::from_wire(instants)?,
        waited_ns: wire.waited_ns,
        camera: wire.camera,
        closed_by: wire.closed_by,
        used_count,
        fields_refused: wire.fields_refused,
        used,
        bodies: Mirror::from_wire(&wire.bodies)?,
    })
}

fn checkpoint(header: &CheckpointHeader, state: &[u8]) -> wire::Checkpoint {
    let CheckpointHeader { step, field, handles_below, pedals_below, state_hash, bytes: _ } = *header;
    wire::Checkpoint { step, field, handles_below, pedals_below, state_hash, state: state.to_vec() }
}

fn checkpoint_back(wire: wire::Checkpoint) -> Item {
    let wire::Checkpoint { step, field, handles_below, pedals_below, state_hash, state } = wire;
    let bytes = state.len() as u64;
    Item::Checkpoint(CheckpointHeader { step, field, handles_below, pedals_below, state_hash, bytes }, state)
}

fn picture(header: &PictureHeader, jpeg: &[u8]) -> wire::Picture {
    let PictureHeader { frame, field, displayed, bytes: _ } = *header;
    wire::Picture { frame, field, displayed, jpeg: jpeg.to_vec() }
}

fn picture_back(wire: wire::Picture) -> Item {
    let wire::Picture { frame, field, displayed, jpeg } = wire;
    Item::Picture(PictureHeader { frame, field, displayed, bytes: jpeg.len() as u64 }, jpeg)
}

fn note_message(note: &Note) -> wire::Note {
    let kind = match note.kind {
        NoteKind::Log => wire::note::Kind::Log,
        NoteKind::Restart => wire::note::Kind::Restart,
        NoteKind::Loss => wire::note::Kind::Loss,
    };
    wire::Note {
        instant_ns: note.instant_ns,
        kind: kind.into(),
        process: note.process.map_or(0, |p| p as u32 + 1),
        count: note.count,
        text: note.text.clone(),
    }
}

fn note_back(wire: wire::Note) -> Result<Note, MessageError> {
    let unknown = |what, code| MessageError::Encoding(format!("unknown {what} {code}"));
    let kind = match wire::note::Kind::try_from(wire.kind) {
        Ok(wire::note::Kind::Log) => NoteKind::Log,
        Ok(wire::note::Kind::Restart) => NoteKind::Restart,
        Ok(wire::note::Kind::Loss) => NoteKind::Loss,
        Err(_) => return Err(unknown("kind of note", i64::from(wire.kind))),
    };
    let process = match wire.process.checked_sub(1) {
        None => None,
        Some(code) => {
            Some(Process::from_wire(code).ok_or_else(|| unknown("process", i64::from(wire.process)))?)
        }
    };
    Ok(Note { instant_ns: wire.instant_ns, kind, process, count: wire.count, text: wire.text })
}

#[cfg(test)]
mod tests {
    use super::super::samples::{any_item, bits};
    use super::*;
    use proptest::prelude::*;

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

    #[test]
    fn arrays_of_another_length_are_refused() {
        let wire = wire::PedalState { axes: vec![0.0; 3], ..Default::default() };
        let refused = decode("pedal", &wire.encode_to_vec()).unwrap_err();
        assert_eq!(refused, MessageError::Shape(Shape { expected: 2, found: 3 }));
    }

    #[test]
    fn poisoned_numbers_are_refused() {
        let wire = wire::HandleState { jaw_rad: Some(f64::NAN), tool: 1, ..Default::default() };
        let refused = decode("handles", &wire.encode_to_vec()).unwrap_err().to_string();
        assert!(refused.contains("jaw_rad"), "{refused}");
    }
}
