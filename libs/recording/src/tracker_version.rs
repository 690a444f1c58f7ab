//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 4;

/// FNV-1a digests of all bodies that the tracker makes of streams in `tests/data/tracker`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x573c22f800eb3385),
    ("nominal", 0xd8ad40c1690833eb),
    ("samecol", 0x3a7362fa772b83e0),
    ("static", 0x6b3fcbd4edcb3410),
];
