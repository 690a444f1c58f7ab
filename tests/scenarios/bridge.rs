//! Poses by OpenIGTLink: a client gets what is recorded, and those that do not read delay nobody.

use igtl::{Content, Message, Reader};
use protocol::poses::TrackerFrame;
use recording::{Item, Recording};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use vitreo_tests::{WATCHDOG, Watchdog, binaries, instance_name, interrupt, vitreo};

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
    fn start(instance: &str) -> Self {
        let mut child = Command::new(binaries().join("vitreo"))
            .args(["bridge", "--igtl", "0", "--instance", instance])
            .env("XDG_CONFIG_HOME", "/nonexistent")
            .stderr(Stdio::piped())
            .spawn()
            .expect("vitreo starts");
        let watchdog = Watchdog::on(child.id());
        let mut log = BufReader::new(child.stderr.take().expect("piped"));
        let told = line_with(&mut log, "OpenIGTLink on ");
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

/// Reads until the end of the simulator is told.
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
    let mut bridge = Bridge::start(&name);
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
    assert!(rest.contains("frames handed on, 0 lost"), "{rest}");
}

#[test]
fn who_does_not_speak_openigtlink_is_told_and_closed() {
    use std::io::Write;
    let bridge = Bridge::start(&instance_name());
    let mut browser = bridge.connect();
    browser.write_all(&b"GET / HTTP/1.1\r\nHost: here\r\n\r\n".repeat(3)).expect("sent");
    let mut answer = Vec::new();
    // Closed with what was not read: an end or a reset.
    let _ = browser.read_to_end(&mut answer);
    assert!(answer.is_empty());
    let rest = bridge.end();
    assert!(
        rest.contains("it does not speak OpenIGTLink (a header of version 18245: expected 1 to 3)"),
        "{rest}"
    );
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
        (&["bridge", "--igtl", "1", "--igtl-version", "4"], "1..=3"),
    ] {
        let told = vitreo(args).expect_code(2).stderr;
        assert!(told.contains(named), "{args:?}: {told}");
    }
}
