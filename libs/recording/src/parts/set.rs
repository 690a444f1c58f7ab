//! Parts that were found become one recording: which of them belong together, and what is missing.

use super::{GOES_ON, Kept, PartOf, RecordedFile, split_name};
use crate::chunk_index::holds_metadata;
use crate::read::Opened;
use crate::{CUT, Provenance, Recording, RecordingError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A part of a recording, for those who list them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartInfo {
    /// Its file.
    pub file: PathBuf,
    /// Bytes; 0 where it is missing.
    pub bytes: u64,
    /// Why nothing of it is read, if so.
    pub problem: Option<String>,
}

/// A file that may be a part.
struct Found {
    /// By its contents, and where these say nothing by its name.
    number: u32,
    path: PathBuf,
    opened: Result<(Opened, PartOf), String>,
}

impl Found {
    fn open(path: PathBuf) -> (Self, Option<RecordingError>) {
        let number = split_name(&path).map_or(0, |(_, number)| number);
        let opened = Opened::of(&path);
        let reason = |error: &RecordingError| {
            let text = error.to_string();
            text.strip_prefix(&format!("{}: ", path.display())).map(str::to_owned).unwrap_or(text)
        };
        match opened {
            Ok(opened) => match opened.part.clone() {
                Some(part) => (Found { number: part.number, path, opened: Ok((opened, part)) }, None),
                None => (Found { number, path, opened: Err("is a separate recording".into()) }, None),
            },
            Err(error) => (Found { number, opened: Err(reason(&error)), path }, Some(error)),
        }
    }

    fn part(&self) -> Option<&PartOf> {
        self.opened.as_ref().ok().map(|(_, part)| part)
    }
}

/// Opens these files as the parts of one recording of that name.
///
/// # Errors
/// Where none of them is a part that can be read.
pub(crate) fn assemble(path: &Path, files: Vec<PathBuf>) -> Result<Recording, RecordingError> {
    let (mut found, mut first_error) = (Vec::new(), None);
    for file in files {
        let (part, error) = Found::open(file);
        found.push(part);
        first_error = first_error.or(error);
    }
    found.sort_by_key(|part| part.number);
    let Some(first) = found.iter().position(|part| part.opened.is_ok()) else {
        let problem = "none of its files is a part of a recording".into();
        return Err(first_error.unwrap_or(RecordingError::Part { file: path.display().to_string(), problem }));
    };
    refuse_strangers(&mut found, first);
    let provenance =
        found[first].opened.as_ref().map(|(opened, _)| opened.provenance.clone()).unwrap_or_default();
    let (mut checksum, mut finished, mut doubt) = (true, true, None);
    for part in &mut found {
        let Ok((opened, _)) = &mut part.opened else { continue };
        checksum &= opened.checksum;
        finished &= opened.finished;
        doubt = doubt.or(opened.doubt.take());
    }
    let files = with_missing(found)?;
    let bytes = files.iter().map(|file| file.bytes).sum();
    finished &= !files.iter().any(RecordedFile::is_lost);
    let files = files.into();
    Ok(Recording { path: path.into(), files, provenance, checksum, doubt, finished, bytes, part: None })
}

/// Marks what belongs to another recording than the first part, and numbers that come twice.
fn refuse_strangers(found: &mut [Found], first: usize) {
    let (Ok((opened, part)), path) = (&found[first].opened, found[first].path.display().to_string()) else {
        return;
    };
    let (set, provenance) = (part.set.clone(), opened.provenance.clone());
    let mut seen = BTreeMap::new();
    for part in found.iter_mut() {
        let Ok((opened, own)) = &part.opened else { continue };
        let name = part.path.display().to_string();
        let problem = if own.set != set {
            Some(format!("belongs to another recording than {path}"))
        } else if let Some(difference) = provenance.difference(&opened.provenance) {
            Some(format!("belongs to another recording than {path}: their {difference} differ"))
        } else {
            seen.insert(own.number, name.clone()).map(|other| {
                seen.insert(own.number, other.clone());
                format!("contains part {}, as does {other}", own.number)
            })
        };
        if let Some(problem) = problem {
            // Its own number counts in its own recording.
            part.number = split_name(&part.path).map_or(own.number, |(_, number)| number);
            part.opened = Err(problem);
        }
    }
    found.sort_by_key(|part| part.number);
}

/// The files in their order, with those that are missing between and behind them.
///
/// # Errors
/// Those of the operating system.
fn with_missing(found: Vec<Found>) -> Result<Vec<RecordedFile>, RecordingError> {
    let readable: BTreeMap<u32, PartOf> =
        found.iter().filter_map(|part| Some((part.number, part.part()?.clone()))).collect();
    let name_of = |number: u32| {
        let known = found.iter().find_map(|part| split_name(&part.path)).map(|(whole, _)| whole);
        super::part_file(&known.unwrap_or_else(|| "part".into()), number)
    };
    let missing = |from: u32, to: u32| RecordedFile {
        problem: Some(match to - from {
            0 => format!("is missing, part {from} of the recording"),
            _ => format!("is missing, with all up to part {to} of the recording"),
        }),
        ..RecordedFile::whole(name_of(from), 0)
    };
    let (mut files, mut next) = (Vec::new(), 1);
    for part in &found {
        let number = part.number;
        if number > next {
            files.push(missing(next, number - 1));
        }
        next = next.max(number + 1);
        files.push(match &part.opened {
            Err(problem) => {
                RecordedFile { problem: Some(problem.clone()), ..RecordedFile::whole(part.path.clone(), 0) }
            }
            Ok((opened, own)) => {
                let mut kept = Kept::default();
                // Where a neighbour is missing, what is there of it is all that there is.
                if readable.contains_key(&(number - 1)) {
                    kept.from = own.from;
                }
                if let Some(behind) = readable.get(&(number + 1)) {
                    kept.until = behind.from;
                }
                RecordedFile { kept: Arc::new(kept), ..RecordedFile::whole(part.path.clone(), opened.bytes) }
            }
        });
    }
    let last = found.iter().rev().find(|part| part.opened.is_ok()).filter(|part| part.number + 1 == next);
    if let Some(last) = last
        && holds_metadata(&last.path, GOES_ON)?
    {
        files.push(missing(next, next));
    }
    Ok(files)
}

impl Provenance {
    /// The first part of what results depend on that differs; where a part begins is no difference.
    pub fn difference(&self, other: &Provenance) -> Option<&'static str> {
        let config = |p: &Provenance| {
            p.config.clone().into_iter().filter(|(key, _)| key != CUT).collect::<BTreeMap<_, _>>()
        };
        let (a, b) = (self, other);
        let parts = [
            ("rigs", a.rig_json == b.rig_json),
            ("scenes", a.scene_toml == b.scene_toml),
            ("sources", a.source == b.source),
            ("seeds", a.seeds == b.seeds),
            ("versions", a.versions == b.versions),
            ("configurations", config(a) == config(b)),
        ];
        parts.into_iter().find(|(_, same)| !same).map(|(what, _)| what)
    }
}

impl Recording {
    /// Opens these files as the parts of one recording; `path` is the name by which it is called.
    ///
    /// # Errors
    /// Where none of them is a part that can be read. A part that is missing or of another recording is an error
    /// while the items are read.
    pub fn of_parts(path: &Path, files: &[PathBuf]) -> Result<Self, RecordingError> {
        let recording = assemble(path, files.to_vec())?;
        recording.trusted()
    }

    /// Which part it is, where the file is one and was opened alone.
    pub fn part(&self) -> Option<&PartOf> {
        self.part.as_ref()
    }

    /// Its parts, with those that are missing; nothing for a recording in one file.
    pub fn parts(&self) -> Vec<PartInfo> {
        if self.files.len() == 1 && self.files[0].path == self.path {
            return Vec::new();
        }
        let info = |file: &RecordedFile| PartInfo {
            file: file.path.clone(),
            bytes: file.bytes,
            problem: file.problem.clone(),
        };
        self.files.iter().map(info).collect()
    }
}
