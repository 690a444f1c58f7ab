//! A live run is recorded and its replay is identical to the bit, again and again.

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

#[test]
fn a_recording_of_another_build_replays_to_the_bit() {
    let golden = repository().join("tests/data/golden/peel-2s.mcap");
    let name = instance_name();
    let file = golden.to_str().expect("UTF-8");
    vitreo(&["replay", file, "--lockstep", "--verify", "--instance", &name]).expect_code(0);
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
