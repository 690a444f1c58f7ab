//! Processes die; the run goes on and says so, and recordings stay whole.

use protocol::blobs::BlobField;
use protocol::events::{Event, EventKind};
use protocol::frames::FrameRecord;
use protocol::health::{Process, STATE_RUNNING, STATE_STARTING};
use protocol::steps::StepRecord;
use std::path::Path;
use vitreo_tests::verified::{WITHOUT_FRAME, verify};
use vitreo_tests::{Observer, Running, instance_name, json, kill, next, vitreo};

/// Simulations that try to resume before the state is given up: three from the newest checkpoint, two from the
/// one before it.
const RESUME_TRIES: u32 = 5;

/// Runs for some seconds with `cameras` (`--direct`, or fields of pixels without it), kills
/// `victim` in the middle, returns the report and the recording.
fn run_and_kill(victim: Process, cameras: &[&str]) -> (serde_json::Value, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (file, report, name) = (path("a.mcap"), path("report.json"), instance_name());
    let run = ["run", "--no-picture", "--duration", "7", "--instance", &name];
    let outputs = ["--record", &file, "--report", &report];
    let running = Running::start(&[&run[..], &outputs, cameras].concat());
    let mut observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    let health = observer.health(victim, |h| h.state == STATE_RUNNING);
    let before = next(&mut steps, |s| s.step >= 60);
    kill(health.pid);
    let reborn = observer.health(victim, |h| h.pid != health.pid && h.state == STATE_RUNNING);
    assert_ne!(reborn.pid, health.pid);
    next(&mut steps, |s| s.instants.exposed > before.instants.exposed + 1_000_000_000);
    drop((steps, observer));
    running.finish().expect_code(0);
    (json(&folder.path().join("report.json")), folder)
}

/// All that was recorded verifies, but for the fields that nobody tracked and blocks that a launcher without
/// a processor did not record.
fn replays_to_the_bit(folder: &tempfile::TempDir) {
    verify(&folder.path().join("a.mcap")).expect_but([100, 100], &[WITHOUT_FRAME, "gaps", "lack"]);
}

#[test]
fn a_dead_tracker_is_restarted_and_the_recording_replays() {
    let (report, folder) = run_and_kill(Process::Tracker, &["--direct"]);
    assert_eq!(report["restarts"]["tracker"], 1, "{}", report["restarts"]);
    replays_to_the_bit(&folder);
}

#[test]
fn a_dead_virtual_rig_is_restarted_and_the_recording_replays() {
    let (report, folder) = run_and_kill(Process::VirtualRig, &[]);
    assert_eq!(report["restarts"]["virtual-rig"], 1, "{}", report["restarts"]);
    replays_to_the_bit(&folder);
}

#[test]
fn a_surgeon_whose_rig_dies_goes_on_where_he_was() {
    let (name, folder) = (instance_name(), tempfile::tempdir().expect("folder"));
    let report = folder.path().join("report.json");
    let run = ["run", "--module", "forceps", "--no-picture", "--direct", "--instance", &name, "--report"];
    let running = Running::start(&[&run[..], &[&report.display().to_string()]].concat());
    let mut observer = Observer::join(&name);
    let (mut events, mut blobs) = (observer.receiver::<Event>(), observer.receiver::<BlobField>());
    let health = observer.health(Process::VirtualRig, |h| h.state == STATE_RUNNING);
    next(&mut events, |e| e.kind == EventKind::GoalReached as u32);
    kill(health.pid);
    let reborn = observer.health(Process::VirtualRig, |h| h.pid != health.pid && h.state == STATE_RUNNING);
    assert_ne!(reborn.pid, health.pid);
    let mut newest = 0;
    next(&mut blobs, |b| {
        assert!(b.field >= newest, "field {} follows {newest}", b.field);
        newest = newest.max(b.field);
        b.exposed_ns > reborn.instant_ns + 1_000_000_000
    });
    let score = next(&mut events, |e| e.kind == EventKind::ScoreTotal as u32).value;
    drop((events, blobs, observer));
    running.finish().expect_code(0);
    let report = json(&report);
    assert_eq!(report["restarts"]["virtual-rig"], 1);
    let processes = report["processes"].as_array().expect("processes");
    let lost: u64 = processes.iter().filter_map(|p| p["lost"].as_u64()).sum();
    // Undisturbed he has 98; a round begun anew costs 20 and more. Fields that a slow machine leaves out
    // cost some points too.
    let least = if lost == 0 { 92.0 } else { 75.0 };
    assert!(score > least, "{score} points, {lost} fields left out");
}

#[test]
fn dead_camera_hardware_is_restarted_and_the_recording_replays() {
    let (report, folder) = run_and_kill(Process::FpgaModel, &[]);
    assert_eq!(report["restarts"]["fpga-model"], 1, "{}", report["restarts"]);
    replays_to_the_bit(&folder);
}

#[test]
fn a_dead_simcore_resumes_where_it_was() {
    let (report, folder) = run_and_kill(Process::Simcore, &["--direct"]);
    assert_eq!(report["restarts"]["simcore"], 1, "{}", report["restarts"]);
    replays_to_the_bit(&folder);
}

/// Waits for a heartbeat of another simcore than `pid` that is still starting, and kills it.
fn kill_while_starting(observer: &mut Observer, pid: u32) -> u32 {
    let starting = observer.health(Process::Simcore, |h| h.pid != pid);
    assert_eq!(starting.state, STATE_STARTING, "a resumed simulation tells that it is starting first");
    kill(starting.pid);
    starting.pid
}

#[test]
fn a_simcore_killed_while_it_resumes_goes_on_where_it_was() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (file, report, name) = (path("a.mcap"), path("report.json"), instance_name());
    let run = ["run", "--no-picture", "--direct", "--duration", "60", "--instance", &name];
    let running = Running::start(&[&run[..], &["--record", &file, "--report", &report]].concat());
    let mut observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    let health = observer.health(Process::Simcore, |h| h.state == STATE_RUNNING);
    next(&mut steps, |s| s.step >= 60);
    kill(health.pid);
    let again = kill_while_starting(&mut observer, health.pid);
    let third = kill_while_starting(&mut observer, again);
    let reborn = observer.health(Process::Simcore, |h| h.pid != third && h.state == STATE_RUNNING);
    assert_ne!(reborn.pid, health.pid);
    let mut last = 0;
    let reached = next(&mut steps, |s| {
        assert!(s.step >= 60, "step {} comes after step 60: the eye is new", s.step);
        s.step >= 200
    });
    while let Some(step) = steps.next_valid().expect("channel works") {
        assert!(step.step > last.max(reached.step));
        last = step.step;
    }
    drop((steps, observer));
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    running.finish().expect_code(0);
    let report = json(&folder.path().join("report.json"));
    assert_eq!((&report["restarts"]["simcore"], &report["states_lost"]), (&3.into(), &0.into()));
    replays_to_the_bit(&folder);
}

#[test]
fn a_state_that_cannot_be_resumed_is_lost_and_told() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (file, report, name) = (path("a.mcap"), path("report.json"), instance_name());
    let run = ["run", "--no-picture", "--direct", "--duration", "170", "--instance", &name];
    let running = Running::start(&[&run[..], &["--record", &file, "--report", &report]].concat());
    let mut observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    let health = observer.health(Process::Simcore, |h| h.state == STATE_RUNNING);
    let before = next(&mut steps, |s| s.step >= 60);
    // Every journal kills the simulation that reads it: it is a folder. That does not depend on who is faster,
    // as a signal to a simulation that is still starting does.
    let instance = ipc::instance_directory(&name).expect("valid name");
    for journal in 0..2 * RESUME_TRIES {
        std::fs::create_dir(instance.join(format!("resume-{journal}.journal"))).expect("folder");
    }
    kill(health.pid);
    let anew = next(&mut steps, |s| s.step < before.step);
    // It counts its steps anew, the cameras their fields on.
    let worked = next(&mut steps, |s| s.step >= anew.step + 60);
    assert!(worked.field + before.step >= before.field + worked.step + 60, "{before:?}, {worked:?}");
    drop((steps, observer));
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    let told = running.finish().expect_code(3).stderr;
    assert!(told.contains("the state of the eye is lost"), "{told}");
    let report = json(&folder.path().join("report.json"));
    assert_eq!(
        (&report["restarts"]["simcore"], &report["states_lost"]),
        (&(RESUME_TRIES + 1).into(), &1.into())
    );
    let incidents = report["happenings"].to_string();
    assert!(incidents.contains("restarts from its scene"), "{incidents}");
    // Of the first life and of the one that begins at the scene.
    let verified = verify(Path::new(&file)).expect([60, 60]);
    assert_eq!(verified.finished.code, Some(3));
    assert!(!format!("{verified:?}").contains("18446744073709551615"), "{verified:?}");
}

#[test]
fn a_lost_graphics_device_costs_a_restart_and_nobody_else_anything() {
    if let Err(e) = renderer::gpu::Gpu::headless() {
        return println!("skipped: {e}");
    }
    let folder = tempfile::tempdir().expect("folder");
    let (report, name) = (folder.path().join("report.json").display().to_string(), instance_name());
    let run = ["run", "--headless", "--direct", "--duration", "90", "--lose-device-after", "40"];
    let running = Running::start(&[&run[..], &["--instance", &name, "--report", &report]].concat());
    let mut observer = Observer::join(&name);
    let (mut steps, mut frames) = (observer.receiver::<StepRecord>(), observer.receiver::<FrameRecord>());
    let health = observer.health(Process::Renderer, |h| h.state == STATE_RUNNING);
    let reborn = observer.health(Process::Renderer, |h| h.pid != health.pid && h.state == STATE_RUNNING);
    // A renderer counts its frames from 0: the new one draws more than the old one could.
    next(&mut frames, |f| f.frame > 45);
    assert_ne!(reborn.pid, health.pid);
    let mut last = next(&mut steps, |_| true).step;
    while let Some(step) = steps.next_valid().expect("channel works") {
        assert_eq!(step.step, last + 1, "the simulation waited for nobody");
        last = step.step;
    }
    drop((steps, frames, observer));
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    let finished = running.finish();
    assert!(finished.stderr.contains("graphics device lost"), "{finished:#?}");
    finished.expect_code(0);
    let report = json(&folder.path().join("report.json"));
    for (process, restarts) in
        [("renderer", 1), ("simcore", 0), ("tracker", 0), ("fpga-model", 0), ("virtual-rig", 0)]
    {
        let found = &report["restarts"][process];
        assert_eq!(found.as_u64().unwrap_or(0), restarts, "{process}: {}", report["restarts"]);
    }
}

#[test]
fn a_killed_recorder_loses_little_and_recover_mends_it() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (file, mended, name) = (path("a.mcap"), path("b.mcap"), instance_name());
    let running = Running::start(&[
        "run",
        "--no-picture",
        "--direct",
        "--duration",
        "60",
        "--instance",
        &name,
        "--record",
        &file,
    ]);
    let observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    let last = next(&mut steps, |s| s.step >= 150);
    kill(running.pid());
    running.finish();
    drop((steps, observer));
    let items = recording::Recording::open(std::path::Path::new(&file)).expect("readable");
    let newest = items.items().map_while(Result::ok).filter_map(|(_, item)| match item {
        recording::Item::Step(step) => Some(step.instants.exposed),
        _ => None,
    });
    let newest = newest.last().expect("steps in the file");
    let lost_ns = last.instants.exposed.saturating_sub(newest);
    assert!(lost_ns <= 200_000_000, "{} ms lost", lost_ns / 1_000_000);
    let told = vitreo(&["info", &file]).expect_code(3);
    assert!(format!("{}{}", told.stdout, told.stderr).contains("recover"), "{told:?}");
    vitreo(&["recover", &file, "-o", &mended]).expect_code(3);
    vitreo(&["info", &mended]).expect_code(0);
    verify(Path::new(&mended)).expect([140, 140]);
    // The next owner of the name takes away what the killed one left.
    drop(ipc::Instance::own(&name).expect("the name is free again"));
}
