//! Which recordings a batch is made of: files, folders, the lines of a manifest, and what lies in
//! an object store. A recording that is named more than once is in the list once, and reported.

use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Ending of a recording's name.
pub const RECORDING: &str = "mcap";

/// A list that cannot be worked through.
#[derive(Debug, thiserror::Error)]
pub enum ListError {
    /// A file or folder cannot be read.
    #[error("{file}: {problem}")]
    Read {
        /// What was named.
        file: String,
        /// Why.
        problem: std::io::Error,
    },
    /// A folder without recordings.
    #[error("{folder}: expected recordings (*.mcap) in it or below, found none")]
    Empty {
        /// What was named.
        folder: String,
    },
}

/// A recording that a list names more than once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Repeated {
    /// The recording.
    pub file: PathBuf,
    /// How often it is named, 2 or more.
    pub times: u64,
}

/// Recordings in the order in which they were named, each once.
#[derive(Debug, Default)]
pub struct List {
    all: Vec<(PathBuf, u64)>,
    places: BTreeMap<Name, usize>,
}

/// What makes two names the same. Paths are compared by their parts (`a//b` is `a/b`), addresses by
/// their letters: an object store has no folders.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Name {
    Path(PathBuf),
    Address(OsString),
}

impl List {
    /// Adds a recording under its name.
    pub fn add(&mut self, recording: PathBuf) {
        let name = match is_address(&recording) {
            true => Name::Address(recording.clone().into_os_string()),
            false => Name::Path(recording.clone()),
        };
        let place = *self.places.entry(name).or_insert(self.all.len());
        match self.all.get_mut(place) {
            Some((_, times)) => *times += 1,
            None => self.all.push((recording, 1)),
        }
    }

    /// Adds a file as it is, or every `*.mcap` in and below a folder, by name.
    ///
    /// # Errors
    /// If a folder cannot be read, or holds no recording.
    pub fn add_path(&mut self, path: &Path) -> Result<(), ListError> {
        if !path.is_dir() {
            self.add(path.to_path_buf());
            return Ok(());
        }
        let mut found = Vec::new();
        walk(path, &mut found)?;
        if found.is_empty() {
            return Err(ListError::Empty { folder: path.display().to_string() });
        }
        found.into_iter().for_each(|file| self.add(file));
        Ok(())
    }

    /// The recordings, each once.
    pub fn recordings(&self) -> Vec<PathBuf> {
        self.all.iter().map(|(file, _)| file.clone()).collect()
    }

    /// Those that were named more than once.
    pub fn repeated(&self) -> Vec<Repeated> {
        let repeated = self.all.iter().filter(|(_, times)| *times > 1);
        repeated.map(|(file, times)| Repeated { file: file.clone(), times: *times }).collect()
    }
}

/// SHA-256 of a list of names in its order, in hexadecimal digits: whether two machines worked from
/// the same list.
pub fn digest<'n>(names: impl IntoIterator<Item = &'n str>) -> String {
    let mut hasher = Sha256::new();
    for name in names {
        hasher.update(name.as_bytes());
        // No name has it, so that no two lists have the same bytes.
        hasher.update([0]);
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Whether a name is an address (`s3://bucket/key`) and no path.
pub fn is_address(name: &Path) -> bool {
    let bytes = name.as_os_str().as_encoded_bytes();
    let Some(end) = bytes.windows(3).position(|w| w == b"://") else { return false };
    let plain = |b: &u8| b.is_ascii_alphanumeric() || b"+-.".contains(b);
    bytes[..end].iter().all(plain) && bytes.first().is_some_and(u8::is_ascii_alphabetic)
}

/// Recordings of a manifest: one a line, paths from its own folder on, addresses as they are; blank
/// lines and those that begin with `#` are passed over.
pub fn lines(text: &str, folder: &Path) -> Vec<PathBuf> {
    let lines = text.lines().map(|line| line.trim_end_matches('\r'));
    let named = lines.filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
    named.map(|line| if is_address(line.as_ref()) { line.into() } else { folder.join(line) }).collect()
}

fn walk(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), ListError> {
    let refused = |path: &Path, problem| ListError::Read { file: path.display().to_string(), problem };
    let entries = std::fs::read_dir(folder).map_err(|e| refused(folder, e))?;
    let mut entries = entries.collect::<Result<Vec<_>, _>>().map_err(|e| refused(folder, e))?;
    entries.sort_by_key(|e| e.file_name());
    for entry in entries {
        let path = entry.path();
        // A link to a folder may lead in a circle.
        let kind = entry.file_type().map_err(|e| refused(&path, e))?;
        if kind.is_dir() {
            walk(&path, found)?;
        } else if path.extension().is_some_and(|e| e == RECORDING) {
            match recording::whole_of(&path) {
                None => found.push(path),
                // Its parts are one recording.
                Some(whole) if found.contains(&whole) => {}
                Some(whole) => found.push(whole),
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use recording::{
        Item, Limit, Note, NoteKind, Packing, PartFiles, PartsWriter, Provenance, RecordingError, Source,
        Writer,
    };
    use std::fs::File;

    proptest! {
        #[test]
        fn every_name_is_there_once_and_counted(names in prop::collection::vec("[ab]/?[c.]{1,2}|s3://b/[cd]", 0..20)) {
            let mut list = List::default();
            names.iter().for_each(|name| list.add(name.into()));
            let (all, repeated) = (list.recordings(), list.repeated());
            let more: u64 = repeated.iter().map(|r| r.times - 1).sum();
            prop_assert_eq!(all.len() as u64 + more, names.len() as u64);
            for name in &names {
                prop_assert!(all.contains(&name.into()));
            }
        }

        #[test]
        fn lists_that_differ_have_other_digests(a in prop::collection::vec("[ab]{0,2}", 0..4), b in prop::collection::vec("[ab]{0,2}", 0..4)) {
            let of = |names: &[String]| digest(names.iter().map(String::as_str));
            prop_assert_eq!(of(&a) == of(&b), a == b);
        }
    }

    #[test]
    fn folders_are_walked_by_name_and_manifests_read_from_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("day/b")).unwrap();
        for name in ["day/c.mcap", "day/b/z.mcap", "day/a.mcap", "day/notes.txt"] {
            std::fs::write(at(name), "").unwrap();
        }
        std::os::unix::fs::symlink(at("day"), at("day/b/circle")).unwrap();
        let mut list = List::default();
        list.add_path(&at("day")).unwrap();
        list.add_path(&at("single")).unwrap();
        let manifest = "# made by hand\nday/a.mcap\r\n\n/far/x y.mcap\ns3://bucket/a//b.mcap\n./single\n";
        lines(manifest, folder.path()).into_iter().for_each(|file| list.add(file));
        let far: [PathBuf; 2] = ["/far/x y.mcap".into(), "s3://bucket/a//b.mcap".into()];
        let expected = [at("day/a.mcap"), at("day/b/z.mcap"), at("day/c.mcap"), at("single")];
        assert_eq!(list.recordings(), [&expected[..], &far].concat());
        let twice = |name| Repeated { file: at(name), times: 2 };
        assert_eq!(list.repeated(), [twice("day/a.mcap"), twice("single")]);
        std::fs::create_dir(at("bare")).unwrap();
        assert!(List::default().add_path(&at("bare")).unwrap_err().to_string().contains("bare"));
    }

    #[test]
    fn the_parts_of_a_recording_are_listed_once() {
        struct Named;
        impl PartFiles for Named {
            fn begin(&mut self, path: &Path) -> Result<File, RecordingError> {
                let file = path.display().to_string();
                File::create(path).map_err(|problem| RecordingError::Io { file, problem })
            }

            fn appear(&mut self, _: &Path) -> Result<(), RecordingError> {
                Ok(())
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("run.mcap");
        let provenance = Provenance { source: Source::Import, ..Provenance::default() };
        let first = File::create(recording::part_file(&base, 1)).unwrap();
        let (packing, limit) = (Packing::default(), Limit::Time(5));
        let mut writer =
            PartsWriter::begin(&base, first, &provenance, packing, limit, Box::new(Named)).unwrap();
        for at in 0..20 {
            let (kind, text) = (NoteKind::Log, "n".into());
            let note = Note { instant_ns: at, kind, process: None, count: at, text };
            writer.write(at, &Item::Note(note)).unwrap();
        }
        writer.finish().unwrap();
        // One that is named like a part and is none.
        let alone = folder.path().join("run.0009.mcap");
        Writer::create(&alone, &provenance).unwrap().finish().unwrap();
        let mut list = List::default();
        list.add_path(folder.path()).unwrap();
        assert!(recording::parts_of(&base).len() > 3);
        assert_eq!(list.recordings(), [base, alone]);
        assert!(list.repeated().is_empty());
    }

    #[test]
    fn an_address_is_no_path() {
        for address in ["s3://b/a.mcap", "s3://", "gs://b", "https://x/y"] {
            assert!(is_address(address.as_ref()), "{address}");
        }
        for path in ["a.mcap", "/s3://b", "./s3://b", "s3:/b", "://b", "a b://c", ""] {
            assert!(!is_address(path.as_ref()), "{path}");
        }
        let mut list = List::default();
        ["s3://b/a//c", "s3://b/a/c", "s3://b/a/./c"].iter().for_each(|name| list.add(name.into()));
        assert_eq!((list.recordings().len(), list.repeated()), (3, Vec::new()), "other keys");
    }
}
