//! Standby renderers, with everything loaded and compiled, which takes seconds on a software driver. While
//! they wait they use memory but no processor time. The first one is ready before the first field, so that
//! nothing is compiled while frames are judged.

use crate::children::Child;
use protocol::health::Process;
use protocol::time::Nanos;

/// Option that makes a renderer wait for its promotion.
pub const OPTION: &str = "--standby";
/// Uptime of the renderer before a standby is prepared, ns, and time between the preparations of two
/// standbys. The first standby is prepared at once. Preparation takes processor time from the renderer.
const AFTER_NS: u64 = 1_500_000_000;
/// Number of standbys after a renderer has died. A renderer that dies soon after its promotion needs the
/// second one.
const WAITING: usize = 2;
/// Minimum available memory to start a standby, KiB.
const MEMORY_KIB: u64 = 1 << 20;
/// Number of failures of waiting standbys after which no more are started.
const MAX_FAILURES: u32 = 3;

/// The waiting renderers, oldest first.
#[derive(Debug, Default)]
pub struct Standby {
    children: Vec<Child>,
    /// Time since which the renderer has been working, or since the last standby was prepared, ns.
    at_work_since: Option<Nanos>,
    failures: u32,
    /// True once a standby has been requested.
    begun: bool,
    /// True once a standby has been promoted.
    used: bool,
}

impl Standby {
    /// True if a standby should be started now. `at_work`: a renderer is working.
    pub fn is_wanted(&mut self, now: Nanos, at_work: bool) -> bool {
        let waited = self.children.len();
        self.children.retain(|child| child.exited().is_none());
        self.failures += (waited - self.children.len()) as u32;
        if !at_work {
            self.at_work_since = None;
            return false;
        }
        let since = *self.at_work_since.get_or_insert(now);
        let enough = if self.used { WAITING } else { 1 };
        let after_ns = if self.begun { AFTER_NS } else { 0 };
        if self.children.len() >= enough
            || self.failures >= MAX_FAILURES
            || now.saturating_sub(since) < after_ns
        {
            return false;
        }
        // If there is too little memory, a standby is requested again later.
        (self.begun, self.at_work_since) = (true, None);
        is_memory_enough()
    }

    /// True if the start of a run need not wait for the first standby: it is ready, or there is none.
    pub fn is_prepared(&self) -> bool {
        self.begun && self.children.iter().all(|c| c.is_ready() || c.exited().is_some())
    }

    /// Stores a started standby; `None` if it could not be started.
    pub fn set(&mut self, child: Option<Child>) {
        self.failures += u32::from(child.is_none());
        self.children.extend(child);
        self.at_work_since = None;
    }

    /// True if a standby is waiting.
    pub fn waits(&self) -> bool {
        !self.children.is_empty()
    }

    /// Promotes the oldest standby to take the place of a renderer; `arguments` are those of the renderer's
    /// restart. `None` for another process or without a standby.
    pub fn take_over(&mut self, process: Process, arguments: &[String]) -> Option<Child> {
        self.children.retain(|child| child.exited().is_none());
        if process != Process::Renderer || self.children.is_empty() {
            return None;
        }
        let mut child = self.children.remove(0);
        (self.used, self.at_work_since) = (true, None);
        // The last argument is the quality tier; it is missing if no frame was drawn.
        child.write_line(arguments.last().map_or("", String::as_str)).ok()?;
        Some(child)
    }
}

fn is_memory_enough() -> bool {
    let info = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    available_kib(&info).is_some_and(|kib| kib >= MEMORY_KIB)
}

fn available_kib(info: &str) -> Option<u64> {
    let line = info.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().trim_end_matches("kB").trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_wanted_when_the_renderer_has_worked_for_a_while() {
        let mut standby = Standby::default();
        let second = 1_000_000_000;
        assert!(!standby.is_prepared(), "not before it was asked for");
        assert_eq!(standby.is_wanted(9 * second, true), is_memory_enough(), "the first at once");
        assert!(standby.is_prepared(), "there is none");
        assert!(!standby.is_wanted(10 * second, true));
        assert!(!standby.is_wanted(12 * second, false), "it died");
        assert!(!standby.is_wanted(14 * second, true), "counted from the start");
        assert_eq!(standby.is_wanted(16 * second, true), is_memory_enough());
        (0..MAX_FAILURES).for_each(|_| standby.set(None));
        assert!(!standby.is_wanted(30 * second, true) && !standby.is_wanted(40 * second, true));
    }

    #[test]
    fn the_memory_available_is_read() {
        assert_eq!(available_kib("MemTotal: 9 kB\nMemAvailable:   16243900 kB\n"), Some(16_243_900));
        assert_eq!(available_kib("MemTotal: 9 kB\n"), None);
    }
}
