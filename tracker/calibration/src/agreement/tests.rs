//! Lists of which a known part is wrong.

use super::*;
use crate::draws::Draws;
use crate::lens::pinhole_camera;
use nalgebra::{Point3, Rotation3, Vector2, Vector3};
use rig::camera::Camera;

const SIZE: [u32; 2] = [640, 480];

fn camera() -> Camera {
    let mut camera = pinhole_camera(0, SIZE, Vector2::new(1200.0, 1205.0), Vector2::new(330.0, 236.0));
    camera.distortion = [-0.25, 0.1, 0.001, -0.001, 0.0];
    camera.camera_from_world = Rotation3::new(Vector3::new(0.2, -0.3, 0.1)).into_inner();
    camera.translation_mm = Vector3::new(1.0, -2.0, 150.0);
    camera
}

/// Numbers from -1 to 1.
fn number(draws: &mut Draws) -> f64 {
    draws.below(1_000_001) as f64 / 500_000.0 - 1.0
}

/// 200 dots with a noise of up to 0.2 px, of which the first `wrong` ones of a random order are anywhere in the
/// picture; `flat` for dots of one plane. Also the wrong ones, ascending.
fn list(wrong: usize, flat: bool, seed: u64) -> (Vec<Correspondence>, Vec<usize>) {
    let (camera, mut draws) = (camera(), Draws::new(seed));
    let mut sample = || {
        let depth = if flat { 0.0 } else { 12.0 };
        let point =
            Point3::new(28.0 * number(&mut draws), 20.0 * number(&mut draws), depth * number(&mut draws));
        let noise = Vector2::new(number(&mut draws), number(&mut draws)) * 0.2;
        Correspondence { pixel: camera.project(&point).unwrap() + noise, point }
    };
    let mut samples: Vec<Correspondence> = (0..200).map(|_| sample()).collect();
    let mut chosen = draws.order(samples.len())[..wrong].to_vec();
    for &i in &chosen {
        let at = Vector2::new(320.0 + 319.0 * number(&mut draws), 240.0 + 239.0 * number(&mut draws));
        samples[i].pixel = at;
    }
    chosen.sort_unstable();
    (samples, chosen)
}

fn calibrated(
    prior: CameraPrior,
    samples: Vec<Correspondence>,
) -> Result<(Calibrated, Vec<usize>), CalibrationError> {
    let sheets = [TargetView { name: "a".into(), camera: 0, view: 0, samples }];
    let agreeing = calibrate_agreeing(&[prior], &sheets, [true; LENS], Robustness::Huber, &mut |_, _| {})?;
    assert_eq!(agreeing.sheets[0].samples.len() + agreeing.wrong.len(), sheets[0].samples.len());
    Ok((agreeing.found, agreeing.wrong.iter().map(|w| w.sample).collect()))
}

/// The wrong points that are found are those that are wrong, except ones that are right by chance.
fn expect_same(found: &[usize], samples: &[Correspondence], wrong: &[usize]) {
    let truth = camera();
    let off = |i: &usize| (truth.project(&samples[*i].point).unwrap() - samples[*i].pixel).norm();
    let far: Vec<usize> = wrong.iter().copied().filter(|i| off(i) > 4.0).collect();
    assert!(found.iter().all(|i| wrong.contains(i)), "{found:?} of {wrong:?}");
    assert!(far.iter().all(|i| found.contains(i)), "{found:?} of {far:?}");
}

#[test]
fn wrong_points_are_left_out_and_named() {
    for (seed, wrong) in [(1, 1), (2, 8), (3, 20), (4, 60), (5, 80)] {
        let (samples, wrong) = list(wrong, false, seed);
        let (found, left_out) = calibrated(CameraPrior::Size(SIZE), samples.clone()).unwrap();
        expect_same(&left_out, &samples, &wrong);
        let camera = &found.scene.cameras[0];
        assert!((camera.focal_px.x / 1200.0 - 1.0).abs() < 0.01, "{seed}: {}", camera.focal_px);
        assert!((camera.centre_in_world() - self::camera().centre_in_world()).norm() < 2.0, "{seed}");
        assert!(found.rms_px < 0.4, "{seed}: {}", found.rms_px);
    }
}

#[test]
fn wrong_points_are_left_out_with_a_known_lens() {
    for flat in [false, true] {
        let (samples, wrong) = list(70, flat, 6);
        let (found, left_out) = calibrated(CameraPrior::Lens(camera()), samples.clone()).unwrap();
        expect_same(&left_out, &samples, &wrong);
        let off = (found.scene.cameras[0].centre_in_world() - camera().centre_in_world()).norm();
        assert!(off < 0.5, "{flat}: {off} mm");
    }
}

#[test]
fn lists_of_which_less_than_half_agrees_are_refused() {
    for wrong in [130, 200] {
        let (samples, _) = list(wrong, false, 7);
        let told = calibrated(CameraPrior::Size(SIZE), samples).unwrap_err().to_string();
        assert!(told.contains("camera 0 (a): ") && told.contains("of 200 points agree"), "{told}");
        assert!(!told.contains("left-handed"), "{told}");
    }
}

#[test]
fn only_a_mirrored_world_is_called_left_handed() {
    for (wrong, prior) in [
        (0, CameraPrior::Size(SIZE)),
        (40, CameraPrior::Size(SIZE)),
        (0, CameraPrior::Lens(camera())),
        (40, CameraPrior::Lens(camera())),
    ] {
        let (mut samples, _) = list(wrong, false, 8);
        samples.iter_mut().for_each(|s| s.point.z = -s.point.z);
        let error = calibrated(prior, samples).unwrap_err();
        assert!(matches!(error, CalibrationError::LeftHanded), "{wrong}: {error}");
    }
}

#[test]
fn a_focal_length_that_is_not_known_is_refused() {
    // From afar and with large noise, there is no perspective.
    let mut far = camera();
    far.translation_mm.z = 60_000.0;
    far.focal_px *= 300.0;
    let (mut samples, _) = list(0, false, 9);
    let mut draws = Draws::new(10);
    for s in &mut samples {
        s.pixel = far.project(&s.point).unwrap() + Vector2::new(number(&mut draws), number(&mut draws));
    }
    let told = calibrated(CameraPrior::Size(SIZE), samples).unwrap_err().to_string();
    assert!(told.contains("focal length") || told.contains("left-handed"), "{told}");
}
