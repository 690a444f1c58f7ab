//! `vitreo-calibration dots` on lists with mistakes: what it writes, refuses and names.

use calibration::lens::pinhole_camera;
use calibration::rig_output::rig_with;
use calibration::target_problem::set_camera_pose;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use rig::Rig;
use rig::camera::Camera;
use std::path::{Path, PathBuf};
use std::process::Command;

const SIZE: [u32; 2] = [640, 480];

/// Cameras around a stepped target; the second has its principal point beyond the picture.
fn cameras() -> Vec<Camera> {
    let place = |(id, turn): (u32, f64)| {
        let centre = if id == 1 { Vector2::new(-60.0, 242.0) } else { Vector2::new(318.0, 242.0) };
        let mut camera = pinhole_camera(id, SIZE, Vector2::new(1500.0, 1505.0), centre);
        let aside = (318.0 - centre.x) / 1500.0 * 110.0;
        set_camera_pose(
            &mut camera,
            &Isometry3::new(Vector3::new(aside, 0.0, 110.0), Vector3::new(0.1, turn, 0.0)),
        );
        camera
    };
    [(0, 0.4), (1, -0.3), (2, 0.1)].map(place).into()
}

/// What may be wrong with a list.
#[derive(Clone, Copy)]
struct Flaws {
    /// Every so many-th dot is elsewhere; 0: none.
    wrong_every: usize,
    /// Positions are multiplied by this.
    unit: f64,
    /// Each image point is paired with the dot so many lines on.
    shifted: usize,
}

const NONE: Flaws = Flaws { wrong_every: 0, unit: 1.0, shifted: 0 };

fn list(camera: &Camera, flaws: Flaws) -> String {
    let dot = |i: usize| {
        let (c, r) = ((i % 12) as f64, (i / 12) as f64);
        Point3::new(3.0 * c - 16.5, 3.0 * r - 13.5, 5.0 * ((i % 12) / 2 % 3) as f64)
    };
    let line = |i: usize| {
        let noise = Vector2::new((i as f64 * 1.7).sin(), (i as f64 * 2.9).cos()) * 0.1;
        let mut at = camera.project(&dot(i)).unwrap() + noise;
        if flaws.wrong_every > 0 && i % flaws.wrong_every == 2 % flaws.wrong_every {
            let seed = i + 31 * camera.id as usize;
            at = Vector2::new((seed * 197 % 640) as f64, (seed * 113 % 480) as f64);
        }
        let dot = dot((i + flaws.shifted) % 120) * flaws.unit;
        format!("{:.4} {:.4} {} {} {}\n", at.x, at.y, dot.x, dot.y, dot.z)
    };
    (0..120).map(line).collect()
}

/// Files of a test.
struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        let files = Files(tempfile::tempdir().unwrap());
        let template = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/rig-200hz.json");
        let rig = rig_with(&Rig::load(&template).unwrap(), &cameras()).unwrap();
        std::fs::write(files.path("rig.json"), rig.to_json()).unwrap();
        files
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes lists of the cameras in some order and calibrates by them; the exit code, and all that is printed.
    fn dots(&self, order: &[usize], flaws: Flaws, more: &str) -> (i32, String) {
        let _ = std::fs::remove_file(self.path("new.json"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_vitreo-calibration"));
        command.current_dir(self.0.path()).arg("dots");
        for &c in order {
            std::fs::write(self.path(&format!("list{c}")), list(&cameras()[c], flaws)).unwrap();
            command.arg(format!("list{c}"));
        }
        let output = command.args(more.split_whitespace()).args(["-o", "new.json"]).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code().unwrap(), String::from_utf8(text).unwrap())
    }

    /// What it says where it refuses.
    fn refused(&self, order: &[usize], flaws: Flaws, more: &str) -> String {
        let (code, told) = self.dots(order, flaws, more);
        assert!(code == 1 && !self.path("new.json").exists(), "{code}: {told}");
        told
    }
}

#[test]
fn a_rig_is_written_without_a_template() {
    let files = Files::new();
    let (code, told) = files.dots(&[0, 1, 2], NONE, "--size 640x480 --without k2,k3,p1,p2");
    assert!(code == 0 && told.contains("without --rig, the rig has whole frames at 50 Hz"), "{told}");
    assert!(!told.contains("is --size right?"), "{told}");
    let rig = Rig::load(&files.path("new.json")).unwrap();
    assert!(rig.cameras[1].cx < 0.0, "{}", rig.cameras[1].cx);
    for (found, truth) in rig.cameras().iter().zip(cameras()) {
        let off = (found.centre_in_world() - truth.centre_in_world()).norm();
        assert!(off < 1.5, "camera {}: {off} mm", truth.id);
    }
}

/// Pictures of that size have scan and timing of the shipped rig's cameras, which need not be those of these.
#[test]
fn a_rig_of_the_shipped_size_without_a_template_says_whose_timing_it_has() {
    let files = Files::new();
    let lenses = "--size 720x576 --without k2,k3,p1,p2";
    let (code, told) = files.dots(&[0, 1, 2], NONE, lenses);
    let timing = "without --rig, the rig has the shipped rig's scan (interlaced) and timing, with fields at 50 Hz: set \
                  field_hz, line_ns, exposure_ns, scan and shutter";
    assert!(code == 0 && told.contains(timing), "{told}");
    assert!(!files.dots(&[0, 1, 2], NONE, &format!("{lenses} --rig rig.json")).1.contains("without --rig"));
}

/// A lens over pictures of twice the size is not determined by dots in a quarter of them.
#[test]
fn lists_of_pictures_of_half_the_size_are_noticed() {
    let files = Files::new();
    let doubt = "px of a picture of 1280×960 px: is --size right?";
    let (code, told) = files.dots(&[0, 1, 2], NONE, "--size 1280x960 --without k1,k2,k3,p1,p2");
    assert!(code == 0 && told.contains(doubt), "{code}: {told}");
    let (code, told) = files.dots(&[0, 1, 2], NONE, "--size 1280x960");
    assert!(code == 5 && told.contains(doubt), "{code}: {told}");
    assert!(told.contains("nothing was written: all points of all cameras lie within"), "{told}");
    assert!(told.contains("lens terms instead of") && !files.path("new.json").exists(), "{told}");
}

#[test]
fn a_rig_that_cannot_be_written_is_found_before_the_work() {
    let files = Files::new();
    let mut slow = Rig::load(&files.path("rig.json")).unwrap();
    (slow.field_hz, slow.line_ns, slow.exposure_ns) = (450.0, 4_600, 1_000_000);
    std::fs::write(files.path("fast.json"), slow.to_json()).unwrap();
    // No list shows its dots, which the work would find.
    let told = files.refused(&[0, 1, 2], Flaws { wrong_every: 1, ..NONE }, "--size 640x490 --rig fast.json");
    assert!(told.contains("fast.json does not fit 3 cameras of 640×490 px"), "{told}");
    assert!(told.contains("line_ns: expected lines that are read out"), "{told}");
    let told = files.refused(&[0], NONE, "--size 640x480");
    assert!(told.contains("does not fit 1 cameras") && told.contains("2 to 8"), "{told}");
}

#[test]
fn wrong_points_are_named_by_their_lines() {
    let files = Files::new();
    let flaws = Flaws { wrong_every: 7, ..NONE };
    for more in ["--size 640x480 --without k2,k3,p1,p2", "--rig rig.json"] {
        let (code, told) = files.dots(&[0, 1, 2], flaws, more);
        assert!(told.contains("camera 0 (list0): 17 of 120 points contradict the others"), "{told}");
        assert!(told.contains("line 3 at (394, 226), off by") && told.contains("and 12 more"), "{told}");
        // The true rig may predict better than one from noise.
        assert!(code == 0 || code == 5, "{code}: {told}");
    }
    let most = Flaws { wrong_every: 1, ..NONE };
    let told = files.refused(&[0, 1, 2], most, "--size 640x480");
    assert!(told.contains("camera 2 (list2): ") && told.contains("of 120 points agree"), "{told}");
}

#[test]
fn positions_in_metres_are_refused() {
    let files = Files::new();
    let metres = Flaws { unit: 1e-3, ..NONE };
    let told = files.refused(&[0, 1, 2], metres, "--size 640x480 --rig rig.json");
    assert!(told.contains("0.0010 times as far apart as in the rig as given"), "{told}");
    let told = files.refused(&[0, 1, 2], metres, "--size 640x480");
    assert!(told.contains("expected 11.5 to 10000 mm: are the positions of the dots in mm?"), "{told}");
}

/// In most other units nothing contradicts; the sizes are said.
#[test]
fn the_size_of_the_target_and_the_distances_are_said() {
    let files = Files::new();
    let (code, told) = files.dots(&[0, 1, 2], NONE, "--size 640x480 --without k2,k3,p1,p2");
    assert!(
        code == 0 && told.contains("dots span 33 × 27 × 10 mm; cameras stand 115 to 118 mm away"),
        "{told}"
    );
    let smaller = Flaws { unit: 0.2, ..NONE };
    let (code, told) = files.dots(&[0, 1, 2], smaller, "--size 640x480 --without k2,k3,p1,p2");
    assert!(
        code == 0 && told.contains("dots span 6.6 × 5.4 × 2.0 mm; cameras stand 23 to 24 mm away"),
        "{told}"
    );
}

/// Some of such a list shows a camera beside the true one, which every start of every set of terms then looks for.
#[test]
fn shifted_lists_are_refused_soon() {
    let files = Files::new();
    let from = std::time::Instant::now();
    let told = files.refused(&[0, 1, 2], Flaws { shifted: 13, ..NONE }, "--size 640x480");
    assert!(told.contains("54 of 120 points agree with one camera, expected half of them or more"), "{told}");
    // Of lists that are wrong by less than half, what is left out is said as soon.
    let (_, told) = files.dots(&[0, 1, 2], Flaws { shifted: 6, ..NONE }, "--size 640x480");
    assert!(told.contains("points contradict the others and are left out"), "{told}");
    // A bound for a busy machine: both took ten times as long when nothing bounded the steps of a start.
    assert!(from.elapsed().as_secs() < 10, "{:?}", from.elapsed());
}

/// The lists are right, and the rig is that of cameras with another lens or another size of pictures.
#[test]
fn a_lens_that_is_not_the_cameras_is_named_instead_of_the_dots() {
    let files = Files::new();
    let written = |name: &str, change: &dyn Fn(&mut rig::RigCamera)| {
        let mut rig = Rig::load(&files.path("rig.json")).unwrap();
        change(&mut rig.cameras[2]);
        std::fs::write(files.path(name), rig.to_json()).unwrap();
    };
    written("longer.json", &|camera| (camera.fx, camera.fy) = (2.5 * camera.fx, 2.5 * camera.fy));
    let told = files.refused(&[0, 1, 2], NONE, "--rig longer.json");
    assert!(told.contains("camera 2 (list2): the lens or the picture size (640×480 px)"), "{told}");
    assert!(told.contains("instead of 3750 px") && told.contains("--size WIDTHxHEIGHT"), "{told}");
    assert!(!told.contains("not those of its dots") && !told.contains("camera 0 ("), "{told}");
    // No lens explains points that are paired with other dots.
    let told = files.refused(&[0, 1, 2], Flaws { shifted: 13, ..NONE }, "--rig longer.json");
    assert!(told.contains("not those of its dots") && !told.contains("the lens or the picture"), "{told}");
}

#[test]
fn exchanged_lists_are_named() {
    let files = Files::new();
    for more in ["--rig rig.json", "--rig rig.json --size 640x480"] {
        let told = files.refused(&[2, 1, 0], NONE, more);
        assert!(told.contains("list2 was given for camera 0, but fits camera 2"), "{told}");
        assert!(told.contains("list0 was given for camera 2, but fits camera 0"), "{told}");
        assert!(!told.contains("list1 was"), "{told}");
    }
}

#[test]
fn one_list_for_two_cameras_is_refused_by_name() {
    let files = Files::new();
    for more in ["--size 640x480", "--rig rig.json", "--size 640x480 --rig rig.json --splits 2"] {
        let told = files.refused(&[0, 2, 2], NONE, more);
        let expected = "cameras 1 and 2: expected image points by each camera, found the same ones (120 dots) in list2 and list2";
        assert!(told.contains(expected), "{told}");
    }
}

#[test]
fn one_picture_for_two_cameras_is_refused() {
    let files = Files::new();
    image::GrayImage::from_pixel(64, 48, image::Luma([90])).save(files.path("a.png")).unwrap();
    let told = files.refused(&[], NONE, "--target list0 --pictures a.png a.png --picked list0 list0");
    assert!(
        told.contains("cameras 0 and 1: expected a picture by each camera, found the same one"),
        "{told}"
    );
}
