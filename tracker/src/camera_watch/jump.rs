//! A field that jumps: most of its markers lie off their predictions by one turn and shift of the camera,
//! and they belong to more than one body.

use super::{CameraJacobian, scaled_jacobian, sighting, solve};
use crate::associate::{AssociationInput, PredictedBody};
use crate::constants as k;
use crate::observation::{FieldObservation, camera_of};
use crate::pose_math::{Matrix6, Vector6, propagated};
use crate::projection::{PoseMatrix, pose_jacobian};
use nalgebra::Vector2;
use protocol::limits::{BODIES, MAX_MARKERS};
use protocol::poses::EYE;

/// A marker with the nearest blob of its colour.
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
    let (offsets, count) = offsets(input, field, predicted);
    let offsets = &offsets[..count];
    let far = offsets.iter().flatten().filter(|o| o.px.norm() > k::KNOCK_JUMP_PX).count();
    if count < k::KNOCK_JUMP_MARKERS || 5 * far < 2 * count {
        return None;
    }
    let delta = robust_move(offsets)?;
    let mut agreeing = [0; BODIES];
    for o in offsets.iter().flatten() {
        agreeing[o.body] += u32::from((o.px - o.jacobian * delta).norm() < k::KNOCK_AGREES_PX);
    }
    let all: u32 = agreeing.iter().sum();
    let bodies = agreeing.iter().filter(|n| **n >= 2).count();
    let eye_alone = predicted.iter().enumerate().all(|(body, p)| p.is_none() == (body != EYE));
    // The eye is predicted best: where its markers stay, the instruments were predicted badly.
    let of_eye = || offsets.iter().flatten().filter(|o| o.body == EYE);
    let eye_px: f64 = of_eye().map(|o| o.px.norm()).sum::<f64>() / of_eye().count().max(1) as f64;
    if of_eye().count() > 0 && eye_px < k::KNOCK_JUMP_PX {
        return None;
    }
    let enough = 5 * all as usize >= 3 * count && all as usize >= k::KNOCK_JUMP_MARKERS;
    let moved: f64 = offsets.iter().flatten().map(|o| (o.jacobian * delta).norm()).sum();
    let px = moved / count as f64;
    (enough && (bodies >= 2 || eye_alone) && px > k::KNOCK_JUMP_PX).then_some(px)
}

/// All markers that have a blob of their colour and size near them.
fn offsets(
    input: &AssociationInput<'_>,
    field: &FieldObservation,
    predicted: &[Option<PredictedBody>; BODIES],
) -> ([Option<Offset>; BODIES * MAX_MARKERS], usize) {
    let mut found = [None; BODIES * MAX_MARKERS];
    let mut count = 0;
    let Some(camera) = camera_of(input.rig, field) else { return (found, 0) };
    let scale = input.area_scales[field.camera];
    for (body, predicted) in predicted.iter().enumerate() {
        let Some(predicted) = predicted else { continue };
        let pose = propagated(&predicted.pose, &predicted.motion, input.dt_s(field));
        let pose = PoseMatrix::from(&pose);
        for s in sighting::of_body(input.rig, body, &pose, camera, field, scale, k::KNOCK_REACH_PX) {
            let j = pose_jacobian(&s.image, &pose);
            // An eye that was just found is predicted badly itself.
            if body == EYE && (j * predicted.covariance * j.transpose()).trace() > k::KNOCK_SURE_PX2 {
                return (found, 0);
            }
            found[count] = Some(Offset {
                body,
                px: s.offset,
                jacobian: scaled_jacobian(camera, &s.image.jacobian, &s.image.point),
            });
            count += 1;
        }
    }
    (found, count)
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
