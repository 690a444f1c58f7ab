//! Random items for the tests of this module.

use super::{Item, Note, NoteKind};
use bytemuck::{Pod, Zeroable};
use proptest::prelude::*;
use protocol::blobs::{Blob, BlobField};
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::events::{EVENTS, Event};
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalState};
use protocol::health::Process;
use protocol::limits::{BODIES, INSTRUMENTS, MAX_BLOBS, MAX_FIELDS_USED, MAX_MARKERS};
use protocol::matches::{BlobUse, MatchFrame, MatchedBlob, MissedMarker, NO_BODY};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, StepRecord};

/// Every number of an item as bytes: equal only for items that are equal to the bit.
pub fn bits(item: &Item) -> Vec<u8> {
    match (item, item.block()) {
        (_, Some(block)) => [block.bytes, block.payload].concat(),
        (note, None) => format!("{note:?}").into_bytes(),
    }
}

/// Finite numbers of every size and sign, the awkward ones among them.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(0.0),
        Just(-0.0),
        any::<f64>().prop_map(|v| if v.is_finite() { v } else { f64::MIN_POSITIVE / 2.0 }),
    ]
}

/// A block whose every 8 bytes are a number that is finite when read as `f64`; `mend` makes the
/// rest of its meaning right.
fn block<B: Message + std::fmt::Debug>(mend: fn(&mut B)) -> impl Strategy<Value = B> {
    let words = size_of::<B>().div_ceil(8);
    prop::collection::vec(number(), words).prop_map(move |numbers| {
        let mut block = B::zeroed();
        let bytes = bytemuck::cast_slice::<f64, u8>(&numbers);
        bytemuck::bytes_of_mut(&mut block).copy_from_slice(&bytes[..size_of::<B>()]);
        mend(&mut block);
        block.validate().expect("a valid sample");
        block
    })
}

fn blobs(field: &mut BlobField) {
    field.exposed_ns |= 1;
    field.parity &= 1;
    field.count %= MAX_BLOBS as u32 + 1;
    let count = field.count as usize;
    field.blobs[count..].fill(Blob::zeroed());
    for blob in &mut field.blobs[..count] {
        blob.colour = blob.colour % 7 + 1;
    }
}

fn poses(frame: &mut TrackerFrame) {
    frame.instants.exposed |= 1;
    frame.used_count %= MAX_FIELDS_USED as u32 + 1;
    let count = frame.used_count as usize;
    frame.used[count..].fill(Zeroable::zeroed());
    for body in &mut frame.bodies[..BODIES] {
        body.world_from_body =
            Pose { position_mm: [0.1, -0.0, 1e-300], rotation_wxyz: [0.6, 0.0, -0.8, 0.0] };
        body.validity %= 3;
    }
}

/// Numbers of `f32` that are finite, whatever bits they had.
fn finite(v: &mut f32) {
    *v = if v.is_finite() { *v } else { -0.0 };
}

fn matched_blob(blob: &mut MatchedBlob) {
    blob.blob %= MAX_BLOBS as u32;
    blob.outcome %= BlobUse::ALL.len() as u32;
    blob.body %= NO_BODY + u32::from(!blob.outcome().is_matched());
    blob.marker %= MAX_MARKERS as u32;
    let MatchedBlob { x_px, y_px, innovation_x_px, innovation_y_px, .. } = blob;
    [x_px, y_px, innovation_x_px, innovation_y_px].into_iter().for_each(finite);
    let MatchedBlob { residual_x_px, residual_y_px, nis, .. } = blob;
    [residual_x_px, residual_y_px, &mut *nis].into_iter().for_each(finite);
    blob.nis = blob.nis.abs();
}

fn missed_marker(missed: &mut MissedMarker) {
    missed.body %= NO_BODY;
    missed.marker %= MAX_MARKERS as u32;
    [&mut missed.x_px, &mut missed.y_px].into_iter().for_each(finite);
}

fn matches(frame: &mut MatchFrame) {
    frame.exposed_ns |= 1;
    frame.field_count %= MAX_FIELDS_USED as u32 + 1;
    let count = frame.field_count as usize;
    frame.fields[count..].fill(Zeroable::zeroed());
    for field in frame.fields_mut() {
        field.parity &= 1;
        field.blob_count %= MAX_BLOBS as u32 + 1;
        field.missed_count %= field.missed.len() as u32 + 1;
        let (blobs, missed) = (field.blob_count as usize, field.missed_count as usize);
        field.blobs[blobs..].fill(Zeroable::zeroed());
        field.missed[missed..].fill(Zeroable::zeroed());
        field.blobs[..blobs].iter_mut().for_each(matched_blob);
        field.missed[..missed].iter_mut().for_each(missed_marker);
    }
}

fn event(event: &mut Event) {
    event.kind = EVENTS[event.kind as usize % EVENTS.len()].kind as u32;
    event.severity %= 3;
}

fn frame(frame: &mut FrameRecord) {
    let mut order = [frame.frame_start, frame.drawn, frame.displayed];
    order.sort();
    [frame.frame_start, frame.drawn, frame.displayed] = order;
}

fn handle(handle: &mut HandleState) {
    handle.instrument %= INSTRUMENTS as u32;
    handle.tool = handle.tool % 5 + 1;
    handle.jaw_rad = handle.jaw_rad.abs().min(1.25);
}

fn pedal(pedal: &mut PedalState) {
    pedal.axes = pedal.axes.map(|a| a.clamp(-1.0, 1.0));
    pedal.mode %= 5;
}

fn payload() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), 0..2000)
}

fn with_bytes<H: Message + std::fmt::Debug + Pod>(
    set: fn(&mut H, u64),
    item: fn(H, Vec<u8>) -> Item,
) -> impl Strategy<Value = Item> {
    (block::<H>(|_| {}), payload()).prop_map(move |(mut header, bytes)| {
        set(&mut header, bytes.len() as u64);
        item(header, bytes)
    })
}

fn note() -> impl Strategy<Value = Item> {
    let kind = prop::sample::select(vec![NoteKind::Log, NoteKind::Restart, NoteKind::Loss]);
    let process = prop::option::of(prop::sample::select(Process::ALL.to_vec()));
    (any::<u64>(), kind, process, any::<u64>(), ".{0,40}").prop_map(
        |(instant_ns, kind, process, count, text)| {
            Item::Note(Note { instant_ns, kind, process, count, text })
        },
    )
}

/// Any item with any numbers that pass its validation.
pub fn any_item() -> impl Strategy<Value = Item> {
    prop_oneof![
        block::<BlobField>(blobs).prop_map(|b| Item::Blobs(Box::new(b))),
        block::<HandleState>(handle).prop_map(Item::Handle),
        block::<PedalState>(pedal).prop_map(Item::Pedal),
        block::<TrackerFrame>(poses).prop_map(|b| Item::Poses(Box::new(b))),
        block::<StepRecord>(|s| s.instants.exposed |= 1).prop_map(Item::Step),
        block::<Event>(event).prop_map(Item::Event),
        block::<FrameRecord>(frame).prop_map(Item::Frame),
        with_bytes::<CheckpointHeader>(|h, n| h.bytes = n, Item::Checkpoint),
        with_bytes::<PictureHeader>(|h, n| h.bytes = n, Item::Picture),
        note(),
        with_bytes::<TrackerCheckpointHeader>(|h, n| h.bytes = n, Item::TrackerCheckpoint),
        block::<MatchFrame>(matches).prop_map(|b| Item::Matches(Box::new(b))),
    ]
}
