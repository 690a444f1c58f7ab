//! Messages in Foxglove's own schemas, which viewers show as they are.

pub(super) mod annotations;
pub mod rig;

use super::{Item, Note, NoteKind};
use foxglove::messages::log::Level;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, FrameTransforms, ImageAnnotations, Log, Quaternion,
    SceneUpdate, Timestamp, Vector3,
};
use foxglove::{Encode, Schema};
use protocol::events::{Event, NO_INSTRUMENT};
use protocol::geometry::Validity;
use protocol::limits::MAX_CAMERAS;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::time::Nanos;

/// Topics for viewers, in the order in which the file declares them; new ones come last.
pub const TOPICS: [&str; 20] = [
    "/tf",
    "/log",
    "/picture",
    "/camera0/matches",
    "/camera1/matches",
    "/camera2/matches",
    "/camera3/matches",
    "/camera4/matches",
    "/camera5/matches",
    "/camera6/matches",
    "/camera7/matches",
    "/camera0/calibration",
    "/camera1/calibration",
    "/camera2/calibration",
    "/camera3/calibration",
    "/camera4/calibration",
    "/camera5/calibration",
    "/camera6/calibration",
    "/camera7/calibration",
    "/rig",
];
/// Indices of topics: where bodies and cameras are, the first camera's matches and calibration, what bodies
/// look like.
const TRANSFORMS: usize = 0;
const OF_CAMERAS: usize = 3;
const CALIBRATIONS: usize = OF_CAMERAS + MAX_CAMERAS;
const RIG: usize = CALIBRATIONS + MAX_CAMERAS;
/// Topics that former versions declared, before [`super::FIRST_TOPICS`] ends.
pub(super) const FIRST: usize = 3;

const _: () = assert!(TOPICS.len() == RIG + 1);

/// Schema of a topic.
pub(super) fn schema(topic: usize) -> Option<Schema> {
    match topic {
        TRANSFORMS => FrameTransforms::get_schema(),
        1 => Log::get_schema(),
        2 => CompressedImage::get_schema(),
        OF_CAMERAS..CALIBRATIONS => ImageAnnotations::get_schema(),
        CALIBRATIONS..RIG => CameraCalibration::get_schema(),
        _ => SceneUpdate::get_schema(),
    }
}

/// The messages of an item for viewers, each with the index of its topic. `realtime_offset_ns` is added to
/// instants, see [`super::Provenance::realtime_offset_ns`]; of one frame in `annotated` the matches are shown.
pub(super) fn encode(item: &Item, realtime_offset_ns: u64, annotated: u64) -> Vec<(usize, Vec<u8>)> {
    let clock = Clock(realtime_offset_ns);
    match item {
        Item::Poses(frame) => one(TRANSFORMS, transforms(frame, clock)),
        Item::Event(event) => one(1, Some(event_log(event, clock))),
        Item::Note(note) => one(1, Some(note_log(note, clock))),
        Item::Picture(header, jpeg) => {
            let image = CompressedImage {
                timestamp: clock.timestamp(header.displayed),
                frame_id: "microscope".into(),
                data: jpeg.clone().into(),
                format: "jpeg".into(),
            };
            one(2, Some(image))
        }
        Item::Matches(frame) => {
            let shown = annotations::of_frame(frame, annotated, clock.timestamp(frame.exposed_ns));
            shown.flat_map(|(camera, message)| one(OF_CAMERAS + camera, Some(message))).collect()
        }
        _ => Vec::new(),
    }
}

/// A message as bytes.
fn one<M: Encode<Error: std::fmt::Debug>>(topic: usize, message: Option<M>) -> Vec<(usize, Vec<u8>)> {
    let bytes = message.map(|message| {
        let mut bytes = Vec::new();
        message.encode(&mut bytes).expect("a vector has room");
        (topic, bytes)
    });
    bytes.into_iter().collect()
}

/// Instants of the recorder's clock as those of the wall clock.
#[derive(Clone, Copy)]
struct Clock(u64);

impl Clock {
    fn timestamp(self, at: Nanos) -> Option<Timestamp> {
        let at = at.wrapping_add(self.0);
        Timestamp::new_checked(u32::try_from(at / 1_000_000_000).ok()?, (at % 1_000_000_000) as u32)
    }
}

/// Bodies that are lost have no transform: a stale one would look like a measured one.
fn transforms(frame: &TrackerFrame, clock: Clock) -> Option<FrameTransforms> {
    let shown = frame.bodies.iter().zip(BODY_NAMES).filter(|(b, _)| b.validity() != Validity::Lost);
    let transforms: Vec<FrameTransform> = shown
        .map(|(body, name)| {
            let [x, y, z] = body.world_from_body.position_mm;
            let [w, i, j, k] = body.world_from_body.rotation_wxyz;
            FrameTransform {
                timestamp: clock.timestamp(frame.instants.exposed),
                parent_frame_id: "world".into(),
                child_frame_id: name.into(),
                translation: Some(Vector3 { x, y, z }),
                rotation: Some(Quaternion { x: i, y: j, z: k, w }),
            }
        })
        .collect();
    (!transforms.is_empty()).then_some(FrameTransforms { transforms })
}

fn event_log(event: &Event, clock: Clock) -> Log {
    let level = [Level::Info, Level::Warning, Level::Error][event.severity.min(2) as usize];
    let (what, unit) = event.info().map_or(("event", ""), |e| (e.text, e.unit));
    let who = match event.instrument {
        NO_INSTRUMENT => String::new(),
        i => format!("instrument {i}: "),
    };
    Log {
        timestamp: clock.timestamp(event.exposed_ns),
        level: level.into(),
        message: format!("{who}{what} ({:.4} {unit}, field {})", event.value, event.field),
        name: "simcore".into(),
        ..Log::default()
    }
}

fn note_log(note: &Note, clock: Clock) -> Log {
    let level = match note.kind {
        NoteKind::Log => Level::Info,
        NoteKind::Restart | NoteKind::Loss => Level::Warning,
    };
    let name = note.process.map_or("vitreo", |p| p.name());
    Log {
        timestamp: clock.timestamp(note.instant_ns),
        level: level.into(),
        message: note.text.clone(),
        name: name.into(),
        ..Log::default()
    }
}
