//! Synthetic cameras with known truth: found to rounding without noise, and within the predicted
//! covariance with noise.

use calibration::CalibrationError;
use calibration::fixed_dots::{CameraPrior, calibrate_on_dots};
use calibration::lens::{LENS, lens_of, pinhole_camera};
use calibration::multi_camera::{ImagePoint, LensMode, calibrate_cameras, noise_of, triangulate};
use calibration::target_problem::{
    Calibrated, Correspondence, FreeParameters, Robustness, TargetProblem, TargetView, calibrate,
    calibrate_lens, start_of_views,
};
use nalgebra::{DMatrix, DVector, Isometry3, Point3, Rotation3, Vector2, Vector3};
use proptest::prelude::*;
use rig::camera::Camera;

const SIZE: [u32; 2] = [720, 576];

/// Numbers of a standard normal distribution, the same on every machine.
struct Noise(rand_chacha::ChaCha8Rng);

impl Noise {
    fn new(seed: u64) -> Self {
        use rand_chacha::rand_core::SeedableRng;
        Noise(rand_chacha::ChaCha8Rng::seed_from_u64(seed))
    }

    /// Sum of twelve uniform numbers less six.
    fn next(&mut self) -> f64 {
        (0..12).map(|_| f64::from(self.0.next_u32()) / f64::from(u32::MAX)).sum::<f64>() - 6.0
    }

    fn pixel(&mut self, sigma: f64) -> Vector2<f64> {
        Vector2::new(self.next(), self.next()) * sigma
    }
}

fn camera() -> Camera {
    let mut camera = pinhole_camera(0, SIZE, Vector2::new(900.0, 980.0), Vector2::new(361.0, 282.0));
    camera.distortion = [-0.21, 0.09, 0.0006, -0.0004, 0.02];
    camera
}

/// A board of 8×6 points, 10 mm apart.
fn board() -> Vec<Point3<f64>> {
    (0..48).map(|i| Point3::new(f64::from(i % 8) * 10.0, f64::from(i / 8) * 10.0, 0.0)).collect()
}

/// Places of the board before a camera, tilted to all sides.
fn places(n: usize, phase: f64) -> Vec<Isometry3<f64>> {
    let place = |i: usize| {
        let a = phase + i as f64;
        let tilt = Vector3::new(0.5 * (1.7 * a).sin(), 0.5 * (2.3 * a).cos(), 0.3 * a.sin());
        let turned = Isometry3::new(Vector3::zeros(), tilt);
        let centre = turned * Vector3::new(35.0, 25.0, 0.0);
        let at = Vector3::new(12.0 * (3.1 * a).sin(), 10.0 * (1.3 * a).cos(), 120.0 + 15.0 * (0.9 * a).sin());
        Isometry3::from_parts((at - centre).into(), turned.rotation)
    };
    (0..n).map(place).collect()
}

fn sheet(
    camera: &Camera,
    index: usize,
    view: usize,
    place: &Isometry3<f64>,
    noise: &mut dyn FnMut() -> Vector2<f64>,
) -> TargetView {
    let sample = |point: &Point3<f64>| Correspondence {
        pixel: camera.project(&(place * point)).unwrap() + noise(),
        point: *point,
    };
    TargetView { name: view.to_string(), camera: index, view, samples: board().iter().map(sample).collect() }
}

fn quiet(_: usize, _: f64) {}

/// A lens by least squares, terms that the views hardly determine included.
fn with_all_terms(sheets: &[TargetView]) -> Result<Calibrated, CalibrationError> {
    let problem = TargetProblem::new(sheets, vec![FreeParameters::LENS], false, sheets.len());
    calibrate(problem, start_of_views(0, SIZE, sheets)?, Robustness::Square, &mut quiet)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_lens_is_found_to_rounding(phase in 0.0..6.0f64, k1 in -0.3..0.1f64, fx in 700.0..1200.0f64) {
        let mut truth = camera();
        truth.distortion[0] = k1;
        truth.focal_px.x = fx;
        let places = places(8, phase);
        let sheets: Vec<TargetView> =
            places.iter().enumerate().map(|(v, p)| sheet(&truth, 0, v, p, &mut Vector2::zeros)).collect();
        let found = calibrate_lens(0, SIZE, &sheets, FreeParameters::LENS, Robustness::Huber, &mut quiet).unwrap();
        prop_assert!(found.rms_px < 1e-7, "{} px", found.rms_px);
        for (a, b) in lens_of(&found.scene.cameras[0]).iter().zip(lens_of(&truth)) {
            prop_assert!((a - b).abs() < 1e-5 * b.abs().max(1.0), "{a} and {b}");
        }
    }

    #[test]
    fn noise_moves_a_lens_as_far_as_its_covariance_says(seed in 0u64..1000) {
        let (truth, mut noise) = (camera(), Noise::new(seed));
        let sheets: Vec<TargetView> = places(10, 0.4)
            .iter()
            .enumerate()
            .map(|(v, p)| sheet(&truth, 0, v, p, &mut || noise.pixel(0.1)))
            .collect();
        let found = with_all_terms(&sheets).unwrap();
        prop_assert!((found.sigma_px / 0.1 - 1.0).abs() < 0.15, "{}", found.sigma_px);
        for (i, (a, b)) in lens_of(&found.scene.cameras[0]).iter().zip(lens_of(&truth)).enumerate() {
            // Twelve cases of nine values: 4.5 standard deviations are reached once in 1000 runs.
            prop_assert!((a - b).abs() < 4.5 * found.sigmas[0][i], "{a} ± {} and {b}", found.sigmas[0][i]);
        }
    }

    #[test]
    fn dots_place_cameras_and_cameras_place_dots(turn in prop::array::uniform3(-0.5..0.5f64), seed in 0u64..1000) {
        let cameras: Vec<Camera> = (0..3).map(|c| {
            let mut camera = Camera { id: c, ..camera() };
            let aside = Rotation3::new(Vector3::new(0.0, 0.6 * (f64::from(c) - 1.0), 0.0));
            camera.camera_from_world = (aside * Rotation3::new(Vector3::from(turn) * 0.5)).into_inner();
            camera.translation_mm = Vector3::new(0.0, 0.0, 150.0);
            camera
        }).collect();
        let mut noise = Noise::new(seed);
        let dots: Vec<Point3<f64>> = (0..150).map(|_| Point3::new(noise.next(), noise.next(), noise.next()) * 12.0).collect();
        let sheets: Vec<TargetView> = cameras.iter().enumerate().map(|(c, camera)| TargetView {
            name: c.to_string(), camera: c, view: 0,
            samples: dots.iter().map(|d| Correspondence { pixel: camera.project(d).unwrap(), point: *d }).collect(),
        }).collect();
        for before in [CameraPrior::Size(SIZE), CameraPrior::Lens(camera())] {
            let found = calibrate_on_dots(&vec![before; 3], &sheets, [true; LENS], Robustness::Huber, &mut quiet).unwrap();
            for (a, b) in found.scene.cameras.iter().zip(&cameras) {
                prop_assert!((a.centre_in_world() - b.centre_in_world()).norm() < 1e-4);
            }
            let sights: Vec<_> = found.scene.cameras.iter().zip(&sheets).map(|(camera, s)| ImagePoint { camera, pixel: s.samples[7].pixel }).collect();
            prop_assert!((triangulate(&sights, &DMatrix::identity(6, 6)).unwrap() - dots[7]).norm() < 1e-5);
        }
    }
}

#[test]
fn predicted_deviations_are_those_that_occur() {
    // Over 40 draws the mean squared normalised error of each value is 1 ± 4·√(2/40).
    let (truth, mut noise) = (camera(), Noise::new(7));
    let mut squares = [0.0; LENS];
    for _ in 0..40 {
        let sheets: Vec<TargetView> = places(6, 1.1)
            .iter()
            .enumerate()
            .map(|(v, p)| sheet(&truth, 0, v, p, &mut || noise.pixel(0.08)))
            .collect();
        let found = with_all_terms(&sheets).unwrap();
        let values = lens_of(&found.scene.cameras[0]);
        for (i, s) in squares.iter_mut().enumerate() {
            *s += ((values[i] - lens_of(&truth)[i]) / found.sigmas[0][i]).powi(2) / 40.0;
        }
    }
    assert!(squares.iter().all(|s| (0.2..1.9).contains(s)), "{squares:?}");
}

#[test]
fn cameras_are_placed_through_views_that_only_some_share() {
    // Camera 1 shares views with camera 0 and with camera 2; 0 and 2 share none.
    let mut cameras: Vec<Camera> = (0..3).map(|id| Camera { id, ..camera() }).collect();
    for (c, camera) in cameras.iter_mut().enumerate().skip(1) {
        camera.camera_from_world = Rotation3::new(Vector3::new(0.02, 0.12 * c as f64, -0.01)).into_inner();
        camera.translation_mm = Vector3::new(-14.0 * c as f64, 1.0, 2.0);
    }
    let places = places(10, 0.2);
    let seen = [0..6, 0..10, 6..10];
    let sheets: Vec<TargetView> = seen
        .into_iter()
        .enumerate()
        .flat_map(|(c, views)| views.map(move |v| (c, v)))
        .map(|(c, v)| sheet(&cameras[c], c, v, &places[v], &mut Vector2::zeros))
        .collect();
    let found = calibrate_cameras(
        &[SIZE; 3],
        &sheets,
        [true; LENS],
        &LensMode::Refined,
        Robustness::Huber,
        &mut quiet,
    )
    .unwrap();
    for (a, b) in found.scene.cameras.iter().zip(&cameras) {
        assert!((a.centre_in_world() - b.centre_in_world()).norm() < 1e-4, "{a:?}");
    }
    let apart: Vec<TargetView> = sheets.into_iter().filter(|s| s.camera != 1).collect();
    let relabelled: Vec<TargetView> =
        apart.into_iter().map(|s| TargetView { camera: s.camera / 2, ..s }).collect();
    let refused = calibrate_cameras(
        &[SIZE; 2],
        &relabelled,
        [true; LENS],
        &LensMode::Refined,
        Robustness::Huber,
        &mut quiet,
    );
    assert!(refused.unwrap_err().to_string().contains("shares no view"));
}

#[test]
fn a_robust_loss_shrugs_off_what_least_squares_does_not() {
    let (truth, mut noise) = (camera(), Noise::new(3));
    let mut sheets: Vec<TargetView> = places(8, 0.9)
        .iter()
        .enumerate()
        .map(|(v, p)| sheet(&truth, 0, v, p, &mut || noise.pixel(0.05)))
        .collect();
    for sheet in &mut sheets {
        sheet.samples[11].pixel.x += 4.0;
        sheet.samples[30].pixel.y -= 3.0;
    }
    let off = |robustness| {
        let found = calibrate_lens(0, SIZE, &sheets, FreeParameters::LENS, robustness, &mut quiet).unwrap();
        (found.scene.cameras[0].focal_px - truth.focal_px).norm()
    };
    let [square, huber, cauchy] = [Robustness::Square, Robustness::Huber, Robustness::Cauchy].map(off);
    assert!(huber < 0.5 * square && cauchy < 0.5 * square, "{square} {huber} {cauchy}");
}

/// The words with which a calibration is refused.
fn refusal(sheets: &[TargetView]) -> String {
    let refused = calibrate_lens(0, SIZE, sheets, FreeParameters::LENS, Robustness::Huber, &mut quiet);
    refused.map(|c| format!("accepted: {c:?}")).unwrap_or_else(|e: CalibrationError| e.to_string())
}

#[test]
fn what_cannot_be_solved_is_refused_in_words() {
    let truth = camera();
    let all = |places: &[Isometry3<f64>]| -> Vec<TargetView> {
        places.iter().enumerate().map(|(v, p)| sheet(&truth, 0, v, p, &mut Vector2::zeros)).collect()
    };
    let two = all(&places(2, 0.0));
    assert!(refusal(&two).contains("found in 2 pictures; at least 3"), "{}", refusal(&two));
    // The same direction in every picture, face on and tilted.
    for tilt in [0.0, 0.3] {
        let shifted = |i: usize| {
            Isometry3::new(
                Vector3::new(-40.0 + 5.0 * i as f64, -25.0, 120.0 + i as f64),
                Vector3::new(tilt, 0.0, 0.0),
            )
        };
        let parallel = all(&(0..6).map(shifted).collect::<Vec<_>>());
        let mut noise = Noise::new(1);
        let noisy: Vec<TargetView> = parallel
            .iter()
            .map(|s| {
                let samples = s
                    .samples
                    .iter()
                    .map(|p| Correspondence { pixel: p.pixel + noise.pixel(1e-9), ..*p })
                    .collect();
                TargetView { samples, ..s.clone() }
            })
            .collect();
        for sheets in [&parallel, &noisy] {
            let told = refusal(sheets);
            assert!(
                told.contains("degenerate") || told.contains("same direction") || told.contains("too alike"),
                "tilt {tilt}: {told}"
            );
        }
    }
    // All on a line.
    let line: Vec<TargetView> = all(&places(4, 0.0))
        .into_iter()
        .map(|s| TargetView { samples: s.samples[..8].to_vec(), ..s })
        .collect();
    assert!(refusal(&line).contains("on a line"), "{}", refusal(&line));
    // Fewer than four points.
    let few: Vec<TargetView> = all(&places(4, 0.0))
        .into_iter()
        .map(|s| TargetView { samples: vec![s.samples[0], s.samples[7], s.samples[40]], ..s })
        .collect();
    assert!(refusal(&few).contains("at least 4"), "{}", refusal(&few));
}

#[test]
fn dots_that_fix_nothing_are_refused_in_words() {
    let mut camera = camera();
    camera.translation_mm.z = 150.0;
    let sheet = |points: &[Point3<f64>]| TargetView {
        name: "a".into(),
        camera: 0,
        view: 0,
        samples: points
            .iter()
            .map(|d| Correspondence { pixel: camera.project(d).unwrap(), point: *d })
            .collect(),
    };
    let told = |points: &[Point3<f64>]| {
        let found = calibrate_on_dots(
            &[CameraPrior::Size(SIZE)],
            &[sheet(points)],
            [true; LENS],
            Robustness::Huber,
            &mut quiet,
        );
        found.map(|c| format!("accepted: {c:?}")).unwrap_or_else(|e| e.to_string())
    };
    assert!(told(&board()).contains("one plane"), "{}", told(&board()));
    assert!(told(&board()[..8]).contains("on a line"));
    assert!(told(&[]).contains("sees no dot"));
    let five: Vec<_> =
        (0..5).map(|i| Point3::new(f64::from(i), f64::from(i * i), f64::from(i % 3))).collect();
    assert!(told(&five).contains("at least 6"), "{}", told(&five));
    let same = vec![Point3::new(1.0, 2.0, 3.0); 20];
    assert!(told(&same).contains("in one place"), "{}", told(&same));
    // Rays that never meet.
    let point = ImagePoint { camera: &camera, pixel: Vector2::new(300.0, 300.0) };
    let rays = [point; 2];
    assert!(triangulate(&rays, &DMatrix::identity(4, 4)).is_none());
    assert!(triangulate(&rays[..1], &DMatrix::identity(2, 2)).is_none());
}

#[test]
fn errors_of_the_list_of_dots_are_not_taken_for_those_of_the_cameras() {
    let around = |c: u32| {
        let mut camera = camera();
        let turn = Rotation3::from_euler_angles(0.5, 1.2 * f64::from(c) - 1.8, 0.2 * f64::from(c));
        camera.camera_from_world = turn.into_inner();
        camera.translation_mm = Vector3::new(0.0, 0.0, 90.0);
        camera
    };
    let cameras: Vec<Camera> = (0..4).map(around).collect();
    let mut noise = Noise::new(5);
    // The first camera is worse than the others; the list was triangulated without that knowledge.
    let mut dot = || {
        let truth = Point3::new(noise.next(), noise.next(), noise.next()) * 4.0;
        let seen = cameras.iter().enumerate().map(|(c, camera)| {
            let px = if c == 0 { 0.6 } else { 0.1 };
            camera.project(&truth).unwrap() + Vector2::new(noise.next(), noise.next()) * px
        });
        seen.collect::<Vec<_>>()
    };
    let dots: Vec<Vec<Vector2<f64>>> = (0..200).map(|_| dot()).collect();
    let placed = |seen: &[Vector2<f64>], covariance: &DMatrix<f64>| {
        let points = cameras.iter().zip(seen).map(|(camera, &pixel)| ImagePoint { camera, pixel });
        triangulate(&points.collect::<Vec<_>>(), covariance).unwrap()
    };
    let list: Vec<Point3<f64>> = dots.iter().map(|seen| placed(seen, &DMatrix::identity(8, 8))).collect();
    let error = |(seen, point): (&Vec<Vector2<f64>>, &Point3<f64>)| {
        let off = cameras.iter().zip(seen).map(|(camera, pixel)| pixel - camera.project(point).unwrap());
        DVector::from_iterator(8, off.flat_map(|e| [e.x, e.y]))
    };
    let joint = noise_of(&dots.iter().zip(&list).take(100).map(error).collect::<Vec<_>>());
    let apart = joint.map_with_location(|r, c, v| if r / 2 == c / 2 { v } else { 0.0 });
    let left = |covariance: &DMatrix<f64>| {
        let held_out = dots.iter().zip(&list).skip(100);
        held_out.map(|(seen, point)| (placed(seen, covariance) - point).norm_squared()).sum::<f64>().sqrt()
    };
    let [joint, apart] = [&joint, &apart].map(left);
    assert!(joint < 0.6 * apart, "{joint} of {apart}");
}

/// Cameras around the origin, and dots between them.
fn ring_of_cameras(noise: &mut Noise) -> (Vec<Camera>, Vec<TargetView>) {
    let camera_at = |c: u32| {
        let mut camera = camera();
        camera.id = c;
        camera.camera_from_world =
            Rotation3::new(Vector3::new(0.1, 0.4 * f64::from(c) - 0.6, 0.0)).into_inner();
        camera.translation_mm = Vector3::new(0.0, 0.0, 150.0);
        camera
    };
    let cameras: Vec<Camera> = (0..4).map(camera_at).collect();
    let mut dot = || Point3::new(noise.next(), noise.next(), noise.next()) * 12.0;
    let dots: Vec<Point3<f64>> = (0..150).map(|_| dot()).collect();
    let sheet = |(c, camera): (usize, &Camera)| TargetView {
        name: format!("list{c}"),
        camera: c,
        view: 0,
        samples: dots
            .iter()
            .map(|d| Correspondence { pixel: camera.project(d).unwrap() + noise.pixel(0.2), point: *d })
            .collect(),
    };
    let sheets = cameras.iter().enumerate().map(sheet).collect();
    (cameras, sheets)
}

#[test]
fn two_wrong_cameras_are_named_and_nothing_is_invented() {
    let (_, mut sheets) = ring_of_cameras(&mut Noise::new(11));
    for wrong in [1, 3] {
        // Every pixel belongs to another dot.
        let pixels: Vec<_> = sheets[wrong].samples.iter().map(|s| s.pixel).collect();
        let samples = sheets[wrong].samples.iter_mut().enumerate();
        samples.for_each(|(i, s)| s.pixel = pixels[(i * 37 + 11) % pixels.len()]);
    }
    let priors = vec![CameraPrior::Size(SIZE); 4];
    let told = calibrate_on_dots(&priors, &sheets, [true; LENS], Robustness::Huber, &mut quiet)
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(told.contains("camera 1 (list1): ") && told.contains("camera 3 (list3): "), "{told}");
    assert!(!told.contains("camera 0") && !told.contains("camera 2"), "{told}");
}

#[test]
fn weak_lens_terms_are_left_out_camera_by_camera() {
    let (cameras, mut sheets) = ring_of_cameras(&mut Noise::new(5));
    // Fourteen equations for fifteen unknowns.
    sheets[2].samples.truncate(7);
    let priors = vec![CameraPrior::Size(SIZE); 4];
    let found = calibrate_on_dots(&priors, &sheets, [true; LENS], Robustness::Square, &mut quiet).unwrap();
    let weak: Vec<usize> = found.left_out.iter().filter(|o| o.0 == 2).map(|o| o.1).collect();
    assert!(weak.first() == Some(&8), "k3 first: {:?}", found.left_out);
    // A k3 that would fold the picture beyond the dots is not determined, either.
    assert!(found.left_out.iter().all(|o| o.0 == 2 || o.1 == 8), "{:?}", found.left_out);
    assert_eq!(found.scene.cameras[2].distortion[4], 0.0);
    for c in [0, 1, 3] {
        let off = (found.scene.cameras[c].centre_in_world() - cameras[c].centre_in_world()).norm();
        assert!(off < 2.0, "camera {c} is {off} mm off");
    }
}
