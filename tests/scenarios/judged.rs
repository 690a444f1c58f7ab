//! What a replay and a run report of streams with small defects: the cause alone, and every time in the same words.

use rig::Rig;
use std::path::Path;
use validation::streams::{Recipe, Scenario};
use vitreo_tests::{instance_name, json, vitreo};

/// A stream of two waved instruments and the rig file that goes with it, in a folder.
struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    /// Fields as `seen_by` sees them, camera 1's stamps late by `late_ns`; `given` is the rig file.
    fn new(seen_by: &Rig, given: &Rig, late_ns: i64) -> Self {
        let folder = tempfile::tempdir().expect("folder");
        let recipe = Recipe { scenario: Scenario::Nominal, seed: 3, seconds: 6.0, knocks: Vec::new() };
        let mut lines = String::new();
        for mut field in recipe.draw(seen_by).fields {
            if field.camera == 1 {
                field.exposed_ns = field.exposed_ns.saturating_add_signed(late_ns);
            }
            lines += &blob_stream::write_line(&field);
            lines.push('\n');
        }
        std::fs::write(folder.path().join("b.jsonl"), lines).expect("written");
        std::fs::write(folder.path().join("rig.json"), given.to_json()).expect("written");
        Files { folder }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    fn warnings_of(&self, report: &str) -> String {
        json(Path::new(&self.path(report)))["warnings"].to_string()
    }

    /// What the reports of two replays warn of, and what they print.
    fn replayed(&self) -> [(String, String); 2] {
        let [rig, blobs, recording] = ["rig.json", "b.jsonl", "a.mcap"].map(|name| self.path(name));
        vitreo(&["import", "--rig", &rig, &blobs, "-o", &recording]).expect_code(0);
        ["1.json", "2.json"].map(|report| {
            let done = vitreo(&["replay", &recording, "--lockstep", "--report", &self.path(report)]);
            let cause = done.stdout.lines().filter(|line| line.contains("reprojection residual")).collect();
            (self.warnings_of(report), cause)
        })
    }
}

fn shipped() -> Rig {
    Rig::load_or_shipped(None).expect("the shipped rig")
}

/// The warnings of two replays, which are the same.
fn warned(files: &Files) -> String {
    let [first, second] = files.replayed();
    assert_eq!(first, second, "two replays of one recording");
    assert_eq!(first.0 == "[]", first.1.is_empty(), "the end and the report say the same: {first:?}");
    first.0
}

#[test]
fn an_intact_rig_is_not_warned_of() {
    assert_eq!(warned(&Files::new(&shipped(), &shipped(), 0)), "[]");
}

#[test]
fn stamps_five_milliseconds_off_are_a_clock_in_replay_and_run() {
    for (late_ns, named) in [(-5_000_000, "ms early"), (5_000_000, "ms late")] {
        let files = Files::new(&shipped(), &shipped(), late_ns);
        let warnings = warned(&files);
        assert!(
            warnings.contains("the timestamps of camera 1 are") && warnings.contains(named),
            "{warnings}"
        );
        assert!(!warnings.contains("moved"), "{warnings}");
        let [rig, blobs, record, report] =
            ["rig.json", "b.jsonl", "r.mcap", "r.json"].map(|name| files.path(name));
        let name = instance_name();
        let run = ["run", "--no-picture", "--rig", &rig, "--blobs", &blobs, "--duration", "6"];
        let more = ["--record", &record, "--report", &report, "--instance", &name];
        let done = vitreo(&[&run[..], &more].concat());
        assert!(done.stdout.contains(named), "{done:?}");
        assert!(files.warnings_of("r.json").contains(named), "{}", files.warnings_of("r.json"));
    }
}

#[test]
fn two_cameras_off_by_a_pixel_do_not_blame_the_third() {
    let mut told = shipped();
    told.cameras[0].cx += 1.0;
    told.cameras[1].cy -= 1.0;
    let warnings = warned(&Files::new(&shipped(), &told, 0));
    assert!(warnings.contains("cameras 0 and 1 were moved"), "{warnings}");
    let blames = |key: &str| warnings.contains(&format!("\"{key}\":\"camera 2"));
    assert!(!blames("cause") && !warnings.contains("camera 2 is excluded"), "{warnings}");
}

#[test]
fn a_marker_that_was_moved_by_a_fifth_of_a_millimetre_is_named() {
    let mut seen_by = shipped();
    let body = seen_by.bodies.iter_mut().find(|b| b.name == "inst0").expect("inst0");
    body.markers[1].p[2] += 0.2;
    let warnings = warned(&Files::new(&seen_by, &shipped(), 0));
    assert!(warnings.contains("marker 1 of inst0 was moved by"), "{warnings}");
}
