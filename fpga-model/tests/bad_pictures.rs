//! `vitreo-fpga-model blobs` on files that are broken, hostile or do not fit each other: each is
//! refused with the file, the place and what was expected, and nothing is ever worse than a
//! refusal.

use proptest::prelude::*;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn program(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vitreo-fpga-model"));
    command.arg("blobs").args(args).stdin(Stdio::null()).output().expect("the program starts")
}

/// Runs in a folder of files; expects exit code `code` and a message.
fn refused(files: &[(&str, &[u8])], args: &[&str], code: i32, expected: &[&str]) {
    let folder = tempfile::tempdir().expect("scratch folder");
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).expect("file");
    }
    let is_file = |a: &str| files.iter().any(|(name, _)| *name == a);
    let path = |a: &str| folder.path().join(a).display().to_string();
    let args: Vec<String> = args.iter().map(|a| if is_file(a) { path(a) } else { (*a).to_owned() }).collect();
    let done = program(&args.iter().map(String::as_str).collect::<Vec<_>>());
    let told = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(code), "{args:?}: {told}");
    for part in expected {
        assert!(told.contains(part), "{part:?} is not in: {told}");
    }
}

/// A clip of 8 × 4 px, 4:2:2.
fn clip(pictures: usize) -> Vec<u8> {
    clip_as("Ip C422", pictures)
}

fn clip_as(kind: &str, pictures: usize) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 W8 H4 F50:1 {kind}\n").into_bytes();
    for _ in 0..pictures {
        bytes.extend([&b"FRAME\n"[..], &[40; 32], &[128; 32]].concat());
    }
    bytes
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image =
        image::RgbImage::from_fn(width, height, |x, y| image::Rgb([(x * 40) as u8, (y * 60) as u8, 90]));
    image.write_to(&mut bytes, image::ImageFormat::Png).expect("an image");
    bytes.into_inner()
}

fn line(cam: u32, seq: u64) -> String {
    format!("{{\"cam\":{cam},\"seq\":{seq},\"t_ns\":{},\"t_rx_ns\":1,\"parity\":0}}\n", seq + 1)
}

#[test]
fn clips_that_are_no_clips_are_refused_with_their_picture() {
    let cut = &clip(2)[..clip(2).len() - 1];
    refused(
        &[("c.y4m", cut)],
        &["c.y4m"],
        1,
        &["c.y4m, picture 2: expected 64 bytes of samples", "after 63"],
    );
    let deep = String::from_utf8(clip(0)).unwrap().replace("C422", "C422p12");
    refused(
        &[("c.y4m", deep.as_bytes())],
        &["c.y4m"],
        1,
        &["c.y4m: header: expected a colour space", "\"C422p12\""],
    );
    let huge = b"YUV4MPEG2 W4294967296 H1000000000 F50:1 C444\nFRAME\n";
    refused(
        &[("c.y4m", huge)],
        &["c.y4m"],
        1,
        &["c.y4m: header: expected a size from 1x1 to", "4294967296x1000000000"],
    );
    let none = b"YUV4MPEG2 W0 H4 F50:1 C444\nFRAME\n";
    refused(&[("c.y4m", none)], &["c.y4m"], 1, &["found 0x4"]);
    // An odd width is no defect.
    let odd = [&b"YUV4MPEG2 W3 H1 F50:1 C422\nFRAME\n"[..], &[200, 30, 30, 128, 128, 128, 128]].concat();
    refused(&[("c.y4m", &odd)], &["c.y4m"], 0, &["1 pictures"]);
}

#[test]
fn images_that_are_no_images_are_refused() {
    let whole = png(6, 4);
    refused(&[("i.png", &whole[..whole.len() / 2])], &["i.png"], 1, &["i.png: expected a whole PNG or JPEG"]);
    refused(&[("i.png", b"GIF89a")], &["i.png"], 1, &["i.png: expected a PNG, a JPEG or a Y4M clip"]);
    refused(&[("i.png", b"")], &["i.png"], 1, &["i.png: expected a PNG"]);
    refused(&[], &["/nowhere/i.png"], 1, &["/nowhere/i.png: No such file"]);
    refused(&[("i.png", &whole), ("c.y4m", &clip(1))], &["i.png", "c.y4m"], 1, &["found both"]);
    refused(
        &[("i.png", &whole)],
        &["i.png", "--overlay", "/dev/null/o.png"],
        1,
        &["/dev/null/o.png: cannot be written: a part of its path is a file"],
    );
    refused(
        &[("i.png", &whole)],
        &["i.png", "-o", "/dev/null/b.jsonl"],
        1,
        &["/dev/null/b.jsonl: cannot be written: a part of its path is a file"],
    );
}

#[test]
fn lists_of_fields_that_do_not_fit_are_refused_with_their_line() {
    let (two, one) = (clip(2), clip(1));
    let with = |list: &str, expected: &[&str]| {
        let files = [("f.jsonl", list.as_bytes()), ("a.y4m", &two[..]), ("b.y4m", &one[..])];
        refused(&files, &["--fields", "f.jsonl", "a.y4m", "b.y4m"], 1, expected);
    };
    let fits = [line(0, 3), line(1, 3), line(0, 4)].concat();
    with(
        &(fits.clone() + &line(1, 4)),
        &["f.jsonl, line 4: expected picture 2 in", "b.y4m, found the end after 1"],
    );
    with(
        &fits[..fits.len() - line(0, 4).len()],
        &["f.jsonl, line 3: expected a line for picture 2 of", "a.y4m"],
    );
    with(&line(2, 0), &["f.jsonl, line 1: cam: expected 0 to 1, one for each of 2 clips, found 2"]);
    with(&line(9, 0), &["f.jsonl, line 1: cam: expected 0 to 7, found 9"]);
    with("{\"cam\":0}\n", &["f.jsonl, line 1: column", "missing key"]);
    with("\u{0}\n", &["f.jsonl, line 1"]);
}

#[test]
fn arguments_out_of_range_are_wrong_use() {
    for args in [
        &["--threshold", "0", "x.png"][..],
        &["--threshold", "9:5", "x.png"],
        &["--background", "fixed=300", "x.png"],
        &["--background", "white", "x.png"],
        &["--polarity", "grey", "x.png"],
        &["--levels", "9", "x.png"],
        &["--grey", "--key", "x.png"],
        &["--overlay-picture", "3", "x.png"],
        &[],
    ] {
        assert_eq!(program(args).status.code(), Some(2), "{args:?}");
    }
    refused(&[("c.toml", b"format = 3")], &["--colours", "c.toml", "x.png"], 1, &["c.toml, line 1: "]);
}

#[test]
fn a_clip_may_come_through_a_pipe() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vitreo-fpga-model"));
    command.args(["blobs", "-"]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program starts");
    child.stdin.take().expect("a pipe").write_all(&clip(3)).expect("written");
    let done = child.wait_with_output().expect("ended");
    assert!(done.status.success());
    assert_eq!(String::from_utf8(done.stdout).expect("text").lines().count(), 3);
}

/// All pictures of a file through the scanner as the command sets it.
fn find(path: &Path) -> Option<usize> {
    use clap::Parser;
    use fpga_model::colours::file::ColourFile;
    use fpga_model::commands::Command::Blobs;
    use fpga_model::commands::extractor::Extractor;
    use fpga_model::input::source::Source;
    let words = ["vitreo-fpga-model", "blobs", "--background", "tracked", "--threshold", "4:8", "x"];
    let config = fpga_model::config::Config::parse_from(words);
    let Some(Blobs(args)) = config.command else { panic!("not a sub-command") };
    let colours = ColourFile::load_or_shipped(None).expect("shipped");
    let reading = args.tuning.reading(None, None, &colours);
    let mut source = Source::open(&[PathBuf::from(path)], None, &reading).ok()?;
    let mut extractor = Extractor::new(&colours, &args.tuning);
    let mut found = 0;
    while let Some(shot) = source.take().ok()? {
        extractor.scan(&shot);
        assert!(extractor.blobs.iter().all(|b| b.x_px.is_finite() && b.y_field_px.is_finite()));
        found += extractor.blobs.len();
    }
    Some(found)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn altered_files_are_scanned_or_refused(
        kind in 0usize..3,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(), cuts in any::<bool>(),
    ) {
        let mut bytes = match kind {
            0 => clip(3),
            1 => png(13, 7),
            _ => clip_as("It C420", 2),
        };
        for (at, with) in damage {
            let length = bytes.len();
            bytes[at.index(length)] = with;
        }
        if cuts {
            bytes.truncate(cut.index(bytes.len()));
        }
        let mut file = tempfile::NamedTempFile::new().expect("scratch file");
        file.write_all(&bytes).expect("written");
        let _ = find(file.path());
    }
}
