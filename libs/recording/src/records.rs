//! The outer records of a recording's file, framed and held to their limits, and those in a chunk.

use super::RecordingError;
use super::packing::Packing;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapResult, parse_record};
use std::fs::File;
use std::io::{BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// Largest chunk, packed or not, bytes: a checkpoint and a few messages fit many times.
pub(super) const MAX_CHUNK_BYTES: u64 = 64 << 20;
/// Largest record that a recording of ours can hold, bytes; a larger one is damage.
const MAX_RECORD_BYTES: u64 = MAX_CHUNK_BYTES + 1024;
/// Opcode and length before each record, bytes.
pub(super) const FRAME_BYTES: u64 = 9;
/// The footer record with its frame and the magic after it, bytes.
const TAIL_BYTES: u64 = FRAME_BYTES + 20 + MAGIC.len() as u64;

/// An outer record.
#[derive(Debug)]
pub(super) struct Outer {
    pub offset: u64,
    pub opcode: u8,
    pub body: Vec<u8>,
}

/// The file's outer records.
#[derive(Debug)]
pub(super) struct Records {
    pub file: String,
    reader: BufReader<File>,
    pub length: u64,
    pub offset: u64,
    /// CRC-32 of the records read so far, up to the end of the data; of the file's bytes, as long as
    /// nothing was skipped.
    pub crc: crc32fast::Hasher,
}

impl Records {
    /// Opens a file behind its magic.
    ///
    /// # Errors
    /// Where the file cannot be read, or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = path.display().to_string();
        let io = |problem| RecordingError::Io { file: file.clone(), problem };
        let handle = protocol::file::open(path).map_err(io)?.into_inner();
        let length = handle.metadata().map_err(io)?.len();
        let mut reader = BufReader::with_capacity(256 << 10, handle);
        let mut magic = [0; MAGIC.len()];
        match reader.read_exact(&mut magic) {
            Err(e) if e.kind() != ErrorKind::UnexpectedEof => return Err(io(e)),
            Ok(()) if magic == MAGIC => {}
            _ => {
                let problem = "it is not an MCAP file".into();
                return Err(RecordingError::Foreign { file, problem });
            }
        }
        let mut crc = crc32fast::Hasher::new();
        crc.update(MAGIC);
        Ok(Records { file, reader, length, offset: MAGIC.len() as u64, crc })
    }

    pub fn damaged(&self, offset: u64, problem: impl ToString) -> RecordingError {
        RecordingError::Damaged { file: self.file.clone(), offset, problem: problem.to_string() }
    }

    fn io(&self, problem: std::io::Error) -> RecordingError {
        RecordingError::Io { file: self.file.clone(), problem }
    }

    /// Fills `bytes` and goes on behind them.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn read(&mut self, bytes: &mut [u8]) -> Result<(), RecordingError> {
        self.reader.read_exact(bytes).map_err(|e| self.io(e))?;
        self.offset += bytes.len() as u64;
        Ok(())
    }

    /// Goes on at `offset`.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn seek(&mut self, offset: u64) -> Result<(), RecordingError> {
        self.reader.seek(SeekFrom::Start(offset)).map_err(|e| self.io(e))?;
        self.offset = offset;
        Ok(())
    }

    /// The next record; `None` at the end of the file.
    ///
    /// # Errors
    /// A cut or damaged record, after which the place of reading is anywhere, or those of the
    /// operating system.
    pub fn next_record(&mut self) -> Result<Option<Outer>, RecordingError> {
        let offset = self.offset;
        let left = self.length.saturating_sub(offset);
        if left == 0 {
            return Ok(None);
        }
        let cut = || RecordingError::Truncated { file: self.file.clone(), offset };
        if left < FRAME_BYTES {
            return Err(cut());
        }
        let mut frame = [0; FRAME_BYTES as usize];
        self.read(&mut frame)?;
        let [opcode, size @ ..] = frame;
        let size = u64::from_le_bytes(size);
        if frame == [0; FRAME_BYTES as usize] && self.only_zeros_follow()? {
            // A power failure can leave the length of a file without its last bytes.
            return Err(RecordingError::Truncated { file: self.file.clone(), offset });
        }
        if opcode == 0 || size > MAX_RECORD_BYTES {
            return Err(self.damaged(offset, format!("no record begins with {frame:02x?}")));
        }
        if size > left - FRAME_BYTES {
            return Err(RecordingError::Truncated { file: self.file.clone(), offset });
        }
        let mut body = vec![0; size as usize];
        self.read(&mut body)?;
        if opcode != op::DATA_END {
            self.crc.update(&frame);
            self.crc.update(&body);
        }
        Ok(Some(Outer { offset, opcode, body }))
    }

    fn only_zeros_follow(&mut self) -> Result<bool, RecordingError> {
        let mut block = [0; 4096];
        loop {
            let read = self.reader.read(&mut block).map_err(|e| self.io(e))?;
            if block[..read].iter().any(|byte| *byte != 0) {
                return Ok(false);
            }
            if read == 0 {
                return Ok(true);
            }
        }
    }

    /// True if the file ends with footer and magic. Keeps the place of reading.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn has_footer(&mut self) -> Result<bool, RecordingError> {
        if self.length < MAGIC.len() as u64 + TAIL_BYTES {
            return Ok(false);
        }
        let (offset, mut tail) = (self.offset, [0; TAIL_BYTES as usize]);
        self.seek(self.length - TAIL_BYTES)?;
        self.read(&mut tail)?;
        self.seek(offset)?;
        Ok(tail[0] == op::FOOTER && tail[1..9] == 20u64.to_le_bytes() && tail.ends_with(MAGIC))
    }
}

/// A chunk's body as its header describes it: how long it must be, bytes; `None` where the header
/// makes no sense.
pub(super) fn chunk_bytes(body: &[u8]) -> Option<u64> {
    /// Bytes of the header without the name of the compression.
    const FIXED: u64 = 40;
    let number = |at: usize| Some(u64::from_le_bytes(body.get(at..at + 8)?.try_into().ok()?));
    let name_bytes = u32::from_le_bytes(body.get(28..32)?.try_into().ok()?) as usize;
    let name = body.get(32..32 + name_bytes.min(body.len()))?;
    let (unpacked, packed) = (number(16)?, number(32 + name_bytes)?);
    let known = match Packing::of_chunk(name)? {
        Packing::None => packed == unpacked,
        Packing::Zstd | Packing::Lz4 => true,
    };
    let bounded = unpacked <= MAX_CHUNK_BYTES && packed <= MAX_CHUNK_BYTES;
    (known && bounded).then(|| FIXED + name_bytes as u64 + packed)
}

/// The records in a chunk, once its lengths and its CRC have been found right.
pub(super) fn chunk_records(chunk: &[u8]) -> Result<Vec<Record<'static>>, String> {
    if chunk_bytes(chunk) != Some(chunk.len() as u64) {
        return Err("the chunk's header does not agree with its length".into());
    }
    unpack(chunk).map_err(|e| match e {
        mcap::McapError::Io(problem) => format!("a chunk cannot be unpacked: {problem}"),
        other => other.to_string(),
    })
}

fn unpack(chunk: &[u8]) -> McapResult<Vec<Record<'static>>> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(MAX_CHUNK_BYTES as usize);
    let mut reader = LinearReader::new_with_options(options);
    let size = (chunk.len() as u64).to_le_bytes();
    let mut input = Cursor::new([op::CHUNK]).chain(Cursor::new(size)).chain(chunk);
    let mut records = Vec::new();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let room = reader.insert(wanted.min(chunk.len() + FRAME_BYTES as usize));
                let read = input.read(room)?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode: opcode @ (op::CHANNEL | op::MESSAGE), data } => {
                records.push(parse_record(opcode, data)?.into_owned());
            }
            LinearReadEvent::Record { .. } => {}
        }
    }
    Ok(records)
}
