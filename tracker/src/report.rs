//! What a tracker logs while it works.

use crate::tracker::Tracker;

/// Logs each change once.
#[derive(Debug, Clone, Default)]
pub struct Report {
    drift: bool,
    restarts: u64,
}

impl Report {
    /// Logs what has changed: a rig that has drifted by more than the corrections of every calibration, cameras
    /// that disagree with the others, filters that were reset. `field`: of the newest frame.
    pub fn log(&mut self, tracker: &mut Tracker, field: u64) {
        let drift = tracker.drift().filter(|r| r.detected && r.is_large());
        if let Some(report) = drift.filter(|_| !self.drift) {
            tracing::warn!(field, "{report}");
            self.drift = true;
        }
        while let Some(notice) = tracker.take_notice() {
            tracing::warn!(field, "{notice}");
        }
        let restarts = tracker.restarts();
        if restarts > self.restarts {
            tracing::error!(field, restarts, "a filter or predictor was not finite and was reset");
        }
        self.restarts = restarts;
    }

    /// The tracker has forgotten what it knew.
    pub fn reset(&mut self) {
        self.drift = false;
    }
}
