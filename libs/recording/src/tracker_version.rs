//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 2;

/// FNV-1a digests of all bodies that the tracker makes of streams in `tests/data/tracker`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x397f79cbfe5326ca),
    ("nominal", 0x67e8623ff8fee0bc),
    ("samecol", 0x80dd8a6f3c149e0f),
    ("static", 0xabf6ab550930afca),
];
