//! The process itself: fields in over shared memory, frames out, reset, shutdown.

use blob_stream::BlobReader;
use ipc::{Instance, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::{Answer, Command as Ask, EVERY_PROCESS, Request};
use protocol::health::{Health, Process, STATE_RUNNING};
use protocol::poses::{ClosedBy, TrackerFrame};
use rig::Rig;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};
use tracker::tracker::{close, stamp};
use tracker::{Reference, Tracker};

/// Nothing here takes longer on the slowest machine.
const WATCHDOG: Duration = Duration::from_secs(60);
/// Fields that are surely in the tracker's queue at once.
const BATCH: usize = 60;

struct Setup {
    child: Child,
    blobs: Sender<BlobField>,
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
    fn start() -> Setup {
        let name = format!("tp{}", std::process::id() % 1_000_000);
        let instance = Instance::own(&name).unwrap();
        let health = instance.receiver(Queue::InOrder).unwrap();
        let mut setup = Setup {
            blobs: instance.sender().unwrap(),
            control: instance.sender().unwrap(),
            poses: instance.receiver(Queue::InOrder).unwrap(),
            answers: instance.receiver(Queue::InOrder).unwrap(),
            health,
            asked: 0,
            child: Command::new(env!("CARGO_BIN_EXE_vitreo-tracker"))
                .args(["--instance", &name, "--rig"])
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
            assert!(begin.elapsed() < WATCHDOG, "timed out before {what}");
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

    /// Sends fields a queue's length at a time.
    fn send(&mut self, fields: &[BlobField]) -> Vec<TrackerFrame> {
        let mut frames = Vec::new();
        for batch in fields.chunks(BATCH) {
            for field in batch {
                self.blobs.send(field).unwrap();
            }
            // One a turn of the loop, unlike pings: before the second the fields were taken.
            self.ask(Ask::Start);
            self.ask(Ask::Start);
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

/// What a tracker makes of the fields that the process says it used.
fn again(frames: &[TrackerFrame]) -> Vec<TrackerFrame> {
    let all: HashMap<_, BlobField> = fields().into_iter().map(|f| ((f.camera, f.exposed_ns), f)).collect();
    let mut tracker = Tracker::new(&Rig::load(&folder().join("rig.json")).unwrap());
    let track = |frame: &TrackerFrame| {
        let used: Vec<BlobField> = frame.used().iter().map(|u| all[&(u.camera, u.exposed_ns)]).collect();
        let reference =
            Reference { camera: frame.camera, field: frame.field, exposed_ns: frame.instants.exposed };
        let mut again = tracker.track(&used, &reference);
        close(&mut again, ClosedBy::from_wire(frame.closed_by));
        stamp(&mut again, &used, 0);
        again.fields_refused = frame.fields_refused;
        again
    };
    frames.iter().map(track).collect()
}

#[test]
fn what_the_process_makes_of_fields_is_what_the_tracker_makes_of_them() {
    let mut setup = Setup::start();
    for _ in 0..2 {
        let frames = setup.send(&fields());
        assert!(frames.iter().enumerate().all(|(n, f)| f.frame == n as u64), "from 0 on, also after a reset");
        assert!(frames.len() >= 50, "{} frames", frames.len());
        assert!(frames.iter().all(|f| f.instants.tracked >= f.instants.taken && f.instants.taken > 0));
        let same = again(&frames).iter().zip(&frames).all(|(a, b)| result_of(a) == result_of(b));
        assert!(same, "{} frames", frames.len());
        assert_eq!(setup.ask(Ask::Reset).result, 0);
    }
    assert_eq!(setup.ask(Ask::Snapshot).result, 1);
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
    let mut rig = rig::Rig::load_or_shipped(None).unwrap();
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
