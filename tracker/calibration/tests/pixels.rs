//! Recordings of pixels (`vitreo cameras --record-fields FILE.mcap`) serve as what is found in them does: blobs by `vitreo
//! blobs`, dots in pictures.

use calibration::lens::pinhole_camera;
use calibration::target_problem::set_camera_pose;
use clap::Parser;
use fpga_model::commands::blobs::{self, BlobsArgs};
use image::{GrayImage, Luma};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use protocol::blobs::WHOLE_FRAME;
use protocol::fields::{FORMAT_YCBCR_422, FieldHeader};
use recording::{PixelsHead, PixelsWriter};
use rig::Rig;
use rig::camera::Camera;
use scene::{DEFAULT_SCENE, SceneFile};
use std::fs::File;
use std::path::Path;
use std::process::{Command, Output};
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path as How};

fn calibrate(line: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vitreo-calibration")).args(line.split_whitespace()).output().unwrap()
}

/// What it says where it refuses.
fn refused(line: &str) -> String {
    let output = calibrate(line);
    assert_eq!(output.status.code(), Some(1), "{line}");
    String::from_utf8(output.stderr).unwrap()
}

fn begin(path: &Path, rig_json: String, cameras: Vec<u32>, field_hz: f64) -> PixelsWriter {
    let head = PixelsHead { rig_json, cameras, field_hz, realtime_offset_ns: 0, sources: Vec::new() };
    PixelsWriter::on(File::create(path).unwrap(), path, &head).unwrap()
}

/// What the cameras of a rig see of a surgeon, pixel by pixel.
fn painted(path: &Path, rig: &Rig, seconds: f64) {
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut surgeon = MotionSource::new(&scene, rig, None, 3);
    let mut cameras = Cameras::new(rig, How::Pixels, 3).unwrap();
    let ids = rig.cameras.iter().map(|c| c.id).collect();
    let mut writer = begin(path, rig.to_json(), ids, rig.field_hz);
    for number in 1..(seconds * rig.field_hz) as u64 {
        for camera in 0..cameras.len() {
            let mut exposure = cameras.expose(camera, &mut surgeon, number);
            let header = exposure.header();
            let mut payload = vec![0; header.bytes()];
            exposure.paint(&mut payload);
            writer.write(&header, &payload).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[derive(Parser)]
struct BlobsLine {
    #[command(flatten)]
    args: BlobsArgs,
}

#[test]
fn fields_serve_as_the_blobs_that_are_found_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let rig = Rig::load_or_shipped(None).unwrap();
    let [pixels, found, own] = ["wave.mcap", "blobs.jsonl", "rig.json"].map(path);
    painted(Path::new(&pixels), &rig, 2.5);
    std::fs::write(&own, rig.to_json()).unwrap();
    blobs::run(&BlobsLine::parse_from(["blobs", &pixels, "-o", &found]).args).unwrap();
    for task in ["drift --json", "waved --json --instants 60", "pivot --json --instants 60"] {
        let of_pixels = calibrate(&format!("{task} {pixels}"));
        let of_blobs = calibrate(&format!("{task} --rig {own} {found}"));
        let told = String::from_utf8(of_pixels.stdout).unwrap();
        assert_eq!(of_pixels.status.code(), of_blobs.status.code(), "{task}: {told}");
        assert_eq!(told, String::from_utf8(of_blobs.stdout).unwrap(), "{task}");
        // In so few seconds, nothing turns about its pivot: an error in the same words.
        let [a, b] = [of_pixels.stderr, of_blobs.stderr].map(|e| String::from_utf8(e).unwrap());
        let [a, b] = [&a, &b].map(|said| said.lines().last().unwrap_or_default().to_owned());
        assert!(told.contains("\"figures\"") || (!a.is_empty() && a == b), "{task}: {told}{a}\n{b}");
    }
    // Other colours find other blobs: without blue, no instrument is known.
    let mut colours = fpga_model::colours::file::SHIPPED.to_owned();
    let blue = colours.find("colour = \"blue\"").unwrap();
    let from = colours[..blue].rfind("[[class]]").unwrap();
    let to = colours[blue..].find("[[class]]").map_or(colours.len(), |at| blue + at);
    colours.replace_range(from..to, "");
    std::fs::write(path("colours.toml"), colours).unwrap();
    let other = calibrate(&format!("drift --json --colours {} {pixels}", path("colours.toml")));
    assert_ne!(other.stdout, calibrate(&format!("drift --json {pixels}")).stdout);
    let told = refused(&format!("drift --rig {own} --colours {} {found}", path("colours.toml")));
    assert!(told.contains("blobs.jsonl has blobs already"), "{told}");
}

#[test]
fn a_recording_without_fields_or_with_another_rig_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.mcap");
    let file = path.display().to_string();
    begin(&path, "{}".into(), vec![0], 50.0).finish().unwrap();
    let told = refused(&format!("drift {file}"));
    assert!(told.contains("empty.mcap: has no fields"), "{told}");
    let told = refused(&format!("dots {file} --size 640x480"));
    assert!(told.contains("empty.mcap: is a recording of pixels") && told.contains("--pictures"), "{told}");
    let dots = format!("dots --pictures {file} --target {file} --picked {file}");
    let told = refused(&dots);
    assert!(told.contains("of") && told.contains("empty.mcap"), "{told}");
}

/// Size of the pictures of dots, px.
const SIZE: [u32; 2] = [640, 480];

/// Dots of 1.5 mm in steps of three depths.
fn target() -> Vec<Point3<f64>> {
    let dot = |i: i32| {
        let (c, r) = (i % 10, i / 10);
        Point3::new(f64::from(c) * 4.0 - 18.0, f64::from(r) * 4.0 - 14.0, f64::from(c / 2 % 3) * 5.0)
    };
    (0..80).map(dot).collect()
}

/// A camera before the target.
fn camera(id: u32, aside_rad: f64) -> Camera {
    let mut camera = pinhole_camera(id, SIZE, Vector2::new(1500.0, 1505.0), Vector2::new(318.0, 242.0));
    let place = Isometry3::new(Vector3::new(0.0, 0.0, 110.0), Vector3::new(0.1, aside_rad, 0.02));
    set_camera_pose(&mut camera, &place);
    camera
}

/// Bright dots on a dark ground, with soft rims.
fn drawn(camera: &Camera) -> GrayImage {
    let at: Vec<Vector2<f64>> = target().iter().map(|p| camera.project(p).unwrap()).collect();
    GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let p = Vector2::new(f64::from(x), f64::from(y));
        let off = at.iter().map(|dot| (dot - p).norm()).fold(f64::MAX, f64::min);
        Luma([30 + (150.0 * (5.5 - off).clamp(0.0, 1.0)).round() as u8])
    })
}

/// A field of a whole picture.
fn header(camera: u32, field: u64) -> FieldHeader {
    FieldHeader {
        field,
        exposed_ns: field,
        first_line_ns: field,
        line_period_ns: 1,
        camera,
        parity: WHOLE_FRAME,
        format: FORMAT_YCBCR_422,
        width: SIZE[0],
        height: SIZE[1],
        lines: SIZE[1],
    }
}

#[test]
fn a_recording_of_a_target_serves_as_its_pictures_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let cameras = [camera(0, 0.3), camera(1, -0.3)];
    let file = path("target.mcap");
    let rig = Rig::load_or_shipped(None).unwrap();
    let mut writer = begin(Path::new(&file), rig.to_json(), vec![0, 1], 25.0);
    for camera in &cameras {
        let picture = drawn(camera);
        picture.save(path(&format!("{}.png", camera.id))).unwrap();
        let chroma = vec![128; picture.len()];
        writer.write(&header(camera.id, 3), &[picture.as_raw().as_slice(), &chroma].concat()).unwrap();
        let picked = target().into_iter().enumerate().filter(|(i, _)| [0, 9, 34, 72, 78].contains(i));
        let line = |(_, dot): (usize, Point3<f64>)| {
            let at = camera.project(&dot).unwrap();
            format!("{:.0} {:.0} {} {} {}\n", at.x, at.y, dot.x, dot.y, dot.z)
        };
        std::fs::write(path(&format!("{}.txt", camera.id)), picked.map(line).collect::<String>()).unwrap();
    }
    writer.finish().unwrap();
    let dots: String = target().iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
    std::fs::write(path("target.txt"), dots).unwrap();
    let picked = format!("--target {} --picked {} {}", path("target.txt"), path("0.txt"), path("1.txt"));
    let told = |pictures: String| {
        let line = format!("dots --json --without k2,p1,p2,k3 {picked} --pictures {pictures}");
        let output = calibrate(&line);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let fx = |camera: usize| report["cameras"][camera]["lens"][0][1]["value"].as_f64().unwrap();
        (report["rms_px"].as_f64().unwrap(), [fx(0), fx(1)], report["sheets"][1]["points"].as_u64().unwrap())
    };
    let (rms, fx, points) = told(format!("{} {}", path("0.png"), path("1.png")));
    let (rms_recorded, fx_recorded, points_recorded) = told(file.clone());
    println!("rms {rms} px, fx {fx:?}, {points} points");
    assert!(rms < 0.1 && (fx[0] / 1500.0 - 1.0).abs() < 0.01 && points == 80, "{rms} {fx:?} {points}");
    assert!((rms - rms_recorded).abs() < 1e-4 && points == points_recorded, "{rms} {rms_recorded}");
    assert!(fx.iter().zip(fx_recorded).all(|(a, b)| (a / b - 1.0).abs() < 1e-5), "{fx:?} {fx_recorded:?}");
    let told = refused(&format!("dots {picked} --pictures {file} {}", path("0.png")));
    assert!(
        told.contains("expected one recording (.mcap) or a picture of each camera, found both"),
        "{told}"
    );
    let told = refused(&format!("dots {picked} --size 320x240 --pictures {file}"));
    assert!(told.contains("target.mcap, camera 0, picture 3: expected 320×240 px by --size"), "{told}");
}
