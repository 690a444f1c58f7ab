//! Exit codes. Scripts depend on them, so they do not change.

/// Something failed, or an input file does not exist.
pub const FAILED: u8 = 1;
/// Wrong usage: an invalid option or an unknown name. clap exits with this code too.
pub const WRONG_USE: u8 = 2;
/// Completed, but with loss of data.
pub const LOSS: u8 = 3;
/// A latency budget was exceeded.
pub const BUDGET: u8 = 4;
/// Verification found a difference.
pub const DIFFERS: u8 = 5;
/// A body was tracked in a smaller part of the frames than asserted.
pub const UNTRACKED: u8 = 6;
/// There were warnings, or too little was judged, although the absence of warnings was asserted.
pub const WARNED: u8 = 7;
/// Ended by a signal such as Ctrl-C.
pub const INTERRUPTED: u8 = 130;

/// The command line contains something unknown or contradictory; nothing was started.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WrongUse(pub String);
