//! The figures of the cameras as a small file in the instance's private directory: the launcher puts
//! them into its report, and a restarted process goes on with the same numbers.

use protocol::deliveries::{DELIVERIES_FILE, Deliveries};
use std::fs;
use std::path::{Path, PathBuf};

/// The file.
pub(super) struct Figures {
    path: PathBuf,
    /// A failure was reported.
    failure_reported: bool,
}

impl Figures {
    pub(super) fn in_directory(directory: &Path) -> Self {
        Figures { path: directory.join(DELIVERIES_FILE), failure_reported: false }
    }

    /// What a predecessor in this instance left; `None` where there was none.
    pub(super) fn predecessor(&self) -> Option<Deliveries> {
        let left = serde_json::from_slice(&fs::read(&self.path).ok()?).ok();
        left.filter(|left: &Deliveries| left.start_ns > 0)
    }

    /// Keeps them, whole or not at all.
    pub(super) fn keep(&mut self, deliveries: &Deliveries) {
        if let (Err(problem), false) = (ipc::write_whole_json(&self.path, deliveries), self.failure_reported)
        {
            self.failure_reported = true;
            tracing::warn!("the statistics of the cameras cannot be written: {problem}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_successor_finds_the_start_and_no_half_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut figures = Figures::in_directory(folder.path());
        assert!(figures.predecessor().is_none());
        figures.keep(&Deliveries::default());
        assert!(figures.predecessor().is_none(), "it had not begun");
        let begun = Deliveries { start_ns: 7, ..Deliveries::default() };
        figures.keep(&begun);
        assert_eq!(figures.predecessor(), Some(begun));
        fs::write(folder.path().join(DELIVERIES_FILE), "{").unwrap();
        assert!(figures.predecessor().is_none());
    }
}
