//! Marker observations of a whole stream: the tracker finds the bodies with the rig as it is, then
//! every marker is assigned the nearest blob, if the assignment is unambiguous.

use crate::median;
use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, BlobField, WHOLE_FRAME};
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use rig::Rig;
use rig::camera::Camera;
use tracker::lines::BodyInField;
use tracker::observation::{BlobObservation, FieldObservation};
use tracker::rig_model::RigModel;
use tracker::stream::track_stream;

/// The observation of a marker in one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerObservation {
    /// Index of the camera in the rig file.
    pub camera: usize,
    /// Body.
    pub body: usize,
    /// Marker of the body.
    pub marker: usize,
    /// Centre, px of the frame.
    pub pixel: Vector2<f64>,
    /// Covariance, px²; grown where the pose had to be carried to another instant.
    pub covariance: Matrix2<f64>,
    /// Instant of the exposure less that of the pose, s.
    pub dt_s: f64,
    /// Area over the predicted one.
    pub area_ratio: f64,
    /// By how much its line would be too large if the field's parity were swapped, px; 0 in a whole frame.
    pub if_swapped_px: f64,
    /// The part of its covariance that comes from carrying the pose.
    pub carried: Matrix2<f64>,
}

/// A pose with its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MovingPose {
    /// `world_from_body`.
    pub pose: Isometry3<f64>,
    /// Velocity (mm/s) and angular velocity (rad/s).
    pub motion: [Vector3<f64>; 2],
}

/// All observations of one tracker frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameObservations {
    /// The tracker frame's exposure.
    pub exposed_ns: Nanos,
    /// Pose of each body that was measured.
    pub poses: [Option<MovingPose>; BODIES],
    /// Blobs.
    pub seen: Vec<MarkerObservation>,
}

/// Largest distance of a blob from a marker's image, with a drifted rig, px.
const GATE_PX: f64 = 6.0;
/// Least ratio of the distances of the second and the first candidate.
const CLEAR: f64 = 2.5;
/// Tolerance of the ratio of areas about the camera's median; others are partly hidden.
const AREA: f64 = 0.08;
/// Uncertainty of the motion over a time, mm/s and mm/s².
const MOTION_DOUBT: (f64, f64) = (2.0, 200.0);

/// Tracks a stream and collects its observations.
pub fn collect(rig: &Rig, fields: &[BlobField]) -> Vec<FrameObservations> {
    let mut found = Vec::new();
    let model = RigModel::new(rig);
    let mut fields_of: Vec<FieldObservation> =
        rig.cameras.iter().map(|c| FieldObservation::empty(c.id as usize)).collect();
    track_stream(rig, fields, |frame, used| {
        found.extend(instant(rig, &model, frame, used, &mut fields_of));
    });
    drop_hidden(rig.cameras.len(), &mut found);
    found
}

/// Drops blobs of an unusual area: their centre is not that of the marker. Extractors measure areas
/// differently, so the ratio is compared with the median of each camera.
fn drop_hidden(cameras: usize, instants: &mut [FrameObservations]) {
    for camera in 0..cameras {
        let own = |s: &&MarkerObservation| s.camera == camera;
        let ratios = instants.iter().flat_map(|i| i.seen.iter().filter(own).map(|s| s.area_ratio));
        let Some(usual) = median(ratios) else { continue };
        for instant in instants.iter_mut() {
            let odd = |s: &MarkerObservation| s.camera == camera && (s.area_ratio / usual - 1.0).abs() > AREA;
            instant.seen.retain(|s| !odd(s));
        }
    }
}

/// The observations of one tracker frame, if there are any.
fn instant(
    rig: &Rig,
    model: &RigModel,
    frame: &TrackerFrame,
    used: &[BlobField],
    fields_of: &mut [FieldObservation],
) -> Option<FrameObservations> {
    let exposed_ns = frame.instants.exposed;
    let pose = |b: usize| {
        let body = &frame.bodies[b];
        let motion = [body.predictor.velocity_mm_s, body.predictor.angular_velocity_rad_s];
        let measured = body.validity() == Validity::Measured && body.blobs_used > 0;
        let pose = || body.world_from_body.isometry();
        measured.then(|| MovingPose { pose: pose(), motion: motion.map(Vector3::from) })
    };
    let mut out = FrameObservations { exposed_ns, poses: std::array::from_fn(pose), seen: Vec::new() };
    for field in used {
        let Some(index) = rig.cameras.iter().position(|c| c.id == field.camera) else { continue };
        let Some(camera) = &model.cameras[field.camera as usize] else { continue };
        fields_of[index].fill(field, camera, &model.tuning);
        let dt_s = (field.exposed_ns as f64 - exposed_ns as f64) * 1e-9;
        let if_swapped_px = match field.parity {
            WHOLE_FRAME => 0.0,
            0 => -1.0,
            _ => 1.0,
        };
        let from = Field { index, camera, dt_s, if_swapped_px };
        pair(model, &mut out, fields_of[index].blobs(), &from);
    }
    (!out.seen.is_empty()).then_some(out)
}

/// The predicted image of a marker in one camera.
struct Expected {
    body: usize,
    marker: usize,
    colour: u32,
    pixel: Vector2<f64>,
    area_px: f64,
    doubt: Matrix2<f64>,
}

/// What is known of a field beside its blobs.
struct Field<'a> {
    index: usize,
    camera: &'a Camera,
    dt_s: f64,
    if_swapped_px: f64,
}

/// Adds the observations of the markers in one field.
fn pair(model: &RigModel, out: &mut FrameObservations, blobs: &[BlobObservation], from: &Field<'_>) {
    let Field { index, camera, dt_s, if_swapped_px } = *from;
    let doubt_mm = MOTION_DOUBT.0 * dt_s.abs() + MOTION_DOUBT.1 * dt_s * dt_s;
    let mut expected: Vec<Expected> = Vec::new();
    for (body, pose) in out.poses.iter().enumerate() {
        let Some(MovingPose { pose, motion, .. }) = pose else { continue };
        let placed = BodyInField::new(model, camera.id as usize, pose, motion, dt_s);
        for (m, marker) in model.bodies[body].markers.iter().enumerate() {
            if let Some((image, _)) = placed.image(marker, camera) {
                let doubt = image.jacobian * image.jacobian.transpose() * (doubt_mm * doubt_mm);
                let (colour, pixel, area_px) = (marker.colour, image.pixel, image.area_px);
                expected.push(Expected { body, marker: m, colour, pixel, area_px, doubt });
            }
        }
    }
    for e in &expected {
        let rivals =
            expected.iter().filter(|o| o.colour == e.colour && (o.body, o.marker) != (e.body, e.marker));
        let rival = rivals.map(|o| (o.pixel - e.pixel).norm()).fold(f64::MAX, f64::min);
        let mut own: Vec<(f64, &BlobObservation)> =
            blobs.iter().filter(|s| s.colour == e.colour).map(|s| ((s.pixel - e.pixel).norm(), s)).collect();
        own.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(distance, blob)) = own.first() else { continue };
        let next = own.get(1).map_or(f64::MAX, |s| s.0);
        let clear = distance < GATE_PX && CLEAR * distance < rival && CLEAR * distance < next;
        if clear && blob.flags & (BLOB_MERGED | BLOB_CLIPPED) == 0 {
            out.seen.push(MarkerObservation {
                camera: index,
                body: e.body,
                marker: e.marker,
                pixel: blob.pixel,
                covariance: blob.covariance + e.doubt,
                dt_s: model.lines[camera.id as usize].dt_s(dt_s, blob.pixel.y),
                area_ratio: blob.area_px / e.area_px,
                if_swapped_px,
                carried: e.doubt,
            });
        }
    }
}
