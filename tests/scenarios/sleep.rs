//! Processes that are stopped for a while and continued: what they missed is past, and they do not
//! act on it as though it were the present.

use ipc::Receiver;
use protocol::blobs::BlobField;
use protocol::frames::{FrameRecord, PICTURE_HELD};
use protocol::health::{Process, STATE_RUNNING};
use protocol::limits::FIELD_PERIOD_NS;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use std::path::Path;
use vitreo_tests::verified::{WITHOUT_FRAME, verify};
use vitreo_tests::{Observer, Running, instance_name, next, signal, vitreo};

/// Fields for which a process is stopped: two seconds, less than makes it count as hung.
const STOPPED: u64 = 100;
/// Age of an input that nobody can take for the present, ns: half of the stop. Awake, an input is
/// some 25 ms old.
const PAST_NS: u64 = STOPPED / 2 * FIELD_PERIOD_NS;

struct Run {
    running: Running,
    observer: Observer,
    file: String,
    name: String,
    _folder: tempfile::TempDir,
}

fn start(view: &str) -> Run {
    let (folder, name) = (tempfile::tempdir().expect("folder"), instance_name());
    let file = folder.path().join("a.mcap").display().to_string();
    let run = ["run", view, "--direct", "--duration", "90", "--instance", &name, "--record", &file];
    let running = Running::start(&run);
    Run { running, observer: Observer::join(&name), file, name, _folder: folder }
}

impl Run {
    /// Stops `process` at work until `sent` says that the time is over.
    fn stop_while(&mut self, process: Process, sent: impl FnOnce()) {
        let pid = self.observer.health(process, |h| h.state == STATE_RUNNING).pid;
        signal(pid, rustix::process::Signal::STOP);
        sent();
        signal(pid, rustix::process::Signal::CONT);
    }

    /// Ends the run, of whose recording so many poses and states verify. A process that puts nothing out for
    /// half a second and more is named, and costs the exit code.
    fn end(self, least: [u64; 2]) -> String {
        let Run { running, observer, file, name, _folder: folder } = self;
        drop(observer);
        vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
        let finished = running.finish();
        let silent = finished.stderr.contains("sends nothing");
        let told = finished.expect_code(if silent { 3 } else { 0 }).stderr;
        verify(Path::new(&file)).expect_but(least, &[WITHOUT_FRAME, "gaps", "lack"]);
        drop(folder);
        told
    }
}

/// The next block that is sent, not one that waits.
fn to_come<M: Message + std::fmt::Debug>(receiver: &mut Receiver<M>) -> M {
    while receiver.next_valid().expect("channel works").is_some() {}
    next(receiver, |_| true)
}

#[test]
fn a_simulation_that_slept_passes_over_what_it_missed() {
    let mut run = start("--no-picture");
    let (mut steps, mut poses) = (run.observer.receiver::<StepRecord>(), run.observer.receiver());
    let before = next(&mut steps, |s| s.step >= 60);
    run.stop_while(Process::Simcore, || {
        let begun = to_come(&mut poses);
        next(&mut poses, |p: &TrackerFrame| p.frame >= begun.frame + STOPPED);
    });
    let after = next(&mut steps, |s| s.frame > before.frame + STOPPED);
    assert!(after.step < before.step + STOPPED / 2, "step {} after {}", after.step, before.step);
    assert!(after.frames_lost >= STOPPED / 2, "{} frames are told", after.frames_lost);
    next(&mut steps, |s| {
        let age_ns = s.instants.stepped.saturating_sub(s.instants.exposed);
        assert!(age_ns < PAST_NS, "step {} is made of a pose of {} ms ago", s.step, age_ns / 1_000_000);
        s.step > after.step + 50
    });
    drop((steps, poses));
    let told = run.end([100, 100]);
    assert!(told.contains("simcore sends nothing"), "{told}");
}

#[test]
fn a_tracker_that_slept_passes_over_what_it_missed() {
    let mut run = start("--no-picture");
    let (mut blobs, mut poses) = (run.observer.receiver::<BlobField>(), run.observer.receiver());
    let before = next(&mut poses, |p: &TrackerFrame| p.frame >= 60);
    run.stop_while(Process::Tracker, || {
        let begun = to_come(&mut blobs);
        next(&mut blobs, |b| b.field >= begun.field + STOPPED);
    });
    let after = next(&mut poses, |p| p.field > before.field + STOPPED);
    next(&mut poses, |p| {
        let age_ns = p.instants.tracked.saturating_sub(p.instants.exposed);
        assert!(age_ns < PAST_NS, "frame {} is of {} ms ago", p.frame, age_ns / 1_000_000);
        p.frame > after.frame + 50
    });
    drop((blobs, poses));
    let told = run.end([100, 100]);
    assert!(told.contains("fields skipped") && told.contains("tracker sends nothing"), "{told}");
}

#[test]
fn a_picture_says_that_it_is_held() {
    if let Err(e) = renderer::gpu::Gpu::headless() {
        return skips::skip(&e);
    }
    let mut run = start("--headless");
    let mut frames = run.observer.receiver::<FrameRecord>();
    let drawn = next(&mut frames, |f| f.frame >= 20 && f.flags & PICTURE_HELD == 0);
    let mut held = drawn;
    run.stop_while(Process::Simcore, || held = next(&mut frames, |f| f.flags & PICTURE_HELD != 0));
    let after = next(&mut frames, |f| f.flags & PICTURE_HELD == 0 && f.scene_field > held.scene_field);
    assert!(after.frame > held.frame);
    drop(frames);
    run.end([20, 20]);
}
