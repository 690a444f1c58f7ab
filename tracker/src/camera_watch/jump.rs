//! A field that jumps: most of its markers lie off their predictions by one turn and shift of the camera,
//! and they belong to more than one body.

use super::sighting::{self, Sighting};
use super::{CameraJacobian, scaled_jacobian, solve};
use crate::associate::{AssociationInput, PredictedBody};
use crate::constants as k;
use crate::lines::BodyInField;
use crate::observation::{FieldObservation, camera_of};
use crate::pose_math::{Matrix6, Vector6};
use crate::projection::{PoseMatrix, pose_jacobian};
use nalgebra::Vector2;
use protocol::limits::{BODIES, MAX_MARKERS};
use protocol::poses::EYE;
use rig::camera::Camera;

/// The markers of a body that a field shows whole, and its predicted pose.
#[derive(Clone, Copy)]
struct Seen {
    body: usize,
    pose: PoseMatrix,
    sighting: Sighting,
}

/// Distance of a blob from its predicted marker, and how a move of the camera changes it.
#[derive(Debug, Clone, Copy)]
struct Offset {
    body: usize,
    px: Vector2<f64>,
    jacobian: CameraJacobian,
}

/// Mean distance of the blobs of a field from their predicted markers, px, if the field jumps.
pub fn of_field(
    input: &AssociationInput<'_>,
    field: &FieldObservation,
    predicted: &[Option<PredictedBody>; BODIES],
) -> Option<f64> {
    let camera = camera_of(input.rig, field)?;
    let mut seen = [None; BODIES * MAX_MARKERS];
    let count = markers_seen(input, field, predicted, camera, &mut seen);
    let seen = seen[..count].iter().flatten();
    let far = seen.clone().filter(|s| s.sighting.offset.norm() > k::KNOCK_JUMP_PX).count();
    // The usual end: whatever follows is only computed for a field that may jump.
    if count < k::KNOCK_JUMP_MARKERS || 5 * far < 2 * count || !eye_jumps(seen.clone(), predicted) {
        return None;
    }
    let mut offsets = [None; BODIES * MAX_MARKERS];
    for (slot, s) in offsets.iter_mut().zip(seen) {
        let Sighting { image, offset, .. } = s.sighting;
        let jacobian = scaled_jacobian(camera, &image.jacobian, &image.point);
        *slot = Some(Offset { body: s.body, px: offset, jacobian });
    }
    let offsets = &offsets[..count];
    by_all(offsets, predicted).or_else(|| by_eye(offsets, predicted))
}

/// The same, where most markers and two bodies agree on one turn and shift, or the eye alone is tracked.
fn by_all(offsets: &[Option<Offset>], predicted: &[Option<PredictedBody>; BODIES]) -> Option<f64> {
    let count = offsets.len();
    let (px, agreeing) = common_move(offsets)?;
    let all: usize = agreeing.iter().sum();
    let bodies = agreeing.iter().filter(|n| **n >= 2).count();
    let eye_alone = predicted.iter().enumerate().all(|(body, p)| p.is_none() == (body != EYE));
    let enough = 5 * all >= 3 * count && all >= k::KNOCK_JUMP_MARKERS;
    (enough && (bodies >= 2 || eye_alone) && px > k::KNOCK_JUMP_PX).then_some(px)
}

/// The same, by the eye, which [`eye_jumps`] found to be predicted well: instruments that follow the moved
/// camera in part are not.
fn by_eye(offsets: &[Option<Offset>], predicted: &[Option<PredictedBody>; BODIES]) -> Option<f64> {
    predicted[EYE].as_ref()?;
    let mut of_eye = [None; MAX_MARKERS];
    let own = offsets.iter().flatten().filter(|o| o.body == EYE);
    let count = of_eye.iter_mut().zip(own).map(|(slot, o)| *slot = Some(*o)).count();
    let (px, agreeing) = common_move(&of_eye[..count])?;
    (agreeing[EYE] >= k::KNOCK_JUMP_MARKERS && px > k::KNOCK_JUMP_PX).then_some(px)
}

/// Mean distance by which the common turn and shift moves the markers, px, and how many of each body agree
/// with it.
fn common_move(offsets: &[Option<Offset>]) -> Option<(f64, [usize; BODIES])> {
    let delta = robust_move(offsets)?;
    let mut agreeing = [0; BODIES];
    for o in offsets.iter().flatten() {
        agreeing[o.body] += usize::from((o.px - o.jacobian * delta).norm() < k::KNOCK_AGREES_PX);
    }
    let moved: f64 = offsets.iter().flatten().map(|o| (o.jacobian * delta).norm()).sum();
    Some((moved / offsets.len().max(1) as f64, agreeing))
}

/// Collects the markers that a field shows whole; returns their number.
fn markers_seen(
    input: &AssociationInput<'_>,
    field: &FieldObservation,
    predicted: &[Option<PredictedBody>; BODIES],
    camera: &Camera,
    seen: &mut [Option<Seen>; BODIES * MAX_MARKERS],
) -> usize {
    let mut count = 0;
    let scale = input.area_scales[field.camera];
    for (body, predicted) in predicted.iter().enumerate() {
        let Some(predicted) = predicted else { continue };
        let (rig, dt_s) = (input.rig, input.dt_s(field));
        let placed = BodyInField::new(rig, field.camera, &predicted.pose, &predicted.motion, dt_s);
        for sighting in sighting::of_body(rig, body, &placed, camera, field, scale, k::KNOCK_REACH_PX) {
            let pose = placed.pose_at(sighting.image.pixel.y);
            seen[count] = Some(Seen { body, pose, sighting });
            count += 1;
        }
    }
    count
}

/// False if the eye's markers do not jump, or were not predicted well enough to decide. The eye is predicted
/// best: where its markers stay, the instruments were predicted badly.
fn eye_jumps<'a>(
    seen: impl Iterator<Item = &'a Seen> + Clone,
    predicted: &[Option<PredictedBody>; BODIES],
) -> bool {
    let of_eye = || seen.clone().filter(|s| s.body == EYE);
    let Some(eye) = predicted[EYE].as_ref().filter(|_| of_eye().count() > 0) else { return true };
    let sure = |s: &Seen| {
        let j = pose_jacobian(&s.sighting.image, &s.pose);
        (j * eye.covariance * j.transpose()).trace() <= k::KNOCK_SURE_PX2
    };
    let mean_px = of_eye().map(|s| s.sighting.offset.norm()).sum::<f64>() / of_eye().count() as f64;
    mean_px >= k::KNOCK_JUMP_PX && of_eye().all(sure)
}

/// The turn and shift of the camera that most offsets are, by repeated weighting (Cauchy).
fn robust_move(offsets: &[Option<Offset>]) -> Option<Vector6> {
    let mut delta = Vector6::zeros();
    for round in 0..6 {
        let (mut information, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
        for o in offsets.iter().flatten() {
            let off = (o.px - o.jacobian * delta).norm_squared();
            let weight =
                if round == 0 { 1.0 } else { 1.0 / (1.0 + off / (k::KNOCK_AGREES_PX * k::KNOCK_AGREES_PX)) };
            information += o.jacobian.transpose() * o.jacobian * (weight * k::KNOCK_WEIGHT);
            gradient += o.jacobian.transpose() * o.px * (weight * k::KNOCK_WEIGHT);
        }
        delta = solve(&information, &gradient)?;
    }
    Some(delta)
}
