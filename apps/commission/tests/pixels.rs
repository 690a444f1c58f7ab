//! A recording of pixels serves as a stream: its blobs are found on the way.

#[allow(dead_code, reason = "some of what it paints is for the other tests")]
mod painted;

use clap::Parser;
use fpga_model::commands::blobs::{self, BlobsArgs};
use nalgebra::Vector3;
use painted::{displaced, places_off, record_pixels, stream, tips_um};
use rig::{Rig, Trocar};
use std::path::Path;
use std::process::{Command, Output};

#[derive(Parser)]
struct BlobsLine {
    #[command(flatten)]
    args: BlobsArgs,
}

fn commission(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vitreo-commission")).args(args).output().unwrap()
}

#[test]
fn a_check_by_pixels_says_what_one_by_their_blobs_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [pixels, found] = ["wave.mcap", "blobs.jsonl"].map(path);
    record_pixels(Path::new(&pixels), &Rig::load_or_shipped(None).unwrap(), 2.7);
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

/// Runs a step; the rig that it leaves in the folder, and what it printed.
fn rig_after(args: &[&str]) -> (Rig, String) {
    let output = commission(args);
    let [out, err] = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b).into_owned());
    assert!(output.status.success(), "{args:?}: {err}");
    println!("{out}{err}");
    (Rig::load(&Path::new(args[0]).join("rig.json")).unwrap(), out + &err)
}

#[test]
fn poses_and_trocars_from_pixels_are_those_of_the_rig_that_painted_them() {
    let truth = Rig::load_or_shipped(None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [pixels, begin, new] = ["wave.mcap", "begin.json", "new"].map(path);
    record_pixels(Path::new(&pixels), &truth, 6.0);
    let mut off = displaced(&truth, 0.1, 1.0);
    off.trocars.iter_mut().for_each(|trocar| trocar.p_eye = trocar.p_eye.map(|v| v + 0.3));
    std::fs::write(&begin, off.to_json()).unwrap();

    // Judged by the blobs of the same motion, with noise of their own.
    let seen = stream(&truth, 6.0);
    let (posed, _) = rig_after(&[&new, "--rig", &begin, "poses", "--from", &pixels]);
    let [found_um, true_um] = [&posed, &truth].map(|rig| tips_um(rig, &seen));
    println!("tips {found_um:.1} µm after, {true_um:.1} with the true rig");
    println!(
        "poses {:.3?} before, {:.3?} after, mm, mrad",
        places_off(&off, &truth),
        places_off(&posed, &truth)
    );
    assert!(found_um < 1.5 * true_um + 1.0, "{found_um} µm");

    let (rig, told) = rig_after(&[&new, "trocars", "--from", &pixels]);
    let mm = |a: &Trocar, b: &Trocar| (Vector3::from(a.p_eye) - Vector3::from(b.p_eye)).norm();
    let [first, second] = [0, 1].map(|i| mm(&rig.trocars[i], &truth.trocars[i]));
    println!("trocars {first:.3} and {second:.3} mm off");
    assert!(first < 0.03, "{first} mm");
    // In these seconds the light pipe hardly tilts.
    assert!(told.contains("inst1: degenerate geometry: the shaft was tilted by"), "{told}");
    assert_eq!(rig.trocars[1], off.trocars[1]);
}
