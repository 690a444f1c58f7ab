//! Cameras that disagree are not called right.

use nalgebra::Vector3;
use protocol::geometry::Validity;
use protocol::poses::BodyStatus;
use rig::Rig;
use tracker::camera_watch::Notice;
use validation::streams::score::Tracked;
use validation::streams::{Knock, Recipe, Scenario};

fn tracked(cameras: &[u32]) -> Tracked {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let knock = |&camera: &u32| {
        let along = if camera == 0 { Vector3::x() } else { Vector3::y() };
        let turn = along * (2.0 / rig.cameras[camera as usize].fx);
        Knock { camera, at_s: 0.0, turn, shift_mm: Vector3::zeros(), goes_on: false }
    };
    let knocks = cameras.iter().map(knock).collect();
    Tracked::of(&Recipe { scenario: Scenario::Nominal, seed: 5, seconds: 6.0, knocks }.draw(&rig))
}

/// Measured poses from an instant on, and those of them with the status *tracked*, and with that of a disagreement.
fn measured_from(tracked: &Tracked, at_s: f64) -> [usize; 3] {
    let later = tracked.frames.iter().filter(|f| f.instants.exposed as f64 * 1e-9 > at_s);
    let measured: Vec<_> =
        later.flat_map(|f| f.bodies).filter(|body| body.validity() == Validity::Measured).collect();
    let count = |status: BodyStatus| measured.iter().filter(|body| body.status == status as u32).count();
    [measured.len(), count(BodyStatus::Tracked), count(BodyStatus::CamerasDisagree)]
}

#[test]
fn no_pose_counts_as_tracked_while_two_of_three_cameras_are_wrong() {
    let tracked = tracked(&[0, 1]);
    let disagree = |(_, notice): &&(f64, Notice)| matches!(notice, Notice::Disagree { .. });
    let (at_s, _) = tracked.notices.iter().find(disagree).expect("they disagree");
    assert!(*at_s < 3.0, "reported after {at_s} s");
    let [measured, right, doubted] = measured_from(&tracked, *at_s);
    println!("{measured} poses measured after {at_s:.2} s, {doubted} of them in doubt");
    assert!(measured > 100 && right == 0 && doubted > measured / 2, "{measured} {right} {doubted}");
}

#[test]
fn poses_count_as_tracked_where_one_camera_is_wrong_and_the_others_agree() {
    for cameras in [&[1][..], &[]] {
        let tracked = tracked(cameras);
        let [measured, right, doubted] = measured_from(&tracked, 2.0);
        assert!(measured > 300 && doubted == 0, "{measured} {doubted}");
        assert!(right > measured / 2, "{right} of {measured}");
    }
}
