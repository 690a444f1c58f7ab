//! Counts and log of the injected faults.

use super::{FaultEvent, FaultKind};
use outputs::{OutputError, Outputs};
use serde::Serialize;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Most events between two writes of the log; further ones are only counted.
const WAITING: usize = 256;

/// A fault event with its field: one line of the fault log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FaultRecord {
    /// Number of the field; 0 for a permanent fault.
    pub field: u64,
    /// Camera id.
    pub camera: u32,
    /// The event.
    #[serde(flatten)]
    pub event: FaultEvent,
}

/// Counts the events and holds those not yet written.
#[derive(Debug, Clone)]
pub struct FaultTally {
    counts: [u64; FaultKind::ALL.len()],
    waiting: Vec<FaultRecord>,
}

impl Default for FaultTally {
    fn default() -> Self {
        FaultTally { counts: [0; FaultKind::ALL.len()], waiting: Vec::with_capacity(WAITING) }
    }
}

impl FaultTally {
    /// Adds an event.
    pub fn record(&mut self, field: u64, camera: u32, event: FaultEvent) {
        self.counts[event.kind() as usize] += 1;
        if self.waiting.len() < WAITING {
            self.waiting.push(FaultRecord { field, camera, event });
        }
    }

    /// Number of fields with this fault; of cameras for a permanent one.
    pub fn count(&self, kind: FaultKind) -> u64 {
        self.counts[kind as usize]
    }

    /// Events not yet written.
    pub fn waiting(&self) -> &[FaultRecord] {
        &self.waiting
    }

    /// Drops the events that were written.
    pub fn clear_waiting(&mut self) {
        self.waiting.clear();
    }

    /// Appends the counts above zero to `text`: `faults: dropped 3, late 5, flicker`.
    pub fn summary(&self, text: &mut String) {
        let mut before = "faults: ";
        for kind in FaultKind::ALL.into_iter().filter(|&k| self.count(k) > 0) {
            text.push_str(before);
            text.push_str(kind.name());
            if !kind.is_permanent() {
                // Writing to a String cannot fail.
                let _ = write!(text, " {}", self.count(kind));
            }
            before = ", ";
        }
    }
}

/// The fault log: one line of JSON an event.
pub struct FaultLog {
    file: BufWriter<File>,
    path: PathBuf,
}

impl FaultLog {
    /// Creates the file.
    ///
    /// # Errors
    /// Where the file is refused.
    pub fn create(path: &Path, force: bool) -> Result<Self, OutputError> {
        let mut file = Outputs::new(force).grow(path)?;
        file.appear()?;
        Ok(FaultLog { file: BufWriter::new(file.handle()?), path: path.into() })
    }

    /// Writes records and flushes them to the file.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&mut self, records: &[FaultRecord]) -> Result<(), OutputError> {
        let mut write = || {
            for record in records {
                serde_json::to_writer(&mut self.file, record)?;
                self.file.write_all(b"\n")?;
            }
            self.file.flush()
        };
        write().map_err(|problem| OutputError::io(&self.path, problem))
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
            tally.record(field, 1, FaultEvent::Dropped);
        }
        tally.record(0, 1, FaultEvent::Flicker { depth: 0.1, hz: 100.0 });
        tally.summary(&mut text);
        assert_eq!(text, "faults: dropped 1000, flicker");
        assert_eq!(tally.waiting().len(), WAITING, "bounded");
        tally.clear_waiting();
        assert_eq!((tally.count(FaultKind::Dropped), tally.waiting().len()), (1000, 0));
    }

    #[test]
    fn each_event_is_a_line_of_json() {
        let path = std::env::temp_dir().join(format!("vitreo-faults-{}.jsonl", std::process::id()));
        let mut log = FaultLog::create(&path, true).unwrap();
        let event = FaultEvent::Occlusion { body: "inst0", markers: 5 };
        log.write(&[FaultRecord { field: 7, camera: 2, event }]).unwrap();
        log.write(&[FaultRecord { field: 8, camera: 0, event: FaultEvent::Late { delay_ns: 30 } }]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let expected = [
            serde_json::json!({"field": 7, "camera": 2, "kind": "occlusion", "body": "inst0", "markers": 5}),
            serde_json::json!({"field": 8, "camera": 0, "kind": "late", "delay_ns": 30}),
        ];
        assert_eq!(lines, expected);
        for kind in FaultKind::ALL {
            assert!(crate::faults::spec::FaultSpec::presets().any(|name| name == kind.name()));
        }
    }
}
