//! A message, and how it is written.

use crate::{
    ASCII, DEVICE_BYTES, EXTENDED_BYTES, HEADER_BYTES, STATUS, STATUS_NAME_BYTES, TRANSFORM, TYPE_BYTES,
    UTF_8, checksum,
};

/// A status: all is well.
pub const STATUS_OK: u16 = 1;
/// A status: what the device's name says is not there.
pub const STATUS_NOT_PRESENT: u16 = 16;

/// Version of a header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeaderVersion {
    /// Of protocols 1 and 2: no metadata.
    One,
    /// Of protocol 3: with metadata.
    Two,
}

/// What a message says.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// A transform: rows of a 3 × 4 matrix, rotation left, translation (mm) right.
    Transform([[f32; 4]; 3]),
    /// State of a device.
    Status {
        /// 1 is well; the protocol lists the others.
        code: u16,
        /// The device's own code.
        subcode: i64,
        /// Name of the error, up to 20 bytes.
        name: String,
        /// In words.
        text: String,
    },
}

/// A message.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Of whom, up to 20 bytes: `Instrument0ToWorld`.
    pub device: String,
    /// Time since 1970, ns (the protocol keeps 2⁻³² s); 0 where it is not known.
    pub unix_ns: u64,
    /// Counts messages; header version 2 only.
    pub id: u32,
    /// Keys and values; header version 2 only.
    pub metadata: Vec<(String, String)>,
    /// What it says.
    pub content: Content,
}

/// Something does not fit where the protocol puts it.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{what} {text:?}: expected up to {limit} bytes, found {found}")]
pub struct TooLong {
    /// What it is.
    pub what: &'static str,
    /// Its text.
    pub text: String,
    /// Bytes that the protocol has for it.
    pub limit: usize,
    /// Bytes that it has.
    pub found: usize,
}

impl Message {
    /// Appends the message to `to`. Header version 1 leaves metadata and id out.
    ///
    /// # Errors
    /// Where a name is longer than the protocol has room for; nothing is appended then.
    pub fn write(&self, version: HeaderVersion, to: &mut Vec<u8>) -> Result<(), TooLong> {
        let start = to.len();
        to.resize(start + HEADER_BYTES, 0);
        let written =
            self.write_body(version, to).and_then(|()| self.write_header(version, &mut to[start..]));
        if written.is_err() {
            to.truncate(start);
        }
        written
    }

    /// Fills in the header of a message whose body is complete.
    fn write_header(&self, version: HeaderVersion, message: &mut [u8]) -> Result<(), TooLong> {
        let (header, body) = message.split_at_mut(HEADER_BYTES);
        let kind = match self.content {
            Content::Transform(_) => TRANSFORM,
            Content::Status { .. } => STATUS,
        };
        header[..2].copy_from_slice(&(version as u16 + 1).to_be_bytes());
        put_text(&mut header[2..][..TYPE_BYTES], "type", kind)?;
        put_text(&mut header[14..][..DEVICE_BYTES], "device name", &self.device)?;
        header[34..42].copy_from_slice(&timestamp(self.unix_ns).to_be_bytes());
        header[42..50].copy_from_slice(&(body.len() as u64).to_be_bytes());
        header[50..58].copy_from_slice(&checksum(body).to_be_bytes());
        Ok(())
    }

    fn write_body(&self, version: HeaderVersion, to: &mut Vec<u8>) -> Result<(), TooLong> {
        let with_metadata = version == HeaderVersion::Two;
        if with_metadata {
            let texts: usize = self.metadata.iter().map(|(key, value)| key.len() + value.len()).sum();
            to.extend_from_slice(&(EXTENDED_BYTES as u16).to_be_bytes());
            to.extend_from_slice(&(2 + 8 * self.metadata.len() as u16).to_be_bytes());
            to.extend_from_slice(&(texts as u32).to_be_bytes());
            to.extend_from_slice(&self.id.to_be_bytes());
        }
        match &self.content {
            Content::Transform(rows) => {
                // Column by column, the translation last.
                for column in 0..4 {
                    rows.iter().for_each(|row| to.extend_from_slice(&row[column].to_be_bytes()));
                }
            }
            Content::Status { code, subcode, name, text } => {
                to.extend_from_slice(&code.to_be_bytes());
                to.extend_from_slice(&subcode.to_be_bytes());
                let at = to.len();
                to.resize(at + STATUS_NAME_BYTES, 0);
                put_text(&mut to[at..], "name of a status", name)?;
                to.extend_from_slice(text.as_bytes());
                to.push(0);
            }
        }
        if with_metadata {
            self.write_metadata(to)?;
        }
        Ok(())
    }

    fn write_metadata(&self, to: &mut Vec<u8>) -> Result<(), TooLong> {
        to.extend_from_slice(&(self.metadata.len() as u16).to_be_bytes());
        for (key, value) in &self.metadata {
            let key_bytes = u16::try_from(key.len()).map_err(|_| TooLong {
                what: "key of metadata",
                text: key.clone(),
                limit: usize::from(u16::MAX),
                found: key.len(),
            })?;
            to.extend_from_slice(&key_bytes.to_be_bytes());
            to.extend_from_slice(&if value.is_ascii() { ASCII } else { UTF_8 }.to_be_bytes());
            to.extend_from_slice(&(value.len() as u32).to_be_bytes());
        }
        for (key, value) in &self.metadata {
            to.extend_from_slice(key.as_bytes());
            to.extend_from_slice(value.as_bytes());
        }
        Ok(())
    }
}

/// Nanoseconds since 1970 in the protocol's form, rounded to the nearest fraction.
fn timestamp(unix_ns: u64) -> u64 {
    let (seconds, ns) = (unix_ns / 1_000_000_000, unix_ns % 1_000_000_000);
    // The protocol counts 2³² seconds, until 2106.
    (seconds << 32).saturating_add(((ns << 32) + 500_000_000) / 1_000_000_000)
}

fn put_text(place: &mut [u8], what: &'static str, text: &str) -> Result<(), TooLong> {
    let (limit, found) = (place.len(), text.len());
    let place = place.get_mut(..found).ok_or_else(|| TooLong { what, text: text.into(), limit, found })?;
    place.copy_from_slice(text.as_bytes());
    Ok(())
}
