//! Limits of restarts, and CPU time accumulated over restarts. Pure.

use protocol::time::Nanos;
use std::collections::VecDeque;

/// Maximum number of restarts of one process within [`WINDOW_NS`]; one more ends the run.
pub const MAX_RESTARTS: usize = 12;
/// Time window in which restarts are counted, ns. A process that dies whenever it is started reaches the
/// limit after about 25 s, in which a temporary shortage may pass.
pub const WINDOW_NS: u64 = 120_000_000_000;
/// A restarted process that worked for less than this, or never, is restarted with a delay, ns.
const SOON_NS: u64 = 300_000_000;
/// First delay, which doubles from death to death, and maximum delay, ns.
const FIRST_WAIT_NS: u64 = 20_000_000;
const LONGEST_WAIT_NS: u64 = 6_400_000_000;

/// Limits the rate of restarts of one process.
#[derive(Debug)]
pub struct RestartLimit {
    most: usize,
    /// Times of the restarts within the window, ns.
    recent: VecDeque<Nanos>,
    wait_ns: u64,
}

impl Default for RestartLimit {
    fn default() -> Self {
        Self::of(MAX_RESTARTS)
    }
}

impl RestartLimit {
    /// Allows `most` restarts within the window.
    pub fn of(most: usize) -> Self {
        RestartLimit { most, recent: VecDeque::new(), wait_ns: 0 }
    }

    /// Number of restarts allowed within the window.
    pub fn most(&self) -> usize {
        self.most
    }

    /// Time at which to restart a process that died at `now` after it had worked for `worked_ns`; `None` if
    /// the limit is reached.
    pub fn restart_at(&mut self, now: Nanos, worked_ns: u64) -> Option<Nanos> {
        while self.recent.front().is_some_and(|&t| now.saturating_sub(t) > WINDOW_NS) {
            self.recent.pop_front();
        }
        if self.recent.len() >= self.most {
            return None;
        }
        let soon = !self.recent.is_empty() && worked_ns < SOON_NS;
        let longer = (2 * self.wait_ns).clamp(FIRST_WAIT_NS, LONGEST_WAIT_NS);
        self.wait_ns = if soon { longer } else { 0 };
        self.recent.push_back(now + self.wait_ns);
        self.recent.back().copied()
    }
}

/// CPU time of a process and its successors, from their heartbeats. The time before a process's first
/// heartbeat, which is spent on loading, is excluded.
#[derive(Debug, Default)]
pub struct CpuAccount {
    last: Option<(u32, u64, Nanos)>,
    used_ns: u64,
    wall_ns: u64,
}

impl CpuAccount {
    /// Adds a heartbeat: process id, CPU time of the process so far, and timestamp of the heartbeat, ns.
    pub fn note(&mut self, pid: u32, cpu_ns: u64, at: Nanos) {
        if let Some((last_pid, last_cpu, last_at)) = self.last
            && last_pid == pid
        {
            self.used_ns += cpu_ns.saturating_sub(last_cpu);
            self.wall_ns += at.saturating_sub(last_at);
        }
        self.last = Some((pid, cpu_ns, at));
    }

    /// Average share of one core, 0 to the number of cores; 0 before the second heartbeat.
    pub fn share(&self) -> f64 {
        self.used_ns as f64 / self.wall_ns.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn restarts_are_bounded_in_a_window_and_allowed_again_after_it() {
        let mut limit = RestartLimit::default();
        let step = WINDOW_NS / 20;
        assert!((0..MAX_RESTARTS as u64).all(|i| limit.restart_at(i * step, step) == Some(i * step)));
        assert_eq!(limit.restart_at(MAX_RESTARTS as u64 * step, step), None);
        let later = WINDOW_NS + step / 2;
        assert_eq!(limit.restart_at(later, step), Some(later), "the first one is out of the window");
        assert_eq!(limit.restart_at(later + step / 4, step), None);
    }

    #[test]
    fn a_process_that_dies_at_once_is_given_longer_and_longer() {
        let (mut limit, mut now, mut waits) = (RestartLimit::default(), 50_000_000_000, Vec::new());
        while let Some(at) = limit.restart_at(now, 0) {
            waits.push((at - now) / 1_000_000);
            now = at + 60_000_000;
        }
        assert_eq!(waits[..11], [0, 20, 40, 80, 160, 320, 640, 1280, 2560, 5120, 6400]);
        assert_eq!(waits.len(), MAX_RESTARTS);
        let mut limit = RestartLimit::default();
        // A process that has worked is restarted without delay, however soon after its last restart it dies.
        let deaths = [(0, 0), (1, 50), (2, 700), (3, 0)].map(|(s, worked_ms)| {
            let at = s * 1_000_000_000;
            limit.restart_at(at, worked_ms * 1_000_000).unwrap() - at
        });
        assert_eq!(deaths, [0, 20_000_000, 0, 20_000_000]);
    }

    #[test]
    fn cpu_time_is_added_up_over_a_restart() {
        let mut cpu = CpuAccount::default();
        cpu.note(1, 500, 1000);
        cpu.note(1, 550, 1100);
        assert_eq!(cpu.share(), 0.5);
        cpu.note(2, 7, 5000);
        cpu.note(2, 107, 5100);
        assert_eq!(cpu.share(), 0.75);
    }
}
