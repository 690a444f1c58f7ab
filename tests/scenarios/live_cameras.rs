//! Pictures that come through pipes and from files in place of the cameras: `vitreo run --cameras y4m:…`.
//!
//! The fields are painted once, of a surgeon who stands still but for one period, so that it does not
//! matter when a pipe is opened. The pipes set the pace: what writes into them waits for its reader.

use protocol::blobs::BlobField;
use protocol::fields::{DARK, FieldPicture};
use protocol::geometry::Validity;
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING, STATE_STARTING};
use protocol::poses::TrackerFrame;
use recording::{Item, Recording};
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path as Way};
use vitreo_tests::verified::{WITHOUT_FRAME, verify};
use vitreo_tests::{Observer, Running, instance_name, interrupt, json, kill, next, repository, vitreo};

/// Number of the even field that is painted; the odd one follows it.
const FIELD: u64 = 200;

/// What each camera of the shipped rig sees: an even and an odd field.
pub(crate) fn painted() -> Vec<[FieldPicture; 2]> {
    let rig = Rig::load_or_shipped(None).expect("the shipped rig");
    let scene = SceneFile::load(DEFAULT_SCENE).expect("the default scene");
    let mut surgeon = MotionSource::new(&scene, &rig, None, 1);
    let mut cameras = Cameras::new(&rig, Way::Pixels, 1).expect("cameras");
    let mut field = |camera, number| {
        let mut exposure = cameras.expose(camera, &mut surgeon, number);
        let header = exposure.header();
        let mut payload = vec![0; header.bytes()];
        exposure.paint(&mut payload);
        let mut whole = FieldPicture::new(rig.cameras()[0].size_px);
        whole.blank_lines(0..whole.height, DARK);
        whole.copy_lines(
            0..header.lines as usize,
            &FieldPicture::in_payload(&header, &payload).expect("planes"),
        );
        whole
    };
    (0..3).map(|camera| [field(camera, FIELD), field(camera, FIELD + 1)]).collect()
}

/// Header and pictures of a camera's stream: fields, or frames of two.
fn stream(fields: &[FieldPicture; 2], interlaced: bool) -> (Vec<u8>, Vec<Vec<u8>>) {
    let (width, height) = (fields[0].width, fields[0].height);
    let planes = |f: &FieldPicture| [f.luma.clone(), f.blue.clone(), f.red.clone()];
    let picture = |planes: [Vec<u8>; 3]| [b"FRAME\n".to_vec(), planes.concat()].concat();
    if !interlaced {
        let head = format!("YUV4MPEG2 W{width} H{height} F50:1 Ip C422\n");
        return (head.into(), fields.iter().map(|f| picture(planes(f))).collect());
    }
    let [even, odd] = [planes(&fields[0]), planes(&fields[1])];
    let woven = |plane: usize| {
        let lines = even[plane].len() / height;
        let pairs = even[plane].chunks(lines).zip(odd[plane].chunks(lines));
        pairs.flat_map(|(even, odd)| [even, odd].concat()).collect()
    };
    let head = format!("YUV4MPEG2 W{width} H{} F25:1 It C422\n", 2 * height);
    (head.into(), vec![picture([woven(0), woven(1), woven(2)])])
}

/// How a writer writes.
#[derive(Clone, Copy, PartialEq)]
enum Manner {
    /// As fast as its reader reads.
    Steady,
    /// Not at all, with its pipe open.
    Silent,
    /// A third of the rig's rate.
    Slow,
    /// Nothing but black.
    Black,
}

/// A writer into a pipe, again and again until it is stopped or the pipe has no reader.
pub(crate) struct Writer {
    stop: Arc<AtomicBool>,
    manner: Arc<Mutex<Manner>>,
    thread: JoinHandle<()>,
}

/// What a writer writes, and where.
struct Writing {
    pipe: PathBuf,
    head: Vec<u8>,
    pictures: Vec<Vec<u8>>,
    black: Vec<u8>,
    stop: Arc<AtomicBool>,
    manner: Arc<Mutex<Manner>>,
}

impl Writing {
    /// Opens the pipe and writes until it is stopped; false where the pipe has no reader any more.
    fn write(&self) -> bool {
        let mut into = std::fs::File::options().write(true).open(&self.pipe).expect("a pipe");
        let mut put = |bytes: &[u8]| match into.write_all(bytes) {
            Err(e) if e.kind() == ErrorKind::BrokenPipe => false,
            written => written.map(|()| true).expect("written"),
        };
        let mut reads = put(&self.head);
        for picture in self.pictures.iter().cycle() {
            if !reads || self.stop.load(Ordering::Relaxed) {
                break;
            }
            let manner = *self.manner.lock().expect("a manner");
            reads = match manner {
                Manner::Steady => put(picture),
                Manner::Black => put(&self.black),
                Manner::Silent => true,
                Manner::Slow => put(picture),
            };
            // The writer's pace, not a wait for somebody.
            match manner {
                Manner::Silent => std::thread::sleep(Duration::from_millis(5)),
                Manner::Slow => std::thread::sleep(Duration::from_millis(60)),
                Manner::Steady | Manner::Black => {}
            }
        }
        reads
    }
}

impl Writer {
    pub(crate) fn start(pipe: &Path, fields: &[FieldPicture; 2], interlaced: bool) -> Self {
        Self::of(pipe, stream(fields, interlaced), false)
    }

    /// One that opens its pipe again where its reader is gone.
    fn persistent(pipe: &Path, fields: &[FieldPicture; 2]) -> Self {
        Self::of(pipe, stream(fields, false), true)
    }

    fn of(pipe: &Path, (head, pictures): (Vec<u8>, Vec<Vec<u8>>), persists: bool) -> Self {
        let (stop, manner) = (Arc::<AtomicBool>::default(), Arc::new(Mutex::new(Manner::Steady)));
        let mut black = pictures[0].clone();
        let luma = (black.len() - 6) / 2;
        black[6..6 + luma].fill(16);
        black[6 + luma..].fill(128);
        let (pipe, stopped, manners) = (pipe.to_owned(), Arc::clone(&stop), Arc::clone(&manner));
        let writing = Writing { pipe, head, pictures, black, stop: stopped, manner: manners };
        let thread = std::thread::spawn(move || {
            while !writing.write() && persists && !writing.stop.load(Ordering::Relaxed) {}
        });
        Writer { stop, manner, thread }
    }

    fn be(&self, manner: Manner) {
        *self.manner.lock().expect("a manner") = manner;
    }

    pub(crate) fn close(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("it writes");
    }
}

/// A folder with a rig and three pipes.
pub(crate) struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        Bench { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    pub(crate) fn exists(&self, name: &str) -> bool {
        self.path(name).exists()
    }

    pub(crate) fn pipes(&self) -> [PathBuf; 3] {
        let pipes = ["a", "b", "c"].map(|name| self.path(name));
        assert!(Command::new("mkfifo").args(&pipes).status().expect("mkfifo").success());
        pipes
    }

    /// The command line of a run whose sources are named so.
    fn run(&self, instance: &str, sources: &[&str], further: &[&str]) -> Vec<String> {
        let sources: Vec<String> = sources.iter().map(|s| format!("y4m:{}", self.text(s))).collect();
        let rig = repository().join("assets/rig.json").display().to_string();
        let cameras = sources.join(",");
        let args = ["run", "--no-picture", "--instance", instance, "--rig", &rig, "--cameras", &cameras];
        args.iter().chain(further).map(|&arg| arg.to_owned()).collect()
    }
}

fn words(args: &[String]) -> Vec<&str> {
    args.iter().map(String::as_str).collect()
}

#[test]
fn three_pipes_are_three_cameras_and_one_that_closes_is_taken_up_again() {
    let (bench, name, painted) = (Bench::new(), instance_name(), painted());
    let pipes = bench.pipes();
    let (record, report) = (bench.text("r.mcap"), bench.text("r.json"));
    let further = ["--record", &record, "--report", &report];
    let run = Running::start(&words(&bench.run(&name, &["a", "b", "c"], &further)));
    let mut observer = Observer::join(&name);
    let [first, last] = [0, 2].map(|i| Writer::start(&pipes[i], &painted[i], false));
    let source = Process::VirtualRig;
    observer.health(source, |h| h.state == STATE_STARTING && h.text().contains("camera 1 is not ready"));
    let (mut poses, mut blobs) = (observer.receiver::<TrackerFrame>(), observer.receiver::<BlobField>());
    let middle = Writer::start(&pipes[1], &painted[1], true);
    let frame = next(&mut poses, |f| {
        f.bodies.iter().all(|b| b.validity() == Validity::Measured) && f.used_count >= 3
    });
    middle.close();
    let closed = observer.health(source, |h| h.state == STATE_DEGRADED && h.text().contains("was closed"));
    assert!(closed.text().starts_with("camera 1 "), "{}", closed.text());
    let without = next(&mut poses, |f| f.field > frame.field + 10 && f.used_count == 2);
    assert_ne!(without.bodies[0].validity(), Validity::Lost, "tracking continues with the others");
    let again = Writer::start(&pipes[1], &painted[1], true);
    observer.health(source, |h| h.state == STATE_RUNNING && h.text().is_empty());
    let back = next(&mut blobs, |b| b.camera == 1 && b.field > without.field);
    assert!(back.count > 5, "{} blobs", back.count);
    next(&mut poses, |f| f.field > back.field && f.used_count >= 3);
    interrupt(run.pid());
    let finished = run.finish();
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    [first, again, last].into_iter().for_each(Writer::close);
    assert!(finished.stderr.contains("was closed by its writer"), "{}", finished.stderr);
    let cameras = &json(&bench.path("r.json"))["cameras"];
    assert_eq!(
        (&cameras[1]["openings"], &cameras[1]["troubles"]["closed"]),
        (&2.into(), &1.into()),
        "{cameras}"
    );
    assert!(cameras[1]["missing"].as_u64() > Some(0), "{cameras}");
    let fields = [0, 1, 2].map(|i| cameras[i]["fields"].as_u64().expect("a number"));
    assert!(fields[1] > 0 && fields[0] > fields[1] && fields[2] > fields[1], "{cameras}");
    assert!(finished.stdout.contains("delay p50"), "{}", finished.stdout);
}

#[test]
fn a_camera_that_is_silent_slow_black_or_of_another_size_is_told_and_taken_up_again() {
    let (bench, name, painted) = (Bench::new(), instance_name(), painted());
    let (pipes, report) = (bench.pipes(), bench.text("r.json"));
    let run = Running::start(&words(&bench.run(&name, &["a", "b", "c"], &["--report", &report])));
    let mut observer = Observer::join(&name);
    let [first, middle, last] = [0, 1, 2].map(|i| Writer::start(&pipes[i], &painted[i], false));
    let (source, mut poses) = (Process::VirtualRig, observer.receiver::<TrackerFrame>());
    let sound = |observer: &mut Observer| {
        observer.health(source, |h| h.state == STATE_RUNNING && h.text().is_empty());
    };
    sound(&mut observer);
    let mut newest = next(&mut poses, |f| f.used_count == 3).field;
    let mut told = |observer: &mut Observer, text: &str| {
        let health = observer.health(source, |h| h.state == STATE_DEGRADED && h.text().contains(text));
        assert!(health.text().starts_with("camera 1 "), "{}", health.text());
        let frame = next(&mut poses, |f| f.field > newest + 10);
        assert_ne!(frame.bodies[0].validity(), Validity::Lost, "{text}: tracking goes on");
        newest = frame.field;
    };
    for (manner, text) in [
        (Manner::Silent, "delivers nothing although its pipe is open"),
        (Manner::Slow, "delivers pictures too late"),
        (Manner::Black, "delivers only black pictures"),
    ] {
        middle.be(manner);
        told(&mut observer, text);
        middle.be(Manner::Steady);
        sound(&mut observer);
    }
    middle.close();
    let small = FieldPicture::new([640, 480]);
    let other = Writer::start(&pipes[1], &[small.clone(), small], false);
    told(&mut observer, "progressive pictures of 640×240 px; the rig expects fields of 720×288 px");
    other.close();
    let again = Writer::start(&pipes[1], &painted[1], false);
    sound(&mut observer);
    next(&mut poses, |f| f.field > newest && f.used_count == 3);
    interrupt(run.pid());
    let finished = run.finish();
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    [first, again, last].into_iter().for_each(Writer::close);
    let troubles = &json(&bench.path("r.json"))["cameras"][1]["troubles"];
    for kind in ["silent", "slow", "black", "refused"] {
        assert!(troubles[kind].as_u64() >= Some(1), "{kind}: {troubles}");
    }
}

#[test]
fn the_program_of_the_cameras_may_be_killed_and_the_recording_verifies() {
    let (bench, name, painted) = (Bench::new(), instance_name(), painted());
    let (pipes, record, report) = (bench.pipes(), bench.text("r.mcap"), bench.text("r.json"));
    let further = ["--record", &record, "--report", &report];
    let run = Running::start(&words(&bench.run(&name, &["a", "b", "c"], &further)));
    let mut observer = Observer::join(&name);
    let writers = [0, 1, 2].map(|i| Writer::persistent(&pipes[i], &painted[i]));
    let (source, mut poses) = (Process::VirtualRig, observer.receiver::<TrackerFrame>());
    let health = observer.health(source, |h| h.state == STATE_RUNNING);
    let before = next(&mut poses, |f| f.used_count == 3 && f.frame > 60);
    kill(health.pid);
    let reborn = observer.health(source, |h| h.pid != health.pid && h.state == STATE_RUNNING);
    assert_ne!(reborn.pid, health.pid);
    // Its first fields may not be those of one instant, and what was lost is found again. Where the parity of a
    // camera's fields were not its pictures', every second would be a pixel off, and the eye would not be found.
    let all_measured =
        |f: &TrackerFrame| f.used_count == 3 && f.bodies.iter().all(|b| b.validity() == Validity::Measured);
    let after = next(&mut poses, |f| all_measured(f) && f.instants.exposed > reborn.instant_ns);
    assert!(after.field > before.field, "fields are counted on");
    next(&mut poses, |f| all_measured(f) && f.field > after.field + 60);
    writers.into_iter().for_each(Writer::close);
    interrupt(run.pid());
    drop((poses, observer));
    let finished = run.finish();
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    assert_eq!(json(&bench.path("r.json"))["restarts"]["virtual-rig"], 1);
    verify(&bench.path("r.mcap")).expect_but([60, 60], &[WITHOUT_FRAME, "gaps", "lack"]);
}

/// Fields between the turns of pictures that go forth and back.
const TURN: usize = 14;
/// Fields after a turn in which a motion is not yet followed.
const SETTLED: usize = 4;

/// The clip of a camera forth and back, without an end: fields 0 to 14, then 13 to 1.
fn forth_and_back(clip: &Path) -> (Vec<u8>, Vec<Vec<u8>>) {
    let bytes = std::fs::read(clip).expect("a clip");
    let head = bytes.iter().position(|b| *b == b'\n').expect("a header") + 1;
    let pictures: Vec<&[u8]> = bytes[head..].chunks((bytes.len() - head) / (TURN + 1)).collect();
    let order = (0..=TURN).chain((1..TURN).rev());
    (bytes[..head].to_vec(), order.map(|i| pictures[i].to_vec()).collect())
}

/// Tips of both instruments in each field of the clip, mm.
fn drawn_tips(truth: &Path) -> Vec<[[f64; 3]; 2]> {
    let text = std::fs::read_to_string(truth).expect("the truth");
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = rows.next().expect("names of the columns");
    let column = |name: String| names.iter().position(|n| *n == name).expect("a column");
    let columns = [0, 1].map(|i| ["x", "y", "z"].map(|axis| column(format!("inst{i}_{axis}"))));
    let rows: Vec<_> = rows.collect();
    let at = |ms: usize| columns.map(|of_tip| of_tip.map(|c| rows[ms][c].parse().expect("a number")));
    // A row a millisecond; field 0 was exposed at 48 ms.
    (0..=TURN).map(|field| at(48 + 20 * field)).collect()
}

#[test]
fn moving_pictures_through_three_pipes_give_the_tips_that_were_drawn() {
    let Some(truth) = skips::data("../tracker-data/pictures-pal/truth.csv") else { return };
    let (bench, tips) = (Bench::new(), drawn_tips(&truth));
    let (pipes, record) = (bench.pipes(), bench.text("r.mcap"));
    let further = ["--record", &record, "--duration", "4"];
    let run = Running::start(&words(&bench.run(&instance_name(), &["a", "b", "c"], &further)));
    let clip = |i: usize| forth_and_back(&truth.with_file_name(format!("cam{i}.y4m")));
    let writers = [0, 1, 2].map(|i| Writer::of(&pipes[i], clip(i), false));
    let finished = run.finish();
    writers.into_iter().for_each(Writer::close);
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    let (mut squares, mut count) = (0.0, 0);
    for (_, item) in
        Recording::open(&bench.path("r.mcap")).expect("a recording").items_of(&["poses"]).flatten()
    {
        let Item::Poses(frame) = item else { continue };
        let phase = frame.field as usize % (2 * TURN);
        if frame.field < 50 || frame.used_count < 3 || phase % TURN < SETTLED {
            continue;
        }
        let drawn = tips[if phase <= TURN { phase } else { 2 * TURN - phase }];
        for (body, tip) in frame.bodies.iter().zip(drawn) {
            assert_eq!(body.validity(), Validity::Measured, "field {}", frame.field);
            let found = body.world_from_body.position_mm;
            squares += found.iter().zip(tip).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            count += 1;
        }
    }
    let rms_um = 1e3 * (squares / f64::from(count)).sqrt();
    println!("{count} tips, {rms_um:.2} µm RMS");
    assert!(count > 20 && rms_um <= 10.0, "{count} tips, {rms_um} µm");
}

#[test]
fn recorded_pixels_are_replayed_as_their_blobs() {
    let bench = Bench::new();
    let [pixels, blobs, again] = ["p.mcap", "b.jsonl", "r.jsonl"].map(|name| bench.text(name));
    vitreo(&["cameras", "virtual", "--duration", "2", "--record-fields", &pixels]).expect_code(0);
    let found = vitreo(&["blobs", &pixels, "-o", &blobs]).expect_code(0);
    assert!(!found.stderr.contains("truncated"), "{}", found.stderr);
    let replayed = vitreo(&["replay", &pixels, "--lockstep", "--blobs", &again]).expect_code(0);
    assert!(replayed.stdout.contains("inst0 measured"), "{replayed:?}");
    let lines = |file: &str| {
        let text = std::fs::read_to_string(bench.path(file)).expect("a stream");
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines.sort();
        lines
    };
    assert!(lines("b.jsonl").len() > 6 && lines("b.jsonl").len() == lines("r.jsonl").len());
    let refused = vitreo(&["replay", &pixels, "--verify"]).expect_code(1);
    assert!(refused.stderr.contains("has no results to compare with"), "{}", refused.stderr);
    let described = vitreo(&["info", &pixels]).expect_code(0);
    assert!(described.stdout.contains(" fields of virtual"), "{}", described.stdout);
    let refused = vitreo(&["export", &pixels, "--blobs", &bench.text("out.jsonl")]).expect_code(1);
    assert!(refused.stderr.contains("a recording of pixels"), "{}", refused.stderr);
}

#[test]
fn a_pipe_without_a_writer_hangs_nothing() {
    let (bench, name) = (Bench::new(), instance_name());
    bench.pipes();
    let run = Running::start(&words(&bench.run(&name, &["a", "b", "c"], &[])));
    let mut observer = Observer::join(&name);
    observer
        .health(Process::VirtualRig, |h| h.text().contains("no program has written a picture into its pipe"));
    interrupt(run.pid());
    // Not one pose has come of it, which is a failure.
    let finished = run.finish().expect_code(1);
    assert!(finished.stderr.contains("is not ready"), "{}", finished.stderr);
    assert!(finished.stderr.contains("no pose was computed in this run"), "{}", finished.stderr);
}

#[test]
fn files_are_paced_and_end_the_run() {
    let (bench, painted) = (Bench::new(), painted());
    for (name, fields) in ["a", "b", "c"].iter().zip(&painted) {
        let (head, pictures) = stream(fields, false);
        std::fs::write(bench.path(name), [head, pictures.concat().repeat(30)].concat()).expect("written");
    }
    let report = bench.text("r.json");
    let args = bench.run(&instance_name(), &["a", "b", "c"], &["--report", &report]);
    let finished = vitreo(&words(&args));
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    let report = json(&bench.path("r.json"));
    assert_eq!(report["ended_by"], "end of the stream");
    assert!(report["duration_s"].as_f64() >= Some(1.1), "{}", report["duration_s"]);
    let camera = &report["cameras"][2];
    let number = |key: &str| camera[key].as_u64().expect("a number");
    assert_eq!(number("fields") + number("late"), 60, "{camera}");
}

#[test]
fn sources_that_cannot_be_cameras_are_refused_in_words() {
    let (bench, painted) = (Bench::new(), painted());
    let (head, pictures) = stream(&painted[0], false);
    std::fs::write(bench.path("a"), [head, pictures.concat()].concat()).expect("written");
    std::fs::write(bench.path("b"), "YUV4MPEG2 W640 H240 F50:1 Ip C422\nFRAME\n").expect("written");
    std::fs::write(bench.path("c"), "YUV4MPEG2 W720 H288 F50:1 Ip C422p12\nFRAME\n").expect("written");
    for (sources, code, named) in [
        (&["a", "a"][..], 2, "expected 3 sources"),
        (&["a"; 9], 2, "found 9"),
        (&["a", "d", "a"], 1, "/d: No such file"),
        (&["a", "b", "a"], 1, "progressive pictures of 640×240 px; the rig expects fields of 720×288 px"),
        (&["a", "a", "c"], 1, "expected a colour space of 8 bits a sample"),
        (&["a", "a", "a?gain=4"], 2, "expected no gain: a pipe or a file has no such setting"),
    ] {
        let refused = vitreo(&words(&bench.run(&instance_name(), sources, &[]))).expect_code(code);
        assert!(refused.stderr.contains(named), "{sources:?}: {}", refused.stderr);
    }
}
