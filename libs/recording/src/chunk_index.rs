//! Where the chunks of a recording stand and what is in each, so that a reader can begin anywhere.
//!
//! A recording that was closed has this at its end, in the summary, which is read alone. One that was not,
//! or whose summary does not match its checksum, is read through once.

use super::data_section::DataSection;
use super::file_items::Topics;
use super::heads::{self, CheckpointHead};
use super::items::{Items, Place};
use super::parts::RecordedFile;
use super::read::Recording;
use super::records::{FRAME_BYTES, Records};
use super::{Item, RecordingError, channel_numbers};
use mcap::MAGIC;
use mcap::parse_record;
use mcap::records::{Record, op};
use protocol::time::Nanos;
use std::path::Path;
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
    /// Topics by channel, of each file up to the one that is looked at.
    topics: Vec<Arc<Topics>>,
    from_summary: bool,
    /// What log times in the file are ahead of the instants by which items are filed, ns.
    realtime_offset_ns: u64,
}

/// One chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    /// Which of the recording's files.
    file: usize,
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
        let Chunk { file, offset, .. } = *self.chunks.get(chunk)?;
        Some(Place::at(file, offset, Arc::clone(&self.topics[file])))
    }

    fn push(&mut self, offset: u64, newest_ns: Nanos, topics: u16) {
        let before = self.chunks.last().map_or(0, |chunk| chunk.newest_ns);
        // A chunk without messages is of no time.
        let newest_ns = newest_ns.saturating_sub(self.realtime_offset_ns);
        let file = self.topics.len().saturating_sub(1);
        self.chunks.push(Chunk { file, offset, newest_ns: newest_ns.max(before), topics });
    }

    fn bit(&self, channel: u16) -> u16 {
        let topic = self.topics.last().and_then(|topics| topics.get(&channel));
        topic.and_then(|topic| Item::TOPICS.iter().position(|t| t == topic)).map_or(0, |i| 1 << i)
    }

    /// Forgets what was found in the present file.
    fn begin_file_again(&mut self) {
        let file = self.topics.len().saturating_sub(1);
        self.chunks.retain(|chunk| chunk.file < file);
        self.topics.iter_mut().skip(file).for_each(|topics| *topics = Arc::default());
    }

    fn note_channel(&mut self, channel: &mcap::records::Channel) {
        if let Some(topic) = Item::TOPICS.iter().find(|topic| **topic == channel.topic) {
            let topics = self.topics.last_mut().expect("a file is looked at");
            Arc::make_mut(topics).insert(channel.id, *topic);
        }
    }
}

impl Recording {
    /// Where its chunks stand.
    ///
    /// # Errors
    /// Those of the operating system. Damage is left out here, and is an error when that place is read.
    pub fn chunk_index(&self) -> Result<ChunkIndex, RecordingError> {
        let mut index = self.empty_index();
        for file in self.files.iter() {
            index.topics.push(Arc::default());
            if file.is_lost() {
                continue;
            }
            let summary = summary_of(&file.path)?;
            if summary.and_then(|summary| read_summary(&summary, &mut index)).is_none() {
                index.begin_file_again();
                scan(file, &mut index)?;
            }
        }
        Ok(index)
    }

    /// The index of no file.
    fn empty_index(&self) -> ChunkIndex {
        let realtime_offset_ns = self.provenance.realtime_offset_ns();
        ChunkIndex { chunks: Vec::new(), topics: Vec::new(), from_summary: true, realtime_offset_ns }
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
        let (mut all, mut opened) = (Vec::new(), None);
        for chunk in index.holding(CHECKPOINTS) {
            let Chunk { file: number, offset, .. } = index.chunks[chunk];
            let of = &self.files[number];
            let io = |problem| RecordingError::Io { file: of.path.display().to_string(), problem };
            let file = match opened.take() {
                Some((before, file)) if before == number => file,
                _ => protocol::file::open(&of.path).map_err(io)?.into_inner(),
            };
            let length = file.metadata().map_err(io)?.len();
            let topics = &index.topics[number];
            let wanted = |channel: u16, sequence: u32| {
                topics.get(&channel) == Some(&CHECKPOINTS) && of.kept.holds(CHECKPOINTS, sequence)
            };
            let heads = heads::of_chunk(&file, length, offset, wanted).map_err(io)?;
            all.extend(heads.into_iter().map(|head| {
                let log_time_ns = head.log_time_ns.wrapping_sub(index.realtime_offset_ns);
                (chunk, CheckpointHead { log_time_ns, ..head })
            }));
            opened = Some((number, file));
        }
        Ok(all)
    }

    /// True if every file of it was closed in order and matches the checksums at its end: then nothing of it is
    /// damaged or missing.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn matches_checksum(&self) -> Result<bool, RecordingError> {
        for file in self.files.iter() {
            if file.is_lost() || !matches_checksum(&file.path)? {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// True if a file was closed in order and matches the checksums at its end.
fn matches_checksum(path: &Path) -> Result<bool, RecordingError> {
    let Some(summary) = summary_of(path)? else { return Ok(false) };
    let mut records = Records::open(path)?;
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

/// True if the summary of a file lists a metadata record of this name.
///
/// # Errors
/// Those of the operating system.
pub(super) fn holds_metadata(path: &Path, name: &str) -> Result<bool, RecordingError> {
    let Some(summary) = summary_of(path)? else { return Ok(false) };
    let is_it = |(opcode, body): (u8, &[u8])| match parse_record(opcode, body) {
        Ok(Record::MetadataIndex(index)) => index.name == name,
        _ => false,
    };
    Ok(records_of(&summary).filter(|(opcode, _)| *opcode == op::METADATA_INDEX).any(is_it))
}

/// The end of a file from the summary's first record on; `None` where there is none, or it does not match its
/// checksum.
fn summary_of(path: &Path) -> Result<Option<Vec<u8>>, RecordingError> {
    let mut records = Records::open(path)?;
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

/// Reads a whole file for its chunks.
fn scan(file: &RecordedFile, index: &mut ChunkIndex) -> Result<(), RecordingError> {
    let mut section = Records::open(&file.path).and_then(DataSection::new)?;
    index.from_summary = false;
    if let Some(topics) = index.topics.last_mut() {
        *topics = Arc::new(channel_numbers().zip(Item::TOPICS).collect());
    }
    let mut offset = section.records.offset;
    loop {
        let found = match section.next_chunk() {
            Ok(Some(found)) => found,
            Ok(None) => return Ok(()),
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
        let file = index.topics.len().saturating_sub(1);
        if index.chunks.last().is_some_and(|before| before.file == file && before.offset >= offset) {
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
mod tests;
