//! What a camera or a marker that was moved does not explain, once it is mended.
//!
//! Of two errors the larger one alone may be named: with it mended, what the smaller one leaves may
//! be little beside what there was, and is still above the noise.

use super::judgement::Explanation;
use super::together::{self, Together};
use super::{Cause, measure, places};
use protocol::blobs::BlobField;
use rig::Rig;

/// Adds to each part that was moved the other one that the rest names.
pub fn complete(rig: &Rig, fields: &[BlobField], explanations: Vec<Explanation>) -> Vec<Explanation> {
    let mut out: Vec<Explanation> = Vec::new();
    for single in explanations {
        let whole = with_rest(rig, fields, &single).unwrap_or(single);
        if out.iter().all(|other| other.cause != whole.cause) {
            out.push(whole);
        }
    }
    out
}

/// The explanation with what the rest names beside it; `None` where the rest is noise, or more of the same.
fn with_rest(rig: &Rig, fields: &[BlobField], single: &Explanation) -> Option<Explanation> {
    let mended = places::moved(rig, fields, &single.cause)?;
    let rest = together::estimate(&mended, fields).ok()?;
    if rest.above.is_noise() || !rest.mends(&mended, fields) {
        return None;
    }
    let cause = joined(&single.cause, &rest)?;
    let left = measure::measure(&rest.found.bundle.rig(&mended), fields);
    Some(Explanation { cause, left_px: left.all.rms()?, blobs: left.all.count })
}

/// One cause for a part that was moved and for what explains the rest.
fn joined(single: &Cause, rest: &Together) -> Option<Cause> {
    let rest = || rest.explained.iter().map(|(cause, _)| cause);
    if rest().any(|cause| is_same(single, cause)) {
        return None;
    }
    rest().find_map(|cause| match (single, cause) {
        (Cause::CameraMoved { camera, .. }, Cause::CameraMoved { camera: other, .. }) => {
            Some(Cause::CamerasMoved { cameras: [*camera.min(other), *camera.max(other)] })
        }
        (Cause::CameraMoved { camera, .. }, Cause::CamerasMoved { cameras }) if cameras.contains(camera) => {
            Some(cause.clone())
        }
        (
            _,
            Cause::CameraMoved { .. }
            | Cause::CamerasMoved { .. }
            | Cause::MarkerMoved { .. }
            | Cause::Drifted,
        ) => Some(Cause::Drifted),
        _ => None,
    })
}

/// True where both are of one camera or marker: it was not mended exactly.
fn is_same(a: &Cause, b: &Cause) -> bool {
    match (a, b) {
        (Cause::CameraMoved { camera: a, .. }, Cause::CameraMoved { camera: b, .. }) => a == b,
        (Cause::MarkerMoved { body: a, marker: m, .. }, Cause::MarkerMoved { body: b, marker: n, .. }) => {
            (a, m) == (b, n)
        }
        _ => false,
    }
}
