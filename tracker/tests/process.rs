//! The process itself: fields in over shared memory, frames out, flush, reset, recorded, shutdown.

use blob_stream::BlobReader;
use bytemuck::Zeroable;
use ipc::{Instance, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::{Answer, Command as Ask, EVERY_PROCESS, RecordedFrame, Request};
use protocol::health::{Health, Process, STATE_RUNNING};
use protocol::poses::TrackerFrame;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// Nothing here takes longer on the slowest machine.
const WATCHDOG: Duration = Duration::from_secs(60);
/// Fields that are surely in the tracker's queue at once.
const BATCH: usize = 60;

struct Setup {
    child: Child,
    blobs: Sender<BlobField>,
    recorded: Sender<RecordedFrame>,
    control: Sender<Request>,
    poses: Receiver<TrackerFrame>,
    answers: Receiver<Answer>,
    health: Receiver<Health>,
    asked: u64,
    _instance: Instance,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/tracker/nominal")
}

fn fields() -> Vec<BlobField> {
    BlobReader::open(&folder().join("blobs.jsonl")).unwrap().collect::<Result<_, _>>().unwrap()
}

impl Setup {
    fn start(mode: &str) -> Setup {
        let name = format!("tp{}{}", &mode[2..4], std::process::id() % 1_000_000);
        let instance = Instance::own(&name).unwrap();
        let health = instance.receiver(Queue::InOrder).unwrap();
        let mut setup = Setup {
            blobs: instance.sender().unwrap(),
            recorded: instance.sender().unwrap(),
            control: instance.sender().unwrap(),
            poses: instance.receiver(Queue::InOrder).unwrap(),
            answers: instance.receiver(Queue::InOrder).unwrap(),
            health,
            asked: 0,
            child: Command::new(env!("CARGO_BIN_EXE_vitreo-tracker"))
                .args(["--instance", &name, mode, "--rig"])
                .arg(folder().join("rig.json"))
                .spawn()
                .unwrap(),
            _instance: instance,
        };
        setup.until("the tracker runs", |s| {
            let health = s.health.next_valid().unwrap()?;
            (health.process == Process::Tracker as u32 && health.state == STATE_RUNNING).then_some(())
        });
        setup
    }

    fn until<T>(&mut self, what: &str, mut found: impl FnMut(&mut Self) -> Option<T>) -> T {
        let begin = Instant::now();
        loop {
            if let Some(result) = found(self) {
                return result;
            }
            assert!(begin.elapsed() < WATCHDOG, "waited in vain until {what}");
            wait(&[&self.poses, &self.answers, &self.health], 5_000_000);
        }
    }

    fn ask(&mut self, command: Ask) -> Answer {
        self.asked += 1;
        let seq = self.asked;
        self.control
            .send(&Request { seq, argument: 0, target: EVERY_PROCESS, command: command as u32 })
            .unwrap();
        self.until("there is an answer", |s| s.answers.next_valid().unwrap().filter(|a| a.seq == seq))
    }

    fn frames(&mut self) -> Vec<TrackerFrame> {
        std::iter::from_fn(|| self.poses.next_valid().unwrap()).collect()
    }

    /// Sends fields a queue's length at a time; a ping after each shows that they were taken.
    fn send(&mut self, fields: &[BlobField]) -> Vec<TrackerFrame> {
        let mut frames = Vec::new();
        for batch in fields.chunks(BATCH) {
            for field in batch {
                self.blobs.send(field).unwrap();
            }
            self.ask(Ask::Ping);
            self.ask(Ask::Ping);
            frames.extend(self.frames());
        }
        frames
    }
}

impl Drop for Setup {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What must repeat: everything but the clock's instants.
fn result_of(frame: &TrackerFrame) -> Vec<u8> {
    let mut frame = *frame;
    (frame.instants.taken, frame.instants.tracked, frame.waited_ns) = (0, 0, 0);
    bytemuck::bytes_of(&frame).to_vec()
}

#[test]
fn a_stream_on_its_own_clock_is_repeated_by_its_recorded_frames() {
    let mut setup = Setup::start("--stream-clock");
    let mut frames = setup.send(&fields());
    assert_eq!(setup.ask(Ask::Flush).result, 0);
    frames.extend(setup.frames());
    assert!(frames.iter().enumerate().all(|(n, f)| f.frame == n as u64));
    assert!(frames.len() >= 99, "{} frames", frames.len());
    assert!(frames.iter().all(|f| f.instants.tracked >= f.instants.taken && f.instants.taken > 0));

    assert_eq!(setup.ask(Ask::Reset).result, 0);
    let again = setup.send(&fields());
    assert!(again.iter().zip(&frames).all(|(a, b)| result_of(a) == result_of(b)), "after a reset");
    assert_eq!(setup.ask(Ask::Snapshot).result, 1);
    drop(setup);

    let mut setup = Setup::start("--replay");
    let all = fields();
    let mut sent = 0;
    for frame in &frames {
        let mut recorded = RecordedFrame::zeroed();
        (recorded.frame, recorded.field, recorded.camera) = (frame.frame, frame.field, frame.camera);
        (recorded.exposed_ns, recorded.closed_by) = (frame.instants.exposed, frame.closed_by);
        (recorded.used, recorded.used_count) = (frame.used, frame.used_count);
        setup.recorded.send(&recorded).unwrap();
        let newest = frame.used().iter().map(|u| u.exposed_ns).max().unwrap();
        while sent < all.len() && all[sent].exposed_ns <= newest {
            setup.blobs.send(&all[sent]).unwrap();
            sent += 1;
        }
        // Fields come by arrival, recorded by exposure: one more may be needed.
        let mut extra = all[sent..].iter().take(3);
        for field in extra.by_ref() {
            setup.blobs.send(field).unwrap();
        }
        sent = (sent + 3).min(all.len());
        let answer = setup.until("the recorded frame arrives", |s| s.poses.next_valid().unwrap());
        assert!(result_of(&answer) == result_of(frame), "frame {}", frame.frame);
    }
    let mut missing = RecordedFrame::zeroed();
    (missing.frame, missing.exposed_ns, missing.used_count) = (1000, 1, 1);
    missing.used[0].field = 77;
    setup.recorded.send(&missing).unwrap();
    setup.ask(Ask::Ping);
    let refused = setup.ask(Ask::Flush);
    assert_eq!((refused.result, refused.text()), (1, "frame 1000 waits for field 77 of camera 0".into()));
    assert_eq!(setup.ask(Ask::Shutdown).result, 0);
    assert!(setup.child.wait().unwrap().success());
}

#[test]
fn a_rig_that_does_not_exist_is_named() {
    let out =
        Command::new(env!("CARGO_BIN_EXE_vitreo-tracker")).args(["--rig", "nowhere.json"]).output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(1));
    assert!(text.contains("nowhere.json"), "{text}");
}

#[test]
fn a_rig_that_cannot_work_is_refused_in_words() {
    let mut rig = protocol::rig::Rig::load_or_shipped(None).unwrap();
    for (i, marker) in rig.bodies[0].markers.iter_mut().enumerate() {
        marker.p = [0.0, 0.0, 1.0 + i as f64];
    }
    let path = std::env::temp_dir().join(format!("vitreo-straight-{}.json", std::process::id()));
    std::fs::write(&path, rig.to_json()).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_vitreo-tracker")).arg("--rig").arg(&path).output().unwrap();
    std::fs::remove_file(&path).unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("inst0 lie in a line") && told.contains("roll"), "{told}");
}
