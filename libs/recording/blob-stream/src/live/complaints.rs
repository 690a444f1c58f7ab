//! Complaints of one kind: the first few are reported singly, the others as a count now and then.

use protocol::time::Nanos;

/// Number that is reported singly.
const EACH: u64 = 5;
/// After that so often, ns.
const PERIOD_NS: u64 = 1_000_000_000;

/// Says the first few in words, and then at most every second how many more there were.
#[derive(Debug, Clone, Default)]
pub struct Complaints {
    count: u64,
    reported: u64,
    reported_ns: Nanos,
    last: String,
}

impl Complaints {
    /// Takes one; returns what is to be said at once.
    pub fn note(&mut self, text: String, at: Nanos) -> Option<String> {
        self.count += 1;
        if self.count > EACH {
            self.last = text;
            return self.due(at);
        }
        (self.reported, self.reported_ns) = (self.count, at);
        Some(text)
    }

    /// The report that is due on those that were only counted.
    pub fn due(&mut self, at: Nanos) -> Option<String> {
        if at < self.reported_ns.saturating_add(PERIOD_NS) { None } else { self.rest(at) }
    }

    /// The same without waiting, at the end.
    pub fn rest(&mut self, at: Nanos) -> Option<String> {
        let more = self.count - self.reported;
        if more == 0 {
            return None;
        }
        (self.reported, self.reported_ns) = (self.count, at);
        Some(format!("{more} more of {}; the last: {}", self.count, self.last))
    }
}
