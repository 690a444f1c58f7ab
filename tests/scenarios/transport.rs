//! A replay that is stepped: by keys in a terminal, and in the window's renderer over the channels of a run.

use ipc::Instance;
use protocol::inputs::{Input, InputEvent, Key, Origin};
use recording::Recording;
use replay::film::StepShown;
use replay::timeline::player::Player;
use replay::timeline::{Target, Timeline};
use replay::viewer::Viewer;
use rig::Rig;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use scene::SceneFile;
use simcore::world::World;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use vitreo_tests::{Watchdog, binaries, instance_name, repository, vitreo};

fn golden() -> PathBuf {
    repository().join("tests/data/golden/peel-2s.mcap")
}

/// A copy of it, beside which an index may lie.
fn copy_of_golden(folder: &Path) -> String {
    let file = folder.join("a.mcap");
    std::fs::copy(golden(), &file).expect("a copy");
    file.display().to_string()
}

/// A replay at a terminal.
struct AtTerminal {
    child: Child,
    watchdog: Watchdog,
    terminal: File,
    /// What it has shown since it was last asked.
    shown: String,
}

impl AtTerminal {
    fn start(args: &[&str]) -> Self {
        let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
        grantpt(&terminal).expect("its rights");
        unlockpt(&terminal).expect("its lock");
        let name = ptsname(&terminal, Vec::new()).expect("its name");
        let name = PathBuf::from(name.to_string_lossy().into_owned());
        let end = || File::options().read(true).write(true).open(&name).expect("the other end");
        let child = Command::new(binaries().join("vitreo"))
            .args(args)
            .env("XDG_CONFIG_HOME", "/nonexistent")
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .spawn()
            .expect("vitreo starts");
        let watchdog = Watchdog::on(child.id());
        AtTerminal { child, watchdog, terminal: terminal.into(), shown: String::new() }
    }

    /// Reads until the terminal shows a text.
    fn await_text(&mut self, text: &str) {
        let mut bytes = [0; 4096];
        while !self.shown.contains(text) {
            let read = self.terminal.read(&mut bytes).unwrap_or(0);
            assert!(read > 0, "expected {text:?} in {:?}", self.shown);
            self.shown.push_str(&String::from_utf8_lossy(&bytes[..read]));
        }
    }

    /// Types, and waits for what the terminal shows then.
    fn type_in(&mut self, keys: &str, text: &str) {
        self.shown.clear();
        self.terminal.write_all(keys.as_bytes()).expect("typed");
        self.await_text(text);
    }

    fn end(mut self) {
        self.terminal.write_all(b"q").expect("typed");
        let status = self.child.wait().expect("its end");
        assert!(status.success() && !self.watchdog.barked(), "{status}");
    }
}

#[test]
fn a_terminal_plays_stops_steps_and_goes_anywhere() {
    let folder = tempfile::tempdir().expect("folder");
    let file = copy_of_golden(folder.path());
    let mut replay = AtTerminal::start(&["replay", &file, "--interactive"]);
    replay.await_text("x1");
    replay.type_in(" ", "paused");
    let number = |text: &str| -> u64 {
        let digits = text.rsplit("step ").next().unwrap().split(' ').next().unwrap();
        digits.parse().expect("a number")
    };
    replay.type_in("gs50\r", "step 50 ");
    assert_eq!(number(&replay.shown), 50);
    replay.type_in(",", "step 49 ");
    replay.type_in(".", "step 50 ");
    replay.type_in("\u{1b}[D", "step 49 ");
    replay.type_in("\u{1b}[H", "0.00 s");
    replay.type_in("\u{1b}[A", "paused at x2");
    replay.type_in("h", "play, pause");
    replay.type_in("gx\r", "expected seconds");
    replay.type_in("g0.5\r", "0.50 s");
    replay.end();
}

#[test]
fn an_imported_stream_is_stepped_too() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [blobs, rig, stream] = ["b.jsonl", "rig.json", "stream.mcap"].map(path);
    let file = golden().display().to_string();
    vitreo(&["export", &file, "--blobs", &blobs, "--rig", &rig]).expect_code(0);
    vitreo(&["import", "--rig", &rig, &blobs, "-o", &stream]).expect_code(0);
    let mut replay = AtTerminal::start(&["replay", &stream, "--interactive", "--rate", "0.05"]);
    replay.await_text("x0.05");
    replay.type_in(" ", "paused at x0.05");
    replay.type_in("gs40\r", "step 40 ");
    replay.type_in(",", "step 39 ");
    replay.end();
    assert!(Path::new(&format!("{stream}.index")).is_file(), "the index is kept");
}

#[test]
fn without_a_terminal_or_steps_it_is_refused() {
    let file = golden().display().to_string();
    let told = vitreo(&["replay", &file, "--interactive"]).expect_code(1).stderr;
    assert!(told.contains("--interactive needs a terminal"), "{told}");
    for wrong in [&["--interactive", "--verify"][..], &["--window", "--poses", "p.csv"]] {
        vitreo(&[&["replay", &file][..], wrong].concat()).expect_code(2);
    }
}

/// What a window shows, without one: the renderer draws stills of what the replay publishes.
#[test]
fn the_renderer_shows_what_a_replay_publishes_and_gives_it_keys() {
    let folder = tempfile::tempdir().expect("folder");
    let stills = folder.path().join("stills");
    let recording = Recording::open(&golden()).expect("the recording");
    let scene = SceneFile::parse(&recording.provenance().scene_toml, "golden").expect("its scene");
    let rig = Rig::parse(&recording.provenance().rig_json, "golden").expect("its rig");
    let world = World::new(&scene).expect("its world");
    let name = instance_name();
    let options = ["--headless", "--tier", "8", "--stills", &stills.display().to_string()].map(Into::into);
    let mut viewer = Viewer::start(&name, (&scene, &world), &rig, &options, || false).expect("a renderer");
    let frames = Instance::join(&name).expect("its instance");
    let mut shown = frames.receiver::<protocol::frames::FrameRecord>(ipc::Queue::InOrder).expect("frames");
    let mut player = Player::new(Timeline::open(&recording).expect("a timeline"), world).expect("a player");
    for step in [60, 20] {
        player.seek(Target::Step(step)).expect("a seek");
        let last = player.last().expect("a step");
        let (instants, state_hash) = (last.record.instants, last.record.state_hash);
        let (world, poses) = (player.world(), &last.poses);
        let flow = viewer.show(&StepShown { world, step, instants, state_hash, poses }).expect("shown");
        assert!(flow.is_continue());
        let frame = vitreo_tests::next(&mut shown, |frame| frame.scene_field == last.record.field);
        assert_eq!(frame.predicted_to, poses.instants.exposed, "drawn as it was, and not predicted");
    }
    let mut window = frames.sender::<InputEvent>().expect("inputs");
    let space = Key::named("space").expect("a key");
    window.send(&InputEvent::new(Input::Press(space), Origin::Window, 1)).expect("sent");
    let pressed = std::iter::repeat_with(|| {
        ipc::wait(&[], 1_000_000);
        viewer.next_key().expect("keys")
    });
    assert_eq!(pressed.take(5_000).flatten().next(), Some(space));
    viewer.show_help(true).expect("help");
    viewer.say("step 20").expect("said");
    viewer.finish().expect("ended");
    assert!(std::fs::read_dir(stills).expect("stills").count() > 0);
}
