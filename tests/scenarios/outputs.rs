//! No command writes over what it reads or, unasked, over what is there; nothing appears half.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use vitreo_tests::{Finished, binaries, instance_name, repository, vitreo};

/// A folder with a copy of everything that the commands read.
struct Desk {
    folder: tempfile::TempDir,
}

/// A command with one output: its words, where `OUT` stands for the output, `IN` for the input that
/// the output must not be.
struct Case {
    words: &'static str,
    input: &'static str,
}

/// Every command that writes a file, and every option that names one.
const CASES: &[Case] = &[
    Case { words: "export IN --poses OUT", input: "a.mcap" },
    Case { words: "export IN --blobs OUT", input: "a.mcap" },
    Case { words: "export IN --rig OUT", input: "a.mcap" },
    Case { words: "export IN --csv steps -o OUT", input: "a.mcap" },
    Case { words: "import --rig rig.json IN -o OUT", input: "b.jsonl" },
    Case { words: "import --rig IN b.jsonl -o OUT", input: "rig.json" },
    Case { words: "recover IN -o OUT", input: "a.mcap" },
    Case { words: "replay IN --lockstep --poses OUT", input: "a.mcap" },
    Case { words: "replay IN --lockstep --blobs OUT", input: "a.mcap" },
    Case { words: "replay IN --lockstep --report OUT", input: "a.mcap" },
    Case {
        words: "run --no-picture --direct --duration 1 --instance NAME --rig IN --record OUT",
        input: "rig.json",
    },
    Case {
        words: "run --no-picture --direct --duration 1 --instance NAME --rig IN --report OUT",
        input: "rig.json",
    },
    Case {
        words: "run --no-picture --direct --duration 1 --instance NAME --rig IN --faults mild --fault-log OUT",
        input: "rig.json",
    },
    Case { words: "play --inputs IN --no-picture --instance NAME --record OUT", input: "inputs.txt" },
    Case { words: "score IN --csv OUT", input: "task.mcap" },
    Case { words: "results --store IN --csv OUT", input: "store.sqlite" },
    Case { words: "results --store IN --parquet OUT", input: "store.sqlite" },
    Case { words: "results --store IN --plot OUT", input: "store.sqlite" },
    Case { words: "blobs IN -o OUT", input: "picture.png" },
    Case { words: "blobs IN --overlay OUT", input: "picture.png" },
    Case { words: "colours learn red=IN -o OUT", input: "picture.png" },
    Case { words: "colours show IN --picture OUT", input: "colours.toml" },
    Case { words: "calibrate drift --rig rig.json IN --residuals OUT", input: "b.jsonl" },
    Case { words: "calibrate drift --rig rig.json IN -o OUT", input: "b.jsonl" },
    Case { words: "calibrate waved IN --instants 20 -o OUT", input: "a.mcap" },
    // A file is a recording, whatever its name; a film's name has its ending.
    Case { words: "film IN --tier 8 --until 0.1 -o OUT", input: "film.mp4" },
];

impl Case {
    /// `name` with the ending that the output must have.
    fn named(&self, name: &str) -> String {
        if self.words.starts_with("film") { format!("{name}.mp4") } else { name.into() }
    }
}

/// The recording of an attempt that ended, made once.
pub fn attempt() -> &'static [u8] {
    static ATTEMPT: OnceLock<Vec<u8>> = OnceLock::new();
    ATTEMPT.get_or_init(|| {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("a.mcap");
        let run =
            ["run", "--module", "steady-path", "--no-picture", "--direct", "--instance", &instance_name()];
        vitreo(&[&run[..], &["--record", &file.display().to_string()]].concat()).expect_code(0);
        std::fs::read(file).expect("recording")
    })
}

impl Desk {
    fn new() -> Self {
        let desk = Desk { folder: tempfile::tempdir().expect("folder") };
        let copies = [
            ("tests/data/golden/peel-2s.mcap", "a.mcap"),
            ("tests/data/golden/peel-2s.mcap", "film.mp4"),
            ("assets/rig.json", "rig.json"),
            ("assets/colours.toml", "colours.toml"),
            ("tests/data/inputs/navigation-1.txt", "inputs.txt"),
        ];
        for (from, to) in copies {
            std::fs::copy(repository().join(from), desk.at(to)).expect(from);
        }
        std::fs::write(desk.at("task.mcap"), attempt()).expect("written");
        let red = |x: u32, y: u32| {
            let ball = (x as i32 - 30).pow(2) + (y as i32 - 24).pow(2) < 100;
            image::Rgb(if ball { [220, 30, 30] } else { [20, 20, 20] })
        };
        image::RgbImage::from_fn(64, 48, red).save(desk.at("picture.png")).expect("picture");
        let [recording, blobs, store, task] =
            ["a.mcap", "b.jsonl", "store.sqlite", "task.mcap"].map(|n| desk.name(n));
        vitreo(&["export", &recording, "--blobs", &blobs]).expect_code(0);
        vitreo(&["results", "add", "--store", &store, "t1", &task]).expect_code(0);
        desk
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn name(&self, name: &str) -> String {
        self.at(name).display().to_string()
    }

    /// The words of a case as arguments.
    fn arguments(&self, case: &Case, output: &str) -> Vec<String> {
        let of = |word: &str| match word {
            "OUT" => output.into(),
            "NAME" => instance_name(),
            "rig.json" | "b.jsonl" => self.name(word),
            _ => word.replace("IN", &self.name(case.input)),
        };
        case.words.split(' ').map(of).collect()
    }

    fn run(&self, case: &Case, output: &str, force: bool) -> Finished {
        let mut arguments = self.arguments(case, output);
        if force {
            arguments.push("--force".into());
        }
        vitreo(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// Names and contents of everything in the folder.
    fn contents(&self) -> Vec<(PathBuf, Vec<u8>)> {
        let files = std::fs::read_dir(self.folder.path()).expect("folder").flatten().map(|e| e.path());
        let mut all: Vec<_> =
            files.filter(|f| f.is_file()).map(|f| (f.clone(), std::fs::read(&f).expect("file"))).collect();
        all.sort();
        all
    }
}

#[track_caller]
fn refused(case: &Case, done: Finished, told: &str) {
    assert_eq!(done.code, Some(1), "{}: {done:?}", case.words);
    assert!(
        done.stderr.contains(told) && !done.stderr.contains("panicked"),
        "{}: {}",
        case.words,
        done.stderr
    );
}

#[test]
fn an_input_is_never_an_output() {
    let desk = Desk::new();
    std::fs::create_dir(desk.at("links")).expect("folder");
    let before = desk.contents();
    for case in CASES {
        let link = format!("links/{}", case.input);
        let _ = std::fs::hard_link(desk.at(case.input), desk.at(&link));
        for output in [desk.name(case.input), desk.name(&link)] {
            for force in [false, true] {
                refused(case, desk.run(case, &output, force), "is an input of the command");
            }
        }
        assert!(desk.contents() == before, "{} changed something", case.words);
    }
}

#[test]
fn what_is_there_is_kept_unless_told_otherwise() {
    let desk = Desk::new();
    for name in ["precious", "precious.mp4"] {
        std::fs::write(desk.at(name), "precious").expect("written");
    }
    std::fs::create_dir(desk.at("folder")).expect("folder");
    // Of each kind of picture that a folder takes one that is there already.
    for name in ["frame-000001.png", "still-000000.00.png", "residuals_cam0.png"] {
        std::fs::write(desk.at("folder").join(name), "precious").expect("written");
    }
    let before = desk.contents();
    for case in CASES {
        if case.words.contains("--residuals") {
            refused(case, desk.run(case, &desk.name("folder"), false), "--force");
        } else {
            refused(case, desk.run(case, &desk.name(&case.named("precious")), false), "--force");
        }
        assert!(desk.contents() == before, "{} changed something", case.words);
    }
    let rig = desk.name("precious");
    vitreo(&["export", &desk.name("a.mcap"), "--rig", &rig, "--force"]).expect_code(0);
    assert!(std::fs::read_to_string(rig).expect("rig").contains("cameras"));
    for folder in ["film peeling --stills", "run --instance x --stills", "vectors"] {
        let words: Vec<&str> = folder.split(' ').collect();
        let full =
            if folder == "vectors" { repository().join("fpga-model/vectors") } else { desk.at("folder") };
        let done = vitreo(&[&words[..], &[&full.display().to_string()]].concat()).expect_code(1);
        assert!(done.stderr.contains("--force"), "{}", done.stderr);
    }
}

#[test]
fn a_failed_command_leaves_nothing_and_takes_nothing() {
    let desk = Desk::new();
    std::fs::write(desk.at("bad.jsonl"), "{\"cam\":0}\n").expect("written");
    std::fs::write(desk.at("precious"), "precious").expect("written");
    let before = desk.contents();
    let [rig, bad, precious, fresh] = ["rig.json", "bad.jsonl", "precious", "fresh"].map(|n| desk.name(n));
    for missing in [&bad, "missing.jsonl"] {
        for output in [&precious, &fresh] {
            vitreo(&["import", "--rig", &rig, missing, "-o", output, "--force"]).expect_code(1);
            assert!(desk.contents() == before);
        }
    }
    // A run that never starts, over a recording that is there.
    let run = ["run", "--no-picture", "--scene", "nowhere", "--force", "--record"];
    vitreo(&[&run[..], &[&precious, "--instance", &instance_name()]].concat()).expect_code(2);
    // Two outputs of one name.
    let run = ["run", "--no-picture", "--instance", &instance_name(), "--record", &fresh, "--report", &fresh];
    vitreo(&run).expect_code(1);
    assert!(desk.contents() == before);
}

#[test]
fn refusing_folders_and_full_disks_are_told() {
    let desk = Desk::new();
    let full = ["full", "full.mp4"].map(|name| desk.at(name));
    full.iter().for_each(|name| std::os::unix::fs::symlink("/dev/full", name).expect("a link"));
    let before = desk.contents();
    for case in CASES.iter().filter(|c| !c.words.contains("--residuals")) {
        let output = case.named("/sys/vitreo-output");
        refused(case, desk.run(case, &output, false), &format!("{output}: cannot be written"));
        // A device takes what it is given until it is full; tables that need to seek do not fit one.
        let output = desk.name(&case.named("full"));
        let full = desk.run(case, &output, false);
        assert_eq!(full.code, Some(1), "{}: {full:?}", case.words);
        let told = full.stderr.contains(&output) || full.stderr.contains("No space left");
        assert!(told && !full.stderr.contains("panicked"), "{}: {}", case.words, full.stderr);
        assert!(desk.contents() == before, "{} left something", case.words);
    }
}

/// Runs a shell line in a mount namespace of its own, where `FULL` is a disk of 16 KiB; nothing
/// where the system grants none.
fn with_small_disk(desk: &Desk, line: &str) -> Option<std::process::Output> {
    let (disk, vitreo) = (desk.at("disk"), binaries().join("vitreo"));
    std::fs::create_dir_all(&disk).expect("folder");
    let mount = format!("mount -t tmpfs -o size=16k tmpfs {} || exit 77", disk.display());
    let line = line
        .replace("FULL", &disk.display().to_string())
        .replace("vitreo ", &format!("{} ", vitreo.display()));
    let done =
        Command::new("unshare").args(["-rm", "sh", "-c", &format!("{mount}; {line}")]).output().ok()?;
    let granted =
        done.status.code() != Some(77) && !String::from_utf8_lossy(&done.stderr).contains("unshare:");
    granted.then_some(done)
}

#[test]
fn on_a_full_disk_a_file_is_whole_or_absent() {
    let desk = Desk::new();
    let recording = desk.name("a.mcap");
    let line = format!(
        "echo old > FULL/o; vitreo export {recording} --blobs FULL/o --force; echo $?; cat FULL/o; ls -A FULL"
    );
    let Some(done) = with_small_disk(&desk, &line) else {
        return skips::skip(&"no mount namespace is granted");
    };
    assert_eq!(String::from_utf8_lossy(&done.stdout), "1\nold\no\n", "{done:?}");
    assert!(String::from_utf8_lossy(&done.stderr).contains("the disk is full"), "{done:?}");
}

/// A what-if and a sweep's table that do not fit, whatever their work has cost by then.
#[test]
fn a_what_if_and_a_sweep_that_run_out_of_disk_name_the_file_and_leave_nothing() {
    let desk = Desk::new();
    let recording = desk.name("a.mcap");
    let sweep = "--set tracker.tremor_ripple_db=1:3:2 --parquet FULL/o > /dev/null";
    for line in [
        format!("vitreo replay {recording} -o FULL/o; echo $?; ls -A FULL"),
        format!(
            "head -c 16k /dev/zero > FULL/a; vitreo sweep {recording} {sweep}; echo $?; rm FULL/a; ls -A FULL"
        ),
    ] {
        let Some(done) = with_small_disk(&desk, &line) else {
            return skips::skip(&"no mount namespace is granted");
        };
        assert_eq!(String::from_utf8_lossy(&done.stdout), "1\n", "{line}: {done:?}");
        let told = String::from_utf8_lossy(&done.stderr).into_owned();
        let file = format!("{}/o", desk.at("disk").display());
        assert!(told.contains(&file) && told.contains("the disk is full"), "{line}: {told}");
    }
}

#[test]
fn a_reader_who_leaves_ends_no_command_and_a_full_disk_is_told() {
    let desk = Desk::new();
    let program = binaries().join("vitreo").display().to_string();
    let names = [
        ("vitreo", program),
        ("FILE", desk.name("a.mcap")),
        ("COLOURS", desk.name("colours.toml")),
        ("PICTURE", desk.name("picture.png")),
    ];
    let shell = |line: &str| {
        let line = names.iter().fold(line.to_owned(), |line, (word, name)| line.replace(word, name));
        Command::new("bash").args(["-c", &format!("set -o pipefail; {line}")]).output().expect("bash")
    };
    for line in [
        "vitreo export FILE --csv steps | true",
        "vitreo info FILE | true",
        "vitreo trace FILE 20 | true",
        "vitreo hardware | true",
        "vitreo colours show | true",
    ] {
        let done = shell(line);
        assert!(done.status.success() && done.stderr.is_empty(), "{line}: {done:?}");
    }
    for line in [
        "vitreo info FILE > /dev/full",
        "vitreo modules > /dev/full",
        "vitreo score --doc > /dev/full",
        "vitreo hardware > /dev/full",
        "vitreo colours show > /dev/full",
        "vitreo colours check COLOURS PICTURE > /dev/full",
        "vitreo calibrate drift --json FILE > /dev/full",
    ] {
        let (done, told) = (shell(line), "the disk is full");
        assert_eq!(done.status.code(), Some(1), "{line}: {done:?}");
        assert!(String::from_utf8_lossy(&done.stderr).contains(told), "{line}: {done:?}");
    }
}

#[test]
fn an_attempt_is_kept_whatever_becomes_of_the_terminal() {
    let desk = Desk::new();
    let (program, store) = (binaries().join("vitreo"), desk.at("new/store.sqlite"));
    let endings = [("t1", "2>&1 | true"), ("t2", "> /dev/full 2>&1"), ("t3", ">&- 2>&-")];
    let run = |(trainee, ending): &(&str, &str)| {
        let line = format!(
            "{} run --module steady-path --no-picture --direct --instance {} --trainee {trainee} --store {} {ending}",
            program.display(),
            instance_name(),
            store.display()
        );
        Command::new("bash").args(["-c", &line]).spawn().expect("bash")
    };
    let runs: Vec<_> = endings.iter().map(run).collect();
    for (mut run, (trainee, ending)) in runs.into_iter().zip(endings) {
        run.wait().expect("bash ends");
        let place = store.display().to_string();
        let kept = vitreo(&["results", "--store", &place, "--trainee", trainee]).expect_code(0);
        assert!(kept.stdout.contains("1 attempts"), "{ending}: {}", kept.stdout);
    }
}

#[test]
fn texts_from_files_do_not_command_the_terminal() {
    let folder = tempfile::tempdir().expect("folder");
    let odd = folder.path().join("\x1b[2J.mcap");
    std::fs::write(&odd, "no recording").expect("written");
    let done = vitreo(&["info", &odd.display().to_string()]).expect_code(1);
    assert!(done.stderr.contains('␛') && !done.stderr.contains('\x1b'), "{}", done.stderr);
}

#[test]
fn deleting_a_trainee_deletes_no_other_recording() {
    let desk = Desk::new();
    let (store, task) = (desk.name("store.sqlite"), desk.name("task.mcap"));
    std::fs::copy(&task, desk.at("own.mcap")).expect("copied");
    let add = |trainee: &str| vitreo(&["results", "add", "--store", &store, trainee, &desk.name("own.mcap")]);
    // The same contents are t1's attempt: nobody else made it.
    let refused = add("t2").expect_code(1);
    assert!(refused.stderr.contains("is attempt 1 of t1"), "{}", refused.stderr);
    vitreo(&["results", "delete", "--store", &store, "t1", "--recordings"]).expect_code(0);
    assert!(!Path::new(&task).exists() && desk.at("own.mcap").exists());
    // A file that was replaced is not t3's any more.
    add("t3").expect_code(0);
    std::fs::write(desk.at("own.mcap"), "something else").expect("written");
    let done = vitreo(&["results", "delete", "--store", &store, "t3", "--recordings"]).expect_code(3);
    assert!(
        desk.at("own.mcap").exists() && done.stderr.contains("is not the attempt's recording"),
        "{}",
        done.stderr
    );
}
