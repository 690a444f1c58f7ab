//! Real pictures of a chessboard and real dots before three cameras, against what others made of
//! them.

use calibration::board::{Board, Pattern};
use calibration::grey_image::GreyImage;
use calibration::lens::LENS;
use calibration::multi_camera::{LensMode, calibrate_cameras};
use calibration::target_problem::{
    Calibrated, Correspondence, FreeParameters, Robustness, TargetProblem, TargetView, calibrate,
    calibrate_lens, start_of_views,
};
use nalgebra::Vector2;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Size of the pictures, px.
const SIZE: [u32; 2] = [640, 480];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/chessboards")
}

/// The boards of both sides; the picture with number 10 was never taken.
static BOARDS: LazyLock<[Vec<TargetView>; 2]> = LazyLock::new(|| {
    let board = Board { pattern: Pattern::Chessboard, columns: 9, rows: 6, pitch_mm: 1.0 };
    let sheet = |side: &str, camera: usize, (view, n): (usize, u32)| {
        let name = format!("{side}{n:02}.jpg");
        let picture = GreyImage::load(&folder().join(&name)).unwrap();
        let samples = board.find(&picture).unwrap_or_else(|e| panic!("{name}: {e}"));
        TargetView { name, camera, view, samples }
    };
    let sheets =
        |side, camera| (1..=14).filter(|n| *n != 10).enumerate().map(|at| sheet(side, camera, at)).collect();
    [sheets("left", 0), sheets("right", 1)]
});

fn lens(sheets: &[TargetView], free: FreeParameters) -> Calibrated {
    let own: Vec<TargetView> = sheets.iter().map(|s| TargetView { camera: 0, ..s.clone() }).collect();
    calibrate_lens(0, SIZE, &own, free, Robustness::Huber, &mut |_, _| {}).unwrap()
}

/// The numbers of a matrix in one of OpenCV's files.
fn matrix(file: &str, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(folder().join(file)).unwrap();
    let at = text.find(&format!("{name}:")).unwrap_or_else(|| panic!("{name} in {file}"));
    let data = &text[at + text[at..].find('[').unwrap() + 1..];
    let data = &data[..data.find(']').unwrap()];
    data.split(',').map(|n| n.trim().parse().unwrap()).collect()
}

#[test]
fn lenses_fit_better_than_opencv_fits_them() {
    // OpenCV 4 reaches 0.41 and 0.46 px on these pictures with its own corners.
    for (sheets, opencv_px) in BOARDS.iter().zip([0.41, 0.46]) {
        let found = lens(sheets, FreeParameters::LENS);
        println!("{}…: rms {:.4} px", sheets[0].name, found.rms_px);
        assert!(found.rms_px <= 0.6 * opencv_px, "{} px", found.rms_px);
        assert_eq!(found.residuals.len(), 13 * 54);
    }
}

#[test]
fn lenses_agree_with_those_in_opencvs_files() {
    // left_intrinsics.yml: square pixels, five terms of distortion; its own rms is 0.39 px, and one
    // of its views has 1.2 px, so that its standard deviations are some three times ours.
    let camera = &lens(&BOARDS[0], FreeParameters::LENS).scene.cameras[0];
    let k = matrix("left_intrinsics.yml", "camera_matrix");
    let d = matrix("left_intrinsics.yml", "distortion_coefficients");
    assert!((camera.focal_px.x / k[0] - 1.0).abs() < 0.01 && (camera.focal_px.y / k[4] - 1.0).abs() < 0.01);
    assert!((camera.centre_px.x - k[2]).abs() < 3.0 && (camera.centre_px.y - k[5]).abs() < 3.0);
    assert!((camera.distortion[0] - d[0]).abs() < 0.04, "k1 {} and {}", camera.distortion[0], d[0]);
    assert!((camera.distortion[2] - d[2]).abs() < 2e-3 && (camera.distortion[3] - d[3]).abs() < 2e-3);
    // intrinsics.yml: both cameras, without tangential distortion, one focal length for both.
    let mut free = FreeParameters::LENS;
    (free.lens[6], free.lens[7], free.lens[8]) = (false, false, false);
    for (sheets, name) in BOARDS.iter().zip(["M1", "M2"]) {
        let camera = &lens(sheets, free).scene.cameras[0];
        let k = matrix("intrinsics.yml", name);
        assert!(
            (camera.focal_px.x / k[0] - 1.0).abs() < 0.01,
            "{name}: fx {} and {}",
            camera.focal_px.x,
            k[0]
        );
        assert!((camera.centre_px.x - k[2]).abs() < 8.0, "{name}: cx {} and {}", camera.centre_px.x, k[2]);
        assert!((camera.centre_px.y - k[5]).abs() < 8.0, "{name}: cy {} and {}", camera.centre_px.y, k[5]);
    }
}

#[test]
fn two_cameras_fit_better_together_than_opencv_fits_them() {
    let sheets = BOARDS.concat();
    for lenses in [LensMode::Held, LensMode::Refined] {
        let mut tell = |_: usize, _: f64| {};
        let found =
            calibrate_cameras(&[SIZE; 2], &sheets, [true; LENS], &lenses, Robustness::Huber, &mut tell)
                .unwrap();
        let baseline = found.scene.cameras[1].translation_mm.norm();
        println!("stereo: rms {:.4} px, baseline {baseline:.4} squares", found.rms_px);
        assert!(found.rms_px <= 0.27, "{} px; OpenCV reaches 0.45", found.rms_px);
        // OpenCV finds 3.345 squares.
        assert!((baseline / 3.345 - 1.0).abs() < 0.01, "{baseline}");
    }
}

/// The corners that OpenCV 5.0 found, as sheets of their own (`corners.csv`, in its order).
fn opencv_corners() -> Vec<TargetView> {
    let text = std::fs::read_to_string(folder().join("corners.csv")).unwrap();
    let points = Board { pattern: Pattern::Chessboard, columns: 9, rows: 6, pitch_mm: 1.0 }.points();
    let theirs = |sheet: &TargetView| {
        let rows = text.lines().filter_map(|l| l.strip_prefix(&format!("{},", sheet.name)));
        let pixels = rows.map(|row| {
            let (x, y) = row.split_once(',').unwrap();
            Vector2::new(x.parse().unwrap(), y.parse().unwrap())
        });
        let samples = pixels.zip(&points).map(|(pixel, &point)| Correspondence { pixel, point }).collect();
        TargetView { samples, ..sheet.clone() }
    };
    BOARDS.iter().flatten().map(theirs).collect()
}

#[test]
fn corners_lie_where_opencv_found_them() {
    // The median over a picture: OpenCV's window is larger than the squares of the steeper views,
    // so that single corners of it are off by pixels.
    for (ours, theirs) in BOARDS.iter().flatten().zip(opencv_corners()) {
        let nearest =
            |p: &Vector2<f64>| theirs.samples.iter().map(|q| (p - q.pixel).norm()).fold(f64::MAX, f64::min);
        let mut off: Vec<f64> = ours.samples.iter().map(|s| nearest(&s.pixel)).collect();
        off.sort_by(f64::total_cmp);
        assert!(off.len() == 54 && off[27] < 0.15, "{}: {:.3} px", ours.name, off[27]);
    }
}

#[test]
fn the_same_corners_give_the_same_answer_as_opencvs_solver() {
    // calibrateCamera and stereoCalibrate of OpenCV 5.0 on corners.csv: rms, fx fy cx cy, k1 k2 p1
    // p2 k3.
    let truth = [
        (0.40869, [536.073, 536.016, 342.370, 235.537], [-0.26509, -0.04674, 0.00183, -0.00031, 0.25231]),
        (0.45864, [542.355, 541.615, 328.324, 246.947], [-0.28054, 0.10432, -0.00056, 0.00130, -0.02372]),
    ];
    let sheets = opencv_corners();
    for (side, (rms_px, k, d)) in truth.into_iter().enumerate() {
        let own: Vec<TargetView> = sheets
            .iter()
            .filter(|s| s.camera == side)
            .enumerate()
            .map(|(view, s)| TargetView { camera: 0, view, ..s.clone() })
            .collect();
        // OpenCV keeps terms that the views hardly determine.
        let problem = TargetProblem::new(&own, vec![FreeParameters::LENS], false, own.len());
        let start = start_of_views(0, SIZE, &own).unwrap();
        let found = calibrate(problem, start, Robustness::Square, &mut |_, _| {}).unwrap();
        let camera = &found.scene.cameras[0];
        assert!((found.rms_px - rms_px).abs() < 2e-4, "{} and {rms_px}", found.rms_px);
        let lens = [camera.focal_px.x, camera.focal_px.y, camera.centre_px.x, camera.centre_px.y];
        assert!(lens.iter().zip(k).all(|(a, b)| (a - b).abs() < 0.05), "{lens:?} and {k:?}");
        assert!(camera.distortion.iter().zip(d).all(|(a, b)| (a - b).abs() < 5e-3), "{camera:?} and {d:?}");
    }
    for (lenses, rms_px, baseline) in
        [(LensMode::Held, 0.44777, 3.34493), (LensMode::Refined, 0.44468, 3.33814)]
    {
        let (free, mut tell) = ([true; LENS], |_: usize, _: f64| {});
        let found =
            calibrate_cameras(&[SIZE; 2], &sheets, free, &lenses, Robustness::Square, &mut tell).unwrap();
        let ours = found.scene.cameras[1].translation_mm.norm();
        assert!((found.rms_px - rms_px).abs() < 2e-4, "{} and {rms_px}", found.rms_px);
        assert!((ours - baseline).abs() < 2e-3, "{ours} and {baseline}");
    }
}
