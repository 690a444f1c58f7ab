//! `vitreo run --poses`: another tracker, played by the test, in the place of cameras and tracker.

use igtl::{Content, HeaderVersion, Message};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use protocol::geometry::Validity;
use protocol::health::{Health, Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::poses::TrackerFrame;
use recording::{Item, Recording};
use std::collections::BTreeMap;
use std::io::Write;
use std::net::TcpListener;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use vitreo_tests::{Observer, Running, instance_name, interrupt, json, kill, next, vitreo};

/// What the other tracker calls its tools, by body.
const NAMES: [&str; 3] = ["StylusToTracker", "NeedleToTracker", "EyeToTracker"];
const MAP: &str = r#"
[inst0]
transform = "StylusToTracker"
[inst1]
transform = "NeedleToTracker"
[eye]
transform = "EyeToTracker"
"#;
const PERIOD_NS: u64 = 20_000_000;

/// Rows of a transform.
type Rows = [[f32; 4]; 3];

/// Where a body is in a frame: tips that go round in the eye, an eye that turns. No two frames are alike.
fn transform(body: usize, frame: u64) -> Rows {
    let t = frame as f64 * 0.02;
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.2 * (0.7 * t).sin(), 0.1, 0.3 * t.cos()));
    let side = [4.0, -4.0, 0.0][body];
    let place = Vector3::new(side + t.sin(), 1e-3 * frame as f64, -6.0) * f64::from(u8::from(body < 2));
    let matrix = Isometry3::from_parts(place.into(), turn).to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)] as f32))
}

/// A server of OpenIGTLink; it ends, and its connection with it, when it is dropped.
struct Server {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Sends `bodies`, counting frames in `frame`, to whoever connects to `port`.
    fn start(port: u16, bodies: &'static [usize], frame: &Arc<AtomicU64>) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", port)).expect("the port is free again");
        listener.set_nonblocking(true).expect("a listener");
        let (ends, frame) = (Arc::<AtomicBool>::default(), Arc::clone(frame));
        let asked = Arc::clone(&ends);
        let thread = std::thread::spawn(move || {
            let (mut stream, mut due) = (None, ipc::clock::now());
            while !asked.load(Ordering::Relaxed) {
                due += PERIOD_NS;
                ipc::clock::sleep_until(due);
                if let Ok((client, _)) = listener.accept() {
                    client.set_nodelay(true).expect("a socket");
                    stream = Some(client);
                }
                let bytes = messages(bodies, frame.fetch_add(1, Ordering::Relaxed));
                // One that was killed is gone; another comes.
                stream = stream.filter(|mut client| client.write_all(&bytes).is_ok());
            }
        });
        Server { ends, thread: Some(thread) }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(ended.is_none_or(|e| e.is_ok()) || std::thread::panicking());
    }
}

fn messages(bodies: &[usize], frame: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    let unix_ns = ipc::clock::now() + ipc::clock::realtime_offset_ns();
    for body in bodies {
        let metadata = vec![("Status".into(), "OK".into())];
        let content = Content::Transform(transform(*body, frame));
        let message = Message { device: NAMES[*body].into(), unix_ns, id: 0, metadata, content };
        message.write(HeaderVersion::Two, &mut bytes).expect("short names");
    }
    bytes
}

/// Waits until the bridge of the run says this.
fn says(observer: &mut Observer, state: u32, words: &str) -> Health {
    observer.health(Process::PosesDriver, |health| health.state == state && health.text().contains(words))
}

/// Waits until it has said so for four seconds, after which it stands in report and picture.
fn goes_on_saying(observer: &mut Observer, words: &str) {
    for _ in 0..40 {
        says(observer, STATE_DEGRADED, words);
    }
}

/// Waits for so many frames with both instruments.
fn poses(observer: &Observer, count: usize) {
    let mut poses = observer.receiver::<TrackerFrame>();
    let measured =
        |frame: &TrackerFrame| frame.bodies[..2].iter().all(|body| body.validity() == Validity::Measured);
    for _ in 0..count {
        next(&mut poses, measured);
    }
}

#[test]
fn a_run_takes_another_tracker_that_comes_late_goes_and_comes_back() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (map, record, report) = (path("map.toml"), path("a.mcap"), path("r.json"));
    std::fs::write(&map, MAP).expect("a map");
    let port = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a port").port();
    let (name, server) = (instance_name(), format!("igtl:127.0.0.1:{port},{map}"));
    let run = Running::start(&[
        "run",
        "--no-picture",
        "--instance",
        &name,
        "--poses",
        &server,
        "--record",
        &record,
        "--report",
        &report,
    ]);
    let mut observer = Observer::join(&name);
    goes_on_saying(&mut observer, "no answer");

    let frame = Arc::<AtomicU64>::default();
    let whole = Server::start(port, &[0, 1, 2], &frame);
    says(&mut observer, STATE_RUNNING, "igtl");
    poses(&observer, 100);
    drop(whole);
    says(&mut observer, STATE_DEGRADED, "no answer");
    let part = Server::start(port, &[0, 2], &frame);
    goes_on_saying(&mut observer, "does not send NeedleToTracker");
    drop(part);
    let again = Server::start(port, &[0, 1, 2], &frame);
    let bridge = says(&mut observer, STATE_RUNNING, "igtl");
    poses(&observer, 50);
    // It is a process of the run: it is started again, and takes the tracker up where it is.
    kill(bridge.pid);
    observer.health(Process::PosesDriver, |h| h.state == STATE_RUNNING && h.pid != bridge.pid);
    poses(&observer, 50);
    interrupt(run.pid());
    // The recording verifies.
    let finished = run.finish();
    drop(again);
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    said_by(&finished.stderr, &json(Path::new(&report)));
    recorded_as_sent(Path::new(&record), frame.load(Ordering::Relaxed));
}

/// What screen and report say of it.
fn said_by(screen: &str, report: &serde_json::Value) {
    for words in ["no answer from 127.0.0.1", "does not send NeedleToTracker", "poses-driver restarted"] {
        assert!(screen.contains(words), "{words:?} is missing in {screen}");
    }
    assert_eq!(report["restarts"]["poses-driver"], 1, "{report:#}");
    let warnings = report["warnings"].to_string();
    assert!(warnings.contains("no answer") && warnings.contains("NeedleToTracker"), "{warnings}");
}

/// Every pose that is recorded as measured was sent, to the last digit that the protocol has.
fn recorded_as_sent(file: &Path, frames: u64) {
    let key = |rows: &Rows| rows.map(|row| row[3].to_bits());
    let sent: BTreeMap<_, Rows> =
        (0..frames).map(|f| transform(0, f)).map(|rows| (key(&rows), rows)).collect();
    let sent_beside: BTreeMap<_, [Rows; 2]> =
        (0..frames).map(|f| (key(&transform(0, f)), [transform(1, f), transform(2, f)])).collect();
    let (mut compared, mut last) = (0, 0);
    let recording = Recording::open(file).expect("a recording");
    for (_, item) in recording.items_of(&["poses"]).flatten() {
        let Item::Poses(frame) = item else { continue };
        assert!(frame.field > last, "numbers rise");
        last = frame.field;
        let recorded = frame.bodies.map(|body| {
            let matrix = body.world_from_body.isometry().to_homogeneous();
            let rows: Rows = std::array::from_fn(|r| std::array::from_fn(|c| matrix[(r, c)] as f32));
            (body.validity() == Validity::Measured, rows)
        });
        let (true, rows) = recorded[0] else { continue };
        let expected = sent.get(&key(&rows)).unwrap_or_else(|| panic!("nobody sent {rows:?}"));
        let beside = sent_beside[&key(&rows)];
        for (i, expected) in [expected, &beside[0], &beside[1]].into_iter().enumerate() {
            let (measured, rows) = recorded[i];
            // Rotations go through a quaternion.
            let off = rows.as_flattened().iter().zip(expected.as_flattened()).map(|(a, b)| (a - b).abs());
            assert!(
                !measured || off.fold(0.0, f32::max) < 4.0 * f32::EPSILON * 8.0,
                "{rows:?}, {expected:?}"
            );
        }
        compared += 1;
    }
    println!("{compared} frames compared");
    assert!(compared > 150, "{compared} frames");
}

#[test]
fn what_cannot_be_is_refused_in_words() {
    let folder = tempfile::tempdir().expect("folder");
    let map = folder.path().join("map.toml");
    let with_map = format!("igtl:localhost:1,{}", map.display());
    for (args, named) in [
        (&["--poses", "localhost:1"][..], "expected igtl:HOST:PORT"),
        (&["--poses", "igtl:h:1", "--direct"], "cannot be used with"),
        (&["--poses", "igtl:h:1", "--cameras", "virtual", "--rig", "r"], "cannot be used with"),
        (&["--poses", "igtl:h:1", "--external", "poses,pedal"], "only one of them"),
    ] {
        let told = vitreo(&[&["run"], args].concat()).expect_code(2).stderr;
        assert!(told.contains(named), "{args:?}: {told}");
    }
    let told = vitreo(&["run", "--poses", &with_map]).expect_code(1).stderr;
    assert!(told.contains("--poses") && told.contains("map.toml: No such file"), "{told}");
    std::fs::write(&map, "[inst0]\ntransfrom = \"A\"\n").expect("a map");
    let name = instance_name();
    let told =
        vitreo(&["run", "--no-picture", "--instance", &name, "--poses", &with_map]).expect_code(1).stderr;
    assert!(told.contains("did not start") && told.contains("transfrom"), "{told}");
}
