//! Faults that happened, counted and logged.

use super::{Deed, Kind};
use serde::Serialize;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

/// Deeds that can wait to be written; more are counted only.
const WAITING: usize = 256;

/// One deed, as a line of the fault log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Entry {
    /// Number of the field; 0 for a fault that stands.
    pub field: u64,
    /// Camera id.
    pub camera: u32,
    /// What was done.
    #[serde(flatten)]
    pub deed: Deed,
}

/// Counts deeds and keeps the newest until they are written.
#[derive(Debug, Clone)]
pub struct FaultTally {
    counts: [u64; Kind::ALL.len()],
    waiting: Vec<Entry>,
}

impl Default for FaultTally {
    fn default() -> Self {
        FaultTally { counts: [0; Kind::ALL.len()], waiting: Vec::with_capacity(WAITING) }
    }
}

impl FaultTally {
    /// Takes a deed in.
    pub fn note(&mut self, field: u64, camera: u32, deed: Deed) {
        self.counts[deed.kind() as usize] += 1;
        if self.waiting.len() < WAITING {
            self.waiting.push(Entry { field, camera, deed });
        }
    }

    /// So many fields had this fault; for one that stands, so many cameras.
    pub fn count(&self, kind: Kind) -> u64 {
        self.counts[kind as usize]
    }

    /// What has not been written yet.
    pub fn waiting(&self) -> &[Entry] {
        &self.waiting
    }

    /// Forgets what was written.
    pub fn clear_waiting(&mut self) {
        self.waiting.clear();
    }

    /// Appends the counts to `text`, those that happened: `faults: dropped 3, late 5, flicker`.
    pub fn summary(&self, text: &mut String) {
        let mut before = "faults: ";
        for kind in Kind::ALL.into_iter().filter(|&k| self.count(k) > 0) {
            text.push_str(before);
            text.push_str(kind.name());
            if !kind.stands() {
                // Writing to a String cannot fail.
                let _ = write!(text, " {}", self.count(kind));
            }
            before = ", ";
        }
    }
}

/// The fault log: one line of JSON for each deed.
pub struct FaultLog {
    file: BufWriter<File>,
}

impl FaultLog {
    /// Makes the file anew.
    pub fn create(path: &Path) -> std::io::Result<Self> {
        Ok(FaultLog { file: BufWriter::new(File::create(path)?) })
    }

    /// Writes entries; they are in the file when this returns.
    pub fn write(&mut self, entries: &[Entry]) -> std::io::Result<()> {
        for entry in entries {
            serde_json::to_writer(&mut self.file, entry)?;
            self.file.write_all(b"\n")?;
        }
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_names_what_happened() {
        let mut tally = FaultTally::default();
        let mut text = String::new();
        tally.summary(&mut text);
        assert_eq!(text, "");
        for field in 0..1000 {
            tally.note(field, 1, Deed::Dropped);
        }
        tally.note(0, 1, Deed::Flicker { depth: 0.1, hz: 100.0 });
        tally.summary(&mut text);
        assert_eq!(text, "faults: dropped 1000, flicker");
        assert_eq!(tally.waiting().len(), WAITING, "bounded");
        tally.clear_waiting();
        assert_eq!((tally.count(Kind::Dropped), tally.waiting().len()), (1000, 0));
    }

    #[test]
    fn each_deed_is_a_line_of_json() {
        let path = std::env::temp_dir().join(format!("vitreo-faults-{}.jsonl", std::process::id()));
        let mut log = FaultLog::create(&path).unwrap();
        let deed = Deed::Occlusion { body: "inst0", markers: 5 };
        log.write(&[Entry { field: 7, camera: 2, deed }]).unwrap();
        log.write(&[Entry { field: 8, camera: 0, deed: Deed::Late { delay_ns: 30 } }]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let expected = [
            serde_json::json!({"field": 7, "camera": 2, "kind": "occlusion", "body": "inst0", "markers": 5}),
            serde_json::json!({"field": 8, "camera": 0, "kind": "late", "delay_ns": 30}),
        ];
        assert_eq!(lines, expected);
        for kind in Kind::ALL {
            assert!(crate::faults::spec::FaultSpec::presets().any(|name| name == kind.name()));
        }
    }
}
