//! Programs of other makers take part in a run: in C, C++ and Python, killed at random, and beside our own processes.

use ipc::{Receiver, wait};
use protocol::geometry::Validity;
use protocol::handles::{HandleState, PedalState};
use protocol::health::Process;
use protocol::poses::TrackerFrame;
use serde_json::Value;
use std::fs::File;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use vitreo::code::Code;
use vitreo::driver::Driver;
use vitreo::roles::{SENDS_BLOBS, SENDS_FIELDS, SENDS_HANDLES, SENDS_PEDAL};
use vitreo_tests::verified::verify;
use vitreo_tests::{
    Finished, Observer, Running, WATCHDOG, Watchdog, binaries, instance_name, interrupt, json, kill, next,
    repository, vitreo,
};

/// Lines of the recorded stream that an example plays: two seconds of three cameras.
const LINES: usize = 300;
/// The name by which programs load the library; `make install` puts it there.
const SONAME: &str = "libvitreo.so.0";
/// How often a driver is killed by default.
const KILLS: usize = 5;
/// How long a driver lives at most before it is killed, ms.
const LIFE_MS: u64 = 400;

fn drivers() -> PathBuf {
    repository().join("drivers")
}

fn rig() -> String {
    text(&repository().join("tests/data/tracker/nominal/rig.json"))
}

fn text(path: &Path) -> String {
    path.to_str().expect("UTF-8").to_owned()
}

fn expect_success(command: &mut Command) {
    let name = format!("{command:?}");
    let output = command.output().unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Compiles an example as docs/drivers.md says, and returns the program.
fn compile(compiler: &str, source: &str, folder: &Path) -> PathBuf {
    let (program, libraries) = (folder.join(source.replace('.', "-")), binaries());
    // Only the library's SONAME is here: a program that asked for any other name would not start.
    symlink(libraries.join("libvitreo.so"), folder.join(SONAME)).expect("a link");
    let run_path = format!("-Wl,-rpath,{}", folder.display());
    let mut command = Command::new(compiler);
    command.args(["-O2", "-Wall", "-Wextra", "-Werror", "-pthread"]);
    command.arg("-I").arg(drivers().join("c")).arg("-I").arg(drivers().join("cpp"));
    command.arg(drivers().join("examples").join(source)).arg("-L").arg(libraries);
    expect_success(command.args(["-lvitreo", &run_path, "-o"]).arg(&program));
    let needed = Command::new("readelf").arg("-d").arg(&program).output().expect("readelf, of binutils");
    let needed = String::from_utf8_lossy(&needed.stdout).into_owned();
    assert!(needed.contains(&format!("[{SONAME}]")) && !needed.contains("[libvitreo.so]"), "{needed}");
    program
}

fn python(file: &str) -> Command {
    let mut command = Command::new("python3");
    command.arg(drivers().join("examples").join(file));
    command.env("PYTHONPATH", drivers().join("python"));
    command.env("VITREO_LIBRARY", binaries().join("libvitreo.so"));
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

/// The beginning of the recorded stream, and the same for scanf.
fn streams(folder: &Path) -> [PathBuf; 2] {
    let [json, lines] = ["blobs.jsonl", "blobs.txt"].map(|name| folder.join(name));
    let whole = std::fs::read_to_string(repository().join("tests/data/tracker/nominal/blobs.jsonl"));
    let part: Vec<String> = whole.expect("stream").lines().take(LINES).map(|l| format!("{l}\n")).collect();
    std::fs::write(&json, part.concat()).expect("stream");
    let to = File::create(&lines).expect("lines");
    let status = python("lines.py").arg(&json).stdout(to).status().expect("python3");
    assert!(status.success());
    [json, lines]
}

/// A run that takes `external` from other programs.
struct Hosted {
    folder: tempfile::TempDir,
    name: String,
    run: Running,
}

impl Hosted {
    fn start(external: &str, more: &[&str]) -> Self {
        let (folder, name) = (tempfile::tempdir().expect("folder"), instance_name());
        let path = |file: &str| text(&folder.path().join(file));
        let (rig, record, report) = (rig(), path("a.mcap"), path("report.json"));
        let run = ["run", "--no-picture", "--external", external, "--rig", &rig, "--instance", &name];
        let files = ["--record", &record, "--report", &report];
        let run = Running::start(&[&run[..], &files, more].concat());
        Hosted { folder, name, run }
    }

    /// Starts a driver, which waits for the run by itself.
    fn drive(&self, program: &mut Command, file: &str) -> (Child, Watchdog) {
        let child = program.arg(&self.name).arg(file).stderr(Stdio::piped()).spawn().expect("a driver");
        let watchdog = Watchdog::on(child.id());
        (child, watchdog)
    }

    /// Waits for the end of the run; returns what it said and its report.
    fn end(self) -> (Finished, Value) {
        // This verifies the recording, too.
        let done = self.run.finish();
        // A machine that is busy elsewhere may cost fields.
        assert!(matches!(done.code, Some(0 | 3)), "{done:?}");
        (done, json(&self.folder.path().join("report.json")))
    }
}

/// Lets a program drive a whole run from the recorded stream.
fn drives_a_whole_run(external: &str, program: &mut Command, stream: &Path, name: &str) {
    let hosted = Hosted::start(external, &[]);
    let record = hosted.folder.path().join("a.mcap");
    let (child, watchdog) = hosted.drive(program, &text(stream));
    let driver = child.wait_with_output().expect("the driver ends");
    let told = String::from_utf8_lossy(&driver.stderr);
    assert!(driver.status.success() && !watchdog.barked(), "{name}: {told}");
    let again = Recorded::of(hosted, &record);
    let processes = again.report["processes"].as_array().expect("processes");
    for channel in external.split(',') {
        let sent = processes.iter().find(|p| p["process"] == format!("{channel}-driver"));
        let sent = sent.unwrap_or_else(|| panic!("{channel}: {processes:?}"));
        assert!(sent["sent"].as_u64().expect("a count") > 0 && sent["text"] == name, "{sent}");
    }
    assert_eq!(again.report["ended_by"], "end of the stream", "{:?}", again.done);
    let waits = format!("waiting for a program that sends {}", external.replace(',', ", "));
    assert!(again.done.stderr.contains(&waits), "{:?}", again.done);
    assert!(again.done.stderr.contains(&format!("{name} has connected and sends blobs")), "{:?}", again.done);
}

/// What a run left, verified.
struct Recorded {
    done: Finished,
    report: Value,
}

impl Recorded {
    fn of(hosted: Hosted, record: &Path) -> Self {
        let Hosted { folder, name: _, run } = hosted;
        let done = run.finish();
        assert!(matches!(done.code, Some(0 | 3)), "{done:?}");
        verify(record).expect([60, 60]);
        Recorded { done, report: json(&folder.path().join("report.json")) }
    }
}

#[test]
fn a_program_in_c_drives_a_whole_run() {
    let folder = tempfile::tempdir().expect("folder");
    let [_, lines] = streams(folder.path());
    let mut program = Command::new(compile("cc", "blobs.c", folder.path()));
    drives_a_whole_run("blobs,handles,pedal", &mut program, &lines, "c-example");
}

#[test]
fn a_program_in_cpp_drives_a_whole_run_and_reads_its_poses() {
    let folder = tempfile::tempdir().expect("folder");
    let [_, lines] = streams(folder.path());
    let mut program = Command::new(compile("c++", "blobs.cpp", folder.path()));
    drives_a_whole_run("blobs", &mut program, &lines, "cpp-example");
}

#[test]
fn a_program_in_python_drives_a_whole_run() {
    let folder = tempfile::tempdir().expect("folder");
    let [json, _] = streams(folder.path());
    drives_a_whole_run("blobs,handles,pedal", &mut python("blobs.py"), &json, "python-example");
}

#[test]
fn another_tracker_drives_a_whole_run() {
    let hosted = Hosted::start("poses,handles,pedal", &[]);
    let (child, watchdog) = hosted.drive(&mut python("poses.py"), "1.5");
    let driver = child.wait_with_output().expect("the driver ends");
    assert!(driver.status.success() && !watchdog.barked(), "{}", String::from_utf8_lossy(&driver.stderr));
    let (done, report) = hosted.end();
    let names: Vec<&str> = report["processes"]
        .as_array()
        .expect("processes")
        .iter()
        .filter_map(|p| p["process"].as_str())
        .collect();
    for absent in ["virtual-rig", "fpga-model", "tracker"] {
        assert!(!names.contains(&absent), "{names:?}");
    }
    assert!(report["received"]["steps"].as_u64().expect("a count") > 30, "{done:?}");
}

/// How often [`a_driver_that_is_killed_comes_back`] kills: `make test-drivers` asks for more.
fn kills() -> usize {
    std::env::var("VITREO_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(KILLS)
}

/// Files of the run in shared memory, and nodes in its directory.
fn left_in(name: &str) -> usize {
    let directory = ipc::instance_directory(name).expect("a name");
    let prefix = ipc::shared_memory_prefix(&directory).expect("a run");
    let begins = prefix.file_name().expect("a name").to_string_lossy().into_owned();
    let shared = std::fs::read_dir("/dev/shm").expect("/dev/shm").flatten();
    let segments = shared.filter(|e| e.file_name().to_string_lossy().starts_with(&begins)).count();
    fn count(folder: &Path) -> usize {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|e| if e.path().is_dir() { 1 + count(&e.path()) } else { 1 }).sum()
    }
    segments + count(&directory)
}

/// Waits until there are as many files as beside the `first` driver, or two more: the dead one's are removed meanwhile.
fn lives_among_as_many(first: usize, name: &str) {
    let deadline = ipc::clock::now() + WATCHDOG.as_nanos() as u64;
    while left_in(name) > first + 2 {
        assert!(ipc::clock::now() < deadline, "files are left: {} after {first}", left_in(name));
        wait(&[], 5_000_000);
    }
}

#[test]
fn a_driver_that_is_killed_comes_back() {
    let folder = tempfile::tempdir().expect("folder");
    let [_, lines] = streams(folder.path());
    let program = compile("cc", "blobs.c", folder.path());
    let hosted = Hosted::start("blobs,handles,pedal", &[]);
    let observer = Observer::join(&hosted.name);
    let mut poses: Receiver<TrackerFrame> = observer.receiver();
    let (mut random, mut first) = (0x9e37_79b9_7f4a_7c15u64, None);
    for _ in 0..kills() {
        let (mut child, watchdog) = hosted.drive(&mut Command::new(&program), &text(&lines));
        // What it sends is tracked, whatever became of its predecessor.
        let from = ipc::clock::now();
        let is_measured = |p: &TrackerFrame| p.bodies.iter().any(|b| b.validity() == Validity::Measured);
        next(&mut poses, |p| p.instants.tracked > from && is_measured(p));
        lives_among_as_many(*first.get_or_insert_with(|| left_in(&hosted.name)), &hosted.name);
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        std::thread::sleep(Duration::from_millis(random % LIFE_MS));
        kill(child.id());
        drop((child.wait().expect("the driver ends"), watchdog));
    }
    let directory = ipc::instance_directory(&hosted.name).expect("a name");
    let prefix = ipc::shared_memory_prefix(&directory).expect("a run");
    drop((poses, observer));
    interrupt(hosted.run.pid());
    let (done, report) = hosted.end();
    let restarts = report["restarts"].as_object().expect("restarts");
    assert!(restarts.values().all(|n| *n == 0), "{restarts:?} {done:?}");
    assert!(report["states_lost"] == 0 && done.stderr.contains("c-example has connected"), "{done:?}");
    let prefix = text(&prefix);
    let shared = std::fs::read_dir("/dev/shm").expect("/dev/shm").flatten();
    let leaked: Vec<PathBuf> = shared.map(|e| e.path()).filter(|p| text(p).starts_with(&prefix)).collect();
    assert!(leaked.is_empty() && !directory.exists(), "{leaked:?}");
}

#[test]
fn a_second_driver_of_a_channel_is_refused_by_the_name_of_the_first_and_may_take_its_place_when_that_is_killed()
 {
    let folder = tempfile::tempdir().expect("folder");
    let [_, lines] = streams(folder.path());
    let program = compile("cc", "blobs.c", folder.path());
    let hosted = Hosted::start("blobs,handles,pedal", &[]);
    let mut observer = Observer::join(&hosted.name);
    let (mut child, watchdog) = hosted.drive(&mut Command::new(&program), &text(&lines));
    observer.health(Process::BlobsDriver, |h| h.sent > 0);
    let open = || Driver::open(&hosted.name, "second", SENDS_BLOBS, 0);
    let refused = open().err().expect("the channel has a driver");
    let first = format!("takes its blobs from the driver 'c-example' (process {})", child.id());
    assert!(refused.code == Code::Taken && refused.text.contains(&first), "{refused}");
    kill(child.id());
    drop((child.wait().expect("the driver ends"), watchdog));
    let second = open().expect("the place of the killed one is free at once");
    drop((second, observer));
    interrupt(hosted.run.pid());
    hosted.end();
}

#[test]
fn a_run_that_nobody_drives_says_what_it_waits_for_and_ends_at_a_signal() {
    let hosted = Hosted::start("blobs", &[]);
    let name = hosted.name.clone();
    // Invited once everything else is at work.
    let deadline = ipc::clock::now() + WATCHDOG.as_nanos() as u64;
    while ipc::outside::invited(&name).expect("a name").is_none() {
        assert!(ipc::clock::now() < deadline);
        wait(&[], 5_000_000);
    }
    let refused = Driver::open(&name, "pedal", SENDS_PEDAL, 0).err().expect("not invited");
    assert!(refused.to_string().contains("--external pedal"), "{refused}");
    interrupt(hosted.run.pid());
    let done = hosted.run.finish();
    assert!(done.stderr.contains("waiting for a program that sends blobs"), "{done:?}");
}

#[test]
fn handles_and_pedal_from_outside_replace_the_scripts() {
    const JAW_RAD: f64 = 0.123;
    let hosted = Hosted::start("handles,pedal", &["--direct"]);
    let mut observer = Observer::join(&hosted.name);
    let (mut handles, mut pedals) = (observer.receiver::<HandleState>(), observer.receiver::<PedalState>());
    observer.health(Process::VirtualRig, |h| h.sent > 0);
    let roles = SENDS_HANDLES | SENDS_PEDAL;
    let mut driver =
        Driver::open(&hosted.name, "bench", roles, WATCHDOG.as_nanos() as u64).expect("a driver");
    for _ in 0..50 {
        for instrument in 0..2 {
            let handle = HandleState {
                instrument,
                tool: 1 + instrument,
                jaw_rad: JAW_RAD,
                ..bytemuck::Zeroable::zeroed()
            };
            driver.send_handle(&handle).expect("sent");
        }
        let pedal = PedalState { axes: [0.5, 0.0], ..bytemuck::Zeroable::zeroed() };
        driver.send_pedal(&pedal).expect("sent");
        wait(&[], 10_000_000);
    }
    let mut came = 0;
    while let Some(handle) = handles.next_valid().expect("handles") {
        assert!(handle.jaw_rad == JAW_RAD, "nobody else sends: {handle:?}");
        came += 1;
    }
    while let Some(pedal) = pedals.next_valid().expect("pedal") {
        assert_eq!(pedal.axes, [0.5, 0.0]);
        came += 1;
    }
    assert_eq!(came, 150);
    interrupt(hosted.run.pid());
    drop(driver);
    hosted.end();
}

#[test]
fn fields_of_pixels_from_outside_are_scanned_and_tracked() {
    let (source, name) = (Hosted::start("pedal", &[]), instance_name());
    let rig = rig();
    let target =
        Running::start(&["run", "--no-picture", "--external", "fields", "--rig", &rig, "--instance", &name]);
    let sees = Observer::join(&source.name);
    let mut fields = sees.pixels();
    let mut driver =
        Driver::open(&name, "pixels", SENDS_FIELDS, WATCHDOG.as_nanos() as u64).expect("a driver");
    let mut poses: Receiver<TrackerFrame> = Observer::join(&name).receiver();
    let deadline = ipc::clock::now() + WATCHDOG.as_nanos() as u64;
    let mut measured = 0;
    while measured < 20 {
        assert!(ipc::clock::now() < deadline, "{measured} frames were measured in time");
        wait(&[&fields], 5_000_000);
        while let Some(field) = fields.receive().expect("fields") {
            let header = field.header();
            // Virtual cameras publish ahead of time; a driver sends what has been exposed.
            wait(&[], header.exposed_ns.saturating_sub(ipc::clock::now()));
            driver.lend_field(header).expect("memory").copy_from_slice(&field.payload()[..header.bytes()]);
            driver.send_field().expect("sent");
        }
        while let Some(frame) = poses.next_valid().expect("poses") {
            measured += usize::from(frame.bodies.iter().any(|b| b.validity() == Validity::Measured));
        }
    }
    interrupt(target.pid());
    interrupt(source.run.pid());
    assert!(matches!(target.finish().code, Some(0 | 3)));
    source.end();
}

#[test]
fn what_excludes_itself_is_wrong_use() {
    let rig = rig();
    for (words, named) in [
        (&["--external", "blobs"][..], "--rig RIG.json"),
        (&["--external", "blobs,poses"], "only one of"),
        (&["--external", "wheels"], "expected blobs, fields, handles, pedal or poses"),
        (&["--external", "blobs", "--rig", &rig, "--direct"], "omit --direct"),
    ] {
        let done = vitreo(&[&["run", "--no-picture"][..], words].concat()).expect_code(2);
        assert!(done.stderr.contains(named), "{named}: {done:?}");
    }
}
