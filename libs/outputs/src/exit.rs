//! Exit codes. Scripts depend on them, so they do not change.

/// Something failed; also an input file that does not exist.
pub const FAILED: u8 = 1;
/// Wrong usage: an invalid option or the name of nothing that is shipped. clap exits with this code too.
pub const WRONG_USE: u8 = 2;
/// Done, but something was lost.
pub const LOSS: u8 = 3;
/// A latency budget was broken.
pub const BUDGET: u8 = 4;
/// Verification found a difference.
pub const DIFFERS: u8 = 5;
/// A body was tracked less than asserted.
pub const UNTRACKED: u8 = 6;
/// There were warnings, and it was asserted that there are none.
pub const WARNED: u8 = 7;
/// A signal ended it: Ctrl-C, say.
pub const INTERRUPTED: u8 = 130;

/// The command line names something unknown; nothing has started.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WrongUse(pub String);
