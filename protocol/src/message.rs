//! Messages: name of the channel, version, schema hash, validation.

use crate::wire::{Wire, layout_of};

/// Why a received block was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}.{field}: expected {expected}, found {found}")]
pub struct Invalid {
    /// Name of the message.
    pub message: &'static str,
    /// Field that is wrong.
    pub field: &'static str,
    /// Allowed values.
    pub expected: &'static str,
    /// Value found.
    pub found: f64,
}

/// Checks one condition of a message.
///
/// # Errors
/// Names the field and the offending number where the condition does not hold.
pub fn require(
    holds: bool,
    message: &'static str,
    field: &'static str,
    expected: &'static str,
    found: f64,
) -> Result<(), Invalid> {
    if holds { Ok(()) } else { Err(Invalid { message, field, expected, found }) }
}

/// True if every number is finite.
pub fn all_finite(values: &[f64]) -> bool {
    values.iter().all(|v| v.is_finite())
}

/// A block that is sent on a channel.
pub trait Message: Wire {
    /// Name of the channel, also the name in logs and recordings.
    const CHANNEL: &'static str;
    /// Version of the meaning; the layout is hashed besides.
    const VERSION: u32;
    /// Blocks kept for a receiver that falls behind (older ones are overwritten and counted).
    const QUEUE: usize;

    /// Refuses blocks whose numbers make no sense.
    ///
    /// # Errors
    /// Names the first field whose number is out of its range.
    fn validate(&self) -> Result<(), Invalid>;

    /// Hash of the channel's name, the version and the whole layout, nested types and the elements
    /// of sections included. Two processes connect only with equal ones.
    const SCHEMA: u64 = {
        let hash = fnv_bytes(fnv1a(Self::CHANNEL.as_bytes()), &Self::VERSION.to_le_bytes());
        layout_of::<Self>().hash(hash)
    };
}

const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;
const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;

pub(crate) const fn fnv_bytes(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(FNV_PRIME);
        i += 1;
    }
    hash
}

/// FNV-1a over bytes (<http://www.isthe.com/chongo/tech/comp/fnv/>); for schemas and state hashes.
pub const fn fnv1a(bytes: &[u8]) -> u64 {
    fnv_bytes(FNV_BASIS, bytes)
}

/// Copies a text into a fixed, zero-padded array, cut at a character border.
pub fn text_bytes<const N: usize>(text: &str) -> [u8; N] {
    let mut out = [0; N];
    let mut end = text.len().min(N);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    out[..end].copy_from_slice(&text.as_bytes()[..end]);
    out
}

/// The text of a zero-padded array; damaged bytes become replacement characters.
pub fn text_of(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fnv_matches_its_published_test_vectors() {
        assert_eq!(fnv1a(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a(b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a(b"foobar"), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn text_survives_and_is_cut_at_a_character() {
        assert_eq!(text_of(&text_bytes::<8>("abc")), "abc");
        assert_eq!(text_of(&text_bytes::<4>("abcé")), "abc");
    }
}
