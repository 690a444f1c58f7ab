//! Runs where something is short: room on the disk, a disk that answers, shared memory, rights, a
//! home, processors. Each row says what must come of it and what came.

use std::path::Path;
use std::process::{Command, Output};
use vitreo_tests::verified::verify;
use vitreo_tests::{binaries, instance_name, repository};

/// Delays every write to a recording from its 60th on for ever: a disk that hangs.
const HUNG_DISK: &str = r#"
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>
static int count;
ssize_t write(int fd, const void *from, size_t n) {
    static ssize_t (*own)(int, const void *, size_t);
    char link[64], path[4096];
    if (!own) own = (ssize_t (*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write");
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    path[length > 0 ? length : 0] = 0;
    if (strstr(path, "hung.mcap") && ++count > 60) for (;;) sleep(1000);
    return own(fd, from, n);
}
"#;

/// A row of the table.
struct Case {
    what: &'static str,
    /// Shell script; `VITREO` is the program, `NAME` an instance, `@DIR` a folder of its own.
    script: &'static str,
    /// It runs in a namespace of its own, as a user who may mount.
    namespace: bool,
    /// Exit code that the script must end with.
    code: i32,
    /// What its output must say.
    says: &'static str,
    /// The recording that must verify, in `@DIR`.
    recording: Option<&'static str>,
}

const CASES: &[Case] = &[
    Case {
        what: "disk full for good",
        script: "mount -t tmpfs -o size=1m tmpfs @DIR/disk || exit 77; VITREO run --no-picture --direct --duration 12 \
                 --instance NAME --record @DIR/disk/a.mcap --report @DIR/r.json; code=$?; cp @DIR/disk/a.mcap @DIR/a.mcap; \
                 grep -o 'the disk is full' @DIR/r.json | head -1; exit $code",
        namespace: true,
        code: 1,
        says: "the disk is full",
        recording: Some("a.mcap"),
    },
    Case {
        what: "disk full for 3 s",
        script: "mount -t tmpfs -o size=8m tmpfs @DIR/disk || exit 77; VITREO run --no-picture --direct --duration 14 \
                 --instance NAME --record @DIR/disk/a.mcap & run=$!; sleep 5; \
                 head -c 20m /dev/zero > @DIR/disk/filler 2>/dev/null; sleep 3; rm @DIR/disk/filler; wait $run; code=$?; \
                 cp @DIR/disk/a.mcap @DIR/a.mcap; exit $code",
        namespace: true,
        code: 0,
        says: "",
        recording: Some("a.mcap"),
    },
    Case {
        what: "disk that hangs",
        script: "cc -shared -fPIC -o @DIR/hung.so @DIR/hung.c -ldl || exit 77; LD_PRELOAD=@DIR/hung.so timeout 40 VITREO run \
                 --no-picture --direct --duration 15 --instance NAME --record @DIR/hung.mcap --report @DIR/r.json; code=$?; \
                 grep -o 'blocked in writing' @DIR/r.json | head -1; exit $code",
        namespace: false,
        code: 1,
        says: "blocked in writing",
        recording: None,
    },
    Case {
        what: "/dev/shm of 64 MB",
        script: "mount -t tmpfs -o size=64m tmpfs /dev/shm || exit 77; VITREO run --no-picture --duration 5 --instance NAME 2>&1",
        namespace: true,
        code: 1,
        says: "MiB",
        recording: None,
    },
    Case {
        what: "/dev/shm full",
        script: "mount -t tmpfs -o size=128m tmpfs /dev/shm || exit 77; head -c 200m /dev/zero > /dev/shm/filler 2>/dev/null; \
                 VITREO run --no-picture --duration 5 --instance NAME 2>&1",
        namespace: true,
        code: 1,
        says: "MiB",
        recording: None,
    },
    Case {
        what: "no real-time rights, no home, no XDG_RUNTIME_DIR",
        script: "unset XDG_RUNTIME_DIR; export HOME=/proc/nowhere; VITREO run --headless --duration 10 --instance NAME \
                 --record @DIR/a.mcap",
        namespace: true,
        code: 0,
        says: "",
        recording: Some("a.mcap"),
    },
    Case {
        what: "both cores busy for a minute",
        script: "for i in $(seq $(nproc)); do (timeout 65 sh -c 'while :; do :; done' &) ; done; VITREO run --headless \
                 --duration 60 --instance NAME --record @DIR/a.mcap",
        namespace: false,
        code: 0,
        says: "",
        recording: Some("a.mcap"),
    },
];

/// Runs every case and prints its row; true if each came out as it must.
///
/// # Errors
/// Where a folder or script cannot be made.
pub fn all(folder: &Path) -> anyhow::Result<bool> {
    let mut good = true;
    for (number, case) in CASES.iter().enumerate() {
        let own = folder.join(format!("shortage-{number}"));
        std::fs::create_dir_all(own.join("disk"))?;
        std::fs::write(own.join("hung.c"), HUNG_DISK)?;
        let done = shell(case, &own)?;
        good &= row(case, &own, &done);
    }
    Ok(good)
}

fn shell(case: &Case, folder: &Path) -> anyhow::Result<Output> {
    let program = binaries().join("vitreo").display().to_string();
    let script = case.script.replace("VITREO", &program).replace("NAME", &instance_name());
    let script = script.replace("@DIR", &folder.display().to_string());
    let mut command = match case.namespace {
        true => Command::new("unshare"),
        false => Command::new("sh"),
    };
    let words: &[&str] = if case.namespace { &["-rm", "sh", "-c"] } else { &["-c"] };
    Ok(command.args(words).arg(&script).current_dir(repository()).output()?)
}

fn row(case: &Case, folder: &Path, done: &Output) -> bool {
    let text = [&done.stdout[..], &done.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    if done.status.code() == Some(77) || text.contains("unshare:") {
        println!("{:<50} skipped: not granted here", case.what);
        return true;
    }
    let unverified = case.recording.and_then(|file| verify(&folder.join(file)).holds([1, 1]).err());
    // A run that lost what it could not write says so with 3.
    let code = done.status.code() == Some(case.code) || (case.code == 0 && done.status.code() == Some(3));
    let good = code && text.contains(case.says) && unverified.is_none();
    let told = match (&unverified, case.recording) {
        (Some(problem), _) => format!(", its recording does not verify: {problem}"),
        (None, Some(_)) => ", its recording verifies".into(),
        (None, None) => String::new(),
    };
    println!(
        "{:<50} exit {:?}{told}: {}",
        case.what,
        done.status.code(),
        if good { "as it must" } else { "WRONG" }
    );
    if !good {
        println!("{text}");
    }
    good
}
