//! A recorded run goes on behind a checkpoint in the middle of the file.

use super::pairs::Known;
use crate::engine::Recorded;
use crate::snapshot::Snapshot;
use protocol::time::Nanos;
use recording::Place;

/// How far behind a checkpoint the record of its step may stand, ns of log time.
const BEHIND_NS: u64 = 5_000_000_000;

impl Recorded {
    /// Goes on from what tracker and simulation knew, of which everything that was under way stands behind
    /// `place`; `begin` is a copy of the run at its beginning. False where the recording does not lead on from
    /// there; then the run stands anywhere.
    ///
    /// # Errors
    /// For a copy of a run of another scene.
    pub(crate) fn resume(&mut self, begin: &Snapshot, place: &Place, known: Known) -> anyhow::Result<bool> {
        self.restore(begin)?;
        self.begins_with = None;
        self.items.go_to(place);
        let Known { world: (header, state), mut tracker, from_ns } = known;
        let until_ns: Nanos = from_ns.saturating_add(BEHIND_NS);
        self.steps.resume_after(header, state);
        loop {
            while let Some(mut turn) = self.frames.next_turn() {
                let Some((header, state)) = &tracker else {
                    self.track(&mut turn);
                    continue;
                };
                let recorded = &turn.recorded;
                if (recorded.frame, recorded.instants.exposed) == (header.frame, header.exposed_ns) {
                    if !self.restore_tracker(state) {
                        return Ok(false);
                    }
                    tracker = None;
                }
            }
            while self.steps.next_step().is_some() {}
            if tracker.is_none() && !self.steps.is_resuming() {
                return Ok(true);
            }
            if self.steps.is_ended() || self.frames.horizon_ns() > until_ns {
                return Ok(false);
            }
            self.read();
        }
    }

    fn restore_tracker(&mut self, state: &[u8]) -> bool {
        // With the recorded poses there is none.
        let Some((tracker, _)) = &mut self.tracker else { return true };
        match tracker.restore(state) {
            Ok(()) => self.frames.go_on_determined(),
            Err(problem) => {
                tracing::warn!("a checkpoint of the tracker cannot be used: {problem}");
                return false;
            }
        }
        true
    }
}
