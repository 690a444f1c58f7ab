//! Names of parts: `run.mcap` in parts is `run.0001.mcap`, `run.0002.mcap` and so on, in the order of the names.

use crate::Recording;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// Parts that a recording has at most; the last one takes all that comes.
pub const MOST_PARTS: u32 = 9999;
/// Digits of a part's number.
const DIGITS: usize = 4;

/// The file of a part, from 1 on, of a recording.
pub fn part_file(recording: &Path, number: u32) -> PathBuf {
    let name = recording.file_name().and_then(OsStr::to_str).unwrap_or_default();
    let name = match ending_of(name) {
        Some((stem, ending)) => format!("{stem}.{number:04}.{ending}"),
        None => format!("{name}.{number:04}"),
    };
    recording.with_file_name(name)
}

/// The recording and the number that a file's name says it is a part of; `None` where it says no such thing.
pub fn split_name(file: &Path) -> Option<(PathBuf, u32)> {
    let name = file.file_name()?.to_str()?;
    let (stem, last) = name.rsplit_once('.')?;
    let (stem, digits, ending) = match is_number(last) {
        true => (stem, last, String::new()),
        false => {
            let (stem, digits) = stem.rsplit_once('.').filter(|(_, digits)| is_number(digits))?;
            (stem, digits, format!(".{last}"))
        }
    };
    let number = digits.parse().ok().filter(|number| *number > 0 && !stem.is_empty())?;
    Some((file.with_file_name(format!("{stem}{ending}")), number))
}

fn is_number(digits: &str) -> bool {
    digits.len() == DIGITS && digits.bytes().all(|b| b.is_ascii_digit())
}

/// Stem and ending of a name; an ending that would be a part's number is none.
fn ending_of(name: &str) -> Option<(&str, &str)> {
    name.rsplit_once('.')
        .filter(|(stem, ending)| !stem.is_empty() && !ending.is_empty() && !is_number(ending))
}

/// The files of a recording: its parts, by number, where there is no file of its name, and else that name alone.
pub fn files_of(recording: &Path) -> Vec<PathBuf> {
    let parts = if recording.symlink_metadata().is_err() { parts_of(recording) } else { Vec::new() };
    if parts.is_empty() { vec![recording.into()] } else { parts }
}

/// The files whose names say that they are parts of a recording, by number.
pub fn parts_of(recording: &Path) -> Vec<PathBuf> {
    let folder = recording.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    let number = |file: &Path| {
        let (whole, number) = split_name(file)?;
        (whole.file_name() == recording.file_name()).then_some(number)
    };
    let mut parts: Vec<_> =
        files.filter_map(|entry| Some((number(&entry.path())?, entry.file_name()))).collect();
    parts.sort();
    parts.into_iter().map(|(_, name)| recording.with_file_name(name)).collect()
}

/// The name of the recording that a file is a part of, by its name and by what stands in it; `None` for any
/// other file, and where a file of that name lies there too.
pub fn whole_of(file: &Path) -> Option<PathBuf> {
    let (whole, _) = split_name(file)?;
    let alone = whole.symlink_metadata().is_ok();
    let is_part = || Recording::open_in_doubt(file).is_ok_and(|recording| recording.part().is_some());
    (!alone && is_part()).then_some(whole)
}
