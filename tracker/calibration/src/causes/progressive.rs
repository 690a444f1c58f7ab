//! Pictures whose two fields were exposed together: blobs then move between pictures and not within them.
//!
//! The evidence needs no pose: between the fields of a picture nothing moves by more than noise, between
//! pictures everything moves by twice as much. An interlaced camera sees equal steps.

use super::Cause;
use protocol::blobs::BlobField;
use rig::Rig;

/// Distance within which the nearest blob of the same colour is the same marker, px.
const REACH_PX: f64 = 15.0;
/// Fewest steps of each kind that give a median.
const ENOUGH: usize = 200;
/// A picture's fields are one exposure where the median of their squared steps is below this share of the
/// median between pictures.
const STILL_SHARE: f64 = 0.15;
/// Least median between pictures, px²: below, nothing moves enough to tell.
const MOVING_PX2: f64 = 0.1;

/// The cameras whose pictures are progressive, as a cause; `None` where there are none, or nothing moves.
pub fn detect(rig: &Rig, fields: &[BlobField]) -> Option<Cause> {
    let ids: Vec<u32> = rig.cameras.iter().map(|c| c.id).collect();
    let found: Vec<u32> = ids.iter().copied().filter(|id| is_progressive(fields, *id)).collect();
    match found[..] {
        [] => None,
        [one] if ids.len() > 1 => Some(Cause::Progressive { camera: Some(one) }),
        _ if found.len() == ids.len() => Some(Cause::Progressive { camera: None }),
        [first, ..] => Some(Cause::Progressive { camera: Some(first) }),
    }
}

/// The fields without the second one of each progressive picture.
pub fn first_fields(cause: &Cause, fields: &[BlobField]) -> Vec<BlobField> {
    let Cause::Progressive { camera } = cause else { return fields.to_vec() };
    let second = |f: &BlobField| {
        camera.is_none_or(|id| id == f.camera) && Some(f.field % 2) == second_number(fields, f.camera)
    };
    fields.iter().filter(|f| !second(f)).copied().collect()
}

fn is_progressive(fields: &[BlobField], camera: u32) -> bool {
    second_number(fields, camera).is_some()
}

/// Remainder by two of the numbers of a camera's second fields.
fn second_number(fields: &[BlobField], camera: u32) -> Option<u64> {
    let [even, odd] = [0, 1].map(|of| steps(fields, camera, of));
    let median = |mut steps: Vec<f64>| {
        steps.sort_by(f64::total_cmp);
        (steps.len() >= ENOUGH).then(|| steps[steps.len() / 2])
    };
    let (from_even, from_odd) = (median(even)?, median(odd)?);
    if from_odd > MOVING_PX2 && from_even < STILL_SHARE * from_odd {
        Some(1)
    } else if from_even > MOVING_PX2 && from_odd < STILL_SHARE * from_even {
        Some(0)
    } else {
        None
    }
}

/// Squared steps of a camera's blobs, px², from fields with such numbers to the next.
fn steps(fields: &[BlobField], camera: u32, number: u64) -> Vec<f64> {
    let own: Vec<&BlobField> = fields.iter().filter(|f| f.camera == camera).collect();
    let pairs = own.windows(2).filter(|p| p[1].field == p[0].field + 1 && p[0].field % 2 == number);
    pairs.flat_map(|p| p[0].blobs().iter().filter_map(|blob| step(p[0], blob, p[1]))).collect()
}

fn step(from: &BlobField, blob: &protocol::blobs::Blob, to: &BlobField) -> Option<f64> {
    let square = |other: &protocol::blobs::Blob| {
        let [x, y] = [other.x_px - blob.x_px, to.y_frame_px(other) - from.y_frame_px(blob)];
        x * x + y * y
    };
    let same = to.blobs().iter().filter(|other| other.colour == blob.colour).map(square);
    same.min_by(f64::total_cmp).filter(|d2| *d2 < REACH_PX * REACH_PX)
}
