//! What is kept packed is what is kept as clips, to the bit of the blobs.

use super::*;
use crate::commands::clips::Clips;
use clap::Parser;
use fpga_model::commands::blobs::{self, BlobsArgs};
use fpga_model::pixels::decode;
use protocol::fields::FieldPicture;
use scene::{DEFAULT_SCENE, SceneFile};
use std::fmt::Write;
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path as Way};

/// Fields of each camera.
const FIELDS: u64 = 6;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: BlobsArgs,
}

/// The blobs that `vitreo blobs` finds.
fn found(folder: &Path, name: &str, words: &[&str]) -> String {
    let out = folder.join(name).display().to_string();
    let line = Line::parse_from([&["blobs"], words, &["-o", &out]].concat());
    blobs::run(&line.args).expect("blobs");
    std::fs::read_to_string(out).expect("a file")
}

#[test]
fn blobs_of_a_recording_are_those_of_clips() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::load_or_shipped(None).unwrap();
    let (count, mut outputs) = (rig.cameras().len(), Outputs::new(false));
    let path = |name: &str| folder.path().join(name);
    let mut packed =
        Pixels::begin(&path("a.mcap"), vec!["virtual".into(); count], &rig, &mut outputs).unwrap();
    assert!(!path("a.mcap").exists(), "it has its name with its first field");
    let mut clips =
        Clips::begin(folder.path(), std::iter::repeat_n(rig.field_hz, count), &mut outputs).unwrap();
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut surgeon = MotionSource::new(&scene, &rig, None, 1);
    let mut cameras = Cameras::new(&rig, Way::Pixels, 1).unwrap();
    let mut list = String::new();
    for number in 0..FIELDS {
        for i in 0..count {
            let mut exposure = cameras.expose(i, &mut surgeon, number + 1);
            let header = exposure.header();
            let mut payload = vec![0; header.bytes()];
            exposure.paint(&mut payload);
            let mut planes = FieldPicture::of_size(rig.sensor(header.camera).field_size().unwrap());
            decode(&header, &payload, &mut planes).unwrap();
            let FieldPicture { width, height, luma, blue, red } = planes;
            let picture = Picture { width, height, luma, blue, red, as_read: Vec::new() };
            packed.keep(&header, &picture).unwrap();
            // What no reader takes is not written.
            packed.keep(&FieldHeader { exposed_ns: 0, ..header }, &picture).unwrap();
            clips.keep(i, number, header.parity, &picture).unwrap();
            let (cam, parity, out) = (header.camera, header.parity, header.read_out_ns());
            let (seq, taken) = (header.field, header.exposed_ns);
            writeln!(list, r#"{{"cam":{cam},"seq":{seq},"t_ns":{taken},"t_rx_ns":{out},"parity":{parity}}}"#)
                .unwrap();
        }
    }
    assert!(path("a.mcap").exists());
    assert_eq!(packed.finish().unwrap(), format!("mcap:{}", path("a.mcap").display()));
    clips.finish().unwrap();
    std::fs::write(path("fields.jsonl"), list).unwrap();
    let names = ["camera-0.y4m", "camera-1.y4m", "camera-2.y4m", "fields.jsonl", "a.mcap"];
    let [a, b, c, fields, mcap] = names.map(|name| path(name).display().to_string());
    let of_clips = found(folder.path(), "clips.jsonl", &[&a, &b, &c, "--fields", &fields]);
    let of_recording = found(folder.path(), "recording.jsonl", &[&mcap]);
    assert_eq!(of_clips.lines().count() as u64, FIELDS * count as u64);
    assert!(
        of_clips.lines().filter(|line| line.contains("\"blobs\":[[") || line.contains("\"x\"")).count() > 3
    );
    assert!(of_recording == of_clips, "{of_recording}\n{of_clips}");
    let size = |name: &str| path(name).metadata().unwrap().len();
    assert!(size("a.mcap") < 3 * size("camera-0.y4m"), "it is packed");
    let whole = std::fs::read(&mcap).unwrap();
    std::fs::write(path("cut.mcap"), &whole[..whole.len() / 2]).unwrap();
    let of_cut = found(folder.path(), "cut.jsonl", &[&path("cut.mcap").display().to_string()]);
    let (kept, all) = (of_cut.lines().count(), of_recording.lines().count());
    assert!((3..all).contains(&kept) && of_recording.starts_with(&of_cut), "{kept} of {all}");
}
