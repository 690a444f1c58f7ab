//! Lenses and camera poses from pictures of a ChArUco board, some of which show only a part of it.

#[allow(dead_code, reason = "some of what it paints is for the other tests")]
mod painted;

use calibration::target_problem::camera_pose;
use nalgebra::{Isometry3, Point3};
use painted::{CharucoPrint, before, displaced, drawn, together, write_boards};
use rig::Rig;
use rig::camera::Camera;
use std::path::Path;
use std::process::Command;

/// The board, larger than a picture.
const BOARD: &str = "12x8,2.8,2.1,DICT_4X4_50";

/// Runs a step, which is expected to end with `code`; what it printed.
fn step(args: &[&str], code: i32) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_vitreo-commission")).args(args).output().unwrap();
    let told = [output.stdout, output.stderr].map(|b| String::from_utf8(b).unwrap()).concat();
    assert_eq!(output.status.code(), Some(code), "{args:?}: {told}");
    println!("{told}");
    told
}

/// The rig in a folder.
fn rig_in(folder: &str) -> Rig {
    Rig::load(&Path::new(folder).join("rig.json")).unwrap()
}

/// True if a camera sees all four corners of a board.
fn sees_whole(camera: &Camera, world_from_board: &Isometry3<f64>, [w, h]: [f64; 2]) -> bool {
    let [width, height] = camera.size_px.map(f64::from);
    [(-w, -h), (w, -h), (w, h), (-w, h)].into_iter().all(|(x, y)| {
        let corner = world_from_board * Point3::new(x / 2.0, y / 2.0, 0.0);
        let in_camera = camera.in_camera(&corner);
        let px = camera.pixel_from_normalised(in_camera.xy() / in_camera.z);
        px.x > 0.0 && px.y > 0.0 && px.x < width && px.y < height
    })
}

/// By camera: how far it is off relative to the first one, mm and mrad.
fn off_beside_first(rig: &Rig, truth: &Rig) -> Vec<[f64; 2]> {
    let from_first = |rig: &Rig| {
        let poses: Vec<_> = rig.cameras().iter().map(camera_pose).collect();
        poses.iter().map(|pose| pose * poses[0].inverse()).collect::<Vec<_>>()
    };
    let off = |(found, expected): (Isometry3<f64>, Isometry3<f64>)| {
        let moved = found.inverse().translation.vector - expected.inverse().translation.vector;
        [moved.norm(), 1e3 * found.rotation.angle_to(&expected.rotation)]
    };
    from_first(rig).into_iter().zip(from_first(truth)).map(off).collect()
}

#[test]
fn a_lens_is_that_of_the_camera_that_saw_the_board() {
    let truth = Rig::load_or_shipped(None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [boards, begin, new] = ["boards", "begin.json", "new"].map(path);
    std::fs::write(&begin, drawn(&truth).to_json()).unwrap();
    let (camera, print) = (&truth.cameras()[..1], CharucoPrint::new(BOARD));
    let views: Vec<_> = (0..10).map(|i| (format!("{i:03}"), vec![before(&camera[0], i)])).collect();
    let in_part = views.iter().filter(|(_, poses)| !sees_whole(&camera[0], &poses[0], print.size_mm)).count();
    assert!(in_part >= 4, "{in_part} of 10 pictures show only a part of the board");
    write_boards(camera, Path::new(&boards), &views, &|x, y| print.at(x, y));
    step(&[&new, "--rig", &begin, "lenses", "--charuco", BOARD, "--from", &boards], 0);
    let (found, expected) = (&rig_in(&new).cameras[0], &truth.cameras[0]);
    let off = [found.fx / expected.fx - 1.0, found.fy / expected.fy - 1.0].map(|v| 100.0 * v.abs());
    let centre = [found.cx - expected.cx, found.cy - expected.cy];
    println!("focal lengths {off:.3?} %, centre {centre:.2?} px off");
    assert!(off.iter().all(|percent| *percent < 0.3), "{off:?} %");
    assert!(centre.iter().all(|px| px.abs() < 6.0), "{centre:?} px");
}

#[test]
fn poses_are_those_of_the_cameras_that_saw_the_board_together() {
    let truth = Rig::load_or_shipped(None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [boards, begin, new] = ["boards", "begin.json", "new"].map(path);
    let begun = displaced(&truth, 0.5, 4.0);
    std::fs::write(&begin, begun.to_json()).unwrap();
    let print = CharucoPrint::new(BOARD);
    let views: Vec<_> = (0..8).map(|i| (format!("{i:03}"), vec![together(i)])).collect();
    write_boards(&truth.cameras(), Path::new(&boards), &views, &|x, y| print.at(x, y));
    // Squares of another size would move the cameras apart.
    let poses = |board| [&*new, "--rig", &*begin, "poses", "--charuco", board, "--from", &*boards];
    let refused = step(&poses("12x8,5.6,4.2,DICT_4X4_50"), 1);
    assert!(refused.contains("times as far apart as in the rig: is SQUARE of --charuco"), "{refused}");
    step(&poses(BOARD), 0);
    let [off, before] = [&rig_in(&new), &begun].map(|rig| off_beside_first(rig, &truth));
    println!("beside the first camera: {off:.3?} mm, mrad; as drawn {before:.3?}");
    assert!(before[1..].iter().all(|[mm, mrad]| *mm > 0.2 && *mrad > 1.0), "{before:?}");
    assert!(off.iter().all(|[mm, mrad]| *mm < 0.03 && *mrad < 0.4), "{off:?} mm, mrad");
}
