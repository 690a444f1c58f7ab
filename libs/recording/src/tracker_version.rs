//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 13;

/// FNV-1a digests of all bodies that the tracker makes of the streams of `proofs/validation/tests/version.rs`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0xc5b65af07cc4c175),
    ("nominal", 0x88fc68ab3283f89e),
    ("samecol", 0x3521997e9addb234),
    ("static", 0x4cf5f9b11bfe911f),
    ("hard", 0x64ab873f7c047d7e),
    ("knocked", 0x559ded38944c9b64),
];
