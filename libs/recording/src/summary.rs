//! The end of a recording's file: what stands in which chunk, for readers that seek.
//!
//! The layout is that of the MCAP specification (<https://mcap.dev/spec>).

use mcap::MAGIC;
use mcap::records::{Statistics, op};
use std::fs::File;
use std::os::unix::fs::FileExt;

/// Index entries are put into the file in pieces of this size, bytes.
const PIECE_BYTES: usize = 64 << 10;

/// Bytes that pile up over hours: in an unnamed file, or in memory where there is none or where it
/// takes no more.
struct Pile {
    file: Option<File>,
    /// Bytes in the file.
    filed: u64,
    memory: Vec<u8>,
}

impl Pile {
    fn put(&mut self, bytes: &[u8]) {
        self.memory.extend_from_slice(bytes);
        let Some(file) = self.file.as_ref().filter(|_| self.memory.len() >= PIECE_BYTES) else { return };
        // What the file does not take stays in memory, and is tried again with the next piece.
        if file.write_all_at(&self.memory, self.filed).is_ok() {
            self.filed += self.memory.len() as u64;
            self.memory = Vec::with_capacity(PIECE_BYTES);
        }
    }

    /// All of it; nothing where the file cannot be read.
    fn contents(&self) -> Vec<u8> {
        let mut all = vec![0; self.filed as usize];
        let read = self.file.as_ref().is_none_or(|file| file.read_exact_at(&mut all, 0).is_ok());
        if !read {
            return Vec::new();
        }
        all.extend_from_slice(&self.memory);
        all
    }
}

/// Index and statistics of the chunks of several writers.
pub(super) struct Index {
    chunks: Pile,
    metadata: Vec<u8>,
    statistics: Statistics,
}

impl Index {
    /// An empty one; `scratch` takes what needs no memory.
    pub fn new(scratch: Option<File>) -> Self {
        let chunks = Pile { file: scratch, filed: 0, memory: Vec::with_capacity(PIECE_BYTES) };
        Index { chunks, metadata: Vec::new(), statistics: Statistics::default() }
    }

    /// Takes in the end of a file that a writer of the crate made, without the first chunk where
    /// that stands in the file already.
    pub fn take_in(&mut self, tail: &[u8], statistics: Option<&Statistics>, without_first: bool) {
        let of_chunks = of_kind(tail, op::CHUNK_INDEX).skip(usize::from(without_first));
        of_chunks.for_each(|record| self.chunks.put(record));
        self.metadata.extend(of_kind(tail, op::METADATA_INDEX).flatten());
        let (Some(new), sum) = (statistics, &mut self.statistics) else { return };
        (sum.schema_count, sum.channel_count) = (new.schema_count, new.channel_count);
        sum.metadata_count += new.metadata_count;
        sum.chunk_count += new.chunk_count - u32::from(without_first && new.chunk_count > 0);
        if new.message_count > 0 {
            let first = if sum.message_count == 0 { u64::MAX } else { sum.message_start_time };
            sum.message_start_time = first.min(new.message_start_time);
            sum.message_end_time = sum.message_end_time.max(new.message_end_time);
            sum.message_count += new.message_count;
        }
        for (channel, count) in &new.channel_message_counts {
            *sum.channel_message_counts.entry(*channel).or_default() += count;
        }
    }

    /// The end of a file whose chunks end at `position` and have the given CRC-32. Schemas and
    /// channels are those in `last`, the end that the last writer made. Where the unnamed file cannot be
    /// read, the end has no index, and readers look through the file.
    pub fn end_of_file(&self, last: &[u8], position: u64, data_crc: u32) -> Vec<u8> {
        let mut out = Vec::new();
        record(&mut out, op::DATA_END, &data_crc.to_le_bytes());
        let begin = out.len();
        let mut groups = Vec::new();
        for opcode in [op::SCHEMA, op::CHANNEL, op::STATISTICS, op::CHUNK_INDEX, op::METADATA_INDEX] {
            let start = out.len();
            match opcode {
                op::STATISTICS => record(&mut out, opcode, &body_of(&self.statistics)),
                op::CHUNK_INDEX => out.extend(self.chunks.contents()),
                op::METADATA_INDEX => out.extend_from_slice(&self.metadata),
                _ => of_kind(last, opcode).for_each(|record| out.extend_from_slice(record)),
            }
            if out.len() > start {
                groups.push((opcode, position + start as u64, (out.len() - start) as u64));
            }
        }
        let offsets = position + out.len() as u64;
        for (opcode, start, length) in groups {
            let body = [&[opcode][..], &start.to_le_bytes(), &length.to_le_bytes()].concat();
            record(&mut out, op::SUMMARY_OFFSET, &body);
        }
        let places = [(position + begin as u64).to_le_bytes(), offsets.to_le_bytes()].concat();
        out.push(op::FOOTER);
        out.extend_from_slice(&20u64.to_le_bytes());
        out.extend_from_slice(&places);
        // The checksum covers the footer up to itself.
        let crc = crc32fast::hash(&out[begin..]);
        out.extend_from_slice(&crc.to_le_bytes());
        out.extend_from_slice(MAGIC);
        out
    }
}

fn record(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend_from_slice(&(body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}

fn body_of(s: &Statistics) -> Vec<u8> {
    let mut body = s.message_count.to_le_bytes().to_vec();
    body.extend_from_slice(&s.schema_count.to_le_bytes());
    for count in [s.channel_count, s.attachment_count, s.metadata_count, s.chunk_count] {
        body.extend_from_slice(&count.to_le_bytes());
    }
    body.extend_from_slice(&s.message_start_time.to_le_bytes());
    body.extend_from_slice(&s.message_end_time.to_le_bytes());
    body.extend_from_slice(&(10 * s.channel_message_counts.len() as u32).to_le_bytes());
    for (channel, count) in &s.channel_message_counts {
        body.extend_from_slice(&channel.to_le_bytes());
        body.extend_from_slice(&count.to_le_bytes());
    }
    body
}

/// The whole records of a kind in bytes that the crate wrote.
fn of_kind(mut bytes: &[u8], opcode: u8) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        loop {
            let (&found, rest) = bytes.split_first()?;
            let length = u64::from_le_bytes(*rest.first_chunk()?) as usize;
            let (record, next) = bytes.split_at_checked(9 + length)?;
            bytes = next;
            if found == opcode {
                return Some(record);
            }
        }
    })
}
