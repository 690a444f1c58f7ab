//! One timer a phase of the step.

use protocol::phases::{Phase, PhaseClock};
use protocol::steps::StepProfile;

/// Adds up the time between laps, by phase.
pub(super) struct StepTimer<'a, C> {
    clock: &'a mut C,
    /// When the last lap ended, ns.
    lap_ns: u64,
    profile: StepProfile,
}

impl<'a, C: PhaseClock> StepTimer<'a, C> {
    /// Starts the first lap. `clock` gives nanoseconds, and takes note of the laps if it wants to.
    pub fn start(clock: &'a mut C) -> Self {
        let lap_ns = clock.read();
        StepTimer { clock, lap_ns, profile: StepProfile::default() }
    }

    /// Ends a lap: its time is added to a phase.
    pub fn lap(&mut self, phase: Phase) {
        let now = self.clock.read();
        *self.profile.time_of(phase) += now.saturating_sub(self.lap_ns);
        self.clock.lap(phase, [self.lap_ns, now]);
        self.lap_ns = now;
    }

    /// Times of all laps.
    pub fn profile(self) -> StepProfile {
        self.profile
    }
}
