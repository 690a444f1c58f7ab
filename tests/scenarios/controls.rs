//! A pedal and handles of devices: a pseudo-terminal with a scripted encoder, pipes and recorded events.

use controls::encoder::Sample;
use controls::events::Event;
use controls::inputs::Input;
use controls::mapping::Mapping;
use ipc::Receiver;
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::optics::PedalButton;
use protocol::steps::StepRecord;
use recording::{Item, Recording};
use rig::Rig;
use rig::handles::RigHandle;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Stdio};
use vitreo_tests::verified::verify;
use vitreo_tests::{
    Observer, Running, Watchdog, binaries, instance_name, interrupt, json, kill, next, repository, vitreo,
};

/// Keys that a foot switch types.
const A: u16 = 30;
const B: u16 = 48;
const C: u16 = 46;
/// The encoders of the rig: counts of closed and of open jaws, and how far those are, rad.
const ENCODERS: [(i32, i32, f64); 2] = [(100, 1_100, 0.8), (900, -100, 0.5)];

fn key(at_us: i64, code: u16, value: i32) -> [u8; 24] {
    Event { at_us, kind: 1, code, value }.to_bytes()
}

/// A microcontroller at the other end of a serial line.
struct Encoder {
    line: File,
    name: String,
    seq: u16,
}

impl Encoder {
    fn new() -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
        grantpt(&master).expect("granted");
        unlockpt(&master).expect("unlocked");
        let name = ptsname(&master, Vec::new()).expect("a name").into_string().expect("UTF-8");
        // What is written before somebody listens is not sent back.
        let mut settings = tcgetattr(&master).expect("a terminal");
        settings.make_raw();
        tcsetattr(&master, OptionalActions::Now, &settings).expect("raw");
        Encoder { line: master.into(), name, seq: 0 }
    }

    fn spec(&self) -> String {
        format!("serial:{}", self.name)
    }

    fn send(&mut self, handle: u32, count: i32, tool: Option<Tool>) {
        let line = Sample { seq: self.seq, handle, count, tool }.line();
        self.seq = self.seq.wrapping_add(1);
        self.write(&line);
    }

    fn write(&mut self, text: &str) {
        self.line.write_all(text.as_bytes()).expect("somebody listens");
    }
}

/// A folder with a rig whose handles have encoders, and a pipe for a pedal.
struct Bench {
    folder: tempfile::TempDir,
    name: String,
}

impl Bench {
    fn new() -> Self {
        let bench = Bench { folder: tempfile::tempdir().expect("folder"), name: instance_name() };
        let mut rig = Rig::load(&repository().join("assets/rig.json")).expect("the shipped rig");
        let handle =
            |(instrument, (closed, open, open_rad))| RigHandle { instrument, closed, open, open_rad };
        rig.handles = (0..).zip(ENCODERS).map(handle).collect();
        std::fs::write(bench.path("rig.json"), rig.to_json()).expect("written");
        assert!(Command::new("mkfifo").arg(bench.path("pedal")).status().expect("mkfifo").success());
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    fn pedal(&self) -> String {
        format!("evdev:{},keyboard-switch", self.text("pedal"))
    }

    /// A foot on the pedal; waits until the pedal is read.
    fn foot(&self) -> File {
        OpenOptions::new().write(true).open(self.path("pedal")).expect("the pedal is read")
    }

    fn start(&self, further: &[&str]) -> (Running, Observer) {
        let (rig, record, report) = (self.text("rig.json"), self.text("a.mcap"), self.text("report.json"));
        let run = ["run", "--no-picture", "--instance", &self.name, "--rig", &rig, "--record", &record];
        let running = Running::start(&[&run[..], &["--report", &report], further].concat());
        (running, Observer::join(&self.name))
    }
}

fn jaw(hands: &mut Receiver<HandleState>, instrument: u32, jaw_rad: f64) -> HandleState {
    next(hands, |h| h.instrument == instrument && (h.jaw_rad - jaw_rad).abs() < 1e-12)
}

#[test]
fn a_pedal_and_handles_of_devices_are_sent_told_of_and_recorded() {
    let (bench, mut encoder) = (Bench::new(), Encoder::new());
    let (pedal, handles) = (bench.pedal(), encoder.spec());
    let (run, mut observer) = bench.start(&["--direct", "--pedal", &pedal, "--handles", &handles]);
    let (mut hands, mut feet) = (observer.receiver::<HandleState>(), observer.receiver::<PedalState>());
    let mut foot = bench.foot();

    // The line is open once its first state is there. Half closed forceps in the second hand, closed ones in
    // the first.
    next(&mut hands, |_| true);
    encoder.send(1, 400, Some(Tool::Forceps));
    encoder.send(0, 100, Some(Tool::Forceps));
    let half = jaw(&mut hands, 1, 0.25);
    assert_eq!(half.tool, Tool::Forceps as u32);
    jaw(&mut hands, 0, 0.0);
    foot.write_all(&[key(5, A, 1), key(9, C, 1)].concat()).expect("it is read");
    let pressed = next(&mut feet, |p| p.axes == [1.0, 0.0] && p.buttons == PedalButton::Lens as u32);
    assert_eq!(pressed.mode, 2, "suction");

    // A pedal that is unplugged is up after a while; plugged in again it is a pedal again.
    drop(foot);
    let gone = observer.health(Process::Controls, |h| h.text().contains("the pedal is disconnected"));
    assert_eq!(gone.state, STATE_DEGRADED);
    next(&mut feet, |p| p.axes == [0.0; 2] && p.buttons == 0);
    let mut foot = bench.foot();
    foot.write_all(&key(20, B, 1)).expect("it is read");
    next(&mut feet, |p| p.axes == [0.0, 1.0]);
    observer.health(Process::Controls, |h| !h.text().contains("pedal"));

    // An encoder that is silent, then noisy, then loses lines: the jaws stay, and the newest sample counts.
    observer.health(Process::Controls, |h| h.text().contains("is silent"));
    encoder.write(&"$VH,1,0,5,1*0000\r\n".repeat(9));
    observer.health(Process::Controls, |h| h.text().contains("is noisy"));
    encoder.seq += 40;
    encoder.send(0, 600, None);
    jaw(&mut hands, 0, 0.4);
    let mut steps = observer.receiver::<StepRecord>();
    let reached = next(&mut steps, |_| true).step;
    next(&mut steps, |s| s.step > reached + 60);
    drop((hands, feet, steps, observer));
    interrupt(run.pid());
    let finished = run.finish();
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    for told in ["the pedal is disconnected", "is noisy"] {
        assert!(finished.stderr.contains(told), "{told}: {}", finished.stderr);
    }
    expect_recorded(&bench);
    expect_reported(&bench, &finished.stdout);
}

/// The recording holds what was sent, of one sender a channel, and verifies.
fn expect_recorded(bench: &Bench) {
    let recording = Recording::open(&bench.path("a.mcap")).expect("a recording");
    let (mut jaws, mut pedals, mut seqs) = (Vec::new(), Vec::new(), [Vec::new(), Vec::new()]);
    for item in recording.items_of(&["handles", "pedal"]) {
        match item.expect("whole").1 {
            Item::Handle(handle) => {
                jaws.push((handle.instrument, handle.jaw_rad));
                seqs[0].push(handle.seq);
            }
            Item::Pedal(pedal) => {
                pedals.push((pedal.axes, pedal.buttons));
                seqs[1].push(pedal.seq);
            }
            other => panic!("{other:?}"),
        }
    }
    for wanted in [(1, 0.25), (0, 0.0), (0, 0.4)] {
        assert!(jaws.iter().any(|(i, rad)| *i == wanted.0 && (rad - wanted.1).abs() < 1e-12), "{wanted:?}");
    }
    let lens = PedalButton::Lens as u32;
    for wanted in [([1.0, 0.0], lens), ([0.0; 2], 0), ([0.0, 1.0], 0)] {
        assert!(pedals.contains(&wanted), "{wanted:?}");
    }
    assert!(seqs.iter().all(|seqs| seqs.windows(2).all(|w| w[1] > w[0])), "one sender a channel");
    let verified = verify(&bench.path("a.mcap"));
    verified.holds([60, 60]).expect("it verifies");
}

fn expect_reported(bench: &Bench, stdout: &str) {
    let report = json(&bench.path("report.json"));
    let [pedal, handles] = [0, 1].map(|i| &report["controls"][i]);
    let number =
        |of: &serde_json::Value, key: &str| of[key].as_u64().unwrap_or_else(|| panic!("{key}: {of}"));
    assert_eq!((pedal["control"].as_str(), handles["control"].as_str()), (Some("pedal"), Some("handles")));
    assert_eq!((number(pedal, "taken"), number(pedal, "openings")), (3, 2), "{pedal}");
    assert_eq!(number(&pedal["troubles"], "gone"), 1, "{pedal}");
    assert_eq!((number(handles, "taken"), number(handles, "missing")), (3, 40), "{handles}");
    assert_eq!(number(&handles["bad"], "wrong checksum"), 9, "{handles}");
    assert!(number(&handles["troubles"], "silent") >= 1 && number(&handles["troubles"], "garbled") == 1);
    assert_eq!(report["restarts"]["controls"], 0, "{report}");
    assert!(stdout.contains("40 lines missing; wrong checksum 9 ×"), "{stdout}");
}

#[test]
fn recorded_events_are_a_pedal_beside_recorded_blobs() {
    let bench = Bench::new();
    let data = |name: &str| repository().join("tests/data/tracker/nominal").join(name).display().to_string();
    // Pressed for a fifth of a second, three times, as a device recorded it a while ago.
    let presses = (0..6).map(|i| key(1_700_000_000_000_000 + i64::from(i) * 200_000, A, 1 - i % 2));
    std::fs::write(bench.path("events"), presses.flatten().collect::<Vec<u8>>()).expect("written");
    let (rig, blobs, record) = (data("rig.json"), data("blobs.jsonl"), bench.text("a.mcap"));
    let pedal = format!("evdev:{},keyboard-switch", bench.text("events"));
    let run = ["run", "--no-picture", "--instance", &bench.name, "--rig", &rig, "--blobs", &blobs];
    let finished = vitreo(&[&run[..], &["--record", &record, "--pedal", &pedal]].concat());
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    let recording = Recording::open(&bench.path("a.mcap")).expect("a recording");
    let pedals = recording.items_of(&["pedal"]).filter_map(|item| match item.expect("whole").1 {
        Item::Pedal(pedal) => Some((pedal.axes[0], pedal.instant_ns)),
        _ => None,
    });
    let mut pedals: Vec<(f64, u64)> = pedals.collect();
    pedals.dedup_by_key(|(axis, _)| *axis);
    let presses: Vec<u64> = pedals.iter().filter(|(axis, _)| *axis == 1.0).map(|(_, at)| *at).collect();
    assert_eq!(presses.len(), 3, "{pedals:?}");
    assert!(presses.windows(2).all(|w| w[1] - w[0] > 100_000_000), "with their spacing: {presses:?}");
    let handles = recording.items_of(&["handles"]).count();
    assert!(handles > 20, "those stay with the rig: {handles}");
}

#[test]
fn a_process_of_the_controls_that_dies_is_back_with_its_devices() {
    let (bench, mut encoder) = (Bench::new(), Encoder::new());
    let (pedal, handles) = (bench.pedal(), encoder.spec());
    let (run, mut observer) = bench.start(&["--direct", "--pedal", &pedal, "--handles", &handles]);
    let (mut hands, mut feet) = (observer.receiver::<HandleState>(), observer.receiver::<PedalState>());
    let mut foot = bench.foot();
    foot.write_all(&key(1, A, 1)).expect("it is read");
    next(&mut feet, |p| p.axes[0] == 1.0);
    let mut steps = observer.receiver::<StepRecord>();
    next(&mut steps, |s| s.step > 20);
    let health = observer.health(Process::Controls, |_| true);
    kill(health.pid);
    let reborn = observer.health(Process::Controls, |h| h.pid != health.pid && h.state >= STATE_RUNNING);
    next(&mut hands, |h| h.instant_ns > reborn.instant_ns);
    encoder.send(0, 600, Some(Tool::Forceps));
    jaw(&mut hands, 0, 0.4);
    foot.write_all(&key(2, B, 1)).expect("it is read again");
    next(&mut feet, |p| p.axes[1] == 1.0);
    let reached = next(&mut steps, |_| true).step;
    next(&mut steps, |s| s.step > reached + 50);
    drop((hands, feet, steps, observer));
    interrupt(run.pid());
    let finished = run.finish();
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    assert_eq!(json(&bench.path("report.json"))["restarts"]["controls"], 1);
}

#[test]
fn devices_that_cannot_be_are_refused_in_words() {
    let bench = Bench::new();
    let (rig, none) = (bench.text("rig.json"), bench.text("none"));
    std::fs::write(bench.path("slip.toml"), "format = \"vitreo-pedal-1\"\nname = 3\n").expect("written");
    let slip = format!("evdev:{},{}", bench.text("pedal"), bench.text("slip.toml"));
    let reports = format!("hidraw:{},keyboard-switch", bench.text("pedal"));
    let plain = format!("hidraw:{}", bench.text("pedal"));
    for (further, code, named) in [
        (&["--handles", &format!("serial:{}", bench.text("pedal"))][..], 2, "the rig has no section handles"),
        (&["--rig", &rig, "--handles", &format!("serial:{none}")], 1, "none: No such file"),
        (&["--pedal", &format!("evdev:{none}")], 1, "none: No such file"),
        (&["--pedal", "usb:3"], 2, "expected evdev:/dev/input/eventN[,MAPPING]"),
        (&["--pedal", &slip], 1, "slip.toml: line 2: "),
        (&["--pedal", &reports], 1, "the mapping keyboard-switch is for evdev:, not for hidraw:"),
        (&["--pedal", &plain], 1, "expected hidraw:PATH,MAPPING"),
        (&["--rig", &rig, "--cameras", "/bin/true", "--pedal", &bench.pedal()], 2, "publishes both itself"),
    ] {
        let run = ["run", "--no-picture", "--direct", "--duration", "1", "--instance", &bench.name];
        let refused = vitreo(&[&run[..], further].concat()).expect_code(code);
        assert!(refused.stderr.contains(named), "{further:?}: {}", refused.stderr);
    }
}

/// A command that asks, and whoever answers.
struct Asked {
    child: Child,
    says: BufReader<ChildStdout>,
    watchdog: Watchdog,
}

impl Asked {
    fn start(args: &[&str]) -> Self {
        let mut command = Command::new(binaries().join("vitreo"));
        command.args(args).env("XDG_CONFIG_HOME", "/nonexistent");
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("vitreo");
        let says = BufReader::new(child.stdout.take().expect("piped"));
        let watchdog = Watchdog::on(child.id());
        Asked { child, says, watchdog }
    }

    /// Waits until it says this.
    fn hears(&mut self, wanted: &str) {
        let mut line = String::new();
        while !line.contains(wanted) {
            line.clear();
            assert!(self.says.read_line(&mut line).expect("text") > 0, "it ended without {wanted:?}");
        }
    }

    fn enter(&mut self) {
        self.child.stdin.as_mut().expect("piped").write_all(b"\n").expect("it asks");
    }

    fn ends_well(mut self) {
        drop(self.says);
        assert!(self.child.wait().expect("it ends").success());
        assert!(!self.watchdog.barked());
    }
}

#[test]
fn a_mapping_is_learnt_from_what_is_pressed() {
    let bench = Bench::new();
    let (spec, file) = (format!("evdev:{}", bench.text("pedal")), bench.text("learnt.toml"));
    let mut asked = Asked::start(&["pedal", &spec, "--learn", &file]);
    let mut foot = bench.foot();
    asked.hears("Let go of everything");
    asked.enter();
    let mut press = |asked: &mut Asked, code: Option<u16>, what: &str| {
        asked.hears(what);
        let Some(code) = code else { return asked.enter() };
        foot.write_all(&key(0, code, 1)).expect("it is read");
        asked.enter();
        asked.hears("Let go of it");
        foot.write_all(&key(0, code, 0)).expect("it is read");
        asked.enter();
        asked.hears(&Input::Key(code).to_string());
    };
    press(&mut asked, Some(A), "the first axis");
    press(&mut asked, None, "the second axis");
    press(&mut asked, Some(C), "wide-angle lens");
    (0..7).for_each(|_| press(&mut asked, None, "the button"));
    asked.hears("is written");
    asked.ends_well();
    let learnt = Mapping::load(&file).expect("a mapping");
    assert_eq!((learnt.axes.len(), learnt.axes[0].input), (1, Input::Key(A)));
    assert_eq!(learnt.buttons, [(Input::Key(C), PedalButton::Lens)]);
    let again = vitreo(&["pedal", &spec, "--learn", &file]).expect_code(1);
    assert!(again.stderr.contains("already exists"), "{}", again.stderr);
}

#[test]
fn jaws_are_calibrated_into_a_new_rig() {
    let (bench, mut encoder) = (Bench::new(), Encoder::new());
    let (rig, new) = (repository().join("assets/rig.json").display().to_string(), bench.text("new.json"));
    let mut asked =
        Asked::start(&["handles", &encoder.spec(), "--calibrate", &rig, "-o", &new, "--open-rad", "0.7"]);
    asked.hears("Close the jaws");
    (0..5).for_each(|noise| encoder.send(0, 500 + noise, None));
    asked.enter();
    asked.hears("Let them open");
    (0..5).for_each(|noise| encoder.send(0, 3_000 - noise, None));
    asked.enter();
    asked.hears("is written");
    asked.ends_well();
    let calibrated = Rig::load(std::path::Path::new(&new)).expect("a rig");
    assert_eq!(calibrated.handles, [RigHandle { instrument: 0, closed: 502, open: 2_998, open_rad: 0.7 }]);
    let over = vitreo(&["handles", &encoder.spec(), "--calibrate", &new, "-o", &new]).expect_code(1);
    assert!(over.stderr.contains("is an input of the command"), "{}", over.stderr);
}
