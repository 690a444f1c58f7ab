//! Start of the schedule on the clock, with pauses. Pure: the time is an argument.

use protocol::time::Nanos;

/// From the start of the loop to the first exposure, ns.
const LEAD_NS: u64 = 20_000_000;

/// Start of a schedule; a pause moves it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Timeline {
    start_ns: Nanos,
    paused_since: Option<Nanos>,
}

impl Timeline {
    /// The instant from which the schedule counts.
    pub(super) fn start(&self) -> Nanos {
        self.start_ns
    }

    /// Time since the start, ns; 0 before it.
    pub(super) fn elapsed(&self, now: Nanos) -> u64 {
        now.saturating_sub(self.start_ns)
    }

    /// The instant `offset_ns` after the start; `u64::MAX` during a pause.
    pub(super) fn instant(&self, offset_ns: u64) -> Nanos {
        if self.is_paused() { u64::MAX } else { self.start_ns.saturating_add(offset_ns) }
    }

    /// True between pause and resume.
    pub(super) fn is_paused(&self) -> bool {
        self.paused_since.is_some()
    }

    /// Pauses the schedule.
    pub(super) fn pause(&mut self, now: Nanos) {
        self.paused_since.get_or_insert(now);
    }

    /// Resumes the schedule; the start moves by the pause.
    pub(super) fn resume(&mut self, now: Nanos) {
        let pause_ns = self.paused_since.take().map_or(0, |since| now.saturating_sub(since));
        self.start_ns += pause_ns;
    }

    /// Moves the start by a time in which nothing went on.
    pub(super) fn shift(&mut self, by_ns: u64) {
        if !self.is_paused() {
            self.start_ns += by_ns;
        }
    }

    /// Goes on where `elapsed_ns` had passed since the start.
    pub(super) fn go_on(&mut self, now: Nanos, elapsed_ns: u64, paused: bool) {
        self.start_ns = now.saturating_sub(elapsed_ns);
        self.paused_since = paused.then_some(now);
    }

    /// Starts again after [`LEAD_NS`]; a pause continues.
    pub(super) fn restart(&mut self, now: Nanos) {
        self.start_ns = now + LEAD_NS;
        self.paused_since = self.paused_since.map(|_| self.start_ns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_moves_the_start_and_a_restart_keeps_the_pause() {
        let mut timeline = Timeline::default();
        timeline.restart(1_000);
        let start = timeline.start();
        assert_eq!((start, timeline.elapsed(500), timeline.instant(7)), (1_000 + LEAD_NS, 0, start + 7));
        timeline.pause(start + 100);
        timeline.pause(start + 150);
        assert_eq!(timeline.instant(7), u64::MAX);
        timeline.resume(start + 300);
        assert_eq!((timeline.start(), timeline.elapsed(start + 300)), (start + 200, 100));
        timeline.pause(start + 400);
        timeline.restart(start + 500);
        assert!(timeline.is_paused());
        timeline.resume(start + 500 + LEAD_NS + 40);
        assert_eq!(timeline.start(), start + 540 + LEAD_NS);
    }

    #[test]
    fn a_sleep_moves_the_start_and_who_goes_on_has_the_time_behind_him() {
        let mut timeline = Timeline::default();
        timeline.go_on(9_000, 2_000, true);
        assert_eq!((timeline.start(), timeline.elapsed(9_000), timeline.is_paused()), (7_000, 2_000, true));
        timeline.shift(50);
        assert_eq!(timeline.start(), 7_000, "a pause counts once");
        timeline.resume(9_100);
        timeline.shift(50);
        assert_eq!(timeline.start(), 7_150);
    }
}
