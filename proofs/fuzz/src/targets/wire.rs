//! Messages: `validate`, and whoever takes in a block that it lets pass.

use super::{Kind, Target};
use crate::corpus;
use blob_stream::{parse_line, write_line};
use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::budget::{frame_latencies, pose_latencies, step_latencies};
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::control::{Answer, Command, Notice, Request};
use protocol::events::Event;
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalState};
use protocol::health::Health;
use protocol::inputs::{Hint, InputEvent};
use protocol::limits::BODIES;
use protocol::matches::{MatchFrame, MatchedBlob};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::predict::predict;
use protocol::scene::{self, SceneBody, SceneBrick, SceneHeader, SceneMark, SceneNode, SceneTriangle};
use protocol::steps::{CheckpointHeader, StepRecord};
use protocol::wire::layout_of;
use recording::Item;
use std::hint::black_box;

/// Targets of all messages.
pub fn targets() -> Vec<Target> {
    vec![
        target::<FieldHeader>("field", |b| take(b, field)),
        target::<BlobField>("blobs", |b| take(b, blobs)),
        target::<HandleState>("handle", |b| take(b, |h: &HandleState, rare| item(rare, || Item::Handle(*h)))),
        target::<PedalState>("pedal", |b| take(b, |p: &PedalState, rare| item(rare, || Item::Pedal(*p)))),
        target::<TrackerFrame>("poses", |b| take(b, poses)),
        target::<MatchFrame>("matches", |b| take(b, matches)),
        target::<SceneHeader>("scene-block", |b| take(b, scene_header)),
        target::<StepRecord>("step", |b| take(b, step)),
        target::<CheckpointHeader>("checkpoint", |b| {
            take(b, |c: &CheckpointHeader, rare| item(rare, || Item::Checkpoint(*c, vec![1; 9])));
        }),
        target::<TrackerCheckpointHeader>("tracker-checkpoint", |b| {
            take(b, |c: &TrackerCheckpointHeader, rare| {
                item(rare, || Item::TrackerCheckpoint(*c, vec![1; 9]));
            });
        }),
        target::<Event>("event", |b| take(b, event)),
        target::<FrameRecord>("frame", |b| take(b, frame)),
        target::<PictureHeader>("picture", |b| {
            take(b, |p: &PictureHeader, rare| item(rare, || Item::Picture(*p, vec![2; 9])));
        }),
        target::<Health>("health", |b| take(b, |h: &Health, rare| text(rare, || h.text()))),
        target::<Request>("request", |b| {
            take(b, |r: &Request, _| _ = black_box(Command::from_wire(r.command)))
        }),
        target::<Answer>("answer", |b| take(b, |a: &Answer, rare| text(rare, || a.text()))),
        target::<Notice>("notice", |b| take(b, |n: &Notice, rare| text(rare, || n.text()))),
        target::<InputEvent>("input", |b| take(b, input)),
        target::<Hint>("hint", |b| take(b, |h: &Hint, rare| text(rare, || h.text()))),
    ]
}

fn target<M: Message>(name: &'static str, run: fn(&[u8])) -> Target {
    let layout = layout_of::<M>();
    Target { name, kind: Kind::Wire, run, seeds: seeds::<M>, layout: Some(layout), longest: layout.size }
}

/// Blocks of real recordings, or one that is zero but for what must not be.
fn seeds<M: Message>() -> Vec<Vec<u8>> {
    let recorded = corpus::recorded_blocks(layout_of::<M>().name, 6);
    if recorded.is_empty() { vec![valid::<M>()] } else { recorded }
}

/// A block that passes validation.
fn valid<M: Message>() -> Vec<u8> {
    let zero = bytemuck::bytes_of(&M::zeroed()).to_vec();
    let tries: [Vec<u8>; 4] = [
        bytemuck::bytes_of(&a_field()).to_vec(),
        bytemuck::bytes_of(&a_scene()).to_vec(),
        bytemuck::bytes_of(&some_matches()).to_vec(),
        zero,
    ];
    let fits = |block: &&Vec<u8>| {
        block.len() == size_of::<M>() && bytemuck::pod_read_unaligned::<M>(block).validate().is_ok()
    };
    let found = tries.iter().find(fits);
    found.unwrap_or_else(|| panic!("a valid {}", M::CHANNEL)).clone()
}

fn a_field() -> FieldHeader {
    let mut header = FieldHeader::zeroed();
    (header.field, header.exposed_ns, header.first_line_ns, header.line_period_ns) =
        (3, 47_000_000, 49_000_000, 64_000);
    (header.format, header.width, header.height, header.lines) = (1, 720, 288, 4);
    header
}

fn some_matches() -> MatchFrame {
    let mut frame = MatchFrame { exposed_ns: 1, field_count: 2, ..Zeroable::zeroed() };
    for field in frame.fields_mut() {
        (0..3).for_each(|blob| field.push(MatchedBlob { blob, nis: 1.0, ..Zeroable::zeroed() }));
        field.push_missed(Zeroable::zeroed());
    }
    frame
}

fn a_scene() -> SceneHeader {
    let mut header = SceneHeader::zeroed();
    (header.step, header.world_from_eye) = (1, Pose::IDENTITY);
    header.instruments.iter_mut().for_each(|i| i.world_from_instrument = Pose::IDENTITY);
    header.instants.exposed = 1;
    (header.microscope.field_mm, header.microscope.working_distance_mm) = (16.0, 200.0);
    header.nodes = scene::Section { offset: 16, count: 2 };
    header.text = scene::Section { offset: 0, count: 9 };
    header
}

/// Validates a block; `then` gets it where it passes. What takes long is done for one in 1024
/// blocks, derived from its bytes, so that an input always does the same.
fn take<M: Message>(bytes: &[u8], then: impl FnOnce(&M, bool)) {
    if bytes.len() != size_of::<M>() {
        return;
    }
    let block: M = bytemuck::pod_read_unaligned(bytes);
    if block.validate().is_ok() {
        let words = bytes.as_chunks::<8>().0.iter().map(|w| u64::from_le_bytes(*w));
        let sum = words.fold(0u64, |sum, word| sum ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        then(&block, sum >> 54 == 0);
    } else {
        // The reason is shown in messages.
        black_box(block.validate().map_err(|e| e.field).err());
    }
}

fn text(rare: bool, text: impl FnOnce() -> String) {
    if rare {
        black_box(text());
    }
}

/// Encodes an item as recordings do, and as a table does.
fn item(rare: bool, item: impl FnOnce() -> Item) {
    if rare {
        let item = item();
        black_box(item.encoded());
        black_box(replay::export::row(&item));
        black_box(item.instant_ns());
    }
}

fn field(header: &FieldHeader, _: bool) {
    black_box((header.bytes(), header.read_out_ns()));
    let payload = [128; 64];
    if let Some(picture) = FieldPicture::in_payload(header, &payload) {
        black_box((0..picture.height).map(|y| picture.line(y).0.len()).sum::<usize>());
    }
}

fn blobs(field: &BlobField, rare: bool) {
    black_box(field.blobs().iter().map(|b| field.y_frame_px(b)).sum::<f64>());
    item(rare, || Item::Blobs(Box::new(*field)));
    if rare && field.camera < 8 {
        let back = parse_line(&write_line(field), "f", 1);
        // What passes validation may still contradict itself, as a covariance larger than its variances.
        black_box(back.is_ok());
    }
}

fn poses(frame: &TrackerFrame, rare: bool) {
    black_box(pose_latencies(frame));
    for body in 0..BODIES {
        let exposed = frame.instants.exposed;
        for at in [exposed, exposed.saturating_add(60_000_000), exposed.saturating_add(10_000_000_000), 0] {
            let shown = predict(frame, body, at);
            assert!(shown.world_from_body.is_valid() || !rare, "{body} at {at}: {:?}", shown.world_from_body);
        }
    }
    if rare {
        black_box(
            renderer::latch::latch(frame, frame.instants.exposed.saturating_add(50_000_000)).all_tracked(),
        );
        let mut csv = blob_stream::poses_csv::PosesCsv::new(Vec::new()).expect("memory");
        csv.measured(frame, frame.instants.tracked).expect("memory");
        csv.predicted(frame, frame.instants.tracked, frame.instants.tracked).expect("memory");
    }
    item(rare, || Item::Poses(Box::new(*frame)));
}

fn matches(frame: &MatchFrame, rare: bool) {
    let blobs = || frame.fields().iter().flat_map(|f| f.blobs());
    black_box(blobs().filter_map(|b| b.predicted_px().zip(b.marker())).count());
    black_box(blobs().map(|b| b.outcome().text().len()).sum::<usize>());
    item(rare, || Item::Matches(Box::new(*frame)));
}

fn scene_header(header: &SceneHeader, rare: bool) {
    const ROOM: usize = 4096;
    let payload = vec![0u128; ROOM / 16];
    let payload: &[u8] = bytemuck::cast_slice(&payload);
    let lengths = [
        scene::section::<SceneNode>(payload, header.nodes).map_or(0, <[_]>::len),
        scene::section::<SceneTriangle>(payload, header.triangles).map_or(0, <[_]>::len),
        scene::section::<SceneMark>(payload, header.marks).map_or(0, <[_]>::len),
        scene::section::<SceneBody>(payload, header.bodies).map_or(0, <[_]>::len),
        scene::section::<SceneBrick>(payload, header.bricks).map_or(0, <[_]>::len),
        scene::section::<f32>(payload, header.doses).map_or(0, <[_]>::len),
        scene::section::<u8>(payload, header.text).map_or(0, <[_]>::len),
    ];
    assert!(lengths.iter().all(|n| *n <= ROOM));
    if rare {
        let latched = renderer::latch::latch_scene(header);
        black_box(latched.eye_from_instrument());
        black_box(renderer::view::depth_range_mm(&header.microscope));
        let identity = renderer::latch::matrix(&Pose::IDENTITY);
        for channel in 0..2 {
            black_box(renderer::view::view_uniform(&header.microscope, channel, 1.25, &identity));
        }
    }
}

fn step(step: &StepRecord, rare: bool) {
    black_box((step_latencies(step), step.profile.step_ns(), step.profile.paper_phases_ns()));
    item(rare, || Item::Step(*step));
}

fn event(event: &Event, rare: bool) {
    text(rare, || event.describe());
    item(rare, || Item::Event(*event));
}

fn frame(frame: &FrameRecord, rare: bool) {
    black_box(frame_latencies(frame));
    item(rare, || Item::Frame(*frame));
}

fn input(event: &InputEvent, _: bool) {
    black_box(event.input());
}
