//! Lists of plain numbers saved as they lie in memory, so that saving and hashing them is a copy:
//! for `#[serde(with = …)]`.

use bytemuck::{AnyBitPattern, NoUninit};
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

const _: () = assert!(cfg!(target_endian = "little"), "numbers are saved as they lie in memory");

struct Saved<'a, T>(&'a [T]);

struct Read<T>(Vec<T>);

struct Bytes<T>(PhantomData<T>);

impl<T: NoUninit> Serialize for Saved<'_, T> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(bytemuck::cast_slice(self.0))
    }
}

impl<'de, T: AnyBitPattern> Deserialize<'de> for Read<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_bytes(Bytes(PhantomData)).map(Read)
    }
}

impl<T: AnyBitPattern> Visitor<'_> for Bytes<T> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "bytes, {} a number", size_of::<T>())
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<T>, E> {
        let numbers = bytes.chunks_exact(size_of::<T>());
        if !numbers.remainder().is_empty() {
            return Err(E::invalid_length(bytes.len(), &self));
        }
        Ok(numbers.map(bytemuck::pod_read_unaligned).collect())
    }
}

/// A list.
pub mod list {
    use super::*;

    /// Saves it.
    ///
    /// # Errors
    /// If the serializer refuses.
    pub fn serialize<T: NoUninit, S: Serializer>(list: &[T], to: S) -> Result<S::Ok, S::Error> {
        Saved(list).serialize(to)
    }

    /// Reads it.
    ///
    /// # Errors
    /// If the bytes are no whole numbers of the type.
    pub fn deserialize<'de, T: AnyBitPattern, D: Deserializer<'de>>(from: D) -> Result<Vec<T>, D::Error> {
        Read::deserialize(from).map(|r| r.0)
    }
}

/// Lists along x, y and z.
pub mod lists {
    use super::*;

    /// Saves them.
    ///
    /// # Errors
    /// If the serializer refuses.
    pub fn serialize<T: NoUninit, S: Serializer>(lists: &[Vec<T>; 3], to: S) -> Result<S::Ok, S::Error> {
        lists.each_ref().map(|list| Saved(list)).serialize(to)
    }

    /// Reads them.
    ///
    /// # Errors
    /// If the bytes are no whole numbers of the type.
    pub fn deserialize<'de, T: AnyBitPattern, D: Deserializer<'de>>(
        from: D,
    ) -> Result<[Vec<T>; 3], D::Error> {
        <[Read<T>; 3]>::deserialize(from).map(|lists| lists.map(|r| r.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Both {
        #[serde(with = "list")]
        list: Vec<u16>,
        #[serde(with = "lists")]
        lists: [Vec<f32>; 3],
    }

    fn config() -> impl bincode::config::Config {
        bincode::config::standard().with_fixed_int_encoding()
    }

    proptest! {
        #[test]
        fn lists_come_back(
            list in prop::collection::vec(any::<u16>(), 0..9),
            lists in prop::array::uniform3(prop::collection::vec(-1e9f32..1e9, 0..9)),
        ) {
            let both = Both { list, lists };
            let bytes = bincode::serde::encode_to_vec(&both, config()).unwrap();
            let (read, used): (Both, usize) = bincode::serde::decode_from_slice(&bytes, config()).unwrap();
            prop_assert_eq!((&read, used), (&both, bytes.len()));
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let _: Result<(Both, usize), _> = bincode::serde::decode_from_slice(&bytes, config());
        }
    }

    #[test]
    fn half_a_number_is_refused() {
        let bytes = bincode::serde::encode_to_vec(Saved(&[1u8, 2, 3]), config()).unwrap();
        let read: Result<(Read<u16>, usize), _> = bincode::serde::decode_from_slice(&bytes, config());
        assert!(read.err().unwrap().to_string().contains("2 a number"));
    }
}
