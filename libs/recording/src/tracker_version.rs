//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 9;

/// FNV-1a digests of all bodies that the tracker makes of the streams of `proofs/validation/tests/version.rs`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x1a58fcd97ce49970),
    ("nominal", 0x8dcaaa14a2e18853),
    ("samecol", 0x53ee1322d658a370),
    ("static", 0x4cf5f9b11bfe911f),
    ("hard", 0xd56e079a5f1de994),
    ("knocked", 0x9bc5d78d7734376b),
];
