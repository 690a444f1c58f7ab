//! Poses by OpenIGTLink: a client gets what is recorded, and those that do not read delay nobody.

use igtl::{Content, Message, Reader};
use protocol::poses::TrackerFrame;
use recording::{Item, Recording};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use vitreo_tests::{Running, WATCHDOG, Watchdog, binaries, instance_name, interrupt, repository, vitreo};

/// Clients that never read.
const DEAF: usize = 10;
/// What stands in the state of every transform once no simulator runs.
const NOT_PRESENT: u16 = 16;

/// `vitreo bridge`, and where it listens.
struct Bridge {
    child: Child,
    watchdog: Watchdog,
    log: BufReader<ChildStderr>,
    address: String,
}

impl Bridge {
    /// Starts it, and waits until it says where it is.
    fn start(args: &[&str], told: &str) -> Self {
        let mut child = Command::new(binaries().join("vitreo"))
            .arg("bridge")
            .args(args)
            .env("XDG_CONFIG_HOME", "/nonexistent")
            .stderr(Stdio::piped())
            .spawn()
            .expect("vitreo starts");
        let watchdog = Watchdog::on(child.id());
        let mut log = BufReader::new(child.stderr.take().expect("piped"));
        let told = line_with(&mut log, told);
        let address = told.rsplit(' ').next().expect("an address").trim().to_owned();
        Bridge { child, watchdog, log, address }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).expect("the bridge listens");
        stream.set_read_timeout(Some(WATCHDOG)).expect("a time");
        stream
    }

    /// Ends it as Ctrl-C does; returns what else it said.
    fn end(mut self) -> String {
        interrupt(self.child.id());
        let mut rest = String::new();
        self.log.read_to_string(&mut rest).expect("text");
        assert!(self.child.wait().expect("its end").success(), "{rest}");
        assert!(!self.watchdog.barked(), "hung and was killed: {rest}");
        rest
    }
}

fn line_with(log: &mut impl BufRead, wanted: &str) -> String {
    let mut line = String::new();
    while !line.contains(wanted) {
        line.clear();
        assert!(log.read_line(&mut line).expect("text") > 0, "the bridge ended before {wanted:?}");
    }
    line
}

/// Reads until the end of the simulator is announced.
fn messages_of(mut stream: TcpStream) -> Vec<Message> {
    let (mut reader, mut bytes, mut all) = (Reader::default(), [0; 4096], Vec::new());
    let is_end = |m: &Message| {
        matches!(m.content, Content::Status { code: NOT_PRESENT, .. }) && m.device == "WorldToEye"
    };
    while !all.last().is_some_and(is_end) {
        let n = stream.read(&mut bytes).expect("in time");
        assert!(n > 0, "the bridge closed the connection");
        reader.take(&bytes[..n], |message| all.push(message.expect("sound"))).expect("OpenIGTLink");
    }
    all
}

/// Poses of a recording by field.
fn recorded(file: &Path) -> BTreeMap<u64, TrackerFrame> {
    let mut frames = BTreeMap::new();
    let recording = Recording::open(file).expect("a recording");
    for (_, item) in recording.items_of(&["poses"]).flatten() {
        if let Item::Poses(frame) = item {
            frames.insert(frame.field, *frame);
        }
    }
    frames
}

#[test]
fn a_client_gets_the_poses_that_are_recorded_though_others_do_not_read() {
    let name = instance_name();
    let mut bridge = Bridge::start(&["--igtl", "0", "--instance", &name], "OpenIGTLink on ");
    line_with(&mut bridge.log, "waiting for the simulator");
    let deaf: Vec<TcpStream> = (0..DEAF).map(|_| bridge.connect()).collect();
    let stream = bridge.connect();
    let client = std::thread::spawn(move || messages_of(stream));
    let folder = tempfile::tempdir().expect("folder");
    let record = folder.path().join("a.mcap");
    let file = record.to_str().expect("UTF-8");
    // A machine that is busy elsewhere may cost fields.
    let run = vitreo(&[
        "run",
        "--no-picture",
        "--direct",
        "--instance",
        &name,
        "--duration",
        "6",
        "--record",
        file,
    ]);
    assert!(matches!(run.code, Some(0 | 3)), "{run:?}");
    let (heard, recorded) = (client.join().expect("a client"), recorded(&record));

    let mut compared = 0;
    for message in &heard {
        let Content::Transform(rows) = message.content else { continue };
        let of = |key: &str| message.metadata.iter().find(|(k, _)| k == key).map(|(_, v)| v.clone());
        let field: u64 = of("Frame").expect("its field").parse().expect("a number");
        let Some(frame) = recorded.get(&field) else { continue };
        let body = match &*message.device {
            "Instrument0ToWorld" => 0,
            "Instrument1ToWorld" => 1,
            "EyeToWorld" => 2,
            _ => continue,
        };
        let matrix = frame.bodies[body].world_from_body.isometry().to_homogeneous();
        let expected: [[f32; 4]; 3] =
            std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)] as f32));
        assert_eq!(rows, expected, "{} of field {field}", message.device);
        let is_measured = frame.bodies[body].validity() == protocol::geometry::Validity::Measured;
        assert_eq!(of("Status").as_deref() == Some("OK"), is_measured, "{} of field {field}", message.device);
        compared += 1;
    }
    println!("{compared} transforms compared");
    assert!(compared > 3 * 200, "{compared} of {} messages", heard.len());
    drop(deaf);
    let rest = bridge.end();
    assert!(rest.contains("frames forwarded, 0 lost"), "{rest}");
}

/// Another tracker is played by a run of our own.
#[test]
fn another_tracker_drives_a_run() {
    let (other, name) = (instance_name(), instance_name());
    let bridge = Bridge::start(&["--igtl", "0", "--instance", &other], "OpenIGTLink on ");
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (theirs, ours) = (path("theirs.mcap"), path("ours.mcap"));
    let rig = repository().join("assets/rig.json");
    let run = |args: &[&str], record: &str| {
        Running::start(&[&["run", "--no-picture"], args, &["--record", record]].concat())
    };
    let rig = rig.to_str().expect("UTF-8");
    let driven = run(&["--external", "poses", "--rig", rig, "--instance", &name, "--duration", "3"], &ours);
    let from = format!("igtl:{}", bridge.address);
    let driver = Bridge::start(&["--from", &from, "--instance", &name], "connected to ");
    let tracker = run(&["--direct", "--instance", &other], &theirs);
    // The run verifies.
    let done = driven.finish();
    assert!(matches!(done.code, Some(0 | 3)), "{done:?}");
    interrupt(tracker.pid());
    tracker.finish();
    let rest = driver.end();
    assert!(rest.contains("frames sent"), "{rest}");
    bridge.end();

    // An instant goes through the protocol's fractions of a second and another look at the wall clock.
    let theirs: BTreeMap<u64, TrackerFrame> =
        recorded(Path::new(&theirs)).into_values().map(|f| (f.instants.exposed / 1_000_000, f)).collect();
    let mut compared = 0;
    for frame in recorded(Path::new(&ours)).into_values() {
        let at = (frame.instants.exposed + 500_000) / 1_000_000;
        let Some(sent) = [at, at - 1].iter().find_map(|ms| theirs.get(ms)) else { continue };
        for (a, b) in frame.bodies.iter().zip(&sent.bodies) {
            if b.validity() == protocol::geometry::Validity::Measured {
                let between = a.world_from_body.isometry().inverse() * b.world_from_body.isometry();
                let off = (between.translation.vector.norm(), between.rotation.angle());
                assert!(off.0 < 1e-4 && off.1 < 1e-5, "field {}: {off:?}", sent.field);
                compared += 1;
            }
        }
    }
    println!("{compared} poses compared");
    assert!(compared > 3 * 100, "{compared} poses were compared");
}

#[test]
fn who_does_not_speak_openigtlink_is_told_and_closed() {
    use std::io::Write;
    let bridge = Bridge::start(&["--igtl", "0", "--instance", &instance_name()], "OpenIGTLink on ");
    let mut browser = bridge.connect();
    browser.write_all(&b"GET / HTTP/1.1\r\nHost: here\r\n\r\n".repeat(3)).expect("sent");
    let mut answer = Vec::new();
    // Closed with what was not read: an end or a reset.
    let _ = browser.read_to_end(&mut answer);
    assert!(answer.is_empty());
    let rest = bridge.end();
    assert!(rest.contains("it does not speak OpenIGTLink (header version 18245: expected 1 to 3)"), "{rest}");
}

#[test]
fn an_address_that_cannot_be_used_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let told = vitreo(&["bridge", "--igtl", &port]).expect_code(1).stderr;
    assert!(told.contains("--igtl") && told.contains(&format!("127.0.0.1:{port}")), "{told}");
    for (args, named) in [
        (&["bridge"][..], "--igtl"),
        (&["bridge", "--igtl", "x"], "PORT or HOST:PORT"),
        (&["bridge", "--igtl", "1", "--igtl-version", "4"], "from 1 to 3"),
        (&["bridge", "--from", "localhost:1"], "expected igtl:HOST:PORT"),
        (&["bridge", "--from", "igtl:h:1", "--igtl", "1"], "cannot be used with"),
    ] {
        let told = vitreo(args).expect_code(2).stderr;
        assert!(told.contains(named), "{args:?}: {told}");
    }
}
