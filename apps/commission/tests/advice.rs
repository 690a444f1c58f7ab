//! Wrong input of a step is reported with its remedy, and nothing is written.

#[allow(dead_code, reason = "the boards that it paints are for the other tests")]
mod painted;

use fpga_model::colours::learn::hue_deg;
use painted::{stream, write_markers, write_stream};
use protocol::blobs::Colour;
use rig::Rig;
use std::path::{Path, PathBuf};
use std::process::Command;

fn data(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(path)
}

/// What a step says, and its exit code.
fn said(args: &[&str]) -> (String, i32) {
    let output = Command::new(env!("CARGO_BIN_EXE_vitreo-commission")).args(args).output().unwrap();
    let told = [output.stdout, output.stderr].map(|b| String::from_utf8(b).unwrap()).concat();
    assert!(!told.contains("panicked"), "{told}");
    (told, output.status.code().unwrap())
}

/// Checks that a step refuses in these words, and leaves no folder.
fn refused(folder: &Path, args: &[&str], code: i32, named: &[&str]) {
    let new = folder.join("new");
    let (told, found) = said(&[&[new.to_str().unwrap()], args].concat());
    assert_eq!(found, code, "{args:?}: {told}");
    named.iter().for_each(|words| assert!(told.contains(words), "{args:?}: {words:?} in {told}"));
    assert!(!new.exists(), "{args:?}: something was written");
}

/// Chessboards of a stereo rig as pictures of cameras 0 and 1 of a rig of their size.
fn chessboards(folder: &Path, left: &[u32], blank: u32) -> (String, String) {
    let mut rig = Rig::load_or_shipped(None).unwrap();
    rig.cameras.truncate(2);
    rig.cameras.iter_mut().for_each(|c| (c.width, c.height, c.cx, c.cy) = (640, 480, 320.0, 240.0));
    rig.frame = Some([640, 480]);
    std::fs::write(folder.join("rig.json"), rig.to_json()).unwrap();
    std::fs::create_dir(folder.join("pictures")).unwrap();
    for number in left {
        let from = data(&format!("chessboards/left{number:02}.jpg"));
        std::fs::copy(from, folder.join(format!("pictures/cam0-{number:02}.jpg"))).unwrap();
    }
    for number in 0..blank {
        let name = folder.join(format!("pictures/cam0-{:02}.png", 50 + number));
        image::GrayImage::from_pixel(640, 480, image::Luma([90])).save(name).unwrap();
    }
    let path = |name: &str| folder.join(name).display().to_string();
    (path("rig.json"), path("pictures"))
}

#[test]
fn a_board_that_was_seen_seldom_is_to_be_moved_nearer() {
    let folder = tempfile::tempdir().unwrap();
    let (rig, pictures) = chessboards(folder.path(), &[1, 2, 3], 9);
    refused(
        folder.path(),
        &["--rig", &rig, "lenses", "--board", "9x6", "--pitch", "25", "--from", &pictures],
        1,
        &["camera 0 saw the board in 3 of 12 pictures, at least 8 are needed: move it nearer"],
    );
    // Of another board some corners hang together.
    refused(
        folder.path(),
        &["--rig", &rig, "lenses", "--board", "12x9", "--from", &pictures],
        1,
        &["camera 0 saw the board in 0 of 12 pictures", "check --board"],
    );
    refused(
        folder.path(),
        &["lenses", "--board", "9x6", "--from", &pictures],
        1,
        &["cam0-01.jpg: 640×480 px, but camera 0 of the rig has 720×576 px", "give the pictures of camera 0"],
    );
    let poses = ["--rig", &*rig, "poses", "--board", "9x6", "--from", &*pictures];
    refused(folder.path(), &poses, 1, &["camera 1: no pictures: all cameras must see the board"]);
}

/// Real pictures: OpenCV's own lens of all thirteen is 536 px (`intrinsics.yml`).
#[test]
fn real_boards_give_a_lens_and_say_what_is_bare() {
    let folder = tempfile::tempdir().unwrap();
    let (rig, pictures) = chessboards(folder.path(), &[1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14], 0);
    let new = folder.path().join("new");
    let args = ["--rig", &*rig, "lenses", "--board", "9x6", "--pitch", "25", "--from", &*pictures];
    let (told, code) = said(&[&[new.to_str().unwrap()], &args[..]].concat());
    assert_eq!(code, 0, "{told}");
    assert!(told.contains("camera 0: pictures with the board: 13 of 13"), "{told}");
    assert!(told.contains("camera 1: no pictures; its lens is unchanged"), "{told}");
    let found = Rig::load(&new.join("rig.json")).unwrap();
    assert!((found.cameras[0].fx / 536.0 - 1.0).abs() < 0.02, "{}", found.cameras[0].fx);
    assert!(new.join("pictures/lens-cam0.png").exists() && new.join("report.html").exists());
    let (told, code) = said(&[new.to_str().unwrap()]);
    assert!(code == 0 && told.contains("lenses    done: cameras 0") && told.contains("next:"), "{told}");
}

#[test]
fn markers_of_two_colours_that_are_too_near_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let pictures = folder.path().join("markers");
    std::fs::create_dir(&pictures).unwrap();
    let rig = Rig::load_or_shipped(None).unwrap();
    let [red, yellow] = [Colour::Red, Colour::Yellow].map(|c| hue_deg(&c.reference()));
    // Yellow paint that is orange: its hue is carried to so many degrees from red.
    let orange = |to_deg: f64| {
        move |[y, cb, cr]: [u8; 3]| {
            let (hue, [b, r]) = (hue_deg(&[y, cb, cr]), [cb, cr].map(|v| f64::from(v) - 128.0));
            if (hue - yellow).abs() > 25.0 || b.hypot(r) < 12.0 {
                return [y, cb, cr];
            }
            let (sin, cos) = (red + to_deg + 0.3 * (hue - yellow)).to_radians().sin_cos();
            let [b, r] = [cos, sin].map(|v| (128.0 + v * b.hypot(r)).round() as u8);
            [y, b, r]
        }
    };
    let args = ["colours", "--from", pictures.to_str().unwrap()];
    write_markers(&rig, &pictures, 100, orange(18.0));
    refused(folder.path(), &args, 1, &["red", "yellow", "too close"]);
    write_markers(&rig, &pictures, 100, |[y, _, _]| [y, 128, 128]);
    refused(folder.path(), &args, 1, &["red: no picture shows a marker of this colour", "with more light"]);
    write_markers(&rig, &pictures, 100, |[y, cb, cr]| [y.max(120), cb, cr]);
    refused(folder.path(), &args, 1, &["the background is too bright (luma 120", "cover what is behind"]);
    std::fs::write(pictures.join("cam0-0200.png"), "no picture").unwrap();
    refused(folder.path(), &args, 1, &["cam0-0200.png"]);
}

#[test]
fn streams_that_say_too_little_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let rig = Rig::load_or_shipped(None).unwrap();
    let file = folder.path().join("stream.jsonl");
    let path = file.display().to_string();
    let seen = stream(&rig, 4.0);
    let try_all = |named: &[&str]| {
        for step in ["poses", "trocars", "check"] {
            refused(folder.path(), &[step, "--from", &path], 1, named);
        }
    };
    write_stream(&seen.fields[..150], &file);
    try_all(&["the stream lasts 1.0 s, at least 2.5 s are needed: record half a minute"]);
    let without: Vec<_> = seen.fields.iter().filter(|f| f.camera != 1).copied().collect();
    write_stream(&without, &file);
    try_all(&["no field of camera 1: is it connected?"]);
    let dark = seen.fields.iter().copied().map(|mut f| {
        f.count = if f.camera == 2 && f.field > 20 { 0 } else { f.count };
        f
    });
    write_stream(&dark.collect::<Vec<_>>(), &file);
    try_all(&["camera 2 saw blobs in", "turn it to the instruments"]);
    let strange = seen.fields.iter().copied().map(|mut f| {
        f.camera += 1;
        f
    });
    write_stream(&strange.collect::<Vec<_>>(), &file);
    try_all(&["has fields of camera 3, which the rig lacks"]);
    std::fs::write(&file, "{\"cam\":0}\n").unwrap();
    try_all(&["stream.jsonl, line 1"]);
    // Hands that rest tilt nothing.
    let rest: Vec<_> = (0..200u64)
        .flat_map(|n| seen.fields[..6].iter().map(move |f| (n, *f)))
        .map(|(n, mut f)| {
            f.field += 2 * n;
            [f.exposed_ns, f.read_out_ns, f.blobs_out_ns] =
                [f.exposed_ns, f.read_out_ns, f.blobs_out_ns].map(|t| t + 40_000_000 * n);
            f
        })
        .collect();
    write_stream(&rest, &file);
    refused(folder.path(), &["trocars", "--from", &path], 1, &["tilt it in its trocar, far to all sides"]);
}

#[test]
fn wrong_use_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (args, code, named) in [
        (&["lenses", "--board", "9x6"][..], 2, "--from"),
        (&["lenses", "--from", "x"], 2, "expected a board: --board COLUMNSxROWS"),
        (&["lenses", "--board", "9x6", "--from", "gone.png"], 1, "gone.png"),
        (
            &["lenses", "--board", "9x6", "--cameras", "driver"],
            2,
            "expected y4m:PATH, mcap:FILE, v4l2:/dev/videoN or genicam:NAME",
        ),
        (
            &["lenses", "--board", "9x6", "--cameras", "y4m:a"],
            1,
            "expected one for each of 3 cameras, found 1",
        ),
        (&["poses", "--every", "0", "--from", "x"], 2, "--every"),
        (&["trocars"], 2, "--from"),
        (&["lunch"], 2, "lunch"),
    ] {
        refused(folder.path(), args, code, &[named]);
    }
}
