//! Blobs that another program writes while the simulator runs: through a pipe, a port, standard input.

use ipc::Receiver;
use protocol::control::Notice;
use protocol::geometry::Validity;
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::message::text_of;
use protocol::poses::TrackerFrame;
use serde_json::Value;
use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use vitreo_tests::verified::verify;
use vitreo_tests::{
    Finished, Observer, Running, WATCHDOG, Watchdog, binaries, instance_name, interrupt, json, next,
    repository,
};

/// Lines of the excerpt that one writer writes: a second of three cameras.
const LINES: usize = 150;
/// No camera-field.
const BAD: &str = "{\"cam\":0}\n";

fn data(name: &str) -> PathBuf {
    repository().join("tests/data/tracker/nominal").join(name)
}

fn text(path: &Path) -> String {
    path.to_str().expect("UTF-8").to_owned()
}

/// Writes the excerpt with the spacing in which it was received, a bad line in its middle.
fn write_as_it_came(to: &mut impl Write) {
    let excerpt = std::fs::read_to_string(data("blobs.jsonl")).expect("excerpt");
    let received = |line: &str| {
        let line: Value = serde_json::from_str(line).expect("JSON");
        line["t_rx_ns"].as_u64().expect("an instant")
    };
    let begun = ipc::clock::now();
    let mut first = None;
    for (i, line) in excerpt.lines().take(LINES).enumerate() {
        let at = received(line);
        ipc::clock::sleep_until(begun + at.saturating_sub(*first.get_or_insert(at)));
        if i == LINES / 2 {
            to.write_all(BAD.as_bytes()).expect("a reader");
        }
        to.write_all(format!("{line}\n").as_bytes()).expect("a reader");
    }
}

/// A simulator on a live stream.
struct Live {
    folder: tempfile::TempDir,
    name: String,
    run: Running,
    observer: Observer,
}

impl Live {
    /// Starts it, and waits until it waits for a writer.
    fn start(blobs: &str, folder: tempfile::TempDir) -> Self {
        let name = instance_name();
        let path = |file: &str| text(&folder.path().join(file));
        let (rig, record, report) = (text(&data("rig.json")), path("a.mcap"), path("report.json"));
        let run = ["run", "--no-picture", "--blobs", blobs, "--rig", &rig, "--instance", &name];
        let run = Running::start(&[&run[..], &["--record", &record, "--report", &report]].concat());
        let mut observer = Observer::join(&name);
        observer.health(Process::VirtualRig, |h| h.text().contains("waiting for a writer"));
        Live { folder, name, run, observer }
    }

    /// The port on which it waits, by the log of the process that reads the stream: written after the health was sent.
    fn port(&mut self) -> String {
        let directory = ipc::instance_directory(&self.name).expect("a name");
        loop {
            let log = std::fs::read_to_string(directory.join("virtual-rig.log")).expect("a log");
            let address =
                log.split("waiting for a writer on tcp:").nth(1).and_then(|rest| rest.split_once('\n'));
            if let Some((address, _)) = address {
                return address.to_owned();
            }
            self.observer.health(Process::VirtualRig, |_| true);
        }
    }

    /// Waits until this many lines were taken in, and the reader is in this state.
    fn lines(&mut self, lines: usize, state: u32) {
        self.observer.health(Process::VirtualRig, |h| h.received >= lines as u64 && h.state == state);
    }

    /// Ends it as Ctrl-C does; returns what it said and its figures of the stream.
    fn end(self) -> (Finished, Value) {
        interrupt(self.run.pid());
        // This verifies the recording, too.
        let done = self.run.finish();
        // A machine that is busy elsewhere may cost fields.
        assert!(matches!(done.code, Some(0 | 3)), "{done:?}");
        verify(&self.folder.path().join("a.mcap")).expect([20, 20]);
        let report = json(&self.folder.path().join("report.json"));
        assert!(done.stdout.contains("blob stream: "), "{done:?}");
        (done, report)
    }
}

/// Waits until the launcher has reported that nothing arrives.
fn silence(notices: &mut Receiver<Notice>) {
    next(notices, |notice| text_of(&notice.text).contains("the blob stream sends nothing"));
}

/// Asserts what every stream of two writers leaves.
fn expect_two_writers(done: &Finished, report: &Value) {
    let stream = &report["blob_stream"];
    let count = |key: &str| stream[key].as_u64().unwrap_or_else(|| panic!("{key}: {stream}"));
    assert_eq!((count("lines"), count("bad"), count("writers")), (2 * LINES as u64 + 2, 2, 2), "{stream}");
    let used = count("fields") + count("bad") + count("doubtful") + count("out_of_order");
    assert_eq!(used, count("lines"), "{stream}");
    assert!(count("fields") > LINES as u64 && count("time_bases") >= 2 && count("silences") >= 1, "{stream}");
    for line in [LINES / 2 + 1, LINES + LINES / 2 + 2] {
        let named = format!("line {line}: column 9: missing key seq");
        assert!(done.stderr.contains(&named), "{named}: {done:?}");
    }
    let silent = report["warnings"].as_array().expect("warnings").iter();
    assert!(
        silent.clone().any(|w| w["what"].as_str().is_some_and(|w| w.contains("the blob stream"))),
        "{report}"
    );
}

#[test]
fn a_fifo_is_taken_line_by_line_from_one_writer_after_the_other() {
    let folder = tempfile::tempdir().expect("folder");
    let fifo = folder.path().join("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().expect("mkfifo").success());
    let mut live = Live::start(&text(&fifo), folder);
    let mut poses = live.observer.receiver::<TrackerFrame>();
    let mut notices = live.observer.receiver();
    for round in 1..=2 {
        let mut writer = File::options().write(true).open(&fifo).expect("a reader is there");
        write_as_it_came(&mut writer);
        // The writer is silent, and still there.
        live.lines(round * (LINES + 1), STATE_DEGRADED);
        next(&mut poses, |p| p.bodies.iter().any(|b| b.validity() == Validity::Measured && b.blobs_used > 0));
        silence(&mut notices);
        drop(writer);
        live.observer.health(Process::VirtualRig, |h| h.text().starts_with("waiting for a writer"));
    }
    let (done, report) = live.end();
    expect_two_writers(&done, &report);
    assert!(done.stderr.contains(&format!("waiting for a writer on FIFO {}", fifo.display())), "{done:?}");
    assert!(report["restarts"]["virtual-rig"] == 0, "{report}");
}

#[test]
fn a_port_takes_one_writer_at_a_time() {
    let mut live = Live::start("tcp:0", tempfile::tempdir().expect("folder"));
    let address = live.port();
    let mut notices = live.observer.receiver();
    for round in 1..=2 {
        let mut writer = TcpStream::connect(&address).expect("it listens");
        write_as_it_came(&mut writer);
        live.lines(round * (LINES + 1), STATE_DEGRADED);
        silence(&mut notices);
        let mut told = String::new();
        TcpStream::connect(&address).expect("it listens").read_to_string(&mut told).expect("text");
        assert!(told.contains("another writer is connected"), "{told}");
        drop(writer);
        live.observer.health(Process::VirtualRig, |h| h.text().starts_with("waiting for a writer"));
    }
    let (done, report) = live.end();
    expect_two_writers(&done, &report);
    assert_eq!(report["blob_stream"]["turned_away"], 2, "{report}");
}

#[test]
fn a_run_on_standard_input_ends_with_it() {
    let folder = tempfile::tempdir().expect("folder");
    let (name, report) = (instance_name(), folder.path().join("report.json"));
    let mut command = Command::new(binaries().join("vitreo"));
    command.args(["run", "--no-picture", "--blobs", "-", "--rig", &text(&data("rig.json"))]);
    command.args(["--instance", &name, "--report", &text(&report)]).current_dir(repository());
    command.env("XDG_CONFIG_HOME", "/nonexistent").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.stderr(Stdio::piped()).spawn().expect("vitreo starts");
    let watchdog = Watchdog::on(child.id());
    let mut stdin = child.stdin.take().expect("a pipe");
    let mut observer = Observer::join(&name);
    observer.health(Process::VirtualRig, |h| h.text().contains("waiting for a writer"));
    write_as_it_came(&mut stdin);
    observer.health(Process::VirtualRig, |h| h.state == STATE_RUNNING && h.sent > 0);
    drop(stdin);
    let output = child.wait_with_output().expect("waited for");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!watchdog.barked(), "it did not end within {WATCHDOG:?}: {told}");
    assert!(matches!(output.status.code(), Some(0 | 3)), "{:?}: {told}", output.status);
    assert!(told.contains("standard input has ended"), "{told}");
    let report = json(&report);
    assert_eq!(report["ended_by"], "end of the stream", "{report}");
    assert_eq!(report["blob_stream"]["lines"], LINES as u64 + 1, "{report}");
}
