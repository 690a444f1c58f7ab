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

/// Recordings of earlier builds: poses are the same to the bit; states too, where their hashes mean
/// the same.
#[test]
fn recordings_of_earlier_builds_replay_to_the_same_poses() {
    let corpus = repository().join("tests/data/corpus");
    let mut files: Vec<_> =
        std::fs::read_dir(corpus).expect("corpus").map(|f| f.expect("file").path()).collect();
    assert!(files.len() >= 4, "{files:?}");
    files.push(repository().join("tests/data/golden/peel-2s.mcap"));
    for file in files {
        let recording = Recording::open(&file).expect("a recording");
        let comparable = recording.provenance().other_state_hash_version().is_none();
        let name = instance_name();
        let path = file.to_str().expect("UTF-8");
        let replay = ["replay", path, "--lockstep", "--verify", "--instance", &name];
        let done = vitreo(&replay).expect_code(if comparable { 0 } else { 3 });
        let texts = format!("{}{}", done.stdout, done.stderr);
        let told = if comparable { "poses and" } else { "states cannot be compared" };
        assert!(texts.contains(told), "{path}: {texts}");
    }
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
