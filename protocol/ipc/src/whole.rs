//! Small files of an instance's private directory, which other processes read: there whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Makes a file of what `write` writes; a reader finds the one before or the new one, never a part. It does
/// not outlast the machine: it lies in memory.
///
/// # Errors
/// Where it cannot be written; what was there before then stays.
pub fn write_whole(
    file: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let part = file.with_extension("part");
    let written = File::create(&part).and_then(|made| {
        let mut made = BufWriter::new(made);
        write(&mut made)?;
        made.flush()?;
        fs::rename(&part, file)
    });
    if written.is_err() {
        let _ = fs::remove_file(&part);
    }
    written
}

/// The same for figures and notes, as JSON.
///
/// # Errors
/// As [`write_whole`].
pub fn write_whole_json(file: &Path, value: &impl serde::Serialize) -> io::Result<()> {
    write_whole(file, |to| Ok(serde_json::to_writer(to, value)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_finds_the_old_file_or_the_new_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.json");
        write_whole_json(&file, &[1, 2]).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "[1,2]");
        let failed = write_whole(&file, |to| {
            to.write_all(b"half")?;
            Err(io::Error::other("no more"))
        });
        assert_eq!(failed.unwrap_err().to_string(), "no more");
        assert_eq!(fs::read_to_string(&file).unwrap(), "[1,2]");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no part is left");
        assert!(write_whole_json(&folder.path().join("no/where"), &0).is_err());
    }
}
