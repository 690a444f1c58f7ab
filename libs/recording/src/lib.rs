//! Recordings: MCAP files that other tools open as they are, and that hold everything that a result
//! depends on.
//!
//! [`Provenance`] (rig, scene, configuration, seeds, versions) stands at the start of the file,
//! so that it survives a crash. The blocks follow in the order in which the recorder received
//! them, as lossless protobuf messages on topics named like the channels. Messages and their
//! descriptors are made from the layout of the blocks ([`protocol::wire`]), field by field; a field
//! number is never used again, a reader skips fields that it does not know.
//! Poses, log, pictures and matches are there a second time in Foxglove's own schemas (topics `/tf`, `/log`,
//! `/picture`, `/camera0/matches`…; positions in mm), for viewers; the reader skips those. [`live`] has the same
//! messages for viewers that look on while a run goes on.
//!
//! Items are filed by instants of `CLOCK_MONOTONIC` in ns, and of the stream's own clock in an imported
//! recording. In the file, log times and the timestamps for viewers are those of the wall clock: instants
//! plus [`Provenance::realtime_offset_ns`]. A viewer's time line follows log times and looks up transforms by
//! their timestamps, so both must be of one clock; the reader takes the offset off again. A [`Writer`] closes its chunk when it is 24 KiB large or, with
//! [`Writer::flush_aged`], 80 ms old; a chunk is written in one piece and carries a CRC, so that a
//! killed recorder leaves a file that is readable up to its last chunk, and with
//! [`Writer::sync_along`] a power failure does no worse. `docs/recording.md` says what is under
//! which checksum.

mod checksum;
mod chunk_index;
mod chunks;
mod data_section;
mod descriptors;
mod disk;
mod file_items;
mod heads;
mod items;
pub mod live;
mod note;
mod packing;
mod parts;
mod pixels;
mod protobuf;
mod read;
mod record;
mod records;
mod resync;
mod summary;
mod tracker_version;
mod viewer_messages;
mod write;

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod disk_tests;
#[cfg(test)]
mod samples;

pub use chunk_index::{Chunk, ChunkIndex};
pub use heads::CheckpointHead;
pub use items::{Items, Place};
pub use note::{Note, NoteKind};
pub use packing::Packing;
pub use parts::{
    Limit, MOST_PARTS, PartFiles, PartInfo, PartOf, PartsWriter, files_of, part_file, parts_of, split_name,
    whole_of,
};
pub use pixels::{CameraSettings, PIXELS_PROFILE, PixelsHead, PixelsReader, PixelsWriter};
pub use read::{Recording, states_incomparable};
pub use tracker_version::{TRACKER_DIGESTS, TRACKER_VERSION};
pub use viewer_messages::TOPICS as VIEWER_TOPICS;
pub use write::Writer;

use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::events::Event;
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::handles::{HandleState, PedalState};
use protocol::journal::Entry;
use protocol::matches::MatchFrame;
use protocol::message::{Invalid, Message};
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, STATE_HASH_OF_BARE_SCENES, STATE_HASH_VERSION, StepRecord};
use protocol::time::Nanos;
use protocol::wire::{Layout, layout_of};
use std::collections::BTreeMap;

/// What a provenance calls the inputs of a run at a desk, without cameras.
pub const DESK: &str = "desk";

/// What a provenance calls the place at which a part was cut off the beginning: the recording begins with what
/// tracker and simulation knew there.
pub const CUT: &str = "cut";

/// MCAP profile of a recording.
pub const PROFILE: &str = "vitreo";
/// Version of the recording's format; another one is refused.
pub const FORMAT: &str = "vitreo-recording-1";

/// One block of a recording.
#[derive(Debug, Clone)]
pub enum Item {
    /// Blobs of one camera-field.
    Blobs(Box<BlobField>),
    /// Tool and jaw opening.
    Handle(HandleState),
    /// The foot pedal.
    Pedal(PedalState),
    /// A tracker frame.
    Poses(Box<TrackerFrame>),
    /// Inputs and figures of a simulation step.
    Step(StepRecord),
    /// An event of the simulation.
    Event(Event),
    /// A displayed frame.
    Frame(FrameRecord),
    /// The simulation's whole state.
    Checkpoint(CheckpointHeader, Vec<u8>),
    /// A small JPEG of both channels.
    Picture(PictureHeader, Vec<u8>),
    /// A remark of the recorder.
    Note(Note),
    /// All that the tracker knows.
    TrackerCheckpoint(TrackerCheckpointHeader, Vec<u8>),
    /// Which blob the tracker took for which marker.
    Matches(Box<MatchFrame>),
}

impl Item {
    /// Every topic, in the order in which they came to be.
    pub const TOPICS: [&'static str; 12] = [
        "blobs",
        "handles",
        "pedal",
        "poses",
        "steps",
        "events",
        "frames",
        "checkpoints",
        "pictures",
        "notes",
        "tracker-checkpoints",
        "matches",
    ];

    /// Layout of the blocks on a topic; `None` for notes and for what is no topic.
    pub fn layout(topic: &str) -> Option<&'static Layout> {
        LAYOUTS[Self::TOPICS.iter().position(|t| *t == topic)?]
    }

    /// The item as a block; `None` for a note.
    pub fn block(&self) -> Option<Block<'_>> {
        match self {
            Item::Blobs(field) => Some(Block::of(&**field, &[])),
            Item::Handle(handle) => Some(Block::of(handle, &[])),
            Item::Pedal(pedal) => Some(Block::of(pedal, &[])),
            Item::Poses(frame) => Some(Block::of(&**frame, &[])),
            Item::Step(step) => Some(Block::of(step, &[])),
            Item::Event(event) => Some(Block::of(event, &[])),
            Item::Frame(frame) => Some(Block::of(frame, &[])),
            Item::Checkpoint(header, state) => Some(Block::of(header, state)),
            Item::Picture(header, jpeg) => Some(Block::of(header, jpeg)),
            Item::Note(_) => None,
            Item::TrackerCheckpoint(header, state) => Some(Block::of(header, state)),
            Item::Matches(matches) => Some(Block::of(&**matches, &[])),
        }
    }

    /// As an entry of the simulation's journal; `None` for what the simulation does not read.
    pub fn into_entry(self) -> Option<Entry> {
        match self {
            Item::Checkpoint(header, state) => Some(Entry::Checkpoint(header, state)),
            Item::Step(step) => Some(Entry::Step(step)),
            Item::Poses(frame) => Some(Entry::Poses(frame)),
            Item::Handle(handle) => Some(Entry::Handle(handle)),
            Item::Pedal(pedal) => Some(Entry::Pedal(pedal)),
            _ => None,
        }
    }

    /// When it was made, ns; `None` for events, checkpoints, notes and matches, which are filed as they
    /// come.
    pub fn instant_ns(&self) -> Option<Nanos> {
        match self {
            Item::Blobs(field) => Some(field.blobs_out_ns),
            Item::Handle(handle) => Some(handle.instant_ns),
            Item::Pedal(pedal) => Some(pedal.instant_ns),
            Item::Poses(frame) => Some(frame.instants.tracked),
            Item::Step(step) => Some(step.instants.stepped),
            Item::Frame(frame) => Some(frame.displayed),
            Item::Picture(header, _) => Some(header.displayed),
            Item::Event(_) | Item::Checkpoint(..) | Item::Note(_) => None,
            Item::TrackerCheckpoint(..) | Item::Matches(_) => None,
        }
    }

    /// Topic in the file; the name of the channel.
    pub fn topic(&self) -> &'static str {
        Self::TOPICS[self.topic_index()]
    }

    /// The item's message as it stands in the file: equal for items that are equal to the bit.
    pub fn encoded(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        record::encode(self, &mut bytes);
        bytes
    }

    fn topic_index(&self) -> usize {
        let own = self.block().map(|block| block.layout.name);
        let found = LAYOUTS.iter().position(|layout| layout.map(|l| l.name) == own);
        found.expect("every item has its topic")
    }
}

/// Name of a note's message.
const NOTE: &str = "Note";

/// Layout of each topic's blocks, in the order of [`Item::TOPICS`].
const LAYOUTS: [Option<&Layout>; Item::TOPICS.len()] = [
    Some(layout_of::<BlobField>()),
    Some(layout_of::<HandleState>()),
    Some(layout_of::<PedalState>()),
    Some(layout_of::<TrackerFrame>()),
    Some(layout_of::<StepRecord>()),
    Some(layout_of::<Event>()),
    Some(layout_of::<FrameRecord>()),
    Some(layout_of::<CheckpointHeader>()),
    Some(layout_of::<PictureHeader>()),
    None,
    Some(layout_of::<TrackerCheckpointHeader>()),
    Some(layout_of::<MatchFrame>()),
];

/// Topics that are declared before those for viewers. Later ones come behind them, so that the channels of
/// a file of whatever version whose beginning is lost are known by their numbers.
const FIRST_TOPICS: usize = 10;

/// Numbers of the topics' channels, in the order of [`Item::TOPICS`].
fn channel_numbers() -> impl Iterator<Item = u16> {
    let viewers = viewer_messages::FIRST;
    (0..Item::TOPICS.len()).map(move |i| 1 + (if i < FIRST_TOPICS { i } else { i + viewers }) as u16)
}

/// Full name of a topic's message.
fn message_name(topic: usize) -> String {
    format!("{}.{}", descriptors::PACKAGE, LAYOUTS[topic].map_or(NOTE, |layout| layout.name))
}

/// A block with the table of its fields.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    /// Its fields.
    pub layout: &'static Layout,
    /// The block as it lies in memory.
    pub bytes: &'a [u8],
    /// What follows it; empty for most.
    pub payload: &'a [u8],
}

impl<'a> Block<'a> {
    fn of<B: Message>(block: &'a B, payload: &'a [u8]) -> Self {
        Block { layout: layout_of::<B>(), bytes: bytemuck::bytes_of(block), payload }
    }
}

/// Where a recording comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Source {
    /// A run of the simulator; tracker frames say what they consumed.
    #[default]
    Live,
    /// A blob stream of another tool; there are no tracker frames.
    Import,
}

impl Source {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Source::Live => "live",
            Source::Import => "import",
        }
    }

    /// From its name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Source::Live, Source::Import].into_iter().find(|s| s.name() == name)
    }
}

/// Provenance of a recording: all that its results depend on besides its blocks.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Provenance {
    /// The rig file's text.
    pub rig_json: String,
    /// Name of the scene.
    pub scene_name: String,
    /// The scene file's text.
    pub scene_toml: String,
    /// Live run or imported stream.
    pub source: Source,
    /// Random seeds, by what they are for.
    pub seeds: BTreeMap<String, String>,
    /// Configuration, by key.
    pub config: BTreeMap<String, String>,
    /// Versions, by program.
    pub versions: BTreeMap<String, String>,
}

/// Key of the version of state hashes among [`Provenance::versions`].
pub const STATE_HASH: &str = "state-hash";
/// Key of `CLOCK_REALTIME` less `CLOCK_MONOTONIC` at the start, ns, among [`Provenance::config`].
pub const REALTIME_OFFSET: &str = "realtime-offset-ns";
/// Key of the version of the tracker's arithmetic among [`Provenance::versions`].
pub const TRACKER: &str = "tracker";

impl Provenance {
    /// Version of its state hashes where it is not one that hashes this scene as
    /// [`STATE_HASH_VERSION`] does, so that states cannot be compared; 0 for a version that is no
    /// number. Recordings that name none are of version 1.
    pub fn other_state_hash_version(&self) -> Option<u32> {
        let version = self.versions.get(STATE_HASH).map_or(1, |v| v.parse().unwrap_or(0));
        let has = |table: &str| self.scene_toml.lines().any(|line| line.trim() == table);
        let is_bare = !has("[task]") && !has("[vitreous]");
        let oldest = if is_bare { STATE_HASH_OF_BARE_SCENES } else { STATE_HASH_VERSION };
        (!(oldest..=STATE_HASH_VERSION).contains(&version)).then_some(version)
    }

    /// What is added to an instant of `CLOCK_MONOTONIC` to get wall-clock time since 1970, ns, wrapping; 0
    /// where it is not known: in imported recordings and those of former versions.
    pub fn realtime_offset_ns(&self) -> u64 {
        self.config.get(REALTIME_OFFSET).and_then(|offset| offset.parse().ok()).unwrap_or(0)
    }

    /// Version of the arithmetic of its tracker where it is not [`TRACKER_VERSION`], so that its poses
    /// cannot be expected from this tracker; 0 where it names none, or one that is no number.
    pub fn other_tracker_version(&self) -> Option<u32> {
        let version = self.versions.get(TRACKER).and_then(|v| v.parse().ok()).unwrap_or(0);
        (version != TRACKER_VERSION).then_some(version)
    }
}

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The operating system refused.
    #[error("{}", in_plain_words(file, problem))]
    Io {
        /// The file.
        file: String,
        /// The system's answer.
        #[source]
        problem: std::io::Error,
    },
    /// Written, but the disk did not confirm it.
    #[error("{file}: the disk did not confirm the data; a power failure may lose it: {problem}")]
    NotSafe {
        /// The file.
        file: String,
        /// The system's answer.
        problem: String,
    },
    /// The MCAP library refused to write.
    #[error("{file}: cannot write: {problem}")]
    Write {
        /// The file.
        file: String,
        /// The library's answer.
        problem: String,
    },
    /// The file is something else.
    #[error("{file}: not a vitreo recording: {problem}")]
    Foreign {
        /// The file.
        file: String,
        /// What it is instead.
        problem: String,
    },
    /// A recording of another kind: of pixels, or of a run.
    #[error("{file}: expected {expected}, found {found}")]
    OtherKind {
        /// The file.
        file: String,
        /// What was expected.
        expected: &'static str,
        /// What it is.
        found: &'static str,
    },
    /// A part of the recording is missing, or cannot be read as one of it.
    #[error("{file}: {problem}")]
    Part {
        /// The file.
        file: String,
        /// What is wrong.
        problem: String,
    },
    /// The file ends in the middle of a record, as after a crash; all before it is good.
    #[error(
        "{file}: ends in the middle of a record at byte {offset}; everything before it is readable \
         (vitreo recover repairs it)"
    )]
    Truncated {
        /// The file.
        file: String,
        /// Where the incomplete record begins.
        offset: u64,
    },
    /// A record is damaged; all before it is good.
    #[error("{file}: damaged at byte {offset}: {problem}")]
    Damaged {
        /// The file.
        file: String,
        /// Where the damaged record begins.
        offset: u64,
        /// What is wrong.
        problem: String,
    },
    /// A message is whole but its numbers make no sense.
    #[error("{file}: topic {topic}, message of {log_time_ns} ns: {problem}")]
    Message {
        /// The file.
        file: String,
        /// Topic.
        topic: String,
        /// Log time of the message, ns.
        log_time_ns: Nanos,
        /// What is wrong.
        problem: MessageError,
    },
}

/// The system's error about a file, in plain words.
fn in_plain_words(file: &str, problem: &std::io::Error) -> String {
    use std::io::ErrorKind;
    match problem.kind() {
        ErrorKind::StorageFull => format!("the disk is full: {file}"),
        ErrorKind::QuotaExceeded => format!("the disk quota is used up: {file}"),
        ErrorKind::ReadOnlyFilesystem => format!("the disk is read-only: {file}"),
        ErrorKind::FileTooLarge => format!("the file has reached the largest size allowed here: {file}"),
        _ => format!("{file}: {problem}"),
    }
}

/// Why a message of a recording was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MessageError {
    /// The bytes are no such message.
    #[error("not decodable: {0}")]
    Encoding(String),
    /// A part is missing or an array has the wrong length.
    #[error("expected {expected} elements, found {found}")]
    Shape {
        /// Elements that the block has room for, or must have.
        expected: usize,
        /// Elements in the message.
        found: usize,
    },
    /// A number makes no sense.
    #[error("{0}")]
    Invalid(Invalid),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_of_versions_before_are_comparable_where_the_scene_has_neither_task_nor_vitreous() {
        let other = |version: u32, scene_toml: &str| {
            let versions = [(STATE_HASH.to_owned(), version.to_string())].into();
            let scene_toml = scene_toml.to_owned();
            Provenance { versions, scene_toml, ..Provenance::default() }.other_state_hash_version()
        };
        let scenes = ["title = \"[task]\"\n[eye]\n", "title = \"t\"\n[task]\n", "[vitreous]\nlattice = 24\n"];
        let bare = scenes[0];
        assert_eq!(scenes.map(|scene| other(STATE_HASH_VERSION, scene)), [None; 3]);
        assert_eq!(scenes.map(|scene| other(STATE_HASH_OF_BARE_SCENES, scene)), [None, Some(2), Some(2)]);
        assert_eq!(scenes.map(|scene| other(3, scene)), [None, Some(3), Some(3)]);
        assert_eq!(other(1, bare), Some(1));
        assert_eq!(other(STATE_HASH_VERSION + 1, bare), Some(STATE_HASH_VERSION + 1));
    }
}
