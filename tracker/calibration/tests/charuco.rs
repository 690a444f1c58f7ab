//! Commands that take pictures of boards take ChArUco boards, in files and in recordings of pixels; parts of a board too.

use calibration::lens::pinhole_camera;
use calibration::target_problem::{camera_pose, set_camera_pose};
use image::{GrayImage, Luma};
use nalgebra::{Isometry3, Vector2, Vector3};
use protocol::blobs::WHOLE_FRAME;
use protocol::fields::{FieldHeader, PixelFormat};
use recording::{PixelsHead, PixelsWriter};
use rig::camera::Camera;
use std::fs::File;
use std::path::Path;
use std::process::Command;

/// Of every picture, px.
const SIZE: [u32; 2] = [640, 480];
/// The board, mm, and its pixels an inch and margin in mm as it is printed.
const BOARD: &str = "7x5,8,6,DICT_4X4_50";
const PAPER: (f64, f64) = (1200.0, 10.0);
const VIEWS: u64 = 8;

fn report(args: &[String]) -> serde_json::Value {
    let output = Command::new(env!("CARGO_BIN_EXE_vitreo-calibration")).args(args).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(String::from).collect()
}

/// Left and right camera, 30 mm apart.
fn cameras() -> [Camera; 2] {
    [(0, 15.0, 0.13), (1, -15.0, -0.13)].map(|(id, x, turn)| {
        let mut camera = pinhole_camera(id, SIZE, Vector2::new(900.0, 905.0), Vector2::new(322.0, 236.0));
        set_camera_pose(
            &mut camera,
            &Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::new(0.0, turn, 0.0)),
        );
        camera
    })
}

/// Where the board's first corner is in view `v`; some views show a part of the board only.
fn place(v: u64) -> Isometry3<f64> {
    let t = v as f64;
    let turn = Vector3::new(0.5 * (1.9 * t).sin(), 0.5 * (2.6 * t).cos(), 0.3 * t.sin());
    let aside = Vector3::new(12.0 * (1.3 * t).sin(), 9.0 * (2.1 * t).cos(), 110.0);
    Isometry3::new(aside, turn) * Isometry3::translation(-28.0, -20.0, 0.0)
}

/// The printed board before a camera.
fn drawn(camera: &Camera, board: &GrayImage, place: &Isometry3<f64>) -> GrayImage {
    let board_from_camera = (camera_pose(camera) * place).inverse();
    let origin = board_from_camera.translation.vector;
    let shade = |x: f64, y: f64| {
        let n = (Vector2::new(x, y) - camera.centre_px).component_div(&camera.focal_px);
        let ray = board_from_camera.rotation * n.push(1.0);
        let p = origin - ray * (origin.z / ray.z);
        let at = |mm: f64| ((mm + PAPER.1) * PAPER.0 / 25.4).floor();
        let [u, v] = [at(p.x), at(p.y)];
        let is_in = u >= 0.0 && v >= 0.0 && u < f64::from(board.width()) && v < f64::from(board.height());
        if is_in { f64::from(board.get_pixel(u as u32, v as u32).0[0]) } else { 128.0 }
    };
    GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let near = |i: usize| [i % 3, i / 3].map(|k| k as f64 / 3.0 - 1.0 / 3.0);
        let sum: f64 = (0..9).map(near).map(|[u, v]| shade(f64::from(x) + u, f64::from(y) + v)).sum();
        Luma([(40.0 + 0.6 * sum / 9.0).round() as u8])
    })
}

/// Draws all views as files and as a recording of the cameras 4 and 7; returns the files of both cameras.
fn write(folder: &Path, board: &GrayImage) -> [Vec<String>; 2] {
    let path = folder.join("boards.mcap");
    let head = PixelsHead {
        rig_json: "{}".into(),
        cameras: vec![4, 7],
        field_hz: 25.0,
        realtime_offset_ns: 0,
        sources: Vec::new(),
    };
    let mut writer = PixelsWriter::on(File::create(&path).unwrap(), &path, &head).unwrap();
    let mut files = [Vec::new(), Vec::new()];
    for view in 0..VIEWS {
        for (camera, (files, id)) in cameras().iter().zip(files.iter_mut().zip([4, 7])) {
            let picture = drawn(camera, board, &place(view));
            let file = folder.join(format!("{}-{view}.png", camera.id));
            picture.save(&file).unwrap();
            files.push(file.display().to_string());
            let header = FieldHeader {
                field: view,
                exposed_ns: view + 1,
                first_line_ns: view + 1,
                line_period_ns: 1,
                camera: id,
                parity: WHOLE_FRAME,
                format: PixelFormat::Y8 as u32,
                width: SIZE[0],
                height: SIZE[1],
                lines: SIZE[1],
            };
            writer.write(&header, picture.as_raw()).unwrap();
        }
    }
    writer.finish().unwrap();
    files
}

#[test]
fn lenses_and_pairs_are_calibrated_with_a_charuco_board() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (dpi, margin) = PAPER;
    report(&words(&format!(
        "board --charuco {BOARD} --dpi {dpi} --margin {margin} -o {}",
        path("board.png")
    )));
    let board = image::open(path("board.png")).unwrap().into_luma8();
    let [left, right] = write(folder.path(), &board);
    let without = "--without k1,k2,p1,p2,k3";
    let lens = words(&format!("intrinsics --json {without} --charuco {BOARD}"));
    let fx = |told: &serde_json::Value| told["cameras"][0]["lens"][0][1]["value"].as_f64().unwrap();
    let of_files = report(&[lens.clone(), left.clone()].concat());
    let recorded = words(&format!("--camera 4 --every 1 {}", path("boards.mcap")));
    let of_recording = report(&[lens, recorded].concat());
    let points: Vec<u64> =
        of_files["sheets"].as_array().unwrap().iter().map(|s| s["points"].as_u64().unwrap()).collect();
    println!("fx {:.2} and {:.2}, corners {points:?}", fx(&of_files), fx(&of_recording));
    assert!((fx(&of_files) / 900.0 - 1.0).abs() < 3e-3, "{of_files}");
    // Luma in the studio range has fewer steps.
    assert!((fx(&of_recording) / fx(&of_files) - 1.0).abs() < 2e-3, "{of_recording}");
    assert!(points.len() as u64 == VIEWS && points.iter().any(|n| *n < 24), "some are parts: {points:?}");
    let pair = words(&format!("stereo --json {without} --charuco {BOARD}"));
    let files = [pair.clone(), vec!["--left".into()], left, vec!["--right".into()], right].concat();
    let file = path("boards.mcap");
    let recorded = words(&format!("--every 1 --left {file} --right {file} --recorded 4 7"));
    for args in [files, [pair, recorded].concat()] {
        let told = report(&args);
        let figures = told["figures"].as_array().unwrap();
        let baseline = figures.iter().find(|f| f["name"].as_str().unwrap().contains("baseline")).unwrap();
        let (truth, found) = (
            {
                let [a, b] = cameras();
                (a.centre_in_world() - b.centre_in_world()).norm()
            },
            baseline["value"].as_f64().unwrap(),
        );
        assert!((found / truth - 1.0).abs() < 5e-3, "{found} mm, true {truth} mm: {told}");
    }
}
