//! `vitreo cameras`: what this machine has, how the cameras of a rig stand, and a picture of each.

use std::path::Path;
use vitreo_tests::{instance_name, json, repository, vitreo};

/// A file of one camera's fields as wide and high as the shipped rig's, each of one luma.
fn clip(path: &Path, luma: u8, fields: usize) -> String {
    let picture = [&b"FRAME\n"[..], &vec![luma; 720 * 288], &vec![128; 720 * 288]].concat();
    let bytes = [b"YUV4MPEG2 W720 H288 F50:1 Ip C422\n".to_vec(), picture.repeat(fields)].concat();
    std::fs::write(path, bytes).expect("written");
    format!("y4m:{}", path.display())
}

#[test]
fn the_cameras_of_this_machine_are_listed() {
    let listed = vitreo(&["cameras", "--list"]).expect_code(0).stdout;
    let has_video = std::fs::read_dir("/dev")
        .expect("/dev")
        .flatten()
        .any(|entry| entry.file_name().to_string_lossy().starts_with("video"));
    assert!(has_video || listed.contains("no cameras: this machine has no /dev/video*"), "{listed}");
    assert_eq!(vitreo(&["cameras"]).expect_code(0).stdout, listed);
}

#[test]
fn virtual_cameras_are_shown_and_kept_as_pictures() {
    let folder = tempfile::tempdir().expect("folder");
    let to = folder.path().join("pictures").display().to_string();
    let shown = vitreo(&["cameras", "virtual", "--snapshot", &to]).expect_code(0).stdout;
    for camera in 0..3 {
        let line =
            shown.lines().find(|l| l.starts_with(&format!("camera {camera} (virtual): "))).expect("a line");
        assert!(line.contains(" blobs, ") && !line.contains(" 0.0 blobs"), "{line}");
        let picture = std::fs::read(Path::new(&to).join(format!("camera-{camera}.png"))).expect("a picture");
        // Width and height in the header of a PNG.
        let side = |at: usize| u32::from_be_bytes(picture[at..at + 4].try_into().expect("four bytes"));
        assert_eq!((&picture[1..4], side(16), side(20)), (&b"PNG"[..], 720, 576));
    }
    let again = vitreo(&["cameras", "virtual", "--snapshot", &to]).expect_code(1);
    assert!(again.stderr.contains("camera-") && again.stderr.contains("--force"), "{again:?}");
    vitreo(&["cameras", "virtual", "--snapshot", &to, "--force"]).expect_code(0);
    let lines = vitreo(&["cameras", "virtual", "--duration", "2.5"]).expect_code(0).stdout;
    assert!(lines.lines().filter(|l| l.starts_with("camera 2 (virtual): ")).count() >= 2, "{lines}");
}

#[test]
fn fields_that_are_kept_are_found_again_and_can_be_cameras() {
    let folder = tempfile::tempdir().expect("folder");
    let to = folder.path().join("fields").display().to_string();
    let keep = ["cameras", "virtual", "--record-fields", &to, "--duration", "1.2"];
    let kept = vitreo(&keep).expect_code(0).stdout;
    let sources = kept.lines().find_map(|line| line.strip_prefix("kept: ")).expect("sources").to_owned();
    assert!(vitreo(&keep).expect_code(1).stderr.contains("--force"));
    let blobs = folder.path().join("blobs.jsonl").display().to_string();
    vitreo(&["blobs", &format!("{to}/camera-0.y4m"), "-o", &blobs]).expect_code(0);
    let lines = std::fs::read_to_string(&blobs).expect("blobs");
    assert!(lines.lines().count() > 20 && lines.contains("\"blobs\""), "{lines}");
    let shown = vitreo(&["cameras", &sources]).expect_code(0).stdout;
    let line = shown.lines().find(|l| l.starts_with("camera 2 ")).expect("a line");
    assert!(line.contains(" blobs, ") && !line.contains(" 0.0 blobs"), "{shown}");
}

#[test]
fn what_is_wrong_with_a_camera_is_said_with_what_to_do() {
    let folder = tempfile::tempdir().expect("folder");
    let dark = clip(&folder.path().join("dark"), 45, 100);
    let bright = clip(&folder.path().join("bright"), 235, 100);
    let shown = vitreo(&["cameras", &format!("{dark},{bright}")]).expect_code(0).stdout;
    // In one of the lines: in the last the file is over, and beside other programs its rate is another.
    let said = |camera: &str, words: &[&str]| {
        let mut lines = shown.lines().filter(|l| l.starts_with(camera));
        lines.any(|line| words.iter().all(|word| line.contains(word)))
    };
    assert!(said("camera 0 ", &["too dark: raise exposure or gain"]), "{shown}");
    assert!(said("camera 1 ", &["100.00 % saturated", "too bright"]), "{shown}");
}

#[test]
fn sources_that_cannot_be_shown_are_refused_in_words() {
    let folder = tempfile::tempdir().expect("folder");
    let clip = clip(&folder.path().join("a"), 45, 2);
    let four = [clip.as_str(); 4].join(",");
    let small = folder.path().join("small");
    std::fs::write(&small, "YUV4MPEG2 W640 H240 F50:1 Ip C422\nFRAME\n").expect("written");
    let small = format!("y4m:{}", small.display());
    for (sources, code, named) in [
        ("usb:3", 2, "v4l2:/dev/videoN"),
        ("v4l2:/dev/video0?gain=much", 2, "gain=NUMBER"),
        (&four, 1, "expected at most the rig's 3 cameras, found 4"),
        (&small, 1, "progressive pictures of 640×240 px"),
        ("/bin/true", 2, "pictures of a program cannot be shown"),
    ] {
        let refused = vitreo(&["cameras", sources, "--duration", "2"]).expect_code(code);
        assert!(refused.stderr.contains(named), "{sources}: {}", refused.stderr);
    }
}

#[test]
fn a_recording_of_fields_brings_the_rig_of_its_cameras() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (fields, report) = (path("fields.mcap"), path("report.json"));
    vitreo(&["cameras", "virtual", "--record-fields", &fields, "--duration", "1.5"]).expect_code(0);
    let info = vitreo(&["info", &fields]).expect_code(0).stdout;
    assert!(info.contains("camera 2: ") && info.contains(" fields of virtual"), "{info}");
    let (cameras, name) = (format!("mcap:{fields}"), instance_name());
    let run = ["run", "--no-picture", "--cameras", &cameras, "--instance", &name, "--report", &report];
    let done = vitreo(&run);
    // A machine that is busy elsewhere may cost fields.
    assert!(matches!(done.code, Some(0 | 3)), "{done:?}");
    let report = json(Path::new(&report));
    assert_eq!(report["setup"]["rig"], format!("of {fields}"), "{report:#}");
    assert!(report["received"]["poses"].as_u64().is_some_and(|poses| poses > 10), "{report:#}");
    let other = repository().join("assets/rig-200hz.json").display().to_string();
    let refused = vitreo(&["run", "--cameras", &cameras, "--rig", &other]).expect_code(1).stderr;
    assert!(refused.contains("fields.mcap: camera 0 was recorded "), "{refused}");
    // It serves as pictures, too: there is no board in them.
    let setup = path("setup");
    let looked =
        vitreo(&["commission", &setup, "lenses", "--board", "9x6", "--every", "2", "--from", &fields]);
    assert!(
        looked.code == Some(1) && looked.stderr.contains("camera 0 saw the board in 0 of "),
        "{looked:?}"
    );
    let needs = vitreo(&["run", "--cameras", "y4m:a,y4m:b,y4m:c"]).expect_code(2).stderr;
    assert!(needs.contains("--rig RIG.json"), "{needs}");
}
