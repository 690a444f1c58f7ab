//! Causes that are named although many blobs belong to no marker.
//!
//! In a stream with false blobs in every field, and an instrument that is taken out, a seventh of all blobs is explained by
//! no rig. The residual of all blobs then says little, and even the right remedy does not make the rig hold by it. There a
//! remedy is verified instead: with it, all that is estimated together is noise, and no marker lies beside its blobs.

use super::beside::hides_an_error;
use super::judge::{ALIKE, FOLLOWED};
use super::measure::{Left, measure};
use super::refit;
use super::remedy::{rescaled, undone};
use super::together::Together;
use super::{Cause, later, together, trial};
use crate::bundle::PriorSigmas;
use crate::mend::parts;
use protocol::blobs::BlobField;
use rig::Rig;

/// Remedies that are verified at most, the best first.
const MOST: usize = 4;
/// Least of the mean square that a remedy takes away, px².
const LEAST_PX2: f64 = 0.01;
/// How far two cameras are free, where all else stays.
const WIDE: PriorSigmas = PriorSigmas { camera_mm: 3.0, camera_rad: 0.02, marker_mm: 0.0, lens_px: 0.0 };

/// The causes whose remedies take away about as much as the best, and are verified.
pub fn singles(
    rig: &Rig,
    fields: &[BlobField],
    before: &Left,
    mut found: Vec<(Cause, Left)>,
) -> Vec<(Cause, Left)> {
    let taken = |left: &Left| before.mean() - left.mean();
    found.retain(|(_, left)| left.is_less(FOLLOWED) && taken(left) > LEAST_PX2);
    found.sort_by(|a, b| a.1.mean().total_cmp(&b.1.mean()));
    let best = found.first().map_or(0.0, |(_, left)| taken(left));
    found.retain(|(_, left)| taken(left) >= ALIKE * best);
    found.truncate(MOST);
    found.retain(|(cause, _)| holds_with(rig, fields, cause));
    found
}

/// A wrong scale of the distances between the cameras, with what it leaves; `None` where that is not what is wrong. It is
/// asked for where only all cameras and markers together explain the residuals: they also take up a scale.
pub fn scale(rig: &Rig, fields: &[BlobField]) -> Option<(Cause, Left)> {
    trial::scale(rig, fields).filter(|(cause, left)| left.is_less(FOLLOWED) && holds_with(rig, fields, cause))
}

/// Two cameras that were moved, by what is estimated together; `None` where the rig does not hold with both of them
/// mended. It is asked for where the tracker does not follow the rig with everything mended: if cameras are far off, a part
/// of that has gone into the places of markers.
pub fn two_cameras(rig: &Rig, fields: &[BlobField], found: &Together) -> Option<(Cause, Left)> {
    let two = |cause: &&Cause| matches!(cause, Cause::CamerasMoved { .. });
    found.explained.iter().map(|(cause, _)| cause).filter(two).find_map(|cause| {
        let (mended, rest) = refit::mended(rig, fields, &parts(rig, cause)?, &WIDE, found)?;
        let rig = mended.bundle.rig(rig);
        let left = measure(&rig, fields);
        let is_it = rest.above.is_noise() && left.is_less(FOLLOWED) && !hides_an_error(&rig, fields);
        is_it.then(|| (cause.clone(), left))
    })
}

/// True where nothing but noise is left with the remedy of a cause.
fn holds_with(rig: &Rig, fields: &[BlobField], cause: &Cause) -> bool {
    let mended = match *cause {
        Cause::Scale { camera: None, factor } => Some(rescaled(rig, factor)),
        _ => later::mended(rig, fields, cause),
    };
    let Some(mended) = mended else { return false };
    let fields = undone(rig, cause, fields);
    together::estimate(&mended, &fields).is_ok_and(|t| t.above.is_noise())
        && !hides_an_error(&mended, &fields)
}
