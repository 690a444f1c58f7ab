//! Exit codes, a contract with other people's scripts.

/// Something failed.
pub const FAILED: u8 = 1;
/// Wrong use of the command line (clap exits with it too).
pub const WRONG_USE: u8 = 2;
/// Done, but something was lost.
pub const LOSS: u8 = 3;
/// A latency budget was broken.
pub const BUDGET: u8 = 4;
/// Verification found a difference.
pub const DIFFERS: u8 = 5;
