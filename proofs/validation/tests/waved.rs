//! What `calibrate waved` writes where several parts of a rig have moved: the frames of bodies and world stay where they
//! were, or nothing is written.

use calibration::bundle::PriorSigmas;
use calibration::cli::{Waved, refined_by_waving};
use nalgebra::{Matrix3, Rotation3, Vector3};
use protocol::poses::BODY_NAMES;
use rig::Rig;
use validation::planted::{Defect, Planted, plant};
use validation::streams::Scenario;

/// Distance from its true place within which a marker is found again, mm.
const NEAR_MM: f64 = 0.003;

/// A rig whose camera 1 is turned by 3 px and a marker moved, and what waving makes of it.
fn waved(body: usize, marker: usize, by_mm: [f64; 3]) -> (Rig, Waved) {
    let Planted { rig: truth, fields, .. } = plant(Defect::None, Scenario::Nominal, 7, 8.0, 0.0);
    let mut rig = truth.clone();
    let camera = &mut rig.cameras[1];
    let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), 3.0 / camera.fx);
    let turned = turn.matrix() * Matrix3::from_fn(|r, c| camera.rotation[r][c]);
    camera.rotation = std::array::from_fn(|r| std::array::from_fn(|c| turned[(r, c)]));
    camera.t = (turn * Vector3::from(camera.t)).into();
    let body = rig.bodies.iter_mut().find(|b| b.name == BODY_NAMES[body]).expect("a body");
    body.markers[marker].p.iter_mut().zip(by_mm).for_each(|(p, by)| *p += by);
    let waved = refined_by_waving(&rig, &fields, &PriorSigmas::default(), 200).expect("a solution");
    (truth, waved)
}

#[test]
fn a_camera_and_a_marker_that_moved_are_put_where_they_are() {
    for (body, marker, by_mm) in
        [(1, 3, [0.08, 0.0, 0.1]), (0, 1, [0.02, 0.03, 0.1]), (2, 2, [0.1, 0.0, 0.12])]
    {
        let (truth, Waved::Better { found, .. }) = waved(body, marker, by_mm) else {
            panic!("marker {marker} of {} was not refined", BODY_NAMES[body]);
        };
        let mut compared = 0;
        for (markers, name) in found.bundle.markers.iter().zip(BODY_NAMES) {
            for (found, truth) in markers.iter().zip(&truth.body(name).expect("a body").markers) {
                let off_mm = (found.position.coords - Vector3::from(truth.p)).norm();
                assert!(off_mm < NEAR_MM, "{name}: {off_mm} mm ({body} {marker})");
                compared += 1;
            }
        }
        assert_eq!(compared, 14);
    }
}

#[test]
fn nothing_is_written_where_another_marker_may_as_well_have_moved() {
    // Across the plane of the four markers.
    let (_, waved) = waved(0, 0, [0.0, 0.15, 0.0]);
    let Waved::Kept { why, .. } = waved else { panic!("a rig with a wrong frame was written") };
    assert!(why.contains("inst0: the stream does not determine which of its markers 0, 1"), "{why}");
}
