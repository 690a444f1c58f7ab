//! Whether a process slept: was stopped by a signal, or had no processor, for longer than its inputs
//! mean the present. Pure: the present instant is an argument.

use protocol::time::Nanos;

/// A loop that takes this long for a turn has slept, ns. Its waits are bounded to 5 ms; what came in
/// between is ten fields old and more.
pub const SLEPT_NS: u64 = 200_000_000;

/// Watches the turns of a loop.
#[derive(Debug, Default, Clone, Copy)]
pub struct Awake {
    last_ns: Nanos,
}

impl Awake {
    /// To be asked once a turn: how long the process slept since the turn before, ns, if it did.
    pub fn slept(&mut self, now: Nanos) -> Option<u64> {
        let since_ns = now.saturating_sub(self.last_ns);
        let slept = self.last_ns > 0 && since_ns >= SLEPT_NS;
        self.last_ns = now;
        slept.then_some(since_ns)
    }

    /// So much of the present turn is no sleep, ns.
    pub fn excuse(&mut self, busy_ns: u64) {
        self.last_ns += busy_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_long_turn_is_a_sleep_and_it_is_told_once() {
        let mut awake = Awake::default();
        let told = [9_000_000_000, 9_005_000_000, 9_204_999_999, 9_404_999_999, 9_410_000_000];
        assert_eq!(told.map(|at| awake.slept(at)), [None, None, None, Some(SLEPT_NS), None]);
        awake.excuse(150_000_000);
        assert_eq!(awake.slept(9_700_000_000), None);
    }
}
