//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 16;

/// FNV-1a digests of all bodies that the tracker makes of the streams of `proofs/validation/tests/version.rs`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x596ca317d8644783),
    ("nominal", 0xdf1931d5a5092375),
    ("samecol", 0xa8d538daabfd1f0b),
    ("static", 0xbaa9acf88fcd07d6),
    ("hard", 0xf07c4561d7516e98),
    ("knocked", 0xa8ff11e25e864ba9),
];
