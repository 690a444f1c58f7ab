//! A rig of which a few parts are free and all else stays, tracked again with what was found.

use super::together::{self, MOST, Together};
use crate::bundle::{FIXED_RIG, Freedom, Part, PriorSigmas};
use crate::lens::{DISTORTION, LENS};
use crate::observations::{FrameObservations, collect};
use crate::self_calibration::{SelfCalibration, refine_moving};
use protocol::blobs::BlobField;
use rig::Rig;

/// Rounds of tracking with what was found, until all blobs are followed, and estimating again.
const ROUNDS: usize = 2;
/// Deweighting of blobs at first: residuals come from the rig.
const ROUGH: f64 = 5.0;

/// The rig with some of its parts where they leave least; all else stays.
pub fn fit(
    rig: &Rig,
    instants: &[FrameObservations],
    parts: &[Part],
    wide: &PriorSigmas,
) -> Option<SelfCalibration> {
    // The higher terms of a lens are uncertain beside the first one, and their errors much like it.
    let higher_terms = |part: &Part| match *part {
        Part::Camera(c) => (DISTORTION + 1..LENS).map(|term| (c, term)).collect(),
        _ => Vec::new(),
    };
    let free = Freedom {
        known: FIXED_RIG,
        elsewhere: parts.to_vec(),
        wide: *wide,
        aside: 1.0,
        near_enough: together::NEAR,
        held: parts.iter().flat_map(higher_terms).collect(),
        ..Freedom::default()
    };
    refine_moving(rig, instants.to_vec(), MOST, &free, ROUGH).ok()
}

/// The same from what is tracked with it, at first with the rig of `found`; and what is wrong beside it.
pub fn mended(
    rig: &Rig,
    fields: &[BlobField],
    parts: &[Part],
    wide: &PriorSigmas,
    found: &Together,
) -> Option<(SelfCalibration, Together)> {
    let mut by = found.found.bundle.rig(rig);
    let mut last = None;
    for _ in 0..ROUNDS {
        let next = fit(rig, &collect(&by, fields), parts, wide)?;
        by = next.bundle.rig(rig);
        last = Some(next);
    }
    let rest = together::estimate(&by, fields).ok()?;
    last.map(|last| (last, rest))
}
