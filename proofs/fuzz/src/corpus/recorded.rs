//! Inputs made of recordings: blocks, cut recordings, journals.

use super::repository;
use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::geometry::{Pose, Validity};
use protocol::journal::{self, Entry};
use protocol::poses::TrackerFrame;
use recording::{Item, Limit, Packing, PartFiles, PartsWriter, Recording, RecordingError, Writer, part_file};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Items that are kept of a recording for an input.
const ITEMS: usize = 40;

fn path(name: &str) -> PathBuf {
    repository().join("tests/data").join(name)
}

fn items(name: &str) -> impl Iterator<Item = Item> {
    let recording = Recording::open(&path(name)).expect("a recording of the repository");
    recording.items().map(|item| item.expect("a whole recording").1)
}

/// Blocks of messages of this name, spread over recordings.
pub fn recorded_blocks(message: &str, count: usize) -> Vec<Vec<u8>> {
    let mut blocks = Vec::new();
    for file in ["corpus/peel.mcap", "corpus/vitrectomy.mcap"] {
        let of = |item: Item| {
            let block = item.block().filter(|b| b.layout.name == message)?;
            Some(block.bytes.to_vec())
        };
        let all: Vec<_> = items(file).filter_map(of).collect();
        blocks.extend(all.iter().step_by((all.len() * 2 / count).max(1)).take(count / 2).cloned());
    }
    blocks
}

/// Recordings with all kinds of items, small: the beginnings of real ones, in every packing, and a part.
pub fn recordings() -> Vec<Vec<u8>> {
    let name = "corpus/peel.mcap";
    let packed = Packing::ALL.map(|packing| shortened(name, packing));
    packed.into_iter().chain([shortened("corpus/vitrectomy.mcap", Packing::Zstd), part(name)]).collect()
}

/// The first items of a recording, with their instants.
fn first_items(name: &str) -> impl Iterator<Item = (u64, Item)> {
    let small = |item: &Item| !matches!(item, Item::Checkpoint(_, state) if state.len() > 40_000);
    (1000..).zip(items(name).filter(small).take(ITEMS))
}

fn shortened(name: &str, packing: Packing) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("short.mcap");
    let recording = Recording::open(&path(name)).expect("a recording of the repository");
    let file = File::create(&out).expect("a file");
    let mut writer = Writer::packed(file, &out, recording.provenance(), packing).expect("a recording");
    first_items(name).for_each(|(at, item)| writer.write(at, &item).expect("an item"));
    writer.finish().expect("a recording");
    std::fs::read(&out).expect("a recording")
}

/// The first part of a recording that is written in parts.
fn part(name: &str) -> Vec<u8> {
    struct Nowhere;
    impl PartFiles for Nowhere {
        fn begin(&mut self, path: &Path) -> Result<File, RecordingError> {
            let problem = std::io::ErrorKind::Unsupported.into();
            Err(RecordingError::Io { file: path.display().to_string(), problem })
        }

        fn appear(&mut self, _: &Path) -> Result<(), RecordingError> {
            Ok(())
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let base = folder.path().join("short.mcap");
    let out = part_file(&base, 1);
    let recording = Recording::open(&path(name)).expect("a recording of the repository");
    let (file, limit) = (File::create(&out).expect("a file"), Limit::Bytes(u64::MAX));
    let (provenance, packing) = (recording.provenance(), Packing::Zstd);
    let writer = PartsWriter::begin(&base, file, provenance, packing, limit, Box::new(Nowhere));
    let mut writer = writer.expect("a recording");
    first_items(name).for_each(|(at, item)| writer.write(at, &item).expect("an item"));
    writer.finish().expect("a recording");
    std::fs::read(&out).expect("a recording")
}

/// Journals of real inputs.
pub fn journals() -> Vec<Vec<u8>> {
    let mut entries: Vec<Entry> = items("corpus/peel.mcap").take(60).filter_map(Item::into_entry).collect();
    let mut state = vec![7; 100];
    for entry in &mut entries {
        if let Entry::Checkpoint(header, bytes) = entry {
            header.bytes = state.len() as u64;
            *bytes = std::mem::take(&mut state);
            state = bytes.clone();
        }
    }
    let mut bytes = Vec::new();
    journal::write(&mut bytes, entries.iter()).expect("memory");
    vec![bytes]
}

/// The first camera-fields of a recording.
pub fn camera_fields(count: usize) -> Vec<BlobField> {
    let fields = items("corpus/peel.mcap").filter_map(|item| match item {
        Item::Blobs(field) => Some(*field),
        _ => None,
    });
    fields.take(count).collect()
}

/// Tracker frames of a recording that stand one field apart.
pub fn tracker_frames(count: usize) -> Vec<TrackerFrame> {
    let frames = items("corpus/peel.mcap").filter_map(|item| match item {
        Item::Poses(frame) => Some(*frame),
        _ => None,
    });
    frames.skip(40).take(count).collect()
}

/// A frame in which both instruments rest in the eye.
pub fn resting_frame(number: u64) -> TrackerFrame {
    let mut frame = TrackerFrame::zeroed();
    (frame.frame, frame.field) = (number, number);
    frame.instants.exposed = 20_000_000 * (number + 1);
    for body in &mut frame.bodies {
        body.world_from_body = Pose::IDENTITY;
        body.validity = Validity::Measured as u32;
    }
    frame
}
