//! The outer records of a recording's file, and those in a chunk.

use super::RecordingError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapResult, parse_record};
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

/// Largest record that a recording of ours can hold, bytes; a larger one is damage.
const MAX_RECORD_BYTES: u64 = 256 << 20;
/// Largest chunk once unpacked, bytes: a checkpoint and a few messages fit many times.
const MAX_CHUNK_BYTES: usize = 64 << 20;
/// Opcode and length before each record, bytes.
const FRAME_BYTES: u64 = 9;
/// The footer record with its frame and the magic after it, bytes.
const TAIL_BYTES: u64 = FRAME_BYTES + 20 + MAGIC.len() as u64;

/// The file's outer records.
#[derive(Debug)]
pub(super) struct Records {
    pub file: String,
    reader: BufReader<File>,
    pub length: u64,
    pub offset: u64,
}

impl Records {
    /// Opens a file behind its magic.
    ///
    /// # Errors
    /// Where the file cannot be read, or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = path.display().to_string();
        let io = |problem| RecordingError::Io { file: file.clone(), problem };
        let handle = File::open(path).map_err(io)?;
        let length = handle.metadata().map_err(io)?.len();
        let mut reader = BufReader::with_capacity(256 << 10, handle);
        let mut magic = [0; MAGIC.len()];
        match reader.read_exact(&mut magic) {
            Err(e) if e.kind() != ErrorKind::UnexpectedEof => return Err(io(e)),
            Ok(()) if magic == MAGIC => {}
            _ => {
                let problem = "it does not begin as an MCAP file does".into();
                return Err(RecordingError::Foreign { file, problem });
            }
        }
        Ok(Records { file, reader, length, offset: MAGIC.len() as u64 })
    }

    pub fn damaged(&self, offset: u64, problem: impl ToString) -> RecordingError {
        RecordingError::Damaged { file: self.file.clone(), offset, problem: problem.to_string() }
    }

    /// Offset, opcode and body of the next record; `None` at the end of the file.
    ///
    /// # Errors
    /// A cut or damaged record, or those of the operating system.
    pub fn next_record(&mut self) -> Result<Option<(u64, u8, Vec<u8>)>, RecordingError> {
        let offset = self.offset;
        let left = self.length.saturating_sub(offset);
        if left == 0 {
            return Ok(None);
        }
        let cut = || RecordingError::Truncated { file: self.file.clone(), offset };
        let io = |file: &str, problem| RecordingError::Io { file: file.into(), problem };
        if left < FRAME_BYTES {
            return Err(cut());
        }
        let mut frame = [0; FRAME_BYTES as usize];
        self.reader.read_exact(&mut frame).map_err(|e| io(&self.file, e))?;
        let [opcode, size @ ..] = frame;
        let size = u64::from_le_bytes(size);
        if opcode == 0 || size > MAX_RECORD_BYTES {
            return Err(self.damaged(offset, format!("no record begins with {frame:02x?}")));
        }
        if size > left - FRAME_BYTES {
            return Err(cut());
        }
        let mut body = vec![0; size as usize];
        self.reader.read_exact(&mut body).map_err(|e| io(&self.file, e))?;
        self.offset += FRAME_BYTES + size;
        Ok(Some((offset, opcode, body)))
    }

    /// True if the file ends with footer and magic. Keeps the place of reading.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn has_footer(&mut self) -> Result<bool, RecordingError> {
        if self.length < MAGIC.len() as u64 + TAIL_BYTES {
            return Ok(false);
        }
        let mut tail = [0; TAIL_BYTES as usize];
        let (offset, at) = (self.offset, self.length - TAIL_BYTES);
        let looked = self
            .reader
            .seek(SeekFrom::Start(at))
            .and_then(|_| self.reader.read_exact(&mut tail))
            .and_then(|()| self.reader.seek(SeekFrom::Start(offset)));
        looked.map_err(|problem| RecordingError::Io { file: self.file.clone(), problem })?;
        Ok(tail[0] == op::FOOTER && tail[1..9] == 20u64.to_le_bytes() && tail.ends_with(MAGIC))
    }
}

/// The records in a chunk, once its CRC has been found right.
pub(super) fn chunk_records(chunk: &[u8]) -> McapResult<Vec<Record<'static>>> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(MAX_CHUNK_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    let size = (chunk.len() as u64).to_le_bytes();
    let mut input: &[u8] = &[&[op::CHUNK][..], &size, chunk].concat();
    let mut records = Vec::new();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = input.read(reader.insert(wanted.min(input.len())))?;
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
