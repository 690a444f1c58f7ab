//! The checksum of a recording's provenance: a CRC-32 over every key and value of its metadata, as
//! one more pair. Chunks and the finished file have checksums of MCAP's own.

use std::collections::BTreeMap;

/// Key of the checksum among the metadata.
const KEY: &str = "crc32";

/// CRC-32 of all pairs but the checksum itself: length (32 bits, little-endian) and bytes of each
/// key and value, in the order of the keys.
fn checksum(pairs: &BTreeMap<String, String>) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    for text in pairs.iter().filter(|(key, _)| *key != KEY).flat_map(|(key, value)| [key, value]) {
        hasher.update(&(text.len() as u32).to_le_bytes());
        hasher.update(text.as_bytes());
    }
    hasher.finalize()
}

/// The pairs with their checksum.
pub(super) fn signed(mut pairs: BTreeMap<String, String>) -> BTreeMap<String, String> {
    let sum = checksum(&pairs);
    pairs.insert(KEY.into(), format!("{sum:08x}"));
    pairs
}

/// Whether the pairs are those that were written; `None` where they carry no checksum, as in
/// recordings of former versions.
pub(super) fn holds(pairs: &BTreeMap<String, String>) -> Option<bool> {
    let sum = checksum(pairs);
    pairs.get(KEY).map(|own| *own == format!("{sum:08x}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_changed_key_or_value_is_noticed() {
        let pairs =
            |rig: &str, key: &str| BTreeMap::from([("rig".into(), rig.into()), (key.into(), "7".into())]);
        let whole = signed(pairs("1.25", "seed"));
        assert_eq!((holds(&whole), holds(&pairs("1.25", "seed"))), (Some(true), None));
        for (rig, key) in [("1.26", "seed"), ("1.25", "sead"), ("1.2", "5seed")] {
            let mut changed = pairs(rig, key);
            changed.insert(KEY.into(), whole[KEY].clone());
            assert_eq!(holds(&changed), Some(false), "{rig} {key}");
        }
    }
}
