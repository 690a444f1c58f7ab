//! Headers of checkpoints, read without unpacking what they hold: a chunk is unpacked up to them only.

use super::packing::Packing;
use super::protobuf::{self, Fields};
use super::records::{FRAME_BYTES, chunk_bytes};
use bytemuck::Zeroable;
use mcap::records::op;
use protocol::steps::CheckpointHeader;
use protocol::time::Nanos;
use protocol::wire::layout_of;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::fs::FileExt;

/// Bytes of a message that are looked at: more than the fields of a header take.
const HEAD_BYTES: u64 = 128;
/// Channel, sequence, log time and publish time before a message, bytes.
const MESSAGE_HEADER_BYTES: usize = 22;
/// Bytes of a chunk's header without the name of its compression.
const CHUNK_HEADER_BYTES: usize = 40;
/// Records that are passed over before a chunk: the indexes of the one before it, one a channel.
const INDEXES: usize = 64;
/// Packed bytes that are read at a time.
const BUFFER: usize = 16 << 10;

/// Header of a simulation's checkpoint in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CheckpointHead {
    /// Log time, ns.
    pub log_time_ns: Nanos,
    /// The header, whose `bytes` is 0: the state was not read.
    pub header: CheckpointHeader,
}

/// A stretch of a file.
struct Stretch<'a> {
    file: &'a File,
    from: u64,
    to: u64,
}

impl Read for Stretch<'_> {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        let most = room.len().min(usize::try_from(self.to - self.from).unwrap_or(usize::MAX));
        let read = self.file.read_at(&mut room[..most], self.from)?;
        self.from += read as u64;
        Ok(read)
    }
}

/// Those in the chunk at `offset` of a file of `length` bytes, as far as it can be read, of the messages that
/// are `wanted` by their channel and number.
pub(super) fn of_chunk(
    file: &File,
    length: u64,
    offset: u64,
    wanted: impl Fn(u16, u32) -> bool,
) -> io::Result<Vec<CheckpointHead>> {
    let mut found = Vec::new();
    let Some(chunk) = chunk_at(file, length, offset)? else { return Ok(found) };
    let Packed { from, to, plain_bytes, packing } = chunk;
    let packed = BufReader::with_capacity(BUFFER, Stretch { file, from, to });
    let mut take = |plain: &mut dyn BufRead| take(plain, plain_bytes, &wanted, &mut found);
    // What cannot be unpacked is damaged, and found to be so by whoever reads it all.
    let _ = match packing {
        Packing::Zstd => zstd::stream::read::Decoder::with_buffer(packed)
            .and_then(|plain| take(&mut BufReader::new(plain))),
        Packing::Lz4 => lz4::Decoder::new(packed).and_then(|plain| take(&mut BufReader::new(plain))),
        Packing::None => take(&mut { packed }),
    };
    Ok(found)
}

/// The records of a chunk as they stand in the file.
struct Packed {
    from: u64,
    to: u64,
    /// Bytes once unpacked.
    plain_bytes: u64,
    packing: Packing,
}

/// Finds the records of the chunk at `offset` or behind the indexes there.
fn chunk_at(file: &File, length: u64, mut offset: u64) -> io::Result<Option<Packed>> {
    for _ in 0..INDEXES {
        let mut room = [0; FRAME_BYTES as usize + CHUNK_HEADER_BYTES + 4];
        let left = length.saturating_sub(offset);
        let there = &mut room[..left.min(FRAME_BYTES + CHUNK_HEADER_BYTES as u64 + 4) as usize];
        file.read_exact_at(there, offset)?;
        let Some((frame, body)) = there.split_at_checked(FRAME_BYTES as usize) else { return Ok(None) };
        let size = u64::from_le_bytes(frame[1..].try_into().expect("eight bytes"));
        let end = offset.checked_add(FRAME_BYTES).and_then(|at| at.checked_add(size));
        let Some(to) = end.filter(|end| *end < length && frame[0] != op::DATA_END) else { return Ok(None) };
        if frame[0] != op::CHUNK {
            offset = to;
            continue;
        }
        if chunk_bytes(body) != Some(size) {
            return Ok(None);
        }
        let name_bytes = u32::from_le_bytes(body[28..32].try_into().expect("four bytes")) as usize;
        let plain_bytes = u64::from_le_bytes(body[16..24].try_into().expect("eight bytes"));
        let Some(packing) = Packing::of_chunk(&body[32..32 + name_bytes]) else { return Ok(None) };
        let from = offset + FRAME_BYTES + (CHUNK_HEADER_BYTES + name_bytes) as u64;
        return Ok(Some(Packed { from, to, plain_bytes, packing }));
    }
    Ok(None)
}

/// Takes the headers from the records of a chunk.
fn take(
    mut plain: &mut dyn BufRead,
    plain_bytes: u64,
    wanted: &dyn Fn(u16, u32) -> bool,
    found: &mut Vec<CheckpointHead>,
) -> io::Result<()> {
    let (mut frame, mut end) = ([0; FRAME_BYTES as usize], 0u64);
    // The last message is not read to its end.
    while end < plain_bytes && plain.read_exact(&mut frame).is_ok() {
        let [opcode, size @ ..] = frame;
        let size = u64::from_le_bytes(size);
        end = end.saturating_add(FRAME_BYTES).saturating_add(size);
        let mut head = Vec::new();
        if opcode == op::MESSAGE {
            Read::take(&mut plain, size.min(HEAD_BYTES)).read_to_end(&mut head)?;
            found.extend(head_of(&head, wanted));
        }
        let mut rest = size - head.len() as u64;
        while rest > 0 && end < plain_bytes {
            let there = plain.fill_buf()?.len().min(usize::try_from(rest).unwrap_or(usize::MAX));
            if there == 0 {
                return Ok(());
            }
            plain.consume(there);
            rest -= there as u64;
        }
    }
    Ok(())
}

fn head_of(message: &[u8], wanted: &dyn Fn(u16, u32) -> bool) -> Option<CheckpointHead> {
    let (about, data) = message.split_at_checked(MESSAGE_HEADER_BYTES)?;
    let (channel, sequence) = (u16::from_le_bytes([about[0], about[1]]), about[2..6].try_into().ok()?);
    if !wanted(channel, u32::from_le_bytes(sequence)) {
        return None;
    }
    let log_time_ns = u64::from_le_bytes(about[6..14].try_into().ok()?);
    // The state, which comes last, is cut off.
    let mut fields = Fields(data);
    let mut whole = 0;
    while let Some(Ok((_, value))) = fields.next() {
        if matches!(value, protobuf::Value::Delimited(_)) {
            break;
        }
        whole = data.len() - fields.0.len();
    }
    let mut header = CheckpointHeader::zeroed();
    let (layout, block) = (layout_of::<CheckpointHeader>(), bytemuck::bytes_of_mut(&mut header));
    protobuf::decode(layout, &data[..whole], block, &mut Vec::new()).ok()?;
    Some(CheckpointHead { log_time_ns, header })
}
