//! Views of a board that do not determine lenses or poses, or contradict each other: what is said, and that nothing is
//! written.

use calibration::lens::pinhole_camera;
use calibration::rig_output::rig_with;
use calibration::target_problem::set_camera_pose;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rig::Rig;
use rig::camera::Camera;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Of every picture, px.
const SIZE: [u32; 2] = [720, 576];
/// Standard deviation of an image coordinate, px.
const NOISE_PX: f64 = 0.1;

/// A folder with a rig and point lists of its cameras.
struct Bench {
    folder: tempfile::TempDir,
    cameras: Vec<Camera>,
}

impl Bench {
    /// Three cameras about a board, as in the shipped rig, with its file.
    fn new() -> Self {
        let camera = |(id, turn): (u32, f64)| {
            let mut camera =
                pinhole_camera(id, SIZE, Vector2::new(1600.0, 1748.0), Vector2::new(363.0, 284.0));
            camera.distortion = [-0.25, 0.1, 0.0005, -0.0003, 0.0];
            let place = Isometry3::new(Vector3::new(0.3, -0.4, 80.0), Vector3::new(0.2 * turn, turn, 0.1));
            set_camera_pose(&mut camera, &place);
            camera
        };
        let cameras: Vec<Camera> = [(0, 0.5), (1, -0.5), (2, 0.05)].map(camera).into();
        let bench = Bench { folder: tempfile::tempdir().unwrap(), cameras };
        let rig = rig_with(&Rig::load_or_shipped(None).unwrap(), &bench.cameras).unwrap();
        std::fs::write(bench.path("rig.json"), rig.to_json()).unwrap();
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes the list of one camera, `view` and `place` of the board by number; with a share of random points.
    fn write(&self, name: &str, camera: &dyn Fn(usize) -> Camera, places: &[Isometry3<f64>], wrong: f64) {
        let mut dice = Dice(ChaCha8Rng::seed_from_u64(name.len() as u64 + u64::from(camera(0).id)));
        let mut text = String::from("view,x,y,X,Y,Z\n");
        for (view, place) in places.iter().enumerate() {
            for i in 0..54 {
                let point = Point3::new((i % 9) as f64 * 2.0 - 8.0, (i / 9) as f64 * 2.0 - 5.0, 0.0);
                let noise = Vector2::new(dice.normal(), dice.normal()) * NOISE_PX;
                let mut at = camera(view).project(&(place * point)).unwrap() + noise;
                if dice.uniform() < wrong {
                    at = Vector2::new(719.0 * dice.uniform(), 575.0 * dice.uniform());
                }
                if (0.0..=719.0).contains(&at.x) && (0.0..=575.0).contains(&at.y) {
                    text += &format!("v{view},{},{},{},{},0\n", at.x, at.y, point.x, point.y);
                }
            }
        }
        std::fs::write(self.path(name), text).unwrap();
    }

    /// Runs it in the folder; the exit code, and all that is said.
    fn calibrate(&self, line: &str) -> (i32, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_vitreo-calibration"));
        let done = command.current_dir(self.folder.path()).args(line.split_whitespace()).output().unwrap();
        let said = [done.stdout, done.stderr].map(|text| String::from_utf8(text).unwrap()).concat();
        (done.status.code().unwrap(), said)
    }

    /// Checks that a command ends with a code, says something and writes no new.json.
    fn refused(&self, line: &str, code: i32, named: &[&str]) {
        let (found, said) = self.calibrate(&format!("{line} -o new.json"));
        assert!(found == code && !self.path("new.json").exists(), "{line}: exit {found}: {said}");
        assert!(named.iter().all(|words| said.contains(words)), "{line}: {said}");
    }
}

/// Numbers that are the same on every machine.
struct Dice(ChaCha8Rng);

impl Dice {
    fn uniform(&mut self) -> f64 {
        f64::from(self.0.next_u32()) / f64::from(u32::MAX)
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Places of a board about the origin, tilted by up to 0.5 rad to all sides.
fn tilted(count: usize) -> Vec<Isometry3<f64>> {
    let place = |v: usize| {
        let t = v as f64;
        let tilt = Vector3::new((1.9 * t).sin(), (1.9 * t).cos(), 0.0) * (0.35 + 0.15 * (0.7 * t).sin());
        Isometry3::new(Vector3::new((1.7 * t).sin(), (2.3 * t).cos(), (0.9 * t).sin()) * 3.0, tilt)
    };
    (0..count).map(place).collect()
}

/// Places in parallel planes.
fn parallel(count: usize) -> Vec<Isometry3<f64>> {
    tilted(count).iter().map(|p| Isometry3::new(p.translation.vector, Vector3::new(0.3, 0.25, 0.0))).collect()
}

/// Places tilted about the picture's horizontal only, to both sides or with the lower edge nearer.
fn about_one_axis(count: usize, is_one_side: bool) -> Vec<Isometry3<f64>> {
    let place = |(v, place): (usize, &Isometry3<f64>)| {
        let tilt = 0.45 * (2.1 * v as f64).sin();
        let tilt = if is_one_side { -0.15 - tilt.abs() } else { tilt };
        Isometry3::new(place.translation.vector, Vector3::new(tilt, 0.0, 0.0))
    };
    tilted(count).iter().enumerate().map(place).collect()
}

/// Lists of all cameras, which see the board at the same places.
fn write_all(bench: &Bench, places: &[Isometry3<f64>], late: &dyn Fn(&Camera, usize) -> Camera) {
    for camera in &bench.cameras {
        bench.write(&format!("cam{}.csv", camera.id), &|view| late(camera, view), places, 0.0);
    }
}

const STEREO: &str = "stereo --points cam0.csv cam1.csv cam2.csv --size 720x576 --rig rig.json";
const LENS: &str = "intrinsics --points cam0.csv --size 720x576 --rig rig.json";

#[test]
fn boards_in_parallel_planes_determine_no_lens() {
    let bench = Bench::new();
    write_all(&bench, &parallel(14), &|camera, _| camera.clone());
    bench.refused(LENS, 1, &["camera 0: expected boards tilted differently, found all in parallel planes"]);
    // Free lenses of several cameras; terms that the views leave open are named.
    let named = [
        "nothing was written: cameras 0, 1 and 2: expected boards tilted differently, found all in parallel",
    ];
    bench.refused(STEREO, 5, &named);
    // Given lenses need no tilt, and a rig that is off is replaced.
    let mut off = bench.cameras.clone();
    off[1].translation_mm.x += 0.5;
    let rig = rig_with(&Rig::load_or_shipped(None).unwrap(), &off).unwrap();
    std::fs::write(bench.path("rig.json"), rig.to_json()).unwrap();
    let (code, said) = bench.calibrate(&format!("{STEREO} --keep-lenses -o new.json"));
    assert!(code == 0, "{said}");
}

#[test]
fn boards_tilted_about_one_axis_do_not_determine_a_lens() {
    let mut bench = Bench::new();
    // All cameras face the board, as one above the other.
    for (i, camera) in bench.cameras.iter_mut().enumerate() {
        let place = Isometry3::translation(0.3, 4.0 * i as f64 - 4.0, 80.0);
        set_camera_pose(camera, &place);
    }
    let stereo = "stereo --points cam0.csv cam1.csv cam2.csv --size 720x576";
    let intrinsics = "intrinsics --points cam0.csv --size 720x576";
    for (is_one_side, what) in
        [(false, "tilted about one axis only"), (true, "tilted about one axis and seen from one side only")]
    {
        write_all(&bench, &about_one_axis(4, is_one_side), &|camera, _| camera.clone());
        let advice = "tilt the board about the other axis too, the picture's vertical: the left edge nearer";
        let one = format!("nothing was written: camera 0: all boards are {what}");
        bench.refused(intrinsics, 5, &[&one, advice]);
        let all = format!("cameras 0, 1 and 2: all boards are {what}");
        bench.refused(stereo, 5, &[&all, advice]);
        let (_, said) = bench.calibrate(stereo);
        // In the report and as a warning, but not for each camera.
        assert_eq!(said.matches(&all).count(), 2, "{said}");
    }
    // As many views about two axes are enough.
    write_all(&bench, &tilted(4), &|camera, _| camera.clone());
    let (code, said) = bench.calibrate(&format!("{stereo} -o new.json"));
    assert!(code == 0, "{said}");
}

#[test]
fn a_lens_by_few_views_does_not_replace_one_that_predicts_them_as_well() {
    let bench = Bench::new();
    for count in [3, 4, 5] {
        write_all(&bench, &tilted(count), &|camera, _| camera.clone());
        bench.refused(LENS, 5, &["nothing was written: the rig as given predicts held-out points"]);
    }
    // Without a rig it is written, without terms that are smaller than their uncertainty.
    write_all(&bench, &tilted(3), &|camera, _| camera.clone());
    let (code, said) = bench.calibrate("intrinsics --points cam0.csv --size 720x576 -o new.json");
    assert!(code == 0 && said.contains("its points do not determine k3, which is held at 0"), "{said}");
    std::fs::remove_file(bench.path("new.json")).unwrap();
    // A lens that is wrong by 5 % is replaced.
    let mut wrong = bench.cameras.clone();
    wrong[0].focal_px *= 1.05;
    let rig = rig_with(&Rig::load_or_shipped(None).unwrap(), &wrong).unwrap();
    std::fs::write(bench.path("rig.json"), rig.to_json()).unwrap();
    write_all(&bench, &tilted(5), &|camera, _| camera.clone());
    let (code, said) = bench.calibrate(&format!("{LENS} -o new.json"));
    assert!(code == 0 && said.contains("residual of held-out points, rig as given"), "{said}");
}

#[test]
fn a_view_that_is_given_four_times_counts_once() {
    let bench = Bench::new();
    let one = tilted(1);
    write_all(&bench, &[one[0]; 4], &|camera, _| camera.clone());
    let named = [
        "found in 1 pictures; at least 3 are needed",
        "in the same place as in cam0.csv v0 in cam0.csv v1, cam0.csv v2, cam0.csv v3, which are not used",
    ];
    bench.refused(LENS, 1, &named);
}

#[test]
fn cameras_that_moved_between_views_are_kept_back_with_the_view() {
    let bench = Bench::new();
    // Camera 1 is pushed by some 4 px.
    let pushed = |camera: &Camera, view: usize| {
        let mut camera = camera.clone();
        if camera.id == 1 && view >= 6 {
            camera.translation_mm.x += 0.2;
        }
        camera
    };
    write_all(&bench, &tilted(12), &pushed);
    let named = ["nothing was written: the cameras moved relative to each other", "from view cam0.csv v6 on"];
    bench.refused(&format!("{STEREO} --keep-lenses"), 5, &named);
    bench.refused(STEREO, 5, &named);
    // Views of one name that are from different instants.
    write_all(&bench, &tilted(12), &|camera, _| camera.clone());
    let late: Vec<Isometry3<f64>> = tilted(13).split_off(1);
    bench.write("cam2.csv", &|_| bench.cameras[2].clone(), &late, 0.0);
    let named = ["nothing was written: the cameras contradict each other"];
    bench.refused(&format!("{STEREO} --keep-lenses"), 5, &named);
}

#[test]
fn exchanged_lists_are_named() {
    let bench = Bench::new();
    write_all(&bench, &tilted(12), &|camera, _| camera.clone());
    let line = "stereo --points cam0.csv cam2.csv cam1.csv --size 720x576 --rig rig.json --keep-lenses";
    let named = [
        "nothing was written: lists or pictures are exchanged between cameras",
        "expected camera 1 of the rig in place 1 (cam2.csv v0), found camera 2",
    ];
    bench.refused(line, 5, &named);
}

#[test]
fn wrong_points_are_named_and_take_no_part() {
    let bench = Bench::new();
    for share in [0.02, 0.1, 0.2, 0.4] {
        bench.write("cam0.csv", &|_| bench.cameras[0].clone(), &tilted(12), share);
        let line = "intrinsics --points cam0.csv --size 720x576 --json -o new.json --force";
        let (code, said) = bench.calibrate(line);
        assert!(code == 0 && said.contains("points are wrong and not used"), "{share}: {said}");
        let lens: serde_json::Value =
            serde_json::from_slice(&std::fs::read(bench.path("new.json")).unwrap()).unwrap();
        for (name, truth) in [("fx", 1600.0), ("fy", 1748.0)] {
            let found = lens[name].as_f64().unwrap();
            assert!((found / truth - 1.0).abs() < 5e-3, "{share}: {name} {found}");
        }
    }
    // Rows of one view that belong to others.
    let text = std::fs::read_to_string(bench.path("cam0.csv")).unwrap();
    let mut dice = Dice(ChaCha8Rng::seed_from_u64(5));
    let mut line = |line: &str| match line.strip_prefix("v3,") {
        None => format!("{line}\n"),
        Some(rest) => {
            let target = rest.splitn(3, ',').nth(2).unwrap();
            format!("v3,{},{},{target}\n", 719.0 * dice.uniform(), 575.0 * dice.uniform())
        }
    };
    std::fs::write(bench.path("cam0.csv"), text.lines().map(&mut line).collect::<String>()).unwrap();
    let (code, said) = bench.calibrate("intrinsics --points cam0.csv --size 720x576");
    assert!(
        code == 0 && said.contains("cam0.csv v3 skipped: expected the points of a flat target"),
        "{said}"
    );
}

#[test]
fn pictures_of_residuals_overwrite_no_input() {
    let bench = Bench::new();
    let places = tilted(8);
    bench.write("residuals_cam0.png", &|_| bench.cameras[0].clone(), &places, 0.0);
    let list = std::fs::read(bench.path("residuals_cam0.png")).unwrap();
    let is_kept = |bench: &Bench| std::fs::read(bench.path("residuals_cam0.png")).unwrap() == list;
    let intrinsics = "intrinsics --points residuals_cam0.png --size 720x576 --force --residuals .";
    bench.refused(intrinsics, 1, &["residuals_cam0.png: is an input of the command"]);
    assert!(is_kept(&bench));
    write_all(&bench, &places, &|camera, _| camera.clone());
    let stereo = "stereo --points residuals_cam0.png cam1.csv --size 720x576 --force --residuals .";
    bench.refused(stereo, 1, &["residuals_cam0.png: is an input of the command"]);
    bench.refused("drift residuals_cam0.png --force --residuals .", 1, &["is an input of the command"]);
    assert!(is_kept(&bench));
    // Other inputs in the folder do not matter.
    let (code, said) =
        bench.calibrate("intrinsics --points cam0.csv --size 720x576 --force --residuals other");
    assert!(code == 0 && Path::exists(&bench.path("other/residuals_cam0.png")), "{said}");
}
