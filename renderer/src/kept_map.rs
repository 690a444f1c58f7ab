//! The map of the fundus, kept for the next renderer of a run, which then need not bake it: some 0.3 s.

use outputs::{OutputError, Outputs};
use protocol::file::read_bytes;
use scene::Side;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

fn path(folder: &Path, size: u32, side: Side) -> PathBuf {
    folder.join(format!("fundus-map-{size}-{side:?}"))
}

/// The pixels kept in `folder` for this eye, if there are as many as belong to this size.
pub fn take(folder: &Path, size: u32, side: Side) -> Option<Vec<u8>> {
    let bytes = 4 * u64::from(size).pow(2);
    read_bytes(&path(folder, size, side), bytes).ok().filter(|map| map.len() as u64 == bytes)
}

/// Keeps `map`; whole or not at all, also where two renderers start at once.
///
/// # Errors
/// Where there is no such folder any more, or it takes no file of this size.
pub fn put(folder: &Path, size: u32, side: Side, map: &[u8]) -> Result<(), OutputError> {
    // A run that has ended took its folder away, for good.
    if !folder.is_dir() {
        return Err(OutputError::io(folder, ErrorKind::NotFound.into()));
    }
    Outputs::new(true).write(&path(folder, size, side), map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets::Assets;
    use std::fs;

    #[test]
    fn a_map_is_kept_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(take(folder.path(), 2, Side::Left), None);
        put(folder.path(), 2, Side::Left, &[7; 16]).unwrap();
        assert_eq!(take(folder.path(), 2, Side::Left), Some(vec![7; 16]));
        assert_eq!(take(folder.path(), 4, Side::Left), None);
        assert_eq!(take(folder.path(), 2, Side::Right), None);
        fs::write(path(folder.path(), 2, Side::Left), [7; 15]).unwrap();
        assert_eq!(take(folder.path(), 2, Side::Left), None, "a byte is missing");
        assert!(put(&folder.path().join("nowhere"), 2, Side::Left, &[7; 16]).is_err());
    }

    #[test]
    fn the_second_renderer_takes_what_the_first_one_baked() {
        let folder = tempfile::tempdir().unwrap();
        let assets = || Assets::shipped().unwrap().kept_in(folder.path().to_owned());
        let first = assets().map(64, Side::Left);
        assert_eq!(first, Assets::shipped().unwrap().map(64, Side::Left));
        assert_eq!(assets().map(64, Side::Left), first);
        fs::write(path(folder.path(), 64, Side::Left), vec![9; first.len()]).unwrap();
        assert_eq!(assets().map(64, Side::Left), vec![9; first.len()], "nothing was baked");
    }
}
