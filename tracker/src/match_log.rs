//! What became of every blob of a frame: the record of associations and fits, for `matches`.
//!
//! Written from what an update has computed, after it: no pose depends on it. Nothing is allocated per
//! frame.

use crate::associate::{Association, AssociationInput, PredictedBody};
use crate::constants as k;
use crate::fit::{BlobMatch, PoseFit};
use crate::lines::BodyInField;
use crate::observation::{BlobObservation, FieldObservation, camera_of, marker_covariance};
use crate::pose_math::propagated;
use crate::projection::{MarkerImage, PoseMatrix, pose_jacobian, project_marker};
use crate::rig_model::RigModel;
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Matrix2, Vector2};
use protocol::blobs::{Blob, BlobField};
use protocol::limits::{BODIES, MAX_MARKERS};
use protocol::matches::{BlobUse, MatchFrame, MatchedBlob, MatchedField, MissedMarker, NO_BODY};
use protocol::poses::TrackerFrame;
use rig::camera::Camera;

/// Places are rounded to this part of a pixel, because their exact values stand on `blobs`, and so is the NIS:
/// a recording packs rounded numbers well.
const PLACE_STEPS: f64 = 16.0;
/// Innovations and residuals are rounded to this part of a pixel, 50 times below the noise.
const RESIDUAL_STEPS: f64 = 1024.0;

/// The matches of the newest frame.
pub struct MatchLog(Box<MatchFrame>);

impl Default for MatchLog {
    fn default() -> Self {
        MatchLog(Box::new(Zeroable::zeroed()))
    }
}

/// A copy of a tracker knows nothing of the frame before.
impl Clone for MatchLog {
    fn clone(&self) -> Self {
        MatchLog::default()
    }
}

/// What an update has found.
pub struct UpdateResult<'a> {
    /// The fields that were tracked.
    pub input: AssociationInput<'a>,
    /// Set of the cameras that are not left out.
    pub admitted: u32,
    /// Bodies as predicted before the update.
    pub prior: &'a [Option<PredictedBody>; BODIES],
    /// Blobs assigned to markers.
    pub association: &'a Association,
    /// Fits by body, accepted or not.
    pub fits: &'a [Option<PoseFit>; BODIES],
    /// True for the bodies whose fit the filter accepted.
    pub accepted: [bool; BODIES],
}

/// A marker as predicted in one camera.
#[derive(Clone, Copy)]
struct Prediction {
    image: MarkerImage,
    /// Covariance of the image by that of the pose, px².
    spread: Matrix2<f64>,
    variance_scale: f64,
}

/// Predictions by body and marker.
type Predictions = [[Option<Prediction>; MAX_MARKERS]; BODIES];

impl MatchLog {
    /// The newest frame's matches.
    pub fn frame(&self) -> &MatchFrame {
        &self.0
    }

    /// Begins the record of a frame.
    pub fn begin(&mut self, frame: &TrackerFrame) {
        let log = &mut *self.0;
        (log.field, log.frame, log.exposed_ns) = (frame.field, frame.frame, frame.instants.exposed);
        (log.camera, log.field_count) = (frame.camera, 0);
    }

    /// Adds the fields of one update, in this order.
    pub fn note(&mut self, fields: &[BlobField], result: &UpdateResult<'_>) {
        for field in fields {
            let Some(slot) = self.next_slot(field) else { return };
            let observed = result.input.fields.get(field.camera as usize);
            let observed = observed.and_then(|o| camera_of(result.input.rig, o).map(|camera| (o, camera)));
            match observed {
                Some((observed, camera)) => note_field(slot, field, observed, camera, result),
                None => note_all(slot, field, BlobUse::UnknownCamera),
            }
        }
    }

    /// Adds fields none of which is of a camera of the rig.
    pub fn note_unknown(&mut self, fields: &[BlobField]) {
        for field in fields {
            let Some(slot) = self.next_slot(field) else { return };
            note_all(slot, field, BlobUse::UnknownCamera);
        }
    }

    /// Adds the blobs by which a body was found, as far as they are in this frame.
    pub fn note_found(
        &mut self,
        rig: &RigModel,
        fields: &[FieldObservation],
        body: usize,
        pose: &Isometry3<f64>,
        matches: &[BlobMatch],
    ) {
        let placed = PoseMatrix::from(pose);
        for m in matches {
            let newest = self.0.fields_mut().iter_mut().rev().find(|f| f.camera as usize == m.camera);
            let (Some(slot), Some(camera)) = (newest, &rig.cameras[m.camera]) else { continue };
            let index = usize::from(fields[m.camera].source[m.blob]);
            let Some(entry) = slot.blobs[..slot.blob_count as usize].get_mut(index) else { continue };
            let image = project_marker(&rig.bodies[body].markers[m.marker], &placed, camera);
            (entry.outcome, entry.body, entry.marker) = (outcome_of(m, true), body as u32, m.marker as u32);
            (entry.innovation_x_px, entry.innovation_y_px, entry.nis) = (0.0, 0.0, 0.0);
            set_residual(entry, image.map(|image| m.pixel - image.pixel));
        }
    }

    fn next_slot(&mut self, field: &BlobField) -> Option<&mut MatchedField> {
        let slot = self.0.fields.get_mut(self.0.field_count as usize)?;
        self.0.field_count += 1;
        (slot.field, slot.camera, slot.parity) = (field.field, field.camera, field.parity);
        (slot.blob_count, slot.missed_count) = (0, 0);
        Some(slot)
    }
}

/// Adds all blobs of a field with one outcome.
fn note_all(slot: &mut MatchedField, field: &BlobField, outcome: BlobUse) {
    for (index, blob) in field.blobs().iter().enumerate() {
        slot.push(entry(index, field, blob, outcome));
    }
}

/// An entry without a marker.
fn entry(index: usize, field: &BlobField, blob: &Blob, outcome: BlobUse) -> MatchedBlob {
    MatchedBlob {
        blob: index as u32,
        outcome: outcome as u32,
        body: NO_BODY,
        marker: 0,
        x_px: rounded(blob.x_px, PLACE_STEPS),
        y_px: rounded(field.y_frame_px(blob), PLACE_STEPS),
        innovation_x_px: 0.0,
        innovation_y_px: 0.0,
        residual_x_px: 0.0,
        residual_y_px: 0.0,
        nis: 0.0,
    }
}

/// A number at a resolution of `steps` in one; 0 for what is not finite.
fn rounded(value: f64, steps: f64) -> f32 {
    let rounded = (libm::round(value * steps) / steps) as f32;
    if rounded.is_finite() { rounded } else { 0.0 }
}

fn note_field(
    slot: &mut MatchedField,
    field: &BlobField,
    observed: &FieldObservation,
    camera: &Camera,
    result: &UpdateResult<'_>,
) {
    let bit = 1 << observed.camera;
    let refused = match (result.admitted & bit != 0, result.input.cameras & bit != 0) {
        (false, _) => Some(BlobUse::CameraLeftOut),
        (true, false) => Some(BlobUse::FieldJumped),
        (true, true) => None,
    };
    let predictions = predict(result, observed, camera);
    let mut next = 0;
    for (index, blob) in field.blobs().iter().enumerate() {
        let mut entry = entry(index, field, blob, BlobUse::Malformed);
        if observed.sources().get(next).is_some_and(|source| usize::from(*source) == index) {
            entry.outcome = refused.unwrap_or(BlobUse::Unassigned) as u32;
            judge(&mut entry, next, observed, camera, &predictions, result);
            next += 1;
        }
        slot.push(entry);
    }
    if refused.is_none() {
        note_missed(slot, observed.camera, camera, &predictions, result.association);
    }
}

/// The markers of all bodies as predicted in one camera.
fn predict(result: &UpdateResult<'_>, observed: &FieldObservation, camera: &Camera) -> Predictions {
    let mut all = [[None; MAX_MARKERS]; BODIES];
    for ((of_body, prior), model) in all.iter_mut().zip(result.prior).zip(&result.input.rig.bodies) {
        let Some(prior) = prior else { continue };
        let (rig, dt_s) = (result.input.rig, result.input.dt_s(observed));
        let placed = BodyInField::new(rig, observed.camera, &prior.pose, &prior.motion, dt_s);
        for (slot, marker) in of_body.iter_mut().zip(&model.markers) {
            *slot = placed.image(marker, camera).map(|(image, pose)| {
                let jacobian = pose_jacobian(&image, &pose);
                let spread = jacobian * prior.covariance * jacobian.transpose();
                Prediction { image, spread, variance_scale: prior.variance_scale }
            });
        }
    }
    all
}

/// Enters what became of the observed blob `index`.
fn judge(
    entry: &mut MatchedBlob,
    index: usize,
    observed: &FieldObservation,
    camera: &Camera,
    predictions: &Predictions,
    result: &UpdateResult<'_>,
) {
    let its = |m: &&BlobMatch| m.camera == observed.camera && m.blob == index;
    let lists = result.association.matches.iter().enumerate();
    let matched = lists.filter_map(|(body, list)| Some((body, list.iter().find(its)?))).next();
    let Some((body, m)) = matched else {
        let seen = &observed.blobs[index];
        let area_scale = result.input.area_scales[observed.camera];
        return judge_unmatched(entry, seen, area_scale, predictions, result.input.rig);
    };
    (entry.body, entry.marker) = (body as u32, m.marker as u32);
    entry.outcome = outcome_of(m, result.accepted[body]);
    if let Some(prediction) = &predictions[body][m.marker] {
        set_innovation(entry, m.pixel - prediction.image.pixel, &m.covariance, prediction);
    }
    if let (Some(fit), Some(prior)) = (&result.fits[body], &result.prior[body]) {
        let pose = PoseMatrix::from(&propagated(&fit.pose, &prior.motion, m.dt_s));
        let image = project_marker(&result.input.rig.bodies[body].markers[m.marker], &pose, camera);
        set_residual(entry, image.map(|image| m.pixel - image.pixel));
    }
}

fn outcome_of(m: &BlobMatch, accepted: bool) -> u32 {
    let outcome = match (m.outlier, accepted, m.clean) {
        (true, _, _) => BlobUse::Outlier,
        (false, false, _) => BlobUse::BadFit,
        (false, true, true) => BlobUse::Used,
        (false, true, false) => BlobUse::UsedInPart,
    };
    outcome as u32
}

fn set_innovation(
    entry: &mut MatchedBlob,
    innovation: Vector2<f64>,
    covariance: &Matrix2<f64>,
    prediction: &Prediction,
) {
    let expected = prediction.spread + covariance * prediction.variance_scale;
    let Some(inverse) = expected.try_inverse() else { return };
    entry.innovation_x_px = rounded(innovation.x, RESIDUAL_STEPS);
    entry.innovation_y_px = rounded(innovation.y, RESIDUAL_STEPS);
    // 0 is without a prediction.
    let nis = innovation.dot(&(inverse * innovation)).clamp(1.0 / PLACE_STEPS, 1e9);
    entry.nis = rounded(nis, PLACE_STEPS);
}

fn set_residual(entry: &mut MatchedBlob, residual: Option<Vector2<f64>>) {
    let residual = residual.unwrap_or_default();
    entry.residual_x_px = rounded(residual.x, RESIDUAL_STEPS);
    entry.residual_y_px = rounded(residual.y, RESIDUAL_STEPS);
}

/// Enters the nearest marker of its colour, and why the blob is not its. Where the camera is not tracked,
/// that stays the reason.
fn judge_unmatched(
    entry: &mut MatchedBlob,
    seen: &BlobObservation,
    area_scale: f64,
    predictions: &Predictions,
    rig: &RigModel,
) {
    let mut nearest: Option<(f64, usize, usize, &Prediction)> = None;
    let mut tracked = false;
    for (body, model) in rig.bodies.iter().enumerate() {
        for (marker, _) in model.markers.iter().enumerate().filter(|(_, m)| m.colour == seen.colour) {
            let Some(prediction) = predictions[body].get(marker).and_then(Option::as_ref) else { continue };
            tracked = true;
            let distance2 = (seen.pixel - prediction.image.pixel).norm_squared();
            if distance2 < nearest.map_or(k::GATE_PX * k::GATE_PX, |n| n.0) {
                nearest = Some((distance2, body, marker, prediction));
            }
        }
    }
    let refused = entry.outcome != BlobUse::Unassigned as u32;
    let Some((_, body, marker, prediction)) = nearest else {
        if !tracked && !refused {
            entry.outcome = BlobUse::NotTracked as u32;
        }
        return;
    };
    (entry.body, entry.marker) = (body as u32, marker as u32);
    let innovation = seen.pixel - prediction.image.pixel;
    let covariance = marker_covariance(seen, &prediction.image, area_scale, k::AREA_RATIO);
    set_innovation(entry, innovation, &covariance.unwrap_or(seen.covariance), prediction);
    if !refused {
        entry.outcome = match covariance {
            None => BlobUse::WrongSize,
            Some(_) if f64::from(entry.nis) < k::GATE => BlobUse::Duplicate,
            Some(_) => BlobUse::Gated,
        } as u32;
    }
}

/// Adds the markers that were predicted inside of the frame and got no blob.
fn note_missed(
    slot: &mut MatchedField,
    id: usize,
    camera: &Camera,
    predictions: &Predictions,
    association: &Association,
) {
    let [width, height] = camera.size_px.map(f64::from);
    for (body, of_body) in predictions.iter().enumerate() {
        for (marker, prediction) in of_body.iter().enumerate() {
            let Some(Prediction { image, .. }) = prediction else { continue };
            let inside = (0.0..width).contains(&image.pixel.x) && (0.0..height).contains(&image.pixel.y);
            let matched = association.matches[body].iter().any(|m| m.camera == id && m.marker == marker);
            if inside && !matched {
                let [x_px, y_px] = [image.pixel.x, image.pixel.y].map(|v| rounded(v, PLACE_STEPS));
                slot.push_missed(MissedMarker { body: body as u32, marker: marker as u32, x_px, y_px });
            }
        }
    }
}
