//! Messages in Foxglove's own schemas, which viewers show as they are.

use super::{Item, Note, NoteKind};
use foxglove::messages::log::Level;
use foxglove::messages::{
    CompressedImage, FrameTransform, FrameTransforms, Log, Quaternion, Timestamp, Vector3,
};
use foxglove::{Encode, Schema};
use protocol::events::{Event, NO_INSTRUMENT};
use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::time::Nanos;

/// Topics for viewers, in the order in which the file declares them.
pub(super) const TOPICS: [&str; 3] = ["/tf", "/log", "/picture"];

/// Schemas of [`TOPICS`].
pub(super) fn schemas() -> [Option<Schema>; 3] {
    [FrameTransforms::get_schema(), Log::get_schema(), CompressedImage::get_schema()]
}

/// Appends an item's message for viewers; returns the index of its topic.
pub(super) fn encode(item: &Item, out: &mut Vec<u8>) -> Option<usize> {
    let (index, grown) = match item {
        Item::Poses(frame) => (0, transforms(frame)?.encode(out)),
        Item::Event(event) => (1, event_log(event).encode(out)),
        Item::Note(note) => (1, note_log(note).encode(out)),
        Item::Picture(header, jpeg) => {
            let image = CompressedImage {
                timestamp: timestamp(header.displayed),
                frame_id: "microscope".into(),
                data: jpeg.clone().into(),
                format: "jpeg".into(),
            };
            (2, image.encode(out))
        }
        _ => return None,
    };
    grown.expect("a vector has room");
    Some(index)
}

fn timestamp(at: Nanos) -> Option<Timestamp> {
    Timestamp::new_checked(u32::try_from(at / 1_000_000_000).ok()?, (at % 1_000_000_000) as u32)
}

/// Bodies that are lost have no transform: a stale one would look like a measured one.
fn transforms(frame: &TrackerFrame) -> Option<FrameTransforms> {
    let shown = frame.bodies.iter().zip(BODY_NAMES).filter(|(b, _)| b.validity() != Validity::Lost);
    let transforms: Vec<FrameTransform> = shown
        .map(|(body, name)| {
            let [x, y, z] = body.world_from_body.position_mm;
            let [w, i, j, k] = body.world_from_body.rotation_wxyz;
            FrameTransform {
                timestamp: timestamp(frame.instants.exposed),
                parent_frame_id: "world".into(),
                child_frame_id: name.into(),
                translation: Some(Vector3 { x, y, z }),
                rotation: Some(Quaternion { x: i, y: j, z: k, w }),
            }
        })
        .collect();
    (!transforms.is_empty()).then_some(FrameTransforms { transforms })
}

fn event_log(event: &Event) -> Log {
    let level = [Level::Info, Level::Warning, Level::Error][event.severity.min(2) as usize];
    let (what, unit) = event.info().map_or(("event", ""), |e| (e.text, e.unit));
    let who = match event.instrument {
        NO_INSTRUMENT => String::new(),
        i => format!("instrument {i}: "),
    };
    Log {
        timestamp: timestamp(event.exposed_ns),
        level: level.into(),
        message: format!("{who}{what} ({:.4} {unit}, field {})", event.value, event.field),
        name: "simcore".into(),
        ..Log::default()
    }
}

fn note_log(note: &Note) -> Log {
    let level = match note.kind {
        NoteKind::Log => Level::Info,
        NoteKind::Restart | NoteKind::Loss => Level::Warning,
    };
    let name = note.process.map_or("vitreo", |p| p.name());
    Log {
        timestamp: timestamp(note.instant_ns),
        level: level.into(),
        message: note.text.clone(),
        name: name.into(),
        ..Log::default()
    }
}
