//! Both instruments and the eye are found in the first frame, whatever their pose, with distinct
//! and with equal colours, and without a byte allocated on the way.

#![allow(unsafe_code)] // an allocator that counts

use bytemuck::Zeroable;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use protocol::blobs::BlobField;
use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, EYE};
use rig::Rig;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use tracker::{Reference, Tracker};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// Counts what the present thread asks for.
struct Counting;

// SAFETY: forwards to the system's allocator unchanged; the count is plain thread-local data
// without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

type Poses = [Isometry3<f64>; 3];

/// An instrument through its trocar with its tip at `tip` (eye frame, mm), rolled by `roll`.
fn through_trocar(
    rig: &Rig,
    body: usize,
    eye: &UnitQuaternion<f64>,
    tip: Vector3<f64>,
    roll: f64,
) -> Isometry3<f64> {
    let trocar = Vector3::from(rig.trocar(BODY_NAMES[body]).unwrap().p_eye);
    let axis = trocar - tip;
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
    let rolled = turn * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    Isometry3::from_parts(Translation3::from(eye * tip), eye * rolled)
}

/// What the cameras see of the bodies, without noise.
fn fields(rig: &Rig, poses: &Poses, number: u64) -> Vec<BlobField> {
    let see = |camera: &rig::camera::Camera| {
        let mut field = BlobField::zeroed();
        (field.camera, field.field, field.exposed_ns) = (camera.id, number, (number + 1) * 20_000_000);
        field.parity = (number & 1) as u32;
        for (pose, name) in poses.iter().zip(BODY_NAMES) {
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
    Reference { camera: fields[0].camera, field: fields[0].field, exposed_ns: fields[0].exposed_ns }
}

fn equal_colours(rig: &Rig) -> Rig {
    let mut rig = rig.clone();
    let of_first: Vec<_> = rig.body("inst0").unwrap().markers.iter().map(|m| m.colour).collect();
    let second = rig.bodies.iter_mut().find(|b| b.name == "inst1").unwrap();
    for (marker, colour) in second.markers.iter_mut().zip(of_first) {
        marker.colour = colour;
    }
    rig
}

fn any_poses(rig: &Rig) -> impl Strategy<Value = Poses> + use<> {
    let rig = rig.clone();
    let turn = prop::array::uniform3(-0.25..0.25f64);
    let tips = prop::array::uniform2((-4.0..4.0f64, -4.0..4.0f64, -9.0..0.0f64, -3.1..3.1f64));
    (turn, tips).prop_map(move |(turn, tips)| {
        let eye = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
        let [a, b] = [0, 1].map(|i| {
            let (x, y, z, roll) = tips[i];
            through_trocar(&rig, i, &eye, Vector3::new(x, y, z), roll)
        });
        [a, b, Isometry3::from_parts(Translation3::identity(), eye)]
    })
}

fn rig() -> Rig {
    Rig::load_or_shipped(None).unwrap()
}

fn check_found(rig: &Rig, poses: &Poses) -> Result<(), TestCaseError> {
    let mut tracker = Tracker::new(rig);
    let seen = fields(rig, poses, 0);
    let frame = tracker.track(&seen, &reference(&seen));
    for (body, truth) in poses.iter().enumerate() {
        let state = &frame.bodies[body];
        prop_assert_eq!(state.validity(), Validity::Measured, "{}", BODY_NAMES[body]);
        let found = state.world_from_body.isometry();
        let miss = (found.translation.vector - truth.translation.vector).norm();
        // The trocar's play and the neighbours' shadows are not simulated: only a wrong
        // assignment could miss by more.
        prop_assert!(miss < 0.01, "{} misses by {miss} mm", BODY_NAMES[body]);
        prop_assert!(found.rotation.angle_to(&truth.rotation) < 0.02, "{}", BODY_NAMES[body]);
    }
    // Three cameras see six markers; one may stand out of the frame.
    prop_assert!(frame.bodies[EYE].blobs_used >= 15, "{} blobs", frame.bodies[EYE].blobs_used);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn bodies_are_found_from_any_pose(poses in any_poses(&rig())) {
        check_found(&rig(), &poses)?;
    }

    #[test]
    fn equal_colours_are_told_apart_by_their_trocars(poses in any_poses(&rig())) {
        check_found(&equal_colours(&rig()), &poses)?;
    }
}

#[test]
fn nothing_is_allocated_per_frame() {
    let rig = rig();
    let eye = UnitQuaternion::identity();
    let mut tracker = Tracker::new(&rig);
    let mut allocated = Vec::new();
    for number in 0..40u64 {
        let shift = Vector3::new(0.05 * number as f64, -1.0, -5.0);
        let poses = [
            through_trocar(&rig, 0, &eye, shift, 0.3),
            through_trocar(&rig, 1, &eye, -shift.component_mul(&Vector3::new(1.0, 1.0, -1.0)), 1.0),
            Isometry3::identity(),
        ];
        let mut seen = fields(&rig, &poses, number);
        if (15..30).contains(&number) {
            // Lost and not found, then found again.
            seen.iter_mut().for_each(|f| f.count = 3);
        }
        let before = ALLOCATIONS.with(Cell::get);
        let frame = tracker.track(&seen, &reference(&seen));
        let after = ALLOCATIONS.with(Cell::get);
        allocated.push(after - before);
        if !(15..30).contains(&number) {
            assert!(frame.bodies.iter().all(|b| b.validity() == Validity::Measured), "frame {number}");
        }
    }
    assert_eq!(allocated, vec![0; 40]);
}
