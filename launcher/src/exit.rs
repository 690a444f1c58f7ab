//! Exit codes, a contract with other people's scripts. Wrong use exits with 2, which clap does by
//! itself.

/// Something failed.
pub const FAILED: u8 = 1;
/// Done, but something was lost.
pub const LOSS: u8 = 3;
/// A latency budget was broken.
pub const BUDGET: u8 = 4;
/// Verification found a difference.
pub const DIFFERS: u8 = 5;
/// A body was tracked less than asserted.
pub const UNTRACKED: u8 = 6;
