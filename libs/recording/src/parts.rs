//! Recordings in parts: files that are recordings themselves, and together one.
//!
//! `run.mcap` in parts is `run.0001.mcap`, `run.0002.mcap` and so on ([`names`]). Each begins with the
//! provenance, and from the second on with what tracker and simulation knew and with the inputs that were under
//! way ([`recent`]), so that it is read, shown and verified alone. The part before has late inputs in the same
//! way behind its end. Nothing of that is new: the messages of a topic are numbered through all parts, and what
//! two parts hold has the same number in both. So the parts are read as one by numbers alone, to the item: each
//! gives what it is the first to have ([`Kept`]).

mod names;
mod recent;
mod set;
mod writing;

pub use names::{MOST_PARTS, files_of, part_file, parts_of, split_name, whole_of};
pub use set::PartInfo;
pub(super) use set::assemble;
pub use writing::{Limit, PartFiles, PartsWriter};

use super::{Item, RecordingError};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// Numbers of messages by topic, in the order of [`Item::TOPICS`].
pub(super) type Numbers = [u32; Item::TOPICS.len()];

/// Key of a part's number in the metadata of its file.
const NUMBER: &str = "part.number";
/// Key of what names the recording that it is a part of.
const SET: &str = "part.of";
/// Key of the numbers of the first messages by topic that no part before has.
const FROM: &str = "part.from";
/// Name of the metadata record at the end of a part that another one follows.
pub(super) const GOES_ON: &str = "vitreo-next";

/// Which part of a recording a file is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartOf {
    /// Its number, from 1 on.
    pub number: u32,
    /// Names the recording; the same in all its parts, and in those of no other recording.
    pub set: String,
    /// Numbers of the first messages that no part before has.
    pub(super) from: Numbers,
}

impl PartOf {
    /// As pairs of the metadata.
    pub(super) fn pairs(&self) -> [(String, String); 3] {
        let from = Item::TOPICS.iter().zip(self.from).filter(|(_, number)| *number > 0);
        let from: Vec<String> = from.map(|(topic, number)| format!("{topic}={number}")).collect();
        [(NUMBER, self.number.to_string()), (SET, self.set.clone()), (FROM, from.join(" "))]
            .map(|(key, value)| (key.to_string(), value))
    }

    /// From the pairs of the metadata; `None` for a file that is no part.
    ///
    /// # Errors
    /// What is wrong with them.
    pub(super) fn of(pairs: &BTreeMap<String, String>) -> Result<Option<Self>, String> {
        let Some(number) = pairs.get(NUMBER) else { return Ok(None) };
        let number = number.parse().ok().filter(|number| (1..=MOST_PARTS).contains(number));
        let number = number.ok_or(format!("its '{NUMBER}' is no number from 1 to {MOST_PARTS}"))?;
        let set = pairs.get(SET).ok_or(format!("its provenance lacks '{SET}'"))?.clone();
        let mut from = Numbers::default();
        for entry in pairs.get(FROM).ok_or(format!("its provenance lacks '{FROM}'"))?.split_whitespace() {
            let refused = || format!("its '{FROM}' has '{entry}', expected TOPIC=NUMBER");
            let (topic, first) = entry.split_once('=').ok_or_else(refused)?;
            let first = first.parse().map_err(|_| refused())?;
            // Topics of later versions are passed over, as everywhere.
            if let Some(topic) = Item::TOPICS.iter().position(|t| *t == topic) {
                from[topic] = first;
            }
        }
        Ok(Some(PartOf { number, set, from }))
    }
}

/// Which messages of a file belong to the recording that is read; the others stand in the part before or behind
/// it too.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Kept {
    from: Numbers,
    /// `u32::MAX` is no limit.
    until: Numbers,
}

impl Default for Kept {
    /// All of them.
    fn default() -> Self {
        Kept { from: Numbers::default(), until: [u32::MAX; Item::TOPICS.len()] }
    }
}

impl Kept {
    /// True for the message of this number on a topic.
    pub fn holds(&self, topic: &str, number: u32) -> bool {
        let Some(topic) = Item::TOPICS.iter().position(|t| *t == topic) else { return false };
        let until = self.until[topic];
        number >= self.from[topic] && (number < until || until == u32::MAX)
    }
}

/// A file of a recording.
#[derive(Debug)]
pub(super) struct RecordedFile {
    pub path: PathBuf,
    pub bytes: u64,
    pub kept: Arc<Kept>,
    /// Why nothing of it is read.
    problem: Option<String>,
}

impl RecordedFile {
    /// One of which all is read.
    pub fn whole(path: PathBuf, bytes: u64) -> Self {
        RecordedFile { path, bytes, kept: Arc::default(), problem: None }
    }

    /// Why nothing of it is read.
    pub fn lost(&self) -> Option<RecordingError> {
        let problem = self.problem.clone()?;
        Some(RecordingError::Part { file: self.path.display().to_string(), problem })
    }

    /// True if nothing of it is read.
    pub fn is_lost(&self) -> bool {
        self.problem.is_some()
    }
}

#[cfg(test)]
mod tests;
