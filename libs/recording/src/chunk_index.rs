//! Where the chunks of a recording stand and what is in each, so that a reader can begin anywhere.
//!
//! A recording that was closed has this at its end, in the summary, which is read alone. One that was not,
//! or whose summary does not match its checksum, is read through once.

use super::data_section::DataSection;
use super::heads::{self, CheckpointHead};
use super::items::{Items, Place};
use super::read::Recording;
use super::records::{FRAME_BYTES, Records};
use super::{Item, RecordingError, channel_numbers};
use mcap::MAGIC;
use mcap::parse_record;
use mcap::records::{Record, op};
use protocol::time::Nanos;
use std::collections::HashMap;
use std::sync::Arc;

/// Footer and magic at the end of a file, bytes.
const TAIL_BYTES: u64 = FRAME_BYTES + 20 + MAGIC.len() as u64;

/// Topic of the simulation's checkpoints.
const CHECKPOINTS: &str = "checkpoints";
/// The record of the data's end, bytes.
const DATA_END_BYTES: u64 = FRAME_BYTES + 4;
/// Bytes that are read at a time to compute a checksum.
const PIECE_BYTES: usize = 1 << 20;

/// The chunks of a recording, in the order of the file.
#[derive(Debug, Clone)]
pub struct ChunkIndex {
    chunks: Vec<Chunk>,
    /// Topics by channel.
    topics: Arc<HashMap<u16, &'static str>>,
    from_summary: bool,
}

/// One chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    /// Where reading it begins, bytes from the start of the file.
    pub offset: u64,
    /// Newest log time in it and in all chunks before it, ns.
    pub newest_ns: Nanos,
    /// Topics with messages in it, a bit each in the order of [`Item::TOPICS`].
    topics: u16,
}

impl Chunk {
    /// True if it holds messages of a topic.
    pub fn holds(&self, topic: &str) -> bool {
        Item::TOPICS.iter().position(|t| *t == topic).is_some_and(|i| self.topics & 1 << i != 0)
    }
}

impl ChunkIndex {
    /// The chunks.
    pub fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// True if the summary said it all; false where the file had to be read through.
    pub fn is_from_summary(&self) -> bool {
        self.from_summary
    }

    /// The first chunk from which on every message with this log time or a later one stands; the number of
    /// chunks where there is none.
    pub fn first_with(&self, at_ns: Nanos) -> usize {
        self.chunks.partition_point(|chunk| chunk.newest_ns < at_ns)
    }

    /// Numbers of the chunks with messages of a topic.
    pub fn holding(&self, topic: &'static str) -> impl DoubleEndedIterator<Item = usize> {
        (0..self.chunks.len()).filter(move |i| self.chunks[*i].holds(topic))
    }

    /// The place at the beginning of a chunk, to read all topics from there.
    pub fn place(&self, chunk: usize) -> Option<Place> {
        Some(Place::at(self.chunks.get(chunk)?.offset, Arc::clone(&self.topics)))
    }

    fn push(&mut self, offset: u64, newest_ns: Nanos, topics: u16) {
        let before = self.chunks.last().map_or(0, |chunk| chunk.newest_ns);
        self.chunks.push(Chunk { offset, newest_ns: newest_ns.max(before), topics });
    }

    fn bit(&self, channel: u16) -> u16 {
        let topic = self.topics.get(&channel);
        topic.and_then(|topic| Item::TOPICS.iter().position(|t| t == topic)).map_or(0, |i| 1 << i)
    }

    fn note_channel(&mut self, channel: &mcap::records::Channel) {
        if let Some(topic) = Item::TOPICS.iter().find(|topic| **topic == channel.topic) {
            Arc::make_mut(&mut self.topics).insert(channel.id, *topic);
        }
    }
}

impl Recording {
    /// Where its chunks stand.
    ///
    /// # Errors
    /// Those of the operating system. What is damaged is left out, and met again by whoever reads there.
    pub fn chunk_index(&self) -> Result<ChunkIndex, RecordingError> {
        let mut index = ChunkIndex { chunks: Vec::new(), topics: Arc::default(), from_summary: true };
        let summary = self.summary()?;
        match summary.and_then(|summary| read_summary(&summary, &mut index)) {
            Some(()) => Ok(index),
            None => self.scan(),
        }
    }

    /// All items from a place on.
    pub fn items_from(&self, place: &Place) -> Items {
        let mut items = self.items();
        items.go_to(place);
        items
    }

    /// The items of one chunk on these topics, with their log times.
    ///
    /// # Errors
    /// What is wrong with the chunk, or with one of those messages.
    pub fn items_of_chunk(
        &self,
        index: &ChunkIndex,
        chunk: usize,
        topics: &[&'static str],
    ) -> Result<Vec<(Nanos, Item)>, RecordingError> {
        let Some(place) = index.place(chunk) else { return Ok(Vec::new()) };
        let mut items = self.items_of(topics);
        items.go_to(&place.of_topics(topics));
        items.first_chunk()
    }

    /// The headers of the simulation's checkpoints, without what they hold, with the numbers of their chunks;
    /// as far as they can be read.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn checkpoint_heads(
        &self,
        index: &ChunkIndex,
    ) -> Result<Vec<(usize, CheckpointHead)>, RecordingError> {
        let io = |problem| RecordingError::Io { file: self.path().display().to_string(), problem };
        let channels = index.topics.iter().filter(|(_, topic)| **topic == CHECKPOINTS);
        let channels: Vec<u16> = channels.map(|(channel, _)| *channel).collect();
        let file = protocol::file::open(self.path()).map_err(io)?.into_inner();
        let length = file.metadata().map_err(io)?.len();
        let mut all = Vec::new();
        for chunk in index.holding(CHECKPOINTS) {
            let heads = heads::of_chunk(&file, length, index.chunks[chunk].offset, &channels).map_err(io)?;
            all.extend(heads.into_iter().map(|head| (chunk, head)));
        }
        Ok(all)
    }

    /// True if the file was closed in order and matches the checksums at its end: then nothing of it is
    /// damaged or missing.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn matches_checksum(&self) -> Result<bool, RecordingError> {
        let Some(summary) = self.summary()? else { return Ok(false) };
        let mut records = Records::open(self.path())?;
        let end = (records.length - summary.len() as u64).saturating_sub(DATA_END_BYTES);
        let mut piece = vec![0; PIECE_BYTES];
        while records.offset < end {
            let there = &mut piece[..PIECE_BYTES.min((end - records.offset) as usize)];
            records.read(there)?;
            records.crc.update(there);
        }
        let mut frame = [0; DATA_END_BYTES as usize];
        records.read(&mut frame)?;
        let sum = records.crc.finalize().to_le_bytes();
        Ok(frame[0] == op::DATA_END && frame[FRAME_BYTES as usize..] == sum)
    }

    /// The end of the file from the summary's first record on; `None` where there is none, or it does not
    /// match its checksum.
    fn summary(&self) -> Result<Option<Vec<u8>>, RecordingError> {
        let mut records = Records::open(self.path())?;
        if !records.has_footer()? {
            return Ok(None);
        }
        let mut start = [0; 8];
        records.seek(records.length - TAIL_BYTES + FRAME_BYTES)?;
        records.read(&mut start)?;
        let start = u64::from_le_bytes(start);
        if start < MAGIC.len() as u64 || start >= records.length - TAIL_BYTES {
            return Ok(None);
        }
        let mut summary = vec![0; (records.length - start) as usize];
        records.seek(start)?;
        records.read(&mut summary)?;
        let (covered, tail) = summary.split_at(summary.len() - 4 - MAGIC.len());
        let sum = u32::from_le_bytes([tail[0], tail[1], tail[2], tail[3]]);
        Ok((sum == crc32fast::hash(covered)).then_some(summary))
    }

    /// Reads the whole file.
    fn scan(&self) -> Result<ChunkIndex, RecordingError> {
        let mut section = Records::open(self.path()).and_then(DataSection::new)?;
        let all = channel_numbers().zip(Item::TOPICS).collect();
        let mut index = ChunkIndex { chunks: Vec::new(), topics: Arc::new(all), from_summary: false };
        let mut offset = section.records.offset;
        loop {
            let found = match section.next_chunk() {
                Ok(Some(found)) => found,
                Ok(None) => return Ok(index),
                Err(problem @ RecordingError::Io { .. }) => return Err(problem),
                // Whoever reads from there meets the damage too, as if he had come from the beginning.
                Err(_) => continue,
            };
            let (mut newest_ns, mut topics) = (0, 0);
            for record in &found {
                match record {
                    Record::Channel(channel) => index.note_channel(channel),
                    Record::Message { header, .. } => {
                        newest_ns = header.log_time.max(newest_ns);
                        topics |= index.bit(header.channel_id);
                    }
                    _ => {}
                }
            }
            index.push(offset, newest_ns, topics);
            offset = section.records.offset;
        }
    }
}

/// Reads chunks and channels from a summary; `None` where it does not list every chunk once, in the order of
/// the file.
fn read_summary(summary: &[u8], index: &mut ChunkIndex) -> Option<()> {
    let mut listed = None;
    let mut chunks = Vec::new();
    for (opcode, body) in records_of(summary) {
        match opcode {
            op::CHANNEL => match parse_record(opcode, body).ok()? {
                Record::Channel(channel) => index.note_channel(&channel),
                _ => return None,
            },
            op::STATISTICS => match parse_record(opcode, body).ok()? {
                Record::Statistics(statistics) => listed = Some(statistics.chunk_count),
                _ => return None,
            },
            op::CHUNK_INDEX => chunks.push(body),
            op::FOOTER => break,
            _ => {}
        }
    }
    if listed != Some(chunks.len() as u32) {
        return None;
    }
    for body in chunks {
        let number = |at: usize| Some(u64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?));
        // First and last log time, offset, length; then bytes of the map from channels to indexes.
        let (newest_ns, offset) = (number(8)?, number(16)?);
        let map_bytes = u32::from_le_bytes(body.get(32..36)?.try_into().ok()?) as usize;
        let map = body.get(36..)?.get(..map_bytes)?.chunks_exact(10);
        let topics = map.fold(0, |bits, entry| bits | index.bit(u16::from_le_bytes([entry[0], entry[1]])));
        if index.chunks.last().is_some_and(|before| before.offset >= offset) {
            return None;
        }
        index.push(offset, newest_ns, topics);
    }
    Some(())
}

/// Opcode and body of each whole record.
fn records_of(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (opcode, rest) = bytes.split_first()?;
        let (size, rest) = rest.split_first_chunk()?;
        let (body, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*size)).ok()?)?;
        bytes = rest;
        Some((*opcode, body))
    })
}

#[cfg(test)]
mod tests {
    use super::super::samples::any_item;
    use super::super::{Note, NoteKind, Provenance, Writer};
    use super::*;
    use proptest::prelude::*;
    use protocol::steps::CheckpointHeader;
    use std::path::Path;

    fn note(count: u64) -> Item {
        let text = "x".repeat(900);
        Item::Note(Note { instant_ns: 5, kind: NoteKind::Log, process: None, count, text })
    }

    fn checkpoint(step: u64) -> Item {
        let header = CheckpointHeader {
            step,
            field: step + 7,
            handles_below: 1,
            pedals_below: 2,
            state_hash: !step,
            bytes: 0,
        };
        // Larger than a chunk, and hardly to be packed.
        let state: Vec<u8> = (0..60_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        Item::Checkpoint(CheckpointHeader { bytes: state.len() as u64, ..header }, state)
    }

    /// A file with a checkpoint among every 40 notes; item `i` is of 1000 + i ns.
    fn written(path: &Path) -> Vec<Item> {
        let mut writer = Writer::create(path, &Provenance::default()).unwrap();
        let items: Vec<_> = (0..400).map(|i| if i % 40 == 13 { checkpoint(i) } else { note(i) }).collect();
        (1000..).zip(&items).for_each(|(at, item)| writer.write(at, item).unwrap());
        writer.finish().unwrap();
        items
    }

    fn encoded(items: impl Iterator<Item = (Nanos, Item)>) -> Vec<(Nanos, Vec<u8>)> {
        items.map(|(at, item)| (at, item.encoded())).collect()
    }

    /// All that a file's index leads to is what reading it in order gives.
    fn agrees(path: &Path) -> Result<ChunkIndex, TestCaseError> {
        let recording = Recording::open(path).unwrap();
        let index = recording.chunk_index().unwrap();
        let whole = encoded(recording.items().filter_map(Result::ok));
        for i in 0..index.chunks().len() {
            let from = recording.items_from(&index.place(i).unwrap());
            let rest = encoded(from.filter_map(Result::ok));
            prop_assert!(whole.ends_with(&rest), "from chunk {}", i);
            let at = index.chunks()[i].newest_ns;
            let later = whole.iter().position(|(time, _)| *time >= at).unwrap_or(whole.len());
            prop_assert!(whole.len() - rest.len() <= later || i > index.first_with(at));
        }
        prop_assert_eq!(index.first_with(u64::MAX), index.chunks().len());
        Ok(index)
    }

    #[test]
    fn the_summary_says_what_a_scan_finds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let items = written(&path);
        let recording = Recording::open(&path).unwrap();
        let (index, scanned) = (agrees(&path).unwrap(), recording.scan().unwrap());
        assert!(recording.matches_checksum().unwrap());
        assert!(index.is_from_summary() && !scanned.is_from_summary());
        let of = |index: &ChunkIndex| {
            index.chunks().iter().map(|c| (c.newest_ns, c.topics)).filter(|c| c.1 > 0).collect::<Vec<_>>()
        };
        assert_eq!(of(&index), of(&scanned));
        let heads = |index: &ChunkIndex| {
            let heads = recording.checkpoint_heads(index).unwrap();
            heads.into_iter().map(|(_, head)| head).collect::<Vec<_>>()
        };
        let expected: Vec<_> = (1000..)
            .zip(&items)
            .filter_map(|(at, item)| match item {
                Item::Checkpoint(header, _) => Some((at, CheckpointHeader { bytes: 0, ..*header })),
                _ => None,
            })
            .collect();
        let found = heads(&index).into_iter().map(|head| (head.log_time_ns, head.header));
        assert!(found.eq(expected.iter().copied()) && expected.len() == 10);
        assert_eq!(heads(&index), heads(&scanned));
        let chunk = index.holding("checkpoints").nth(3).unwrap();
        let read = recording.items_of_chunk(&index, chunk, &["checkpoints"]).unwrap();
        assert_eq!(encoded(read.into_iter()), [(1133, items[133].encoded())]);
    }

    #[test]
    fn a_file_that_was_not_closed_is_scanned() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        written(&path);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let index = agrees(&path).unwrap();
        assert!(!index.is_from_summary() && index.chunks().len() > 5);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() })]

        #[test]
        fn any_items_are_found_from_any_chunk(items in prop::collection::vec((0u64..50, any_item()), 0..40)) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.mcap");
            let mut writer = Writer::create(&path, &Provenance::default()).unwrap();
            items.iter().for_each(|(at, item)| writer.write(*at, item).unwrap());
            writer.finish().unwrap();
            agrees(&path)?;
        }

        #[test]
        fn damage_never_panics_and_leaves_true_items(
            hits in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..5),
            cut in prop::option::of(any::<prop::sample::Index>()),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.mcap");
            written(&path);
            let mut bytes = std::fs::read(&path).unwrap();
            for (at, xor) in hits {
                let at = at.index(bytes.len());
                bytes[at] ^= xor;
            }
            cut.iter().for_each(|at| bytes.truncate(at.index(bytes.len())));
            std::fs::write(&path, &bytes).unwrap();
            let Ok(recording) = Recording::open(&path) else { return Ok(()) };
            prop_assert!(!recording.matches_checksum().unwrap());
            let index = agrees(&path)?;
            drop(recording.checkpoint_heads(&index));
            for i in 0..index.chunks().len() {
                drop(recording.items_of_chunk(&index, i, &["checkpoints"]));
            }
        }
    }
}
