//! One recording through two builds: this one beside itself, beside one that makes something else, and beside
//! programs that are no vitreo, lack something, fail, crash or hang.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use vitreo_tests::{Finished, WATCHDOG, Watchdog, binaries, interrupt, repository};

/// A folder with a place for what is made in between.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("folder");
        std::fs::create_dir(folder.path().join("between")).expect("folder");
        Desk(folder)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A program that answers as a build of version 9.9.9 does, and replays as `replay` says; in which `VITREO`
    /// is this build.
    fn stub(&self, help: &str, replay: &str) -> PathBuf {
        let path = self.at("other");
        let replay = replay.replace("VITREO", &binaries().join("vitreo").display().to_string());
        let text = format!(
            "#!/bin/sh\ncase \"$*\" in\n--version) echo vitreo 9.9.9;;\n*--help) echo '{help}';;\n*) {replay};;\nesac\n"
        );
        std::fs::write(&path, text).expect("a script");
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("rights");
        path
    }

    fn start(&self, with: &Path, more: &[&str]) -> Child {
        let mut command = Command::new(binaries().join("vitreo"));
        command.arg("replay").arg(repository().join("tests/data/golden/peel-2s.mcap"));
        command.arg("--with").arg(with).args(more).env("TMPDIR", self.at("between"));
        command.env("XDG_CONFIG_HOME", "/nonexistent").current_dir(repository());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("vitreo")
    }

    /// Waits for its end; nothing may be left of what was made in between.
    fn finish(&self, child: Child) -> Finished {
        let watchdog = Watchdog::on(child.id());
        let done = child.wait_with_output().expect("vitreo is waited for");
        assert!(!watchdog.barked(), "hung and was killed");
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        let left: Vec<_> = std::fs::read_dir(self.at("between")).expect("folder").flatten().collect();
        assert!(left.is_empty(), "{left:?}");
        Finished { code: done.status.code(), stdout: text(done.stdout), stderr: text(done.stderr) }
    }

    fn with(&self, program: &Path) -> Finished {
        self.finish(self.start(program, &[]))
    }
}

const HELP: &str = "--output --no-config";

#[test]
fn this_build_makes_the_same_as_itself_by_either_of_its_programs() {
    let desk = Desk::new();
    for name in ["vitreo", "vitreo-replay"] {
        let report = desk.at("report.json");
        let more = ["--force", "--report", &report.display().to_string()];
        let done = desk.finish(desk.start(&binaries().join(name), &more)).expect_code(0);
        for words in ["through two builds", "versions: both vitreo", "same: ", "100 states"] {
            assert!(done.stdout.contains(words), "{words}: {done:?}");
        }
        let found = vitreo_tests::json(&report);
        assert!(found["same"] == true && found["poses"]["identical"] == 100, "{found}");
    }
}

#[test]
fn a_build_that_makes_something_else_is_told_with_the_first_difference_and_its_cause() {
    let desk = Desk::new();
    let other = desk.stub(HELP, "exec VITREO \"$@\" --set tracker.tremor_ripple_db=2.5");
    let done = desk.with(&other).expect_code(5);
    for words in
        ["differ, first in settings", "also in poses", "tracker.tremor_ripple_db changed: \"2.5\" → absent"]
    {
        assert!(done.stdout.contains(words), "{words}: {done:?}");
    }
}

#[test]
fn what_is_no_vitreo_lacks_something_fails_or_crashes_is_told() {
    let desk = Desk::new();
    let told = |program: &Path, code: i32, words: &[&str]| {
        let done = desk.with(program).expect_code(code);
        assert!(words.iter().all(|word| done.stderr.contains(word)), "{words:?}: {done:?}");
    };
    told(&desk.at("absent"), 2, &["absent", "found no file"]);
    told(Path::new("/bin/echo"), 2, &["/bin/echo", "is not vitreo"]);
    told(Path::new("/bin/false"), 2, &["is it vitreo?"]);
    std::fs::write(desk.at("text"), "no program").expect("written");
    told(&desk.at("text"), 1, &["text", "cannot be started"]);
    told(&desk.stub("--lockstep", "exit 9"), 1, &["vitreo 9.9.9", "has no --output"]);
    told(&desk.stub(HELP, "echo unknown thing >&2; exit 2"), 1, &["9.9.9", "exit code 2", "unknown thing"]);
    told(&desk.stub(HELP, "kill -SEGV $$"), 1, &["9.9.9", "crashed, by signal 11"]);
    told(&desk.stub(HELP, "exit 0"), 1, &["9.9.9", "without writing a recording"]);
    told(&desk.stub(HELP, "echo x > \"$5\""), 1, &["9.9.9", "the result of"]);
}

#[test]
fn one_that_hangs_ends_with_this_command_which_leaves_nothing() {
    let desk = Desk::new();
    let begun = desk.at("begun");
    let other =
        desk.stub(HELP, &format!("echo $$ > {0}.part; mv {0}.part {0}; exec sleep 1000", begun.display()));
    let running = desk.start(&other, &[]);
    let deadline = ipc::clock::now() + WATCHDOG.as_nanos() as u64;
    while !begun.exists() {
        assert!(ipc::clock::now() < deadline, "the other build was not started");
        ipc::wait(&[], 5_000_000);
    }
    interrupt(running.id());
    desk.finish(running).expect_code(130);
    let pid: i32 = std::fs::read_to_string(&begun).expect("a number").trim().parse().expect("a number");
    let pid = rustix::process::Pid::from_raw(pid).expect("a process");
    assert!(rustix::process::test_kill_process(pid).is_err(), "it goes on");
}
