//! Where a camera or a marker stands, by what the others locate.

use super::Cause;
use super::measure::{START_NS, track};
use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use protocol::blobs::BlobField;
use protocol::geometry::Validity;
use protocol::limits::BODIES;
use protocol::matches::MatchFrame;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use protocol::predict::predict;
use rig::Rig;
use rig::camera::Camera;
use tracker::projection::{PoseMatrix, camera_jacobian, moved_camera, project_marker};
use tracker::rig_model::RigModel;

/// Distance of a blob from where its marker is expected, px, by iteration of a camera's estimation: the
/// later, the nearer.
const CAMERA_REACH_PX: [f64; 8] = [30.0, 30.0, 20.0, 12.0, 8.0, 4.0, 4.0, 4.0];
/// The same for a marker.
const MARKER_REACH_PX: f64 = 25.0;
/// Estimations of a marker: the others' fit takes up a part of its shift, less each time.
const MARKER_ITERATIONS: usize = 8;
/// Steps fall where one is less than this share of the one before, along it.
const FALLING: f64 = 0.8;
/// A step that ends them, mm.
const MARKER_NEAR_MM: f64 = 0.003;
/// Residual of half weight, px.
const SOFT_PX: f64 = 2.0;
/// Fewest blobs that give a place, and most that are used.
const BLOBS: [usize; 2] = [60, 4000];
/// Farthest instant of a field from a frame, ns.
const NEAR_NS: u64 = 12_000_000;

/// Body poses at the exposure of a field.
struct Sighting {
    field: usize,
    poses: [Option<Isometry3<f64>>; BODIES],
}

/// The poses of a frame at another instant; those that are not measured are left out.
pub fn poses_at(frame: &TrackerFrame, exposed_ns: u64) -> [Option<Isometry3<f64>>; BODIES] {
    std::array::from_fn(|body| {
        let measured = frame.bodies[body].validity() == Validity::Measured;
        let there = predict(frame, body, exposed_ns);
        (measured && there.validity != Validity::Lost).then(|| there.world_from_body.isometry())
    })
}

fn frame_px(field: &BlobField, blob: usize) -> Vector2<f64> {
    let blob = &field.blobs()[blob];
    Vector2::new(blob.x_px, field.y_frame_px(blob))
}

/// The blob of a colour nearest to a place.
pub fn nearest(field: &BlobField, colour: u32, place: Vector2<f64>, reach_px: f64) -> Option<usize> {
    nearest_of(field, |other| other == colour, place, reach_px)
}

/// The blob of some colours nearest to a place.
pub fn nearest_of(
    field: &BlobField,
    is_one: impl Fn(u32) -> bool,
    place: Vector2<f64>,
    reach_px: f64,
) -> Option<usize> {
    let own = (0..field.blobs().len()).filter(|i| is_one(field.blobs()[*i].colour));
    let near = own.map(|i| (i, (frame_px(field, i) - place).norm_squared()));
    near.filter(|(_, d2)| *d2 < reach_px * reach_px).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// The rig with the camera or the marker that a cause names where the blobs say; `None` of other causes.
pub fn moved(rig: &Rig, fields: &[BlobField], cause: &Cause) -> Option<Rig> {
    let (moved, _) = match cause {
        Cause::CameraMoved { camera, .. } => camera_moved(rig, fields, *camera)?,
        Cause::MarkerMoved { body, marker, .. } => {
            let body = BODY_NAMES.iter().position(|name| name == body)?;
            marker_moved(rig, fields, body, *marker)?
        }
        _ => return None,
    };
    Some(moved)
}

/// The rig with a camera where the bodies that the others track are seen from, and the cause that says so.
pub fn camera_moved(rig: &Rig, fields: &[BlobField], id: u32) -> Option<(Rig, Cause)> {
    let index = rig.cameras.iter().position(|c| c.id == id)?;
    let others: Vec<BlobField> = fields.iter().filter(|f| f.camera != id).copied().collect();
    let own: Vec<&BlobField> = fields.iter().filter(|f| f.camera == id).collect();
    let begin = fields.iter().map(|f| f.exposed_ns).min()? + START_NS;
    let mut sightings = Vec::new();
    track(rig, &others, |frame, _, _| {
        let at = frame.instants.exposed;
        let near = own.iter().position(|f| f.exposed_ns.abs_diff(at) < NEAR_NS);
        if let Some(field) = near.filter(|_| at >= begin) {
            sightings.push(Sighting { field, poses: poses_at(frame, own[field].exposed_ns) });
        }
    });
    let before = rig.cameras[index].model();
    let mut camera = before.clone();
    for reach_px in CAMERA_REACH_PX {
        camera = resected(&RigModel::new(rig), &camera, &sightings, &own, reach_px)?;
    }
    let mut moved = rig.clone();
    let entry = &mut moved.cameras[index];
    entry.rotation = std::array::from_fn(|r| std::array::from_fn(|c| camera.camera_from_world[(r, c)]));
    entry.t = camera.translation_mm.into();
    let turn = camera.camera_from_world * before.camera_from_world.transpose();
    let turn_deg = UnitQuaternion::from_matrix(&turn).angle().to_degrees();
    let shift_mm = (camera.centre_in_world() - before.centre_in_world()).norm();
    Some((moved, Cause::CameraMoved { camera: id, turn_deg, shift_mm }))
}

/// One Gauss–Newton step of a camera's pose.
fn resected(
    rig: &RigModel,
    camera: &Camera,
    sightings: &[Sighting],
    fields: &[&BlobField],
    reach_px: f64,
) -> Option<Camera> {
    let (mut information, mut gradient) = (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros());
    let mut blobs = 0;
    for sighting in sightings {
        for (pose, model) in sighting.poses.iter().zip(&rig.bodies) {
            let Some(pose) = pose.as_ref().map(PoseMatrix::from) else { continue };
            for marker in &model.markers {
                let Some(image) = project_marker(marker, &pose, camera) else { continue };
                let field = fields[sighting.field];
                let Some(blob) = nearest(field, marker.colour, image.pixel, reach_px) else { continue };
                let r = frame_px(field, blob) - image.pixel;
                let jacobian = camera_jacobian(camera, &image.jacobian, &image.point);
                let weight = 1.0 / (1.0 + r.norm_squared() / (SOFT_PX * SOFT_PX));
                information += jacobian.transpose() * jacobian * weight;
                gradient += jacobian.transpose() * r * weight;
                blobs += 1;
            }
        }
        if blobs > BLOBS[1] {
            break;
        }
    }
    if blobs < BLOBS[0] {
        return None;
    }
    let step = information.cholesky()?.solve(&gradient);
    let part = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
    Some(moved_camera(camera, part(0), part(3)))
}

/// The rig with a marker where its blobs say, and the cause that says so.
pub fn marker_moved(rig: &Rig, fields: &[BlobField], body: usize, marker: usize) -> Option<(Rig, Cause)> {
    let name = BODY_NAMES[body];
    let index = rig.bodies.iter().position(|b| b.name == name)?;
    let place = |rig: &Rig| Vector3::from(rig.bodies[index].markers[marker].p);
    let mut moved = rig.clone();
    let mut last: Option<Vector3<f64>> = None;
    for _ in 0..MARKER_ITERATIONS {
        let mut step = marker_step(&moved, fields, body, marker)?;
        // Steps fall geometrically: the sum of those to come is known from two in one direction.
        let ratio = last.map_or(1.0, |last| step.dot(&last) / last.norm_squared());
        if (0.0..FALLING).contains(&ratio) {
            step /= 1.0 - ratio;
            last = None;
        } else {
            last = Some(step);
        }
        moved.bodies[index].markers[marker].p = (place(&moved) + step).into();
        if step.norm() < MARKER_NEAR_MM {
            break;
        }
    }
    let by_mm = (place(&moved) - place(rig)).into();
    Some((moved, Cause::marker_moved(body, marker, by_mm)))
}

/// One step of a marker's place in its body, mm.
fn marker_step(rig: &Rig, fields: &[BlobField], body: usize, marker: usize) -> Option<Vector3<f64>> {
    let model = RigModel::new(rig);
    let begin = fields.iter().map(|f| f.exposed_ns).min()? + START_NS;
    let (mut information, mut gradient, mut blobs) = (Matrix3::zeros(), Vector3::zeros(), 0);
    track(rig, fields, |frame, used, matches| {
        if frame.instants.exposed < begin {
            return;
        }
        for (n, field) in used.iter().enumerate() {
            let camera = model.cameras.get(field.camera as usize).and_then(Option::as_ref);
            let pose = poses_at(frame, field.exposed_ns)[body];
            let (Some(camera), Some(pose)) = (camera, pose.as_ref().map(PoseMatrix::from)) else { continue };
            let own = &model.bodies[body].markers[marker];
            let Some(image) = project_marker(own, &pose, camera) else { continue };
            let blob = nearest(field, own.colour, image.pixel, MARKER_REACH_PX);
            let Some(blob) = blob.filter(|b| is_free(matches, n, *b, [body, marker])) else { continue };
            let r = frame_px(field, blob) - image.pixel;
            let jacobian = image.jacobian * pose.rotation;
            let weight = 1.0 / (1.0 + r.norm_squared() / (4.0 * SOFT_PX * SOFT_PX));
            information += jacobian.transpose() * jacobian * weight;
            gradient += jacobian.transpose() * r * weight;
            blobs += 1;
        }
    });
    (blobs >= BLOBS[0]).then(|| information.cholesky().map(|c| c.solve(&gradient))).flatten()
}

/// True for a blob that measures no other marker.
pub fn is_free(matches: &MatchFrame, field: usize, blob: usize, [body, marker]: [usize; 2]) -> bool {
    let entry = matches.fields().get(field).and_then(|f| f.blobs().get(blob));
    entry.is_none_or(|e| !e.outcome().is_used() || e.marker() == Some((body, marker)))
}
