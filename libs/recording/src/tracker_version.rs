//! Version of the tracker's arithmetic, and what it computes at that version. `make tracker-version` writes
//! this file.

/// Version of the tracker's arithmetic: the same camera-fields lead to the same poses, to the bit, where it
/// is the same. Recordings of builds before version 2 name none.
pub const TRACKER_VERSION: u32 = 8;

/// FNV-1a digests of all bodies that the tracker makes of the streams of `proofs/validation/tests/version.rs`.
#[rustfmt::skip]
#[allow(clippy::unreadable_literal)]
pub const TRACKER_DIGESTS: &[(&str, u64)] = &[
    ("calib", 0x941c88360b286d64),
    ("nominal", 0xf082b86679f6a27a),
    ("samecol", 0xa31085f686481fa1),
    ("static", 0x0c9570911c52c814),
    ("hard", 0x521bbe16457b4e9b),
    ("knocked", 0x79b2ec1e1b20e2ae),
];
