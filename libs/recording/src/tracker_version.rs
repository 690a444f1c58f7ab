//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 4;

/// FNV-1a digests of all bodies that the tracker makes of streams in `tests/data/tracker`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x1e2c63f48fd89c84),
    ("nominal", 0xf02c99eb194e4997),
    ("samecol", 0xbbc7f623c6a8f426),
    ("static", 0x5f858fdb7da3ded9),
];
