//! A live run is recorded and its replay is identical to the bit, again and again.

use recording::Recording;
use vitreo_tests::{instance_name, json, repository, vitreo};

#[test]
fn a_live_run_replays_to_the_bit_twice() {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("a.mcap");
    let report = folder.path().join("report.json");
    let (file, report_path) = (file.to_str().expect("UTF-8"), report.to_str().expect("UTF-8"));
    let name = instance_name();
    let run = ["run", "--no-picture", "--duration", "4", "--instance", &name];
    vitreo(&[&run[..], &["--record", file, "--report", report_path]].concat()).expect_code(0);
    let report = json(&report);
    assert!(report.is_object(), "{report}");
    for _ in 0..2 {
        let replay = instance_name();
        let done = vitreo(&["replay", file, "--lockstep", "--verify", "--instance", &replay]).expect_code(0);
        assert!(done.stdout.contains("identical") || done.stderr.contains("identical"), "{done:?}");
    }
}

/// Recordings of earlier builds: every frame is tracked again from the fields that it used. Verification says
/// where the poses differ first, because the tracker's arithmetic has changed since.
#[test]
fn recordings_of_earlier_builds_replay_frame_for_frame() {
    let corpus = repository().join("tests/data/corpus");
    let files: Vec<_> = std::fs::read_dir(corpus).expect("corpus").map(|f| f.expect("file").path()).collect();
    assert!(files.len() >= 4, "{files:?}");
    for file in files {
        let frames = Recording::open(&file).expect("a recording").items_of(&["poses"]).count();
        let path = file.to_str().expect("UTF-8");
        let replay = |more: &[&str]| {
            let name = instance_name();
            vitreo(&[&["replay", path, "--lockstep", "--instance", &name], more].concat())
        };
        let done = replay(&[]).expect_code(0);
        let texts = format!("{}{}", done.stdout, done.stderr);
        assert!(texts.contains(&format!("{frames} tracker frames")), "{path}: {texts}");
        let verified = replay(&["--verify"]).expect_code(5);
        let texts = format!("{}{}", verified.stdout, verified.stderr);
        assert!(texts.contains("verification differs at field"), "{path}: {texts}");
    }
}

/// The golden recording is of this tracker: poses and states are the same to the bit in every build.
#[test]
fn the_golden_recording_verifies_to_the_bit() {
    let golden = repository().join("tests/data/golden/peel-2s.mcap");
    let name = instance_name();
    let path = golden.to_str().expect("UTF-8");
    let done = vitreo(&["replay", path, "--lockstep", "--verify", "--instance", &name]).expect_code(0);
    assert!(format!("{}{}", done.stdout, done.stderr).contains("poses and"), "{done:?}");
}

#[test]
fn two_simulators_run_side_by_side() {
    let names = [instance_name(), instance_name()];
    let both = names.each_ref().map(|name| {
        vitreo_tests::Running::start(&[
            "run",
            "--no-picture",
            "--direct",
            "--duration",
            "2",
            "--instance",
            name,
        ])
    });
    for running in both {
        running.finish().expect_code(0);
    }
}
