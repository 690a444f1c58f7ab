//! A live run is recorded and its replay is identical to the bit, again and again.

use recording::Recording;
use vitreo_tests::verified::{WITHOUT_FRAME, verify};
use vitreo_tests::{instance_name, json, repository, vitreo};

#[test]
fn a_live_run_replays_to_the_bit_twice() {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("a.mcap");
    let report = folder.path().join("report.json");
    let (path, report_path) = (file.to_str().expect("UTF-8"), report.to_str().expect("UTF-8"));
    let name = instance_name();
    let run = ["run", "--no-picture", "--duration", "4", "--instance", &name];
    vitreo(&[&run[..], &["--record", path, "--report", report_path]].concat()).expect_code(0);
    let report = json(&report);
    let frames = report["tracking"]["frames"].as_u64().expect("frames");
    assert!(report["tracking"]["frames_due"].as_u64() >= Some(frames) && frames > 100, "{report}");
    for _ in 0..2 {
        let verified = verify(&file).expect_but([100, 100], &[WITHOUT_FRAME]);
        assert_eq!(verified.poses().recorded, frames, "every frame of the run is in its recording");
    }
}

/// Recordings of earlier builds: every frame is tracked again from the fields that it used. Verification says
/// by how much another tracker's poses differ, and that the states which this simulation makes of them are
/// the recorded ones, where its version is theirs.
#[test]
fn recordings_of_earlier_builds_replay_frame_for_frame() {
    let corpus = repository().join("tests/data/corpus");
    let files: Vec<_> = std::fs::read_dir(corpus).expect("corpus").map(|f| f.expect("file").path()).collect();
    let mut of_this_simulation = 0;
    for file in &files {
        let recording = Recording::open(file).expect("a recording");
        let count = |topic| recording.items_of(&[topic]).count() as u64;
        let (frames, steps) = (count("poses"), count("steps"));
        assert!(frames >= 100 && steps >= 100, "{}: {frames} frames, {steps} steps", file.display());
        let verified = verify(file);
        let (poses, states, reasons) = (verified.poses(), verified.states(), verified.reasons().join("; "));
        let told = verified.finished.expect_code(3).stdout;
        assert!(told.contains("computed by a tracker without a version"), "{}: {told}", file.display());
        assert_eq!((poses.recorded, poses.compared), (frames, frames), "{}: {told}", file.display());
        let differences = verified.report["verify"]["poses"]["differences"].as_object().expect("bodies");
        assert_eq!(differences.len(), 3, "{}: {told}", file.display());
        for (body, difference) in differences {
            let measured = difference["frames"].as_u64().expect("frames");
            assert!(measured > frames / 2, "{body} was measured by both in {measured} of {frames} frames");
            assert!(difference["rms_um"].as_f64() < Some(20.0), "{body}: {told}");
        }
        if recording.provenance().other_state_hash_version().is_none() {
            of_this_simulation += 1;
            assert_eq!([states.recorded, states.compared, states.identical], [steps; 3], "{told}");
        } else {
            assert!(states.compared == 0 && reasons.contains("states cannot be compared"), "{told}");
        }
    }
    assert!(files.len() >= 6 && of_this_simulation >= 1, "{of_this_simulation} of {files:?}");
}

/// The golden recording is of this tracker: poses and states are the same to the bit in every build.
#[test]
fn the_golden_recording_verifies_to_the_bit() {
    let verified = verify(&repository().join("tests/data/golden/peel-2s.mcap")).expect([100, 100]);
    assert_eq!((verified.finished.code, verified.poses().recorded), (Some(0), 100));
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
