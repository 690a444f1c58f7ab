//! A filter that is too sure follows all the same.

use crate::body_filter::BodyFilter;
use crate::tracker::{Reference, Tracker};
use bytemuck::Zeroable;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use protocol::blobs::BlobField;
use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, TrackerFrame};
use rig::Rig;

/// Fields in which everything is at rest.
const AT_REST: u64 = 25;
const TIPS: [[f64; 3]; 2] = [[1.2, -0.9, -9.5], [-3.0, 1.0, -4.0]];

/// Where a body is; the first instrument's tip is `moved`, mm, from its place.
fn pose(rig: &Rig, body: usize, moved: Vector3<f64>) -> Isometry3<f64> {
    let Some(trocar) = rig.trocar(BODY_NAMES[body]) else { return Isometry3::identity() };
    let tip = Vector3::from(TIPS[body]) + if body == 0 { moved } else { Vector3::zeros() };
    let axis = Vector3::from(trocar.p_eye) - tip;
    let upright = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
    Isometry3::from_parts(Translation3::from(tip), upright)
}

/// Field `number` of every camera, without noise.
fn draw(rig: &Rig, number: u64, moved: Vector3<f64>) -> Vec<BlobField> {
    let see = |camera: &rig::camera::Camera| {
        let mut field = BlobField::zeroed();
        (field.camera, field.field, field.parity) = (camera.id, number, (number & 1) as u32);
        field.exposed_ns = 1_000_000_000 + number * 20_000_000;
        for (body, name) in BODY_NAMES.iter().enumerate() {
            let pose = pose(rig, body, moved);
            for marker in &rig.body(name).unwrap().markers {
                let point = pose * Point3::from(Vector3::from(marker.p));
                field.push(camera.blob_of_ball(&point, marker.r, marker.colour, field.parity).unwrap());
            }
        }
        field
    };
    rig.cameras().iter().map(see).collect()
}

fn reference(fields: &[BlobField]) -> Reference {
    let BlobField { camera, field, exposed_ns, .. } = fields[0];
    Reference { camera, field, exposed_ns }
}

fn track(tracker: &mut Tracker, rig: &Rig, number: u64, moved: Vector3<f64>) -> TrackerFrame {
    let fields = draw(rig, number, moved);
    tracker.track(&fields, &reference(&fields))
}

/// A tracker that has seen everything at rest; on the heap, because builds for debugging copy it about.
fn rested(rig: &Rig) -> Box<Tracker> {
    let mut tracker = Box::new(Tracker::new(rig));
    for number in 0..AT_REST {
        track(&mut tracker, rig, number, Vector3::zeros());
    }
    tracker
}

#[test]
fn blobs_that_contradict_a_filter_that_is_too_sure_are_believed() {
    let rig = Rig::load_or_shipped(None).unwrap();
    // Where it moves by less, its blobs lie within their gates; by more, most lie beside them.
    let offsets_um = (14..=30).step_by(2).map(f64::from);
    let directions = [Vector3::x(), Vector3::y(), Vector3::new(0.6, -0.6, 0.5)];
    for (direction, um) in directions.iter().flat_map(|d| offsets_um.clone().map(move |um| (d, um))) {
        let (mut tracker, moved) = (rested(&rig), direction * (um * 1e-3));
        let Some(BodyFilter::Instrument(filter)) = &mut tracker.tracks[0].filter else { panic!("lost") };
        filter.be_surer(1e-3);
        let frame = track(&mut tracker, &rig, AT_REST, moved);
        let state = &frame.bodies[0];
        let found = state.world_from_body.isometry().translation.vector;
        let off_um = 1e3 * (found - pose(&rig, 0, moved).translation.vector).norm();
        assert!(off_um < 1.0 && state.blobs_used == 12, "{direction:?} {um} µm: {off_um} µm, {state:?}");
        assert_eq!(state.validity(), Validity::Measured, "{direction:?} {um} µm");
    }
}

/// Both instruments go on as they were where a wider prediction explains no more.
#[test]
fn false_blobs_are_no_manoeuvre() {
    let rig = Rig::load_or_shipped(None).unwrap();
    let mut tracker = rested(&rig);
    let (mut fields, moved) = (draw(&rig, AT_REST, Vector3::zeros()), Vector3::zeros());
    // Each camera sees three of its blobs elsewhere, a pixel off in directions that no movement explains.
    for field in &mut fields {
        (0..3).for_each(|i| field.blobs[i].x_px += if i % 2 == 0 { 1.5 } else { -1.5 });
    }
    let frame = tracker.track(&fields, &reference(&fields));
    let found = frame.bodies[0].world_from_body.isometry().translation.vector;
    let off_um = 1e3 * (found - pose(&rig, 0, moved).translation.vector).norm();
    assert!(off_um < 3.0, "{off_um} µm");
}
