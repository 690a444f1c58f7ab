//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 14;

/// FNV-1a digests of all bodies that the tracker makes of the streams of `proofs/validation/tests/version.rs`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x8f1ad4821405a8da),
    ("nominal", 0xd6fbc281cd57cd86),
    ("samecol", 0x74908de6fc7f7e76),
    ("static", 0xd4ea9c21a1a14e01),
    ("hard", 0xd44a8c2fe849ad50),
    ("knocked", 0x3cc74de240f77212),
];
