//! Finding the next good chunk behind damage.
//!
//! A chunk is recognised by its header: a known compression, and a length that agrees with its frame
//! or an opcode that does. Its CRC then says whether it is one, so that a damaged frame costs nothing
//! of a good chunk.

use super::RecordingError;
use super::records::{FRAME_BYTES, Records, chunk_bytes, chunk_records};
use mcap::records::{Record, op};

/// Bytes looked at a time.
const WINDOW: u64 = 1 << 20;
/// Bytes of a frame and the longest header of a chunk.
const LOOK_BYTES: usize = FRAME_BYTES as usize + 44;

/// What was found.
#[derive(Debug)]
pub(super) enum Found {
    /// A chunk, and where it ends.
    Chunk {
        /// Its records.
        records: Vec<Record<'static>>,
        /// Offset behind it.
        end: u64,
    },
    /// The end of the data.
    End {
        /// Offset of its record.
        at: u64,
    },
}

/// The first good chunk or the end of the data at `from` or behind it.
///
/// # Errors
/// Those of the operating system.
pub(super) fn find_next(records: &mut Records, from: u64) -> Result<Option<Found>, RecordingError> {
    let (mut at, length) = (from, records.length);
    let mut window = Vec::new();
    while at < length {
        window.resize(WINDOW.min(length - at) as usize, 0);
        records.seek(at)?;
        records.read(&mut window)?;
        let last = at + window.len() as u64 == length;
        let starts = if last { window.len() } else { window.len() - LOOK_BYTES };
        for (start, offset) in (0..starts).zip(at..) {
            let seen = &window[start..];
            if is_data_end(seen) {
                return Ok(Some(Found::End { at: offset }));
            }
            if let Some(bytes) = chunk_at(seen).filter(|bytes| *bytes <= length - offset - FRAME_BYTES) {
                records.seek(offset + FRAME_BYTES)?;
                let mut body = vec![0; bytes as usize];
                records.read(&mut body)?;
                if let Ok(found) = chunk_records(&body) {
                    return Ok(Some(Found::Chunk { records: found, end: offset + FRAME_BYTES + bytes }));
                }
            }
        }
        at += starts as u64;
    }
    Ok(None)
}

/// Bytes of the chunk's body, if a chunk may begin here.
fn chunk_at(seen: &[u8]) -> Option<u64> {
    let (frame, body) = seen.split_at_checked(FRAME_BYTES as usize)?;
    let bytes = chunk_bytes(body)?;
    (frame[0] == op::CHUNK || frame[1..] == bytes.to_le_bytes()).then_some(bytes)
}

/// True where the record of the data's end stands before one of the summary or the footer.
fn is_data_end(seen: &[u8]) -> bool {
    const FRAME: [u8; FRAME_BYTES as usize] = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
    let follows = [op::SCHEMA, op::CHANNEL, op::CHUNK_INDEX, op::STATISTICS, op::FOOTER, op::METADATA_INDEX];
    seen.starts_with(&FRAME) && seen.get(FRAME.len() + 4).is_some_and(|next| follows.contains(next))
}
