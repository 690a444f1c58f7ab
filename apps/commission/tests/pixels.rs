//! A recording of pixels serves as a stream: its blobs are found on the way.

use clap::Parser;
use fpga_model::commands::blobs::{self, BlobsArgs};
use recording::{PixelsHead, PixelsWriter};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::fs::File;
use std::path::Path;
use std::process::{Command, Output};
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path as How};

#[derive(Parser)]
struct BlobsLine {
    #[command(flatten)]
    args: BlobsArgs,
}

fn commission(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vitreo-commission")).args(args).output().unwrap()
}

/// What the cameras of a rig see of a surgeon, pixel by pixel.
fn painted(path: &Path, rig: &Rig, seconds: f64) {
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut surgeon = MotionSource::new(&scene, rig, None, 3);
    let mut cameras = Cameras::new(rig, How::Pixels, 3).unwrap();
    let head = PixelsHead {
        rig_json: rig.to_json(),
        cameras: rig.cameras.iter().map(|c| c.id).collect(),
        field_hz: rig.field_hz,
        realtime_offset_ns: 0,
    };
    let mut writer = PixelsWriter::on(File::create(path).unwrap(), path, &head).unwrap();
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

#[test]
fn a_check_by_pixels_says_what_one_by_their_blobs_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [pixels, found] = ["wave.mcap", "blobs.jsonl"].map(path);
    painted(Path::new(&pixels), &Rig::load_or_shipped(None).unwrap(), 2.7);
    blobs::run(&BlobsLine::parse_from(["blobs", &pixels, "-o", &found]).args).unwrap();
    let [of_pixels, of_blobs] = [("a", &pixels), ("b", &found)]
        .map(|(rig, stream)| commission(&[&path(rig), "check", "--from", stream]));
    let [a, b] = [&of_pixels, &of_blobs].map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
    let said = String::from_utf8_lossy(&of_pixels.stderr);
    assert_eq!(of_pixels.status.code(), of_blobs.status.code(), "{said}");
    assert!(a.starts_with("check: ") && a.contains("camera 2"), "{a}{said}");
    assert_eq!(a, b);
    // With a board, poses are calibrated from its pictures.
    let output = commission(&[&path("c"), "poses", "--board", "9x6", "--pitch", "2.5", "--from", &pixels]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && told.contains("wave.mcap, camera 0, picture "), "{told}");
}
