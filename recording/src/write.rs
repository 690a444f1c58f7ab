//! Writing a recording.

use super::{
    FORMAT, Item, PROFILE, Provenance, RecordingError, descriptors, message_name, record, viewer_messages,
};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapResult, WriteOptions};
use protocol::time::Nanos;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// A chunk is closed before a message once it has passed this, so that with the message it stays
/// below 32 KiB (checkpoints and pictures can be larger), bytes.
const CHUNK_BYTES: u64 = 24 << 10;
/// A chunk is closed at this age: half of what may be lost at a crash, ns.
const CHUNK_AGE_NS: u64 = 100_000_000;
/// Name of the metadata record with the provenance.
pub(super) const METADATA: &str = "vitreo";

/// A recording being written.
///
/// Dropping it finishes the file as well; [`Writer::finish`] reports whether that worked.
pub struct Writer {
    file: String,
    mcap: mcap::Writer<BufWriter<File>>,
    channels: [u16; Item::TOPICS.len()],
    /// Channels of the messages for viewers; none in a temporary file.
    viewers: Option<[u16; viewer_messages::TOPICS.len()]>,
    sequences: BTreeMap<u16, u32>,
    buffer: Vec<u8>,
    /// When [`Writer::flush_aged`] first saw the open chunk.
    open_since: Option<Nanos>,
    open: bool,
}

impl Writer {
    /// Writes the provenance at the start of an empty file; `path` is its name in errors.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn on(target: File, path: &Path, provenance: &Provenance) -> Result<Self, RecordingError> {
        Self::begin(target, path, provenance, true)
    }

    /// The same for a file that is read once and removed: not compressed, without the messages for
    /// viewers.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn temporary(target: File, path: &Path, provenance: &Provenance) -> Result<Self, RecordingError> {
        Self::begin(target, path, provenance, false)
    }

    /// As [`Writer::on`], of a new file in the place of one of that name.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn create(path: &Path, provenance: &Provenance) -> Result<Self, RecordingError> {
        let io = |problem| RecordingError::Io { file: path.display().to_string(), problem };
        Self::on(File::create(path).map_err(io)?, path, provenance)
    }

    fn begin(
        target: File,
        path: &Path,
        provenance: &Provenance,
        lasting: bool,
    ) -> Result<Self, RecordingError> {
        let file = path.display().to_string();
        let target = BufWriter::with_capacity(64 << 10, target);
        let fail = |e: mcap::McapError| RecordingError::Write { file: file.clone(), problem: e.to_string() };
        // Without seeking, a chunk reaches the file in one piece with its length and CRC known.
        let options = WriteOptions::new()
            .profile(PROFILE)
            .library(format!("vitreo {}", env!("CARGO_PKG_VERSION")))
            .compression(lasting.then_some(Compression::Zstd))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let mut mcap = options.create(target).map_err(fail)?;
        mcap.write_metadata(&Metadata { name: METADATA.into(), metadata: pairs(provenance) })
            .map_err(fail)?;
        let (channels, viewers) = add_channels(&mut mcap).map_err(fail)?;
        mcap.flush().map_err(fail)?;
        let (sequences, buffer) = (BTreeMap::new(), Vec::new());
        let viewers = lasting.then_some(viewers);
        Ok(Writer { file, mcap, channels, viewers, sequences, buffer, open_since: None, open: false })
    }

    /// Appends an item, and its message for viewers where it has one. `log_time_ns` is the instant
    /// by which viewers sort; items keep the order of the calls.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&mut self, log_time_ns: Nanos, item: &Item) -> Result<(), RecordingError> {
        self.buffer.clear();
        record::encode(item, &mut self.buffer);
        self.append(self.channels[item.topic_index()], log_time_ns)?;
        let Some(viewers) = self.viewers else { return Ok(()) };
        self.buffer.clear();
        if let Some(viewer) = viewer_messages::encode(item, &mut self.buffer) {
            self.append(viewers[viewer], log_time_ns)?;
        }
        Ok(())
    }

    fn append(&mut self, channel_id: u16, log_time: Nanos) -> Result<(), RecordingError> {
        let sequence = self.sequences.entry(channel_id).or_insert(0);
        let header = MessageHeader { channel_id, sequence: *sequence, log_time, publish_time: log_time };
        *sequence = sequence.wrapping_add(1);
        self.open = true;
        let written = self.mcap.write_to_known_channel(&header, &self.buffer);
        written.map_err(|e| self.failure(e))
    }

    /// Closes and flushes the open chunk once it is 100 ms old. To be called at least every 50 ms
    /// with the present instant, so that a crash loses at most 200 ms.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn flush_aged(&mut self, now_ns: Nanos) -> Result<(), RecordingError> {
        if !self.open {
            return Ok(());
        }
        let since = *self.open_since.get_or_insert(now_ns);
        if now_ns.saturating_sub(since) >= CHUNK_AGE_NS {
            self.mcap.flush().map_err(|e| self.failure(e))?;
            (self.open, self.open_since) = (false, None);
        }
        Ok(())
    }

    /// Closes the last chunk and writes summary and footer.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let finished = self.mcap.finish();
        finished.map(|_| ()).map_err(|e| self.failure(e))
    }

    fn failure(&self, problem: mcap::McapError) -> RecordingError {
        RecordingError::Write { file: self.file.clone(), problem: problem.to_string() }
    }
}

type Channels = ([u16; Item::TOPICS.len()], [u16; viewer_messages::TOPICS.len()]);

fn add_channels(mcap: &mut mcap::Writer<BufWriter<File>>) -> McapResult<Channels> {
    let none = BTreeMap::new();
    let descriptors = descriptors::file_descriptor_set();
    let (mut channels, mut viewers) = ([0; Item::TOPICS.len()], [0; viewer_messages::TOPICS.len()]);
    for (i, topic) in Item::TOPICS.into_iter().enumerate() {
        let schema = mcap.add_schema(&message_name(i), "protobuf", &descriptors)?;
        channels[i] = mcap.add_channel(schema, topic, "protobuf", &none)?;
    }
    for (i, schema) in viewer_messages::schemas().into_iter().enumerate() {
        let schema = match schema {
            Some(s) => mcap.add_schema(&s.name, &s.encoding, &s.data)?,
            None => 0,
        };
        viewers[i] = mcap.add_channel(schema, viewer_messages::TOPICS[i], "protobuf", &none)?;
    }
    Ok((channels, viewers))
}

/// The provenance as key and value pairs; each group has a prefix.
fn pairs(provenance: &Provenance) -> BTreeMap<String, String> {
    let Provenance { rig_json, scene_name, scene_toml, source, seeds, config, versions } = provenance;
    let mut all: BTreeMap<String, String> = [
        ("format", FORMAT),
        ("rig_json", rig_json),
        ("scene_name", scene_name),
        ("scene_toml", scene_toml),
        ("source", source.name()),
        ("clock", "CLOCK_MONOTONIC, ns"),
    ]
    .into_iter()
    .map(|(key, value)| (key.to_string(), value.to_string()))
    .collect();
    for (group, map) in [("seed.", seeds), ("config.", config), ("version.", versions)] {
        all.extend(map.iter().map(|(key, value)| (format!("{group}{key}"), value.clone())));
    }
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
