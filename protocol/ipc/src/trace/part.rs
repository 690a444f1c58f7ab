//! The part of one process in a trace, as a file: a head, then the spans as they lie in memory. It goes from
//! one program of an installation to another on the same machine, and no further.

use super::ring::Ring;
use super::{SPANS_PER_SECOND, Span};
use bytemuck::{Pod, Zeroable, bytes_of, cast_slice, pod_read_unaligned};
use protocol::health::Process;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Begins the file; the last byte is the version.
const MAGIC: [u8; 8] = *b"vtrace\0\x01";
/// Ending of the files.
const ENDING: &str = "trace";
/// Most spans that are read of one file.
const MAX_SPANS: u64 = super::MAX_SECONDS as u64 * SPANS_PER_SECOND as u64;

/// What stands before the spans.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Head {
    magic: [u8; 8],
    /// Spans that ever were, those that are lost included.
    recorded: u64,
    /// Spans in the file.
    count: u64,
    process: u32,
    pid: u32,
}

/// The spans of one process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TracePart {
    /// Which.
    pub process: Process,
    /// Its operating-system id.
    pub pid: u32,
    /// Spans that ever were; those that are not in `spans` are older, and lost.
    pub recorded: u64,
    /// The spans, in the order in which they ended.
    pub spans: Vec<Span>,
}

/// Why a file is no part of a trace.
#[derive(Debug, thiserror::Error)]
pub enum PartError {
    /// It cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It was not written to its end, or by somebody else.
    #[error("{0}")]
    Damaged(&'static str),
}

impl TracePart {
    pub(super) fn of(process: Process, pid: u32, ring: &Ring) -> Self {
        TracePart { process, pid, recorded: ring.recorded(), spans: ring.pieces().concat() }
    }

    /// True if older spans are lost.
    pub fn is_wrapped(&self) -> bool {
        self.recorded > self.spans.len() as u64
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// Where they are not those of a whole file. Spans of phases that this build does not know are taken.
    pub fn parse(bytes: &[u8]) -> Result<Self, PartError> {
        let damaged = |what| Err(PartError::Damaged(what));
        let Some((head, spans)) = bytes.split_at_checked(size_of::<Head>()) else {
            return damaged("it ends within its head");
        };
        let head: Head = pod_read_unaligned(head);
        if head.magic != MAGIC {
            return damaged("it has another version");
        }
        let Some(process) = Process::from_wire(head.process) else { return damaged("it names no process") };
        let spans = spans.chunks_exact(size_of::<Span>());
        if head.count > MAX_SPANS || spans.len() as u64 != head.count || !spans.remainder().is_empty() {
            return damaged("it is incomplete");
        }
        if head.recorded < head.count {
            return damaged("it has more spans than were recorded");
        }
        let spans = spans.map(pod_read_unaligned).collect();
        Ok(TracePart { process, pid: head.pid, recorded: head.recorded, spans })
    }

    /// The bytes of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let head = head(self.process, self.pid, self.recorded, self.spans.len());
        [bytes_of(&head), cast_slice(&self.spans)].concat()
    }
}

fn head(process: Process, pid: u32, recorded: u64, count: usize) -> Head {
    Head { magic: MAGIC, recorded, count: count as u64, process: process as u32, pid }
}

/// The file of a process in the directory of its instance.
pub(super) fn part_file(directory: &Path, process: Process, pid: u32) -> PathBuf {
    directory.join(format!("{}-{pid}.{ENDING}", process.name()))
}

/// Writes what a ring holds.
pub(super) fn write(file: &Path, process: Process, ring: &Ring) -> io::Result<()> {
    let pieces = ring.pieces();
    let count = pieces.iter().map(|piece| piece.len()).sum();
    let mut file = File::create(file)?;
    file.write_all(bytes_of(&head(process, std::process::id(), ring.recorded(), count)))?;
    pieces.iter().try_for_each(|piece| file.write_all(cast_slice(piece)))
}

/// Takes the parts that processes have left in the directory of an instance away, and returns them by process,
/// the earlier of two of one first. One that is not whole is left out.
///
/// # Errors
/// Where the directory cannot be read.
pub fn take_all(directory: &Path) -> io::Result<Vec<TracePart>> {
    let mut parts = Vec::new();
    for entry in fs::read_dir(directory)? {
        let path = entry?.path();
        if path.extension().is_none_or(|ending| ending != ENDING) {
            continue;
        }
        let part = fs::read(&path).map_err(PartError::from).and_then(|bytes| TracePart::parse(&bytes));
        match part {
            Ok(part) => parts.push(part),
            Err(problem) => tracing::debug!("{} is not a part of a trace: {problem}", path.display()),
        }
        let _ = fs::remove_file(&path);
    }
    let place = |part: &TracePart| Process::ALL.iter().position(|p| *p == part.process);
    parts.sort_by_key(|part| (place(part), part.spans.first().map(|span| span.start_ns), part.pid));
    Ok(parts)
}
