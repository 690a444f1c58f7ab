//! The rig for viewers: how each camera sees, where it stands, and the markers and tips of the bodies.

use super::{CALIBRATIONS, Clock, RIG, TRANSFORMS, one};
use foxglove::messages::{
    CameraCalibration, Color, Duration, FrameTransform, FrameTransforms, LinePrimitive, Point3, Pose,
    Quaternion, SceneEntity, SceneUpdate, SpherePrimitive, Vector3,
};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use protocol::blobs::Colour;
use protocol::limits::MAX_CAMERAS;
use protocol::time::Nanos;
use rig::{Rig, RigBody, RigCamera};

/// The messages are written at the beginning and then at this distance, ns of log time, so that a viewer that
/// begins anywhere has them soon.
pub const EVERY_NS: Nanos = 10_000_000_000;
/// Diameter of a tip, mm.
const TIP_MM: f64 = 0.4;
/// Thickness of a shaft's line, mm.
const LINE_MM: f64 = 0.2;

/// All of a rig at an instant, with the indices of their topics.
pub fn encode(rig: &Rig, at: Nanos, realtime_offset_ns: u64) -> Vec<(usize, Vec<u8>)> {
    let timestamp = Clock(realtime_offset_ns).timestamp(at);
    let cameras = || rig.cameras.iter().filter(|camera| (camera.id as usize) < MAX_CAMERAS);
    let transforms = cameras().map(|camera| FrameTransform {
        timestamp,
        parent_frame_id: "world".into(),
        child_frame_id: frame_of(camera),
        ..world_from_camera(camera)
    });
    let mut messages = one(TRANSFORMS, Some(FrameTransforms { transforms: transforms.collect() }));
    for camera in cameras() {
        let calibration = CameraCalibration { timestamp, ..calibration(camera) };
        messages.extend(one(CALIBRATIONS + camera.id as usize, Some(calibration)));
    }
    let entities = rig.bodies.iter().map(|body| SceneEntity { timestamp, ..entity(body) }).collect();
    messages.extend(one(RIG, Some(SceneUpdate { entities, ..SceneUpdate::default() })));
    messages
}

/// The frame of a camera: x to the right, y down, z forward, as OpenCV has it.
fn frame_of(camera: &RigCamera) -> String {
    format!("camera{}", camera.id)
}

fn world_from_camera(camera: &RigCamera) -> FrameTransform {
    let rows = camera.rotation;
    let camera_from_world = Matrix3::from_fn(|row, column| rows[row][column]);
    let world_from_camera = Rotation3::from_matrix_unchecked(camera_from_world.transpose());
    let [x, y, z] = (-(world_from_camera * nalgebra::Vector3::from(camera.t))).into();
    let turn = UnitQuaternion::from_rotation_matrix(&world_from_camera);
    FrameTransform {
        translation: Some(Vector3 { x, y, z }),
        rotation: Some(Quaternion { x: turn.i, y: turn.j, z: turn.k, w: turn.w }),
        ..FrameTransform::default()
    }
}

fn calibration(camera: &RigCamera) -> CameraCalibration {
    let RigCamera { fx, fy, cx, cy, .. } = *camera;
    CameraCalibration {
        frame_id: frame_of(camera),
        width: camera.width,
        height: camera.height,
        distortion_model: "plumb_bob".into(),
        d: camera.dist.into(),
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraCalibration::default()
    }
}

/// A body in its own frame: markers in their colours and sizes, the tip and the shaft of an instrument.
fn entity(body: &RigBody) -> SceneEntity {
    let mut spheres: Vec<SpherePrimitive> =
        body.markers.iter().map(|marker| sphere(marker.p, 2.0 * marker.r, colour(marker.colour))).collect();
    let mut lines = Vec::new();
    if let Some(length) = body.length {
        let grey = Color { r: 0.7, g: 0.7, b: 0.7, a: 1.0 };
        spheres.push(sphere([0.0; 3], TIP_MM, grey));
        let end = |z| Point3 { x: 0.0, y: 0.0, z };
        lines.push(LinePrimitive {
            pose: Some(place([0.0; 3])),
            thickness: LINE_MM,
            points: vec![end(0.0), end(length)],
            color: Some(grey),
            ..LinePrimitive::default()
        });
    }
    SceneEntity {
        frame_id: body.name.clone(),
        id: body.name.clone(),
        // Until the next one replaces it.
        lifetime: Some(Duration::new(0, 0)),
        frame_locked: true,
        spheres,
        lines,
        ..SceneEntity::default()
    }
}

fn sphere(centre: [f64; 3], diameter_mm: f64, color: Color) -> SpherePrimitive {
    let size = Vector3 { x: diameter_mm, y: diameter_mm, z: diameter_mm };
    SpherePrimitive { pose: Some(place(centre)), size: Some(size), color: Some(color) }
}

fn place([x, y, z]: [f64; 3]) -> Pose {
    let orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };
    Pose { position: Some(Vector3 { x, y, z }), orientation: Some(orientation) }
}

fn colour(colour: Colour) -> Color {
    let [r, g, b] = match colour {
        Colour::Red => [1.0, 0.2, 0.2],
        Colour::Yellow => [1.0, 0.9, 0.2],
        Colour::Green => [0.2, 0.9, 0.3],
        Colour::Cyan => [0.2, 0.9, 0.9],
        Colour::Blue => [0.3, 0.4, 1.0],
        Colour::Magenta => [1.0, 0.3, 0.9],
        Colour::White => [1.0, 1.0, 1.0],
    };
    Color { r, g, b, a: 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_camera_and_body_of_the_rig_is_there() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let messages = encode(&rig, 5, 7);
        let topics: Vec<usize> = messages.iter().map(|(topic, _)| *topic).collect();
        let cameras = rig.cameras.iter().map(|camera| CALIBRATIONS + camera.id as usize);
        assert_eq!(topics, [TRANSFORMS].into_iter().chain(cameras).chain([RIG]).collect::<Vec<_>>());
        assert!(messages.iter().all(|(_, bytes)| bytes.len() > 50));
        let markers: usize = rig.bodies.iter().map(|body| entity(body).spheres.len()).sum();
        assert_eq!(
            markers,
            rig.bodies.iter().map(|body| body.markers.len()).sum::<usize>() + 2,
            "and two tips"
        );
    }

    #[test]
    fn a_camera_stands_where_the_model_has_its_centre() {
        let rig = Rig::load_or_shipped(None).unwrap();
        for (camera, model) in rig.cameras.iter().zip(rig.cameras()) {
            let transform = world_from_camera(camera);
            let (t, q) = (transform.translation.unwrap(), transform.rotation.unwrap());
            let centre = model.centre_in_world();
            assert!((nalgebra::Point3::new(t.x, t.y, t.z) - centre).norm() < 1e-9);
            // What lies ahead of it in its own frame lies there in the world.
            let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z));
            let ahead = centre + turn * nalgebra::Vector3::new(3.0, -2.0, 100.0);
            assert!((model.in_camera(&ahead) - nalgebra::Vector3::new(3.0, -2.0, 100.0)).norm() < 1e-9);
        }
    }
}
