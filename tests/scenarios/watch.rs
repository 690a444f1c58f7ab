//! A rig that is wrong does not stay silent: what is wrong is named, with what helps.

use super::outputs::attempt;
use vitreo_tests::{instance_name, json, repository, vitreo};

#[test]
fn a_camera_that_was_moved_is_named_by_replay_and_run() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [recording, blobs, rig, moved, stream, report] =
        ["a.mcap", "b.jsonl", "rig.json", "moved.json", "s.mcap", "r.json"].map(path);
    std::fs::write(&recording, attempt()).expect("written");
    vitreo(&["export", &recording, "--blobs", &blobs, "--rig", &rig]).expect_code(0);
    let mut cameras = json(folder.path().join("rig.json").as_path());
    let centre = cameras["cameras"][1]["cx"].as_f64().expect("cx");
    cameras["cameras"][1]["cx"] = (centre + 2.0).into();
    std::fs::write(&moved, cameras.to_string()).expect("written");
    let verdict = |rig: &str, code: i32| {
        vitreo(&["import", "--rig", rig, &blobs, "-o", &stream, "--force"]).expect_code(0);
        let replay = ["replay", &stream, "--lockstep", "--assert-tracking", "0.95", "--assert-no-warnings"];
        vitreo(&[&replay[..], &["--report", &report, "--force"]].concat()).expect_code(code)
    };
    let good = verdict(&rig, 0);
    assert!(!good.stderr.contains("camera"), "{}", good.stderr);
    // It is excluded, its pose is estimated again, and the tracking suffices.
    let named = "camera 1 is used with a pose estimated from the others";
    let bad = verdict(&moved, 7);
    assert!(bad.stderr.contains("camera 1's blobs are "), "{}", bad.stderr);
    assert!(bad.stderr.contains(named) && bad.stderr.contains("calibrate waved"), "{}", bad.stderr);
    let warnings = json(folder.path().join("r.json").as_path())["warnings"].clone();
    assert!(warnings.to_string().contains(named) && warnings[0]["remedy"].is_string(), "{warnings}");
    // The same live, from the stream.
    let run = ["run", "--no-picture", "--rig", &moved, "--blobs", &blobs, "--duration", "8", "--force"];
    let asserted = [
        "--assert-tracking",
        "0.95",
        "--assert-no-warnings",
        "--instance",
        &instance_name(),
        "--report",
        &report,
    ];
    let live = vitreo(&[&run[..], &asserted].concat()).expect_code(7);
    assert!(live.stderr.contains("camera 1's blobs are "), "{}", live.stderr);
    assert!(live.stderr.contains(named), "{}", live.stderr);
    // If two cameras were moved, it is not known which one still holds.
    let shift = cameras["cameras"][0]["cx"].as_f64().expect("cx") - 3.0;
    cameras["cameras"][0]["cx"] = shift.into();
    std::fs::write(&moved, cameras.to_string()).expect("written");
    let two = verdict(&moved, 6);
    assert!(two.stderr.contains("cameras 0, 1, 2 disagree"), "{}", two.stderr);
    assert!(!two.stderr.contains("is used again"), "{}", two.stderr);
    let figures = json(folder.path().join("r.json").as_path());
    let share = figures["figures"]["tracking"]["bodies"]["eye"]["tracked_share"].as_f64();
    assert!(share.is_none_or(|share| share < 0.95), "{share:?}");
}

/// No warnings of a stream in which nothing could be judged are no assurance.
#[test]
fn a_stream_too_short_to_judge_does_not_pass_an_assertion() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let golden = repository().join("tests/data/golden/peel-2s.mcap").display().to_string();
    let [blobs, rig, short, stream, record] =
        ["b.jsonl", "rig.json", "short.jsonl", "s.mcap", "r.mcap"].map(path);
    vitreo(&["export", &golden, "--blobs", &blobs, "--rig", &rig]).expect_code(0);
    let text = std::fs::read_to_string(&blobs).expect("a stream");
    // Three cameras with 50 fields a second: 0.3 s.
    let lines: Vec<&str> = text.lines().take(45).collect();
    std::fs::write(&short, lines.join("\n") + "\n").expect("written");
    vitreo(&["import", "--rig", &rig, &short, "-o", &stream]).expect_code(0);
    vitreo(&["replay", &stream, "--lockstep"]).expect_code(0);
    let replay = vitreo(&["replay", &stream, "--lockstep", "--assert-no-warnings"]).expect_code(7);
    let named = "--assert-no-warnings: the stream is too short, or shows too little, to judge: ";
    assert!(replay.stderr.contains(named), "{}", replay.stderr);
    assert!(
        replay.stderr.contains("blobs after the first 0.3 s, at least 200 are needed"),
        "{}",
        replay.stderr
    );
    vitreo(&["replay", &golden, "--lockstep", "--assert-no-warnings"]).expect_code(0);
    // A live run ends with the judgement of its recording; without one only what lasts for 2 s is noticed.
    let run = |more: &[&str]| {
        let name = instance_name();
        let run = [
            "run",
            "--no-picture",
            "--rig",
            &rig,
            "--blobs",
            &short,
            "--assert-no-warnings",
            "--instance",
            &name,
        ];
        vitreo(&[&run[..], more].concat()).expect_code(7).stderr
    };
    let recorded = run(&["--record", &record]);
    assert!(recorded.contains(named) && recorded.contains("at least 200 are needed"), "{recorded}");
    let unrecorded = run(&[]);
    assert!(unrecorded.contains(named) && unrecorded.contains("at least 2 s are needed"), "{unrecorded}");
}
