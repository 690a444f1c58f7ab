//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 5;

/// FNV-1a digests of all bodies that the tracker makes of streams in `tests/data/tracker`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x87c7236b2308d6ac),
    ("nominal", 0xcea73a414e9767c2),
    ("samecol", 0xd0b2f1266351bf79),
    ("static", 0xb04016ac44500f35),
];
