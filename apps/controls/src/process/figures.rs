//! The figures of pedal and handles as a small file in the instance's private directory, for the report.

use protocol::controls::{CONTROLS_FILE, ControlFigures};
use std::path::{Path, PathBuf};

/// The file.
pub(super) struct Figures {
    path: PathBuf,
    /// A failure was reported.
    failure_reported: bool,
}

impl Figures {
    pub(super) fn in_directory(directory: &Path) -> Self {
        Figures { path: directory.join(CONTROLS_FILE), failure_reported: false }
    }

    /// Keeps them, whole or not at all.
    pub(super) fn keep(&mut self, controls: &[ControlFigures]) {
        if let (Err(problem), false) = (ipc::write_whole_json(&self.path, &controls), self.failure_reported) {
            self.failure_reported = true;
            tracing::warn!("the statistics of pedal and handles cannot be written: {problem}");
        }
    }
}
