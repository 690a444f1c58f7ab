//! How long nothing has come.

use protocol::time::Nanos;

/// Time without a line after which a stream is silent, ns.
pub const SILENT_NS: u64 = 500_000_000;

/// Watches that something comes.
#[derive(Debug, Clone, Default)]
pub struct Silence {
    /// When something came last; 0 before the first.
    last_ns: Nanos,
    lasts: bool,
    longest_ns: u64,
    count: u64,
}

impl Silence {
    /// Something arrived; returns the length of the silence before, if it was reported.
    pub fn note(&mut self, at: Nanos) -> Option<u64> {
        let silent_ns = self.since_last(at);
        self.longest_ns = self.longest_ns.max(silent_ns);
        self.last_ns = at;
        std::mem::take(&mut self.lasts).then_some(silent_ns)
    }

    /// True once in each silence, when it has lasted for [`SILENT_NS`].
    pub fn begins(&mut self, at: Nanos) -> bool {
        let silent_ns = self.since_last(at);
        let begins = !self.lasts && silent_ns >= SILENT_NS;
        self.lasts |= begins;
        self.count += u64::from(begins);
        self.longest_ns = self.longest_ns.max(silent_ns);
        begins
    }

    /// The time until now is no silence: the stream was not read, or nothing was expected.
    pub fn excuse(&mut self, at: Nanos) {
        if self.last_ns > 0 && !self.lasts {
            self.last_ns = at;
        }
    }

    /// How many there were, the first wait for something not among them.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The longest, ns.
    pub fn longest_ns(&self) -> u64 {
        self.longest_ns
    }

    fn since_last(&self, at: Nanos) -> u64 {
        if self.last_ns == 0 { 0 } else { at.saturating_sub(self.last_ns) }
    }
}
