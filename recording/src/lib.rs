//! Recordings: MCAP files that other tools open as they are, and that hold everything a result
//! depends on.
//!
//! [`Provenance`] (rig, scene, configuration, seeds, versions) stands at the start of the file,
//! so that it survives a crash. The blocks follow in the order in which the recorder received
//! them, as lossless protobuf messages (`proto/vitreo.proto`) on topics named like the channels.
//! Poses, log and pictures are there a second time in Foxglove's own schemas (topics `/tf`, `/log`,
//! `/picture`; positions in mm), for viewers; the reader passes those over.
//!
//! Log times are instants of `CLOCK_MONOTONIC` in ns, and those of the stream's own clock in an
//! imported recording. A [`Writer`] closes its chunk when it is 24 KiB large or, with
//! [`Writer::keep_up`], 100 ms old; a chunk is written in one piece and carries a CRC, so that a
//! killed recorder leaves a file that is readable up to its last chunk.

mod display;
mod mirror;
mod read;
mod record;
mod records;
mod wire;
mod write;

#[cfg(test)]
mod samples;

pub use read::{Items, Recording};
pub use write::Writer;

use protocol::blobs::BlobField;
use protocol::events::Event;
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::handles::{HandleState, PedalState};
use protocol::health::Process;
use protocol::journal::Entry;
use protocol::message::Invalid;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, StepRecord};
use protocol::time::Nanos;
use std::collections::BTreeMap;

/// MCAP profile of a recording: by it a file says that it is one of ours.
pub const PROFILE: &str = "vitreo";
/// Version of the recording's format; another one is refused.
pub const FORMAT: &str = "vitreo-recording-1";

/// One block of a recording.
#[derive(Debug, Clone)]
pub enum Item {
    /// What a camera saw in one field.
    Blobs(Box<BlobField>),
    /// Tool and jaw opening.
    Handle(HandleState),
    /// The foot pedal.
    Pedal(PedalState),
    /// The tracker's answer.
    Poses(Box<TrackerFrame>),
    /// What a simulation step consumed and became.
    Step(StepRecord),
    /// What happened to the eye.
    Event(Event),
    /// A displayed frame.
    Frame(FrameRecord),
    /// The simulation's whole state.
    Checkpoint(CheckpointHeader, Vec<u8>),
    /// A small JPEG of both channels.
    Picture(PictureHeader, Vec<u8>),
    /// What the recorder has to say.
    Note(Note),
}

impl Item {
    /// Every topic, in the order in which the file declares them.
    pub const TOPICS: [&'static str; 10] = [
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
    ];

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
        match self {
            Item::Blobs(_) => 0,
            Item::Handle(_) => 1,
            Item::Pedal(_) => 2,
            Item::Poses(_) => 3,
            Item::Step(_) => 4,
            Item::Event(_) => 5,
            Item::Frame(_) => 6,
            Item::Checkpoint(..) => 7,
            Item::Picture(..) => 8,
            Item::Note(_) => 9,
        }
    }
}

/// What a note is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoteKind {
    /// A message for a person.
    Log,
    /// A process died and was started again.
    Restart,
    /// The recording misses [`Note::count`] blocks here.
    Loss,
}

/// A remark of the recorder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// When it was made.
    pub instant_ns: Nanos,
    /// What it is about.
    pub kind: NoteKind,
    /// The process concerned.
    pub process: Option<Process>,
    /// Blocks missed, or how often.
    pub count: u64,
    /// In words.
    pub text: String,
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

/// What makes a recording complete besides its blocks.
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

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The operating system refused.
    #[error("{file}: {problem}")]
    Io {
        /// The file.
        file: String,
        /// The system's answer.
        #[source]
        problem: std::io::Error,
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
    /// The file ends in the middle of a record, as after a crash; all before it is good.
    #[error(
        "{file}: ends in the middle of a record at byte {offset}; all before it is readable \
         (vitreo recover makes a whole file of it)"
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

/// Why a message of a recording was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MessageError {
    /// The bytes are no such message.
    #[error("not decodable: {0}")]
    Encoding(String),
    /// A part is missing or an array has the wrong length.
    #[error("{0}")]
    Shape(mirror::Shape),
    /// A number makes no sense.
    #[error("{0}")]
    Invalid(Invalid),
}
