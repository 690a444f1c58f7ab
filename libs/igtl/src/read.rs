//! Messages from a stream of bytes, in whatever pieces it comes.

use crate::message::{Content, Message};
use crate::{
    EXTENDED_BYTES, HEADER_BYTES, STATUS, STATUS_BYTES, STATUS_NAME_BYTES, TRANSFORM, TRANSFORM_BYTES,
    checksum,
};

/// Longest body of a transform or status that is taken, bytes; its metadata and text are part of it.
const LONGEST_TAKEN: u64 = 65_536;
/// Longest body of another type that is passed over, bytes: an image of a camera is shorter.
const LONGEST_SKIPPED: u64 = 1 << 28;
/// Newest version of a header.
const NEWEST_VERSION: u16 = 3;

/// Why a message is left out; the next can be read.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
pub enum Refused {
    /// Bytes were changed on the way, or the sender's checksum is another.
    #[error("{kind} of {device:?}: the CRC does not match the body")]
    Crc {
        /// Type of the message.
        kind: String,
        /// Of whom.
        device: String,
    },
    /// The parts do not fit into each other.
    #[error("{kind} of {device:?}: {problem}")]
    Body {
        /// Type of the message.
        kind: String,
        /// Of whom.
        device: String,
        /// What does not fit.
        problem: String,
    },
}

/// The stream is none of OpenIGTLink, or has lost its place: nothing more can be read from it.
#[derive(Debug, Clone, thiserror::Error, PartialEq, Eq)]
pub enum Broken {
    /// The version makes no sense.
    #[error("header version {0}: expected 1 to {NEWEST_VERSION}")]
    Version(u16),
    /// The type makes no sense.
    #[error("message type {0:?}: expected capitals, digits and _")]
    Type(String),
    /// The body is too long.
    #[error("{kind} of {bytes} bytes: expected up to {limit}")]
    Length {
        /// Type of the message.
        kind: String,
        /// Bytes that its header announces.
        bytes: u64,
        /// Bytes that are taken.
        limit: u64,
    },
}

struct Header {
    version: u16,
    kind: String,
    device: String,
    timestamp: u64,
    body_bytes: u64,
    crc: u64,
}

/// Reads messages of types TRANSFORM and STATUS, and passes others over.
#[derive(Debug, Default)]
pub struct Reader {
    pub(crate) buffer: Vec<u8>,
    /// Bytes of a body that is passed over which are still to come.
    skip: u64,
    broken: Option<Broken>,
    /// Messages of other types.
    passed_over: u64,
}

impl Reader {
    /// Takes bytes in and hands every message that they complete to `hear`.
    ///
    /// # Errors
    /// Where nothing more can be read; then and from then on.
    pub fn take(
        &mut self,
        mut bytes: &[u8],
        mut hear: impl FnMut(Result<Message, Refused>),
    ) -> Result<(), Broken> {
        while let (None, false) = (&self.broken, bytes.is_empty()) {
            if self.skip > 0 {
                let skipped = self.skip.min(bytes.len() as u64);
                (self.skip, bytes) = (self.skip - skipped, &bytes[skipped as usize..]);
                continue;
            }
            let wanted = match self.wanted() {
                Ok(wanted) => wanted,
                Err(broken) => {
                    self.broken = Some(broken);
                    break;
                }
            };
            let more = wanted.saturating_sub(self.buffer.len()).min(bytes.len());
            self.buffer.extend_from_slice(&bytes[..more]);
            bytes = &bytes[more..];
            self.complete(&mut hear);
        }
        self.broken.clone().map_or(Ok(()), Err)
    }

    /// Messages of other types that were passed over.
    pub fn passed_over(&self) -> u64 {
        self.passed_over
    }

    /// Bytes that the buffer must hold before something can be said of it.
    fn wanted(&self) -> Result<usize, Broken> {
        match self.header() {
            None => Ok(HEADER_BYTES),
            Some(header) => Ok(HEADER_BYTES + header.checked()? as usize),
        }
    }

    fn header(&self) -> Option<Header> {
        let bytes = self.buffer.first_chunk::<HEADER_BYTES>()?;
        Some(Header {
            version: u16_at(bytes, 0),
            kind: text(&bytes[2..14]),
            device: text(&bytes[14..34]),
            timestamp: u64_at(bytes, 34),
            body_bytes: u64_at(bytes, 42),
            crc: u64_at(bytes, 50),
        })
    }

    /// Takes a message out of the buffer where it is complete, or begins to pass one over.
    fn complete(&mut self, hear: &mut impl FnMut(Result<Message, Refused>)) {
        let Some(header) = self.header() else { return };
        // Checked when more is wanted.
        let Ok(body_bytes) = header.checked() else { return };
        if !header.is_known() {
            (self.skip, self.passed_over) = (header.body_bytes, self.passed_over + 1);
            self.buffer.clear();
        } else if self.buffer.len() as u64 == HEADER_BYTES as u64 + body_bytes {
            hear(header.message(&self.buffer[HEADER_BYTES..]));
            self.buffer.clear();
        }
    }
}

impl Header {
    fn is_known(&self) -> bool {
        self.kind == TRANSFORM || self.kind == STATUS
    }

    /// Bytes of the body that are kept; refuses what is no header.
    fn checked(&self) -> Result<u64, Broken> {
        if !(1..=NEWEST_VERSION).contains(&self.version) {
            return Err(Broken::Version(self.version));
        }
        let is_type = |b: u8| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_';
        if self.kind.is_empty() || !self.kind.bytes().all(is_type) {
            return Err(Broken::Type(self.kind.clone()));
        }
        let limit = if self.is_known() { LONGEST_TAKEN } else { LONGEST_SKIPPED };
        if self.body_bytes > limit {
            return Err(Broken::Length { kind: self.kind.clone(), bytes: self.body_bytes, limit });
        }
        Ok(if self.is_known() { self.body_bytes } else { 0 })
    }

    fn message(&self, body: &[u8]) -> Result<Message, Refused> {
        let refused = |problem: String| {
            let (kind, device) = (self.kind.clone(), self.device.clone());
            Refused::Body { kind, device, problem }
        };
        if checksum(body) != self.crc {
            return Err(Refused::Crc { kind: self.kind.clone(), device: self.device.clone() });
        }
        let (id, content, metadata) =
            if self.version == 1 { (0, body, Vec::new()) } else { parts(body).map_err(refused)? };
        let content = if self.kind == TRANSFORM { transform(content) } else { status(content) };
        Ok(Message {
            device: self.device.clone(),
            unix_ns: unix_ns(self.timestamp),
            id,
            metadata,
            content: content.map_err(refused)?,
        })
    }
}

/// Id, content and metadata of a body with an extended header.
type Parts<'a> = (u32, &'a [u8], Vec<(String, String)>);

fn parts(body: &[u8]) -> Result<Parts<'_>, String> {
    if body.len() < EXTENDED_BYTES {
        return Err(format!("expected {EXTENDED_BYTES} bytes of extended header, found {}", body.len()));
    }
    let (extended, heads, texts) =
        (usize::from(u16_at(body, 0)), usize::from(u16_at(body, 2)), u32_at(body, 4) as usize);
    let end = body.len().checked_sub(heads.saturating_add(texts));
    let Some(end) = end.filter(|end| extended >= EXTENDED_BYTES && extended <= *end) else {
        return Err(format!(
            "parts of {extended}, {heads} and {texts} bytes do not fit into a body of {}",
            body.len()
        ));
    };
    let metadata = metadata(&body[end..][..heads], &body[end + heads..])?;
    Ok((u32_at(body, 8), &body[extended..end], metadata))
}

fn metadata(heads: &[u8], mut texts: &[u8]) -> Result<Vec<(String, String)>, String> {
    if heads.is_empty() {
        return Ok(Vec::new());
    }
    let count = heads.first_chunk().map_or(0, |bytes| usize::from(u16::from_be_bytes(*bytes)));
    if heads.len() != 2 + 8 * count {
        return Err(format!("{count} values of metadata in {} bytes of sizes", heads.len()));
    }
    let mut next = |bytes: usize| {
        let (taken, rest) = texts.split_at_checked(bytes).ok_or("metadata is longer than its part")?;
        texts = rest;
        Ok::<_, String>(text(taken))
    };
    let pairs = heads[2..].chunks_exact(8);
    pairs.map(|sizes| Ok((next(usize::from(u16_at(sizes, 0)))?, next(u32_at(sizes, 4) as usize)?))).collect()
}

fn transform(content: &[u8]) -> Result<Content, String> {
    if content.len() != TRANSFORM_BYTES {
        return Err(format!("expected {TRANSFORM_BYTES} bytes, found {}", content.len()));
    }
    let at = |i: usize| f32::from_bits(u32_at(content, 4 * i));
    let rows: [[f32; 4]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| at(3 * column + row)));
    match rows.iter().flatten().find(|value| !value.is_finite()) {
        Some(value) => Err(format!("expected numbers, found {value}")),
        None => Ok(Content::Transform(rows)),
    }
}

fn status(content: &[u8]) -> Result<Content, String> {
    if content.len() < STATUS_BYTES {
        return Err(format!("expected {STATUS_BYTES} bytes or more, found {}", content.len()));
    }
    Ok(Content::Status {
        code: u16_at(content, 0),
        subcode: u64_at(content, 2) as i64,
        name: text(&content[10..][..STATUS_NAME_BYTES]),
        text: text(&content[STATUS_BYTES..]),
    })
}

/// Up to the first zero; what is no UTF-8 is replaced.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

fn unix_ns(timestamp: u64) -> u64 {
    let (seconds, fraction) = (timestamp >> 32, timestamp & u64::from(u32::MAX));
    seconds * 1_000_000_000 + ((fraction * 1_000_000_000 + (1 << 31)) >> 32)
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    (u32::from(u16_at(bytes, at)) << 16) | u32::from(u16_at(bytes, at + 2))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    (u64::from(u32_at(bytes, at)) << 32) | u64::from(u32_at(bytes, at + 4))
}
