//! One timer a phase of the step.

use protocol::steps::StepProfile;

/// Adds up the time between laps, by phase.
pub(super) struct StepTimer<'a> {
    clock: &'a mut dyn FnMut() -> u64,
    /// When the last lap ended, ns.
    lap_ns: u64,
    profile: StepProfile,
}

impl<'a> StepTimer<'a> {
    /// Starts the first lap. `clock` gives nanoseconds.
    pub fn start(clock: &'a mut dyn FnMut() -> u64) -> Self {
        let lap_ns = clock();
        StepTimer { clock, lap_ns, profile: StepProfile::default() }
    }

    /// Ends a lap: its time is added to a phase.
    pub fn lap(&mut self, phase: impl FnOnce(&mut StepProfile) -> &mut u64) {
        let now = (self.clock)();
        *phase(&mut self.profile) += now.saturating_sub(self.lap_ns);
        self.lap_ns = now;
    }

    /// Times of all laps.
    pub fn profile(self) -> StepProfile {
        self.profile
    }
}
