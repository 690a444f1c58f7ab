//! How often a process may be restarted, and how its CPU time is counted. Pure.

use protocol::time::Nanos;
use std::collections::VecDeque;

/// Restarts of one process that are allowed within [`WINDOW_NS`]; one more ends the run.
pub const MAX_RESTARTS: usize = 5;
/// The time in which they are counted, ns.
pub const WINDOW_NS: u64 = 60_000_000_000;

/// Bounds the rate of restarts of one process.
#[derive(Debug, Default)]
pub struct RestartLimit {
    recent: VecDeque<Nanos>,
}

impl RestartLimit {
    /// Asks for one more restart at `now`; false if there were too many of late.
    pub fn allows(&mut self, now: Nanos) -> bool {
        while self.recent.front().is_some_and(|&t| now.saturating_sub(t) > WINDOW_NS) {
            self.recent.pop_front();
        }
        let allowed = self.recent.len() < MAX_RESTARTS;
        if allowed {
            self.recent.push_back(now);
        }
        allowed
    }
}

/// CPU time of a process and its successors, from their heartbeats. What a process used before
/// its first heartbeat here is left out: that is loading, not running.
#[derive(Debug, Default)]
pub struct CpuAccount {
    last: Option<(u32, u64, Nanos)>,
    used_ns: u64,
    wall_ns: u64,
}

impl CpuAccount {
    /// Takes a heartbeat: process id, its CPU time so far, and the heartbeat's instant, ns.
    pub fn note(&mut self, pid: u32, cpu_ns: u64, at: Nanos) {
        if let Some((last_pid, last_cpu, last_at)) = self.last
            && last_pid == pid
        {
            self.used_ns += cpu_ns.saturating_sub(last_cpu);
            self.wall_ns += at.saturating_sub(last_at);
        }
        self.last = Some((pid, cpu_ns, at));
    }

    /// Share of one core, 0 to the number of cores; 0 before the second heartbeat.
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
        let second = 1_000_000_000;
        assert!((0..MAX_RESTARTS as u64).all(|i| limit.allows(i * second)));
        assert!(!limit.allows(10 * second));
        assert!(limit.allows(WINDOW_NS + second / 2), "the first one is out of the window");
        assert!(!limit.allows(WINDOW_NS + second / 2));
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
