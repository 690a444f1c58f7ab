//! The program `vitreo-calibration`: results, refusals, exit codes.

use protocol::blobs::WHOLE_FRAME;
use protocol::fields::{FieldHeader, PixelFormat};
use recording::{PixelsHead, PixelsWriter};
use rig::Rig;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn data(path: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(path).display().to_string()
}

fn calibrate<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vitreo-calibration")).args(args).output().unwrap()
}

/// Runs it and takes the report; panics with the program's own words where it fails.
fn report<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> serde_json::Value {
    let output = calibrate(args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What it says where it refuses, and its exit code.
fn refused<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> (String, i32) {
    let output = calibrate(args);
    assert!(!output.status.success());
    (String::from_utf8(output.stderr).unwrap(), output.status.code().unwrap())
}

fn figure(report: &serde_json::Value, name: &str) -> f64 {
    let all = report["figures"].as_array().unwrap();
    let found = all.iter().find(|f| f["name"].as_str().unwrap().contains(name));
    found.unwrap_or_else(|| panic!("{name} in {all:?}"))["value"].as_f64().unwrap()
}

fn pictures(side: &str, numbers: &[u32]) -> Vec<String> {
    numbers.iter().map(|n| data(&format!("chessboards/{side}{n:02}.jpg"))).collect()
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(String::from).collect()
}

#[test]
fn pictures_of_two_cameras_become_a_rig_with_residual_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let numbers = [1, 2, 3, 4, 6];
    let stereo = [
        words("stereo --board 9x6 --pitch 25 --json --without k3 -o"),
        vec![path("rig.json"), "--residuals".into(), path("pictures"), "--left".into()],
        pictures("left", &numbers),
        vec!["--right".into()],
        pictures("right", &numbers),
    ];
    let told = report(&stereo.concat());
    assert!(told["rms_px"].as_f64().unwrap() < 0.3, "{told}");
    // OpenCV's baseline of all thirteen pairs is 3.345 squares.
    assert!((figure(&told, "baseline") / 25.0 / 3.345 - 1.0).abs() < 0.02);
    assert_eq!(told["cameras"][0]["lens"][8][1]["sigma"], 0.0, "k3 is held");
    let noted = |words: &str| told["notes"].to_string().contains(words);
    assert!(noted("without --rig, the rig has whole frames at 50 Hz: set field_hz"), "{told}");
    assert!(noted("its bodies, trocars and workspace are those of the shipped rig"), "{told}");
    let rig = Rig::load(Path::new(&path("rig.json"))).unwrap();
    assert_eq!(rig.scan, rig::sensor::Scan::Progressive, "the shipped rig's fields are of 720×576 px");
    assert_eq!((rig.cameras.len(), rig.frame, rig.cameras[0].dist[4]), (2, Some([640, 480]), 0.0));
    for id in 0..2 {
        let picture = image::open(path(&format!("pictures/residuals_cam{id}.png"))).unwrap().into_rgb8();
        assert!(picture.pixels().filter(|p| p.0[0] > 150 && p.0[1] < 100).count() > 300, "vectors are drawn");
    }
    // A lens into the rig that was just made, and whose lens was then turned.
    let mut off = rig.clone();
    (off.cameras[1].fx, off.cameras[1].fy) = (1.02 * rig.cameras[1].fx, 1.02 * rig.cameras[1].fy);
    std::fs::write(path("off.json"), off.to_json()).unwrap();
    let lens = [
        words("intrinsics --json --board 9x6 --camera 1 --rig"),
        vec![path("off.json"), "-o".into(), path("new.json")],
        pictures("right", &numbers),
    ];
    let told = report(&lens.concat());
    let new = Rig::load(Path::new(&path("new.json"))).unwrap();
    assert_eq!(new.cameras[1].t, rig.cameras[1].t, "its place stays");
    assert!((new.cameras[1].fx - told["cameras"][0]["lens"][0][1]["value"].as_f64().unwrap()).abs() < 1e-9);
}

/// The same pictures as a recording of the cameras 4 and 7, one every 25 numbers.
fn recorded(path: &Path, numbers: &[u32]) {
    let head = PixelsHead {
        rig_json: "{}".into(),
        cameras: vec![4, 7],
        field_hz: 25.0,
        realtime_offset_ns: 0,
        sources: Vec::new(),
    };
    let mut writer = PixelsWriter::on(File::create(path).unwrap(), path, &head).unwrap();
    for (i, number) in (0..).zip(numbers) {
        for (camera, side) in [(4, "left"), (7, "right")] {
            let picture = image::open(&pictures(side, &[*number])[0]).unwrap().into_luma8();
            let header = FieldHeader {
                field: 25 * i,
                exposed_ns: i + 1,
                first_line_ns: i + 1,
                line_period_ns: 1,
                camera,
                parity: WHOLE_FRAME,
                format: PixelFormat::Y8 as u32,
                width: picture.width(),
                height: picture.height(),
                lines: picture.height(),
            };
            writer.write(&header, picture.as_raw()).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn a_recording_serves_as_its_pictures_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (numbers, file) = ([1, 2, 3, 4, 6], path("a.mcap"));
    recorded(Path::new(&file), &numbers);
    let fx = |told: &serde_json::Value| told["cameras"][0]["lens"][0][1]["value"].as_f64().unwrap();
    let of_pictures =
        report(&[words("intrinsics --json --board 9x6 --camera 4"), pictures("left", &numbers)].concat());
    let of_recording = report(&words(&format!("intrinsics --json --board 9x6 --camera 4 {file}")));
    // Luma in the studio range has fewer steps.
    assert!((fx(&of_recording) / fx(&of_pictures) - 1.0).abs() < 2e-3, "{of_recording}");
    assert_eq!(of_recording["sheets"].as_array().unwrap().len(), numbers.len());
    let both = format!(
        "stereo --board 9x6 --pitch 25 --json --without k3 --left {file} --right {file} --recorded 4 7"
    );
    assert!((figure(&report(&words(&both)), "baseline") / 25.0 / 3.345 - 1.0).abs() < 0.02);
    for (args, named) in [
        (format!("intrinsics --board 9x6 {file}"), "has no camera 0; its cameras are [4, 7]"),
        (format!("intrinsics --board 9x6 --camera 4 {file} {file}"), "expected one recording"),
        (format!("waved {file} -o {}", path("r.json")), "missing key"),
    ] {
        let (told, code) = refused(&words(&args));
        assert!(code == 1 && told.contains(named), "{args}: {told}");
    }
    // The shipped rig has another size.
    let rig = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/rig.json").display().to_string();
    let mut own: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(rig).unwrap()).unwrap();
    own["cameras"][0]["id"] = 4.into();
    std::fs::write(path("own.json"), own.to_string()).unwrap();
    let (told, _) =
        refused(&words(&format!("intrinsics --board 9x6 --camera 4 --rig {} {file}", path("own.json"))));
    assert!(told.contains("as camera 4 of the rig has, found 640×480"), "{told}");
}

#[test]
fn pictures_without_a_board_are_passed_over_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let blank = folder.path().join("blank.png");
    image::GrayImage::from_pixel(640, 480, image::Luma([90])).save(&blank).unwrap();
    let mut args = [words("intrinsics --json --board 9x6"), pictures("left", &[1, 2, 3])].concat();
    args.push(blank.display().to_string());
    let told = report(&args);
    assert!(told["notes"][0].as_str().unwrap().contains("blank.png skipped: no corners"), "{told}");
    assert_eq!(told["sheets"].as_array().unwrap().len(), 3);
    let small = folder.path().join("small.png");
    image::GrayImage::from_pixel(320, 240, image::Luma([90])).save(&small).unwrap();
    *args.last_mut().unwrap() = small.display().to_string();
    let (told, code) = refused(&args);
    assert!(code == 1 && told.contains("small.png: expected 640×480 px"), "{told}");
}

#[test]
fn bad_input_is_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let (left, nothing) = (data("chessboards/left01.jpg"), file("no.jpg", "no picture"));
    let list = file("list.txt", "1 2 3 4 5\n1 2 x 4 5\n");
    let plane: String =
        (0..20).map(|i| format!("{} {} {} {} 0\n", 30 * (i % 5), 40 * (i / 5), i % 5, i / 5)).collect();
    let further = file("further.txt", &plane.replace(" 0\n", " 1\n"));
    let plane = file("plane.txt", &plane);
    let blobs = file("blobs.jsonl", "{\"cam\":0}\n");
    let empty = file("empty.jsonl", "");
    let poses = file("poses.csv", "t_ns,body\n");
    let rig = data("tracker/static/rig.json");
    let cases: [(String, i32, &str); 29] = [
        ("".into(), 2, "Usage"),
        ("intrinsics --board 9x6".into(), 2, "PICTURE"),
        (format!("intrinsics {left}"), 2, "expected a board: --board COLUMNSxROWS"),
        (format!("intrinsics --board 9 {left}"), 2, "two whole numbers"),
        (format!("intrinsics --board 9x6 --without k9 {left}"), 2, "k9"),
        (format!("intrinsics --board 9x6 --pitch 0 {left}"), 2, "a number above 0"),
        (format!("intrinsics --board 9x6 {left}"), 1, "found in 1 pictures; at least 3"),
        (format!("intrinsics --board 7x5 {left}"), 1, "not found in any of 1 pictures"),
        (format!("intrinsics --board 9x6 {nothing}"), 1, "no.jpg"),
        (format!("intrinsics --points {list} --size 640x480"), 1, "list.txt, line 2: X: expected a number"),
        (format!("stereo --board 9x6 --left {left} {left} --right {left}"), 1, "2 left and 1 right"),
        (
            format!("stereo --board 9x6 --left {left} --right {left}"),
            1,
            "(54 dots) in left01.jpg and left01.jpg",
        ),
        (format!("dots --size 640x480 {plane} {further}"), 1, "all dots lie in one plane"),
        (
            format!("dots {plane}"),
            1,
            "expected --size WIDTHxHEIGHT, to find the lenses too, or --rig RIG.json",
        ),
        (
            format!("dots --rig {rig} {plane}"),
            1,
            "expected a point list of each of the rig's 3 cameras, found 1",
        ),
        (
            format!("dots --size 100x80 {plane}"),
            1,
            "(plane.txt): 8 of 20 points lie outside of the 100×80 px of --size",
        ),
        (format!("intrinsics --charuco 7x5 {left}"), 1, "fewer than two markers of the board"),
        (format!("intrinsics --charuco 7x5,0 {left}"), 2, "square: expected mm above 0"),
        (format!("intrinsics --charuco 7x5 --board 9x6 {left}"), 2, "cannot be used with"),
        (format!("intrinsics --legacy --board 9x6 {left}"), 2, "cannot be used with"),
        (
            format!("intrinsics --rig {rig} --board 9x6 {left} {left} {left}"),
            1,
            "as camera 0 of the rig has, found 640×480",
        ),
        ("board --board 9x6 -o board.gif".into(), 2, "a name that ends in .svg or .png"),
        (format!("dots --pictures {left}"), 2, "--target"),
        (format!("dots --pictures {left} --target {list} --picked {plane}"), 1, "line 1: expected 3 numbers"),
        (format!("waved --rig {rig} {blobs}"), 1, "blobs.jsonl, line 1"),
        (format!("drift --rig {rig} {empty}"), 1, "too little to judge"),
        (format!("waved --rig {rig} {empty}"), 1, "empty.jsonl: too little to judge: 0 blobs"),
        (
            format!("pivot --rig {rig} {empty}"),
            1,
            "empty.jsonl: too little to judge: 0 blobs after the first 0.3 s, at least 200 are needed: is it a stream of",
        ),
        (format!("pivot --rig {rig} --poses {poses}"), 1, "expected a column x"),
    ];
    for (line, expected, named) in cases {
        let (told, code) = refused(&words(&line));
        assert!(code == expected && told.contains(named), "{line}: exit {code}: {told}");
        assert!(!told.contains("panicked"), "{told}");
    }
    let (told, _) = refused(&["drift", &data("tracker/static/blobs.jsonl")]);
    assert!(told.contains("a blob stream needs --rig RIG.json"), "{told}");
}

#[test]
fn a_drifted_rig_ends_with_5_and_a_refined_one_with_0() {
    let folder = tempfile::tempdir().unwrap();
    let refined = folder.path().join("refined.json").display().to_string();
    let (rig, blobs) = (data("tracker/calib/rig.json"), data("tracker/calib/blobs.jsonl"));
    let output = calibrate(&["drift", "--rig", &rig, &blobs]);
    let [report_text, told] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    let code = output.status.code();
    assert!(code == Some(5) && report_text.contains("Remedy: calibrate again"), "{code:?}: {report_text}");
    assert_eq!(told, "", "the report has the verdict, and trackers of the search log nothing");
    let told = report(&["waved", "--json", "--rig", &rig, &blobs, "-o", &refined]);
    let [before, after] = ["before", "after"].map(|n| figure(&told, &format!("rms of residuals {n}")));
    assert!(after < 0.75 * before, "{told}");
    let kept = folder.path().join("drift.json").display().to_string();
    let told = report(&["drift", "--json", "--rig", &refined, &blobs, "-o", &kept]);
    assert!(figure(&told, "camera 0: systematic") < 0.01, "{told}");
    let written: serde_json::Value = serde_json::from_slice(&std::fs::read(&kept).unwrap()).unwrap();
    assert_eq!(written, told, "-o keeps what is told");
}

#[test]
fn a_recording_brings_its_own_rig() {
    let output = calibrate(&["drift", "--json", &data("golden/peel-2s.mcap")]);
    let told: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // Drawn with the very rig that is checked; what remains is how blobs are centred.
    for camera in 0..3 {
        let shift = figure(&told, &format!("camera {camera}: systematic"));
        assert!(shift < 0.1, "camera {camera}: {shift} px");
    }
    assert!(figure(&told, "instants") > 50.0);
}

#[test]
fn trocars_and_the_eyes_centre_are_found_by_pivoting() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("rig.json").display().to_string();
    let (drifted, blobs) = (data("tracker/calib/rig.json"), data("tracker/calib/blobs.jsonl"));
    // Pivots of a rig that does not hold are elsewhere.
    let (told, code) = refused(&["pivot", "--rig", &drifted, &blobs, "-o", &output]);
    assert!(code == 5 && told.contains("nothing was written") && !Path::new(&output).exists(), "{told}");
    let rig = folder.path().join("refined.json").display().to_string();
    report(&["waved", "--json", "--rig", &drifted, &blobs, "-o", &rig]);
    let told = report(&["pivot", "--json", "--recentre", "--rig", &rig, &blobs, "-o", &output]);
    let [old, new] = [rig, output].map(|p| Rig::load(&PathBuf::from(p)).unwrap());
    for (a, b) in old.trocars.iter().zip(&new.trocars) {
        let off: f64 = a.p_eye.iter().zip(b.p_eye).map(|(x, y)| (x - y) * (x - y)).sum();
        // Three seconds of shafts with a play of 0.05 mm, which changes slowly.
        assert!(off.sqrt() < 0.15 && (0.01..0.1).contains(&b.sigma), "{a:?} {b:?}\n{told}");
    }
    for axis in ["x", "y", "z"] {
        // It is the origin; the eye hardly turned about x in these seconds.
        assert!(figure(&told, &format!("eye's centre in the world: {axis}")).abs() < 0.03, "{told}");
    }
    assert_ne!(old.cameras[0].t, new.cameras[0].t);
    // An eye and instruments that are held still show no pivot.
    let (rig, blobs) = (data("tracker/static/rig.json"), data("tracker/static/blobs.jsonl"));
    let (told, code) = refused(&["pivot", "--rig", &rig, &blobs]);
    assert!(code == 1 && told.contains("mrad only"), "{told}");
}

/// The folder of a real rig of three cameras before a stepped target, if it is there.
fn real_rig() -> Option<PathBuf> {
    skips::data("cameras/myptv/Calibration")
}

/// Median errors along x, y, z of dots that took no part, µm.
fn held_out(told: &serde_json::Value) -> [f64; 3] {
    ["x", "y", "z"].map(|axis| figure(told, &format!("rms error along {axis}")))
}

#[test]
fn three_real_cameras_place_dots_within_14_19_57_um() {
    let Some(folder) = real_rig() else { return };
    let mut args = words("dots --json --size 1280x1024 --splits 20");
    args.extend((1..=3).map(|c| folder.join(format!("cam{c}_cal_points")).display().to_string()));
    let [x, y, z] = held_out(&report(&args));
    println!("dots held out, median of 20 splits: {x:.1} {y:.1} {z:.1} µm");
    // Least squares on a random half of the 406 common dots: about 14/27/55 µm.
    assert!(x <= 14.0 && y <= 19.0 && z <= 57.0, "{x} {y} {z}");
}

#[test]
fn three_real_cameras_find_the_dots_in_their_pictures() {
    let Some(folder) = real_rig() else { return };
    let files = |name: &dyn Fn(u32) -> String| -> Vec<String> {
        (1..=3).map(|c| folder.join(name(c)).display().to_string()).collect()
    };
    let mut args = words("dots --json --splits 20 --target");
    args.push(folder.join("target_file").display().to_string());
    args.push("--pictures".into());
    args.extend(files(&|c| format!("cal{c}.png")));
    args.push("--picked".into());
    args.extend(files(&|c| format!("cam{c}_manualPoints")));
    let told = report(&args);
    // MyPTV found 421, 432 and 411 of the 437 dots.
    for sheet in told["sheets"].as_array().unwrap() {
        assert!(sheet["points"].as_u64().unwrap() >= 405, "{sheet}");
    }
    let [x, y, z] = held_out(&told);
    println!("the same from pictures: {x:.1} {y:.1} {z:.1} µm");
    assert!(x <= 14.0 && y <= 20.0 && z <= 55.0, "{x} {y} {z}");
}

#[test]
fn five_real_cameras_converge_with_all_lens_terms() {
    let Some(folder) = skips::data("cameras/flydra") else { return };
    let mut args = words("dots --json --size 656x491 --splits 20");
    args.extend((1..=5).map(|c| folder.join(format!("fly{c}")).display().to_string()));
    let told = report(&args);
    let rms = told["rms_px"].as_f64().unwrap();
    let [x, y, z] = held_out(&told);
    println!("rms {rms:.3} px; dots held out, median of 20 splits: {x:.1} {y:.1} {z:.1} µm");
    // The fifth camera's worse minimum gives 0.2525.
    assert!(rms <= 0.2515, "{rms}");
    assert!(x <= 30.0 && y <= 20.0 && z <= 78.0, "{x} {y} {z}");
}

#[test]
fn pictures_of_another_size_or_without_dots_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    image::GrayImage::from_pixel(640, 480, image::Luma([90])).save(path("blank.png")).unwrap();
    std::fs::write(path("target"), "0 0 0\n5 0 0\n0 5 0\n5 5 3\n").unwrap();
    std::fs::write(path("picked"), "100 100 0 0 0\n200 100 5 0 0\n100 200 0 5 0\n210 210 5 5 3\n").unwrap();
    let mut args = words("dots --pictures");
    args.extend([path("blank.png"), "--target".into(), path("target"), "--picked".into(), path("picked")]);
    let (told, code) = refused(&args);
    let expected = "blank.png: expected the 4 dots of the target, round and on an even ground, found none";
    assert!(code == 1 && told.contains(expected), "{told}");
    args.extend(words("--size 320x240"));
    let (told, code) = refused(&args);
    assert!(code == 1 && told.contains("blank.png: expected 320×240 px by --size, found 640×480"), "{told}");
}
