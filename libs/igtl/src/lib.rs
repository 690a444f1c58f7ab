//! OpenIGTLink, the protocol of image-guided therapy: messages of types TRANSFORM and STATUS, written and read.
//! Pure; sockets are the caller's.
//!
//! Header of every message, 58 bytes, big endian: version (u16), type (12 bytes), device (20 bytes),
//! timestamp (u64: seconds since 1970 in the upper half, fractions of 2⁻³² s in the lower), size of the body
//! (u64), CRC-64 of the body (ECMA-182, u64). Protocols 1 and 2 have header version 1. Protocol 3 has header
//! version 2: before the content stand 12 bytes that size what follows it, metadata of keys and values.
//! Source: openigtlink.org, "Documents/Protocol" of the reference library.

mod message;
mod read;

pub use message::{Content, HeaderVersion, Message, STATUS_NOT_PRESENT, STATUS_OK, TooLong};
pub use read::{Broken, Reader, Refused};

use crc::{CRC_64_ECMA_182, Crc, Table};

/// Bytes of a header.
pub const HEADER_BYTES: usize = 58;
/// Bytes of a type and of a device's name.
const TYPE_BYTES: usize = 12;
const DEVICE_BYTES: usize = 20;
/// Bytes of the extended header.
const EXTENDED_BYTES: usize = 12;
/// Bytes of a transform: twelve f32.
const TRANSFORM_BYTES: usize = 48;
/// Bytes of a status before its text: code, sub-code, name.
const STATUS_BYTES: usize = 30;
/// Bytes of the name in a status.
const STATUS_NAME_BYTES: usize = 20;
/// IANA's number of ASCII and of UTF-8, for values of metadata.
const ASCII: u16 = 3;
const UTF_8: u16 = 106;

const TRANSFORM: &str = "TRANSFORM";
const STATUS: &str = "STATUS";

static CRC: Crc<u64, Table<1>> = Crc::<u64, Table<1>>::new(&CRC_64_ECMA_182);

/// The checksum of a body.
pub fn checksum(body: &[u8]) -> u64 {
    CRC.checksum(body)
}

#[cfg(test)]
mod tests;
