//! Nothing is written that predicts what took no part worse than the rig that was given.

use calibration::lens::pinhole_camera;
use calibration::rig_output::rig_with;
use calibration::target_problem::set_camera_pose;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use rig::Rig;
use rig::camera::Camera;
use std::path::Path;
use std::process::{Command, Output};

/// Of every picture, px.
const SIZE: [u32; 2] = [640, 480];

fn calibrate(line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vitreo-calibration")).args(line.split_whitespace()).output().unwrap()
}

/// Checks that a command is refused with exit code 5, says why and writes nothing.
fn kept_back(line: &str, output: &Path) {
    let done = calibrate(&format!("{line} -o {}", output.display()));
    let [out, err] = [done.stdout, done.stderr].map(|b| String::from_utf8(b).unwrap());
    assert_eq!(done.status.code(), Some(5), "{line}: {out}{err}");
    assert!(out.contains("nothing was written: "), "{out}");
    assert!(out.contains("the rig as given predicts held-out points better"), "{out}");
    assert!(err.contains("nothing was written") && !output.exists(), "{err}");
}

fn written(line: &str, output: &Path) -> String {
    let done = calibrate(&format!("{line} -o {}", output.display()));
    let [out, err] = [done.stdout, done.stderr].map(|b| String::from_utf8(b).unwrap());
    assert!(done.status.success() && output.exists(), "{line}: {out}{err}");
    out
}

/// Two cameras before what is about the origin.
fn cameras() -> Vec<Camera> {
    let camera = |(id, turn): (u32, f64)| {
        let mut camera = pinhole_camera(id, SIZE, Vector2::new(1500.0, 1500.0), Vector2::new(318.0, 242.0));
        let place = Isometry3::new(Vector3::new(0.0, 0.0, 110.0), Vector3::new(0.1, turn, 0.02));
        set_camera_pose(&mut camera, &place);
        camera
    };
    [(0, 0.25), (1, -0.25)].map(camera).into()
}

/// The shipped rig with these cameras, as a file.
fn rig_file(path: &Path, cameras: &[Camera]) {
    let rig = rig_with(&Rig::load_or_shipped(None).unwrap(), cameras).unwrap();
    std::fs::write(path, rig.to_json()).unwrap();
}

/// Noise by a number, ± 0.1 px.
fn noise(i: usize) -> Vector2<f64> {
    Vector2::new((12.9 * i as f64).sin(), (78.2 * i as f64).cos()) * 0.1
}

/// One view of a board of 9 × 6 points: its number, and where it is.
fn boards() -> Vec<(usize, Isometry3<f64>)> {
    let at = |v: usize| {
        let t = v as f64;
        let turn = Vector3::new(0.5 * (1.9 * t).sin(), 0.5 * (2.6 * t).cos(), 0.3 * t.sin());
        (v, Isometry3::new(Vector3::new((1.7 * t).sin(), (2.3 * t).cos(), (0.9 * t).sin()) * 3.0, turn))
    };
    (0..14).map(at).collect()
}

/// Writes a list of board points of each camera; `off` moves what a camera shows of a view.
fn write_boards(folder: &Path, cameras: &[Camera], off: impl Fn(u32, usize) -> Vector2<f64>) {
    for camera in cameras {
        let mut text = String::from("view,x,y,X,Y,Z\n");
        for (view, place) in boards() {
            for i in 0..54 {
                let point = Point3::new((i % 9) as f64 * 2.5 - 10.0, (i / 9) as f64 * 2.5 - 6.25, 0.0);
                let at =
                    camera.project(&(place * point)).unwrap() + noise(54 * view + i) + off(camera.id, view);
                text += &format!("{view},{},{},{},{},0\n", at.x, at.y, point.x, point.y);
            }
        }
        std::fs::write(folder.join(format!("boards{}.csv", camera.id)), text).unwrap();
    }
}

#[test]
fn a_pair_of_cameras_of_which_one_was_pushed_is_kept_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let truth = cameras();
    rig_file(&path("rig.json"), &truth);
    let stereo = format!(
        "stereo --size 640x480 --points {0}/boards0.csv {0}/boards1.csv --rig {0}/",
        folder.path().display()
    );
    // Camera 1 was pushed by 3 px while every second picture was taken.
    write_boards(folder.path(), &truth, |camera, view| {
        let pushed = camera == 1 && view.is_multiple_of(2);
        if pushed { Vector2::new(3.0, -3.0) } else { Vector2::zeros() }
    });
    kept_back(&format!("{stereo}rig.json"), &path("new.json"));
    kept_back(&format!("{stereo}rig.json --keep-lenses"), &path("new.json"));
    // Without a rig there is nothing to compare with, but no pose of camera 1 fits all views.
    let done =
        calibrate(&format!("{} -o {}", stereo.split(" --rig").next().unwrap(), path("first.json").display()));
    let said = String::from_utf8(done.stderr).unwrap();
    assert!(said.contains("nothing was written: the cameras contradict each other"), "{said}");
    assert!(done.status.code() == Some(5) && !path("first.json").exists());
    // Good pictures and a rig that was displaced.
    write_boards(folder.path(), &truth, |_, _| Vector2::zeros());
    let mut displaced = truth.clone();
    displaced[1].translation_mm.x += 0.5;
    rig_file(&path("displaced.json"), &displaced);
    let told = written(&format!("{stereo}displaced.json"), &path("new.json"));
    assert!(told.contains("residual of held-out points, rig as given"), "{told}");
    let told = written(&format!("{stereo}displaced.json --keep-lenses"), &path("kept.json"));
    let [old, new] = ["rig.json", "kept.json"].map(|name| Rig::load(&path(name)).unwrap().cameras());
    let baseline = |c: &[Camera]| (c[0].centre_in_world() - c[1].centre_in_world()).norm();
    assert!((baseline(&old) - baseline(&new)).abs() < 0.1, "{told}");
    // One list for both cameras, under another name too.
    std::fs::copy(path("boards0.csv"), path("again.csv")).unwrap();
    let again = format!("{} -o {}", stereo.replace("boards1", "again"), path("twice.json").display());
    let done = calibrate(&again.replace("/ -o", "/rig.json -o"));
    let said = String::from_utf8(done.stderr).unwrap();
    assert!(said.contains("the same ones (54 dots) in ") && said.contains("again.csv 0"), "{said}");
    assert!(done.status.code() == Some(1) && !path("twice.json").exists());
    // A rig of three cameras is a template only.
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/rig.json");
    std::fs::copy(shipped, path("three.json")).unwrap();
    let told = written(&format!("{stereo}three.json"), &path("two.json"));
    assert!(told.contains("not compared with the rig, whose cameras differ in number or size"), "{told}");
}

/// Writes a list of dots of each camera; `off` moves what a camera shows of a dot.
fn write_dots(folder: &Path, cameras: &[Camera], off: impl Fn(u32, usize) -> Vector2<f64>) {
    for camera in cameras {
        let line = |i: usize| {
            let (c, r) = ((i % 10) as f64, (i / 10) as f64);
            let dot = Point3::new(c * 3.0 - 14.0, r * 3.0 - 11.0, (i % 3) as f64 * 5.0);
            let at = camera.project(&dot).unwrap() + noise(i) + off(camera.id, i);
            format!("{} {} {} {} {}\n", at.x, at.y, dot.x, dot.y, dot.z)
        };
        let text: String = (0..80).map(line).collect();
        std::fs::write(folder.join(format!("dots{}.txt", camera.id)), text).unwrap();
    }
}

#[test]
fn cameras_by_dots_of_which_half_are_others_are_kept_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let truth = cameras();
    rig_file(&path("rig.json"), &truth);
    let dots = format!("dots {0}/dots0.txt {0}/dots1.txt --rig {0}/", folder.path().display());
    // Every second dot was measured on its rim.
    write_dots(folder.path(), &truth, |_, i| Vector2::new(if i.is_multiple_of(2) { 2.0 } else { 0.0 }, 0.0));
    kept_back(&format!("{dots}rig.json"), &path("new.json"));
    kept_back(&format!("{dots}rig.json --size 640x480"), &path("new.json"));
    write_dots(folder.path(), &truth, |_, _| Vector2::zeros());
    let mut displaced = truth.clone();
    displaced.iter_mut().for_each(|c| c.translation_mm.y += 0.3);
    rig_file(&path("displaced.json"), &displaced);
    let told = written(&format!("{dots}displaced.json"), &path("new.json"));
    assert!(told.contains("residual of held-out points"), "{told}");
    let new = Rig::load(&path("new.json")).unwrap().cameras();
    let off = (new[0].centre_in_world() - truth[0].centre_in_world()).norm();
    assert!(off < 0.1, "{off} mm");
}

#[test]
fn a_lens_by_views_that_were_smeared_is_kept_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let truth = cameras();
    rig_file(&path("rig.json"), &truth);
    let lens = format!(
        "intrinsics --size 640x480 --points {0}/boards0.csv --rig {0}/rig.json",
        folder.path().display()
    );
    // Pictures of every second view are larger by a per cent.
    write_boards(folder.path(), &truth, |_, _| Vector2::zeros());
    let text = std::fs::read_to_string(path("boards0.csv")).unwrap();
    let line = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(String::from).collect();
        if cells[0].parse::<usize>().is_ok_and(|view| view.is_multiple_of(2)) {
            let x: f64 = cells[1].parse().unwrap();
            cells[1] = (x + 0.01 * (x - 318.0)).to_string();
        }
        cells.join(",") + "\n"
    };
    std::fs::write(path("boards0.csv"), text.lines().map(line).collect::<String>()).unwrap();
    kept_back(&lens, &path("new.json"));
}
