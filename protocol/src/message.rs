//! What every fixed block on a channel has in common: name, version, layout, validation.

use bytemuck::Pod;

/// Why a block that came in was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}.{field}: expected {expected}, found {found}")]
pub struct Invalid {
    /// Name of the message.
    pub message: &'static str,
    /// Field that is wrong.
    pub field: &'static str,
    /// What would be right.
    pub expected: &'static str,
    /// What is there.
    pub found: f64,
}

/// Checks one condition of a message; the error names the field and the offending number.
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

/// One field of a block as the other process must see it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldLayout {
    /// Name in the source.
    pub name: &'static str,
    /// Bytes from the start of the block.
    pub offset: usize,
    /// Bytes taken.
    pub size: usize,
}

/// A plain block that travels on a channel.
///
/// `Pod` proves at compile time that it has a fixed layout, no padding, no pointers and no
/// invalid bit patterns; `validate` then checks the meaning of what came in.
pub trait Message: Pod {
    /// Name of the channel, also the name in logs and recordings.
    const CHANNEL: &'static str;
    /// Version of the meaning; the layout is hashed besides.
    const VERSION: u32;
    /// The block's fields in order, made by [`crate::fields!`].
    const FIELDS: &'static [FieldLayout];
    /// Blocks kept for a receiver that falls behind (older ones are overwritten and counted).
    const QUEUE: usize;

    /// Refuses blocks whose numbers make no sense.
    fn validate(&self) -> Result<(), Invalid>;

    /// Hash of name, version, field names, offsets and sizes: equal only for equal layouts.
    const SCHEMA: u64 = schema_hash(Self::CHANNEL, Self::VERSION, Self::FIELDS, size_of::<Self>());
}

/// Size of a struct's field, found from an accessor so that it works in constants.
pub const fn size_of_field<T, U>(_: fn(&T) -> &U) -> usize {
    size_of::<U>()
}

/// The layout table of a `#[repr(C)]` struct: `fields!(Blob { x, y, area })`.
#[macro_export]
macro_rules! fields {
    ($type:ty { $($field:ident),* $(,)? }) => {
        &[$($crate::message::FieldLayout {
            name: stringify!($field),
            offset: core::mem::offset_of!($type, $field),
            size: $crate::message::size_of_field::<$type, _>(|t| &t.$field),
        }),*]
    };
}

const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;
const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;

const fn fnv_bytes(mut hash: u64, bytes: &[u8]) -> u64 {
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

/// Hash of a layout. Fails to compile where the table misses a field, because then the sizes do
/// not add up to the size of the block.
pub const fn schema_hash(name: &str, version: u32, fields: &[FieldLayout], size: usize) -> u64 {
    let mut hash = fnv_bytes(FNV_BASIS, name.as_bytes());
    hash = fnv_bytes(hash, &version.to_le_bytes());
    let (mut i, mut end) = (0, 0);
    while i < fields.len() {
        assert!(fields[i].offset == end, "the layout table skips or reorders a field");
        end += fields[i].size;
        hash = fnv_bytes(hash, fields[i].name.as_bytes());
        hash = fnv_bytes(hash, &(fields[i].offset as u64).to_le_bytes());
        hash = fnv_bytes(hash, &(fields[i].size as u64).to_le_bytes());
        i += 1;
    }
    assert!(end == size, "the layout table misses the last fields");
    hash
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
    fn hash_sees_a_swap_of_equal_fields() {
        let ab =
            [FieldLayout { name: "a", offset: 0, size: 8 }, FieldLayout { name: "b", offset: 8, size: 8 }];
        let ba =
            [FieldLayout { name: "b", offset: 0, size: 8 }, FieldLayout { name: "a", offset: 8, size: 8 }];
        assert_ne!(schema_hash("m", 1, &ab, 16), schema_hash("m", 1, &ba, 16));
        assert_ne!(schema_hash("m", 1, &ab, 16), schema_hash("m", 2, &ab, 16));
    }

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
