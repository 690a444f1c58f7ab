//! For tests alone: where the large data lies, and a list of what was skipped for want of something.
//!
//! `make test` names a file in `VITREO_SKIPPED`, to which each skipped test appends a line, and prints it at
//! its end: a test that passes by doing nothing must be seen.

use std::fmt::Display;
use std::io::Write;
use std::panic::Location;
use std::path::{Path, PathBuf};

/// Variable with the folder of the large data.
pub const DATA: &str = "VITREO_DATA";
/// Where that is not set: beside the workspace.
const DEFAULT_DATA: &str = "../shared/data";
/// Variable with the file that lists what was skipped.
pub const SKIPPED: &str = "VITREO_SKIPPED";

/// The workspace's root.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// `path` in the folder of the large data, a relative one seen from the workspace's root, whatever crate
/// asks; `None`, with a line on the list, where it is not there.
#[track_caller]
pub fn data(path: &str) -> Option<PathBuf> {
    let found = place(path);
    if !found.exists() {
        skip(&format!("{} is not there ({DATA} names the folder of the large data)", found.display()));
        return None;
    }
    Some(found)
}

fn place(path: &str) -> PathBuf {
    let folder = std::env::var_os(DATA).filter(|v| !v.is_empty()).unwrap_or_else(|| DEFAULT_DATA.into());
    root().join(folder).join(path)
}

/// Puts the calling test on the list of what was skipped, with the reason.
#[track_caller]
pub fn skip(reason: &dyn Display) {
    let thread = std::thread::current();
    let line = format!("{} in {}: {reason}", thread.name().unwrap_or("a test"), Location::caller().file());
    println!("skipped: {line}");
    let Some(list) = std::env::var_os(SKIPPED) else { return };
    let file = std::fs::OpenOptions::new().append(true).create(true).open(root().join(list));
    let written = file.and_then(|mut file| writeln!(file, "{line}"));
    assert!(written.is_ok(), "the list of skipped tests: {written:?}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_seen_from_the_root() {
        assert!(root().join("tests/skips/src/lib.rs").is_file());
        assert!(place("cameras").starts_with(root()) || std::env::var_os(DATA).is_some());
    }
}
