//! Writing a recording.
//!
//! The `mcap` crate writes into memory, where it cannot fail; whole pieces (a chunk with its indexes)
//! go from there to the file, see [`super::disk`]. So a full disk costs time and no format: what
//! could not be written waits, and the caller waits with the next items.

use super::chunks::Chunks;
use super::disk::{Disk, Medium, NamedFile};
use super::packing::Packing;
use super::parts::{GOES_ON, Numbers, PartOf};
use super::viewer_messages::annotations;
use super::{FORMAT, Item, PROFILE, Provenance, RecordingError, checksum, record, viewer_messages};
use mcap::WriteOptions;
use mcap::records::{MessageHeader, Metadata};
use protocol::limits::FIELD_PERIOD_NS;
use protocol::time::Nanos;
use rig::Rig;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::time::Duration;

/// A chunk is closed before a message once it has passed this, so that with the message it stays
/// below 32 KiB (checkpoints and pictures can be larger), bytes.
const CHUNK_BYTES: u64 = 24 << 10;
/// A chunk is closed at this age, ns. With 40 ms until its age is looked at and twice as much for the
/// disk, what may be lost stays below 200 ms.
const CHUNK_AGE_NS: u64 = 80_000_000;
/// Name of the metadata record with the provenance.
pub(super) const METADATA: &str = "vitreo";

/// A recording being written.
///
/// Only [`Writer::finish`] ends the file in order; one that is dropped is left as by a crash.
///
/// After an error nothing is forgotten: the item is kept, and [`Writer::flush_aged`] tries again.
/// As long as errors come, a caller gives no further items.
pub struct Writer {
    file: String,
    chunks: Chunks,
    disk: Disk,
    channels: [u16; Item::TOPICS.len()],
    viewers: [u16; viewer_messages::TOPICS.len()],
    /// Numbers of the next messages by topic.
    numbers: Numbers,
    /// Numbers of the next messages for viewers by channel.
    sequences: BTreeMap<u16, u32>,
    message: Vec<u8>,
    realtime_offset_ns: u64,
    /// The rig, for viewers; `None` for one that is none.
    rig: Option<Rig>,
    /// Of one frame in so many the matches are shown in viewers.
    annotated: u64,
    /// Log time from which on the rig is due again, ns.
    rig_due_ns: Nanos,
    /// When [`Writer::flush_aged`] first saw the open chunk.
    open_since: Option<Nanos>,
    /// Items in the open chunk.
    open: u64,
    ended: bool,
}

impl Writer {
    /// Writes the provenance at the start of a file that is open and empty; `path` is its name, for
    /// messages and for the directory entry that [`Writer::finish`] carries to the disk.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn on(target: File, path: &Path, provenance: &Provenance) -> Result<Self, RecordingError> {
        Self::packed(target, path, provenance, Packing::default())
    }

    /// As [`Writer::on`], with chunks that are packed in this way.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn packed(
        target: File,
        path: &Path,
        provenance: &Provenance,
        packing: Packing,
    ) -> Result<Self, RecordingError> {
        let medium = NamedFile { file: target, path: path.into() };
        Self::begin(path.display().to_string(), Box::new(medium), provenance, packing, None)
    }

    /// As [`Writer::packed`], of a part of a recording.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub(super) fn of_part(
        target: File,
        path: &Path,
        provenance: &Provenance,
        packing: Packing,
        part: &PartOf,
    ) -> Result<Self, RecordingError> {
        let medium = NamedFile { file: target, path: path.into() };
        Self::begin(path.display().to_string(), Box::new(medium), provenance, packing, Some(part))
    }

    /// As [`Writer::on`], of a new file in the place of one of that name.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn create(path: &Path, provenance: &Provenance) -> Result<Self, RecordingError> {
        let io = |problem| RecordingError::Io { file: path.display().to_string(), problem };
        Self::on(File::create(path).map_err(io)?, path, provenance)
    }

    pub(super) fn begin(
        file: String,
        medium: Box<dyn Medium>,
        provenance: &Provenance,
        packing: Packing,
        part: Option<&PartOf>,
    ) -> Result<Self, RecordingError> {
        let fail = |e: mcap::McapError| RecordingError::Write { file: file.clone(), problem: e.to_string() };
        let options = WriteOptions::new()
            .profile(PROFILE)
            .library(format!("vitreo {}", env!("CARGO_PKG_VERSION")))
            .compression(packing.compression())
            .chunk_size(Some(CHUNK_BYTES));
        let metadata =
            Metadata { name: METADATA.into(), metadata: checksum::signed(pairs(provenance, part)) };
        let scratch = medium.scratch().ok();
        let (mut chunks, (channels, viewers)) = Chunks::begin(options, &metadata, scratch).map_err(fail)?;
        let mut disk = Disk::new(file.clone(), medium);
        disk.put(chunks.take(), 0);
        disk.settle()?;
        let rig = Rig::parse(&provenance.rig_json, "of the recording").ok();
        Ok(Writer {
            file,
            chunks,
            disk,
            channels,
            viewers,
            numbers: part.map(|part| part.from).unwrap_or_default(),
            sequences: BTreeMap::new(),
            message: Vec::new(),
            realtime_offset_ns: provenance.realtime_offset_ns(),
            annotated: annotations::one_in(rig.as_ref().map_or(FIELD_PERIOD_NS, Rig::field_period_ns)),
            rig,
            rig_due_ns: 0,
            open_since: None,
            open: 0,
            ended: false,
        })
    }

    /// From now on carries to the disk what is written, on a thread of its own, so that a power
    /// failure loses no more than a crash.
    ///
    /// # Errors
    /// Where the system refuses a descriptor or a thread.
    pub fn sync_along(&mut self) -> Result<(), RecordingError> {
        self.disk.sync_along()
    }

    /// Appends an item, and its messages for viewers where it has some. `log_time_ns` is the instant by which
    /// it is filed; items keep the order of the calls.
    ///
    /// # Errors
    /// Where the file cannot be written; the item is kept.
    pub fn write(&mut self, log_time_ns: Nanos, item: &Item) -> Result<(), RecordingError> {
        let topic = item.topic_index();
        let number = self.numbers[topic];
        self.numbers[topic] = number.wrapping_add(1);
        self.put(log_time_ns, item, number, 1)
    }

    /// As [`Writer::write`], of an item that another part has too, under this number among those of its topic.
    /// It is not counted.
    ///
    /// # Errors
    /// As there.
    pub(super) fn repeat(
        &mut self,
        log_time_ns: Nanos,
        item: &Item,
        number: u32,
    ) -> Result<(), RecordingError> {
        self.put(log_time_ns, item, number, 0)
    }

    /// Appends an item that counts as so many.
    fn put(
        &mut self,
        log_time_ns: Nanos,
        item: &Item,
        number: u32,
        counts: u64,
    ) -> Result<(), RecordingError> {
        self.message.clear();
        record::encode(item, &mut self.message);
        let log_time = log_time_ns.wrapping_add(self.realtime_offset_ns);
        self.append(self.channels[item.topic_index()], number, log_time)?;
        self.open += counts;
        let mut shown = viewer_messages::encode(item, self.realtime_offset_ns, self.annotated);
        if let Some(rig) = self.rig.as_ref().filter(|_| log_time_ns >= self.rig_due_ns) {
            shown.extend(viewer_messages::rig::encode(rig, log_time_ns, self.realtime_offset_ns));
            self.rig_due_ns = log_time_ns.saturating_add(viewer_messages::rig::EVERY_NS);
        }
        for (viewer, message) in shown {
            self.message = message;
            let sequence = self.sequences.entry(self.viewers[viewer]).or_insert(0);
            let number = *sequence;
            *sequence = sequence.wrapping_add(1);
            self.append(self.viewers[viewer], number, log_time)?;
        }
        self.disk.settle()
    }

    /// Numbers of the next items by topic.
    pub(super) fn numbers(&self) -> Numbers {
        self.numbers
    }

    /// Appends the message. The chunk before it goes to the disk where it was large enough.
    fn append(&mut self, channel_id: u16, sequence: u32, log_time: Nanos) -> Result<(), RecordingError> {
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        let written = self.chunks.append(&header, &self.message);
        written.map_err(|e| self.failure(e))?;
        let piece = self.chunks.take();
        if !piece.is_empty() {
            self.disk.put(piece, std::mem::take(&mut self.open));
            self.open_since = None;
        }
        Ok(())
    }

    /// Closes the open chunk, so that what comes now begins one.
    ///
    /// # Errors
    /// Where the file cannot be written; what was not is kept.
    pub(super) fn close_chunk(&mut self) -> Result<(), RecordingError> {
        self.chunks.flush().map_err(|e| self.failure(e))?;
        self.disk.put(self.chunks.take(), std::mem::take(&mut self.open));
        self.open_since = None;
        self.disk.settle()
    }

    /// Closes the open chunk once it is 80 ms old and writes it, and tries again what could not be
    /// written. To be called at least every 40 ms with the present instant, so that a crash loses
    /// at most 200 ms.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn flush_aged(&mut self, now_ns: Nanos) -> Result<(), RecordingError> {
        if self.open > 0 && !self.ended {
            let since = *self.open_since.get_or_insert(now_ns);
            if now_ns.saturating_sub(since) >= CHUNK_AGE_NS {
                self.chunks.flush().map_err(|e| self.failure(e))?;
                self.disk.put(self.chunks.take(), std::mem::take(&mut self.open));
                self.open_since = None;
            }
        }
        self.disk.settle()
    }

    /// Items that were given and are not on the file.
    pub fn unwritten(&self) -> u64 {
        self.open + self.disk.waiting_items()
    }

    /// Bytes on the file.
    pub fn bytes(&self) -> u64 {
        self.disk.length()
    }

    /// How long written bytes have been waiting for the disk, with [`Writer::sync_along`].
    pub fn sync_lag(&self) -> Duration {
        self.disk.sync_lag()
    }

    /// Closes the last chunk, writes summary and footer, and carries the file and its directory
    /// entry to the disk.
    ///
    /// # Errors
    /// Where the file cannot be written; it then ends with a whole chunk.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.end()
    }

    /// As [`Writer::finish`], for a caller that wants to know what became of the items.
    ///
    /// # Errors
    /// As there.
    pub fn end(&mut self) -> Result<(), RecordingError> {
        if !self.ended {
            let [chunk, rest] = self.chunks.end().map_err(|e| self.failure(e))?;
            self.disk.put(chunk, std::mem::take(&mut self.open));
            self.disk.put(rest, 0);
            self.ended = true;
        }
        self.disk.settle()?;
        self.disk.sync()
    }

    /// As [`Writer::end`], of a part that goes on in another one, which is named at its end.
    ///
    /// # Errors
    /// As there.
    pub(super) fn end_before(&mut self, next: &str) -> Result<(), RecordingError> {
        if !self.ended {
            let pairs = BTreeMap::from([("part".to_string(), next.to_string())]);
            let metadata = Metadata { name: GOES_ON.into(), metadata: pairs };
            self.chunks.note(&metadata).map_err(|e| self.failure(e))?;
        }
        self.end()
    }

    fn failure(&self, problem: mcap::McapError) -> RecordingError {
        RecordingError::Write { file: self.file.clone(), problem: problem.to_string() }
    }
}

/// The provenance as key and value pairs; each group has a prefix.
fn pairs(provenance: &Provenance, part: Option<&PartOf>) -> BTreeMap<String, String> {
    let Provenance { rig_json, scene_name, scene_toml, source, seeds, config, versions } = provenance;
    let mut all: BTreeMap<String, String> = [
        ("format", FORMAT),
        ("rig_json", rig_json),
        ("scene_name", scene_name),
        ("scene_toml", scene_toml),
        ("source", source.name()),
        ("clock", "CLOCK_MONOTONIC, ns; log times: plus config.realtime-offset-ns"),
    ]
    .into_iter()
    .map(|(key, value)| (key.to_string(), value.to_string()))
    .collect();
    for (group, map) in [("seed.", seeds), ("config.", config), ("version.", versions)] {
        all.extend(map.iter().map(|(key, value)| (format!("{group}{key}"), value.clone())));
    }
    all.extend(part.iter().flat_map(|part| part.pairs()));
    all
}

#[cfg(test)]
mod tests {
    use super::super::{Note, NoteKind, Recording};
    use super::*;
    use std::fs;

    fn note(count: u64) -> Item {
        let text = "x".repeat(100);
        Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
    }

    #[test]
    fn a_killed_recorder_loses_only_the_open_chunk() {
        let directory = tempfile::tempdir().unwrap();
        let (path, copy) = (directory.path().join("a.mcap"), directory.path().join("b.mcap"));
        let provenance = Provenance { scene_name: "peel".into(), ..Provenance::default() };
        let mut writer = Writer::create(&path, &provenance).unwrap();
        // One note a millisecond.
        for ms in 0..1000 {
            writer.write(ms * 1_000_000, &note(ms)).unwrap();
            writer.flush_aged(ms * 1_000_000).unwrap();
        }
        fs::copy(&path, &copy).unwrap();
        let recording = Recording::open(&copy).unwrap();
        assert!(!recording.is_finished());
        assert_eq!(recording.provenance(), &provenance);
        let count = |item| match item {
            Ok((_, Item::Note(note))) => note.count,
            other => panic!("{other:?}"),
        };
        let counts: Vec<u64> = recording.items().map(count).collect();
        assert!(counts.iter().copied().eq(0..counts.len() as u64));
        assert!(counts.len() > 800, "{} of 1000 ms are there", counts.len());
    }

    #[test]
    fn viewers_see_the_wall_clock_and_readers_the_instants() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let offset = 1_764_000_000_000_000_000_u64;
        let config = [(super::super::REALTIME_OFFSET.to_string(), offset.to_string())].into();
        let mut writer = Writer::create(&path, &Provenance { config, ..Provenance::default() }).unwrap();
        (7..10).for_each(|at| writer.write(at, &note(at)).unwrap());
        writer.finish().unwrap();
        let recording = Recording::open(&path).unwrap();
        let read: Vec<_> = recording.items().map(|item| item.unwrap().0).collect();
        assert_eq!(read, [7, 8, 9]);
        let bytes = fs::read(&path).unwrap();
        let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        assert_eq!(messages.len(), 6);
        assert!(messages.iter().all(|m| (7..10).contains(&(m.log_time - offset))));
        // Seconds and nanoseconds of the note's own instant, 5 ns.
        let log = messages.iter().find(|m| m.channel.topic == "/log").unwrap();
        let mut stamp = Vec::new();
        crate::protobuf::put_message(&mut stamp, 1, |out| {
            crate::protobuf::put_uint(out, 1, offset / 1_000_000_000);
            crate::protobuf::put_uint(out, 2, 5);
        });
        assert!(log.data.starts_with(&stamp), "{:?}", log.data);
    }

    #[test]
    fn chunks_stay_small() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.mcap");
        let mut writer = Writer::create(&path, &Provenance::default()).unwrap();
        (0..5000).for_each(|i| writer.write(i, &note(i)).unwrap());
        writer.finish().unwrap();
        let summary = mcap::Summary::read(&fs::read(&path).unwrap()).unwrap().unwrap();
        assert!(summary.chunk_indexes.len() > 10);
        // The first one holds the schemas.
        let sizes: Vec<u64> = summary.chunk_indexes.iter().skip(1).map(|c| c.uncompressed_size).collect();
        assert!(sizes.iter().all(|size| *size <= 32 << 10), "{sizes:?}");
    }
}
