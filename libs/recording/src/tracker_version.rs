//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 5;

/// FNV-1a digests of all bodies that the tracker makes of streams in `tests/data/tracker`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x21e3fb84a08fa33a),
    ("nominal", 0x528ad782bcaa1dee),
    ("samecol", 0x8fcec49e879bbd94),
    ("static", 0xe914b7d9db16fb47),
];
