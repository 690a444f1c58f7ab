//! Parts of a recording are recordings: cut out, verified to the bit, drawn, and put together again; and whether
//! one is whole is shown.

use rustix::fs::{FileType, Mode};
use serde_json::Value;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};
use vitreo_tests::{Running, interrupt, repository, vitreo};

/// Poses and states that a verification compared, which must hold.
fn verified(file: &str, report: &str) -> [u64; 2] {
    let args = ["replay", file, "--lockstep", "--verify", "--report", report, "--force"];
    vitreo(&args).expect_code(0);
    let report: Value =
        serde_json::from_str(&std::fs::read_to_string(report).expect("a report")).expect("JSON");
    ["poses", "states"].map(|proof| report["verify"][proof]["identical"].as_u64().expect("a count"))
}

#[test]
fn a_part_verifies_is_drawn_and_joins_the_others_again() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [whole, early, late, joined, report] = ["a.mcap", "b.mcap", "c.mcap", "d.mcap", "r.json"].map(path);
    std::fs::copy(repository().join("tests/data/golden/peel-2s.mcap"), &whole).expect("a copy");
    let all = verified(&whole, &report);
    vitreo(&["cut", &whole, "--until", "0.9", "-o", &early]).expect_code(0);
    vitreo(&["cut", &whole, "--from", "0.6", "-o", &late]).expect_code(0);
    let (first, second) = (verified(&early, &report), verified(&late, &report));
    for i in 0..2 {
        assert!(
            first[i] > 40 && first[i] < all[i] && second[i] > 20 && second[i] < all[i],
            "{first:?} {second:?}"
        );
        assert!(first[i] + second[i] > all[i], "they overlap: {first:?} {second:?} of {all:?}");
    }
    vitreo(&["merge", &late, &early, "-o", &joined]).expect_code(0);
    assert_eq!(verified(&joined, &report), all);
    vitreo(&["check", &whole, &joined, &late]).expect_code(0);
    let film = path("late.y4m");
    vitreo(&["film", &late, "--tier", "8", "--until", "0.4", "-o", &film]).expect_code(0);
    assert!(std::fs::metadata(film).expect("a film").len() > 100_000);
    // A part of a part.
    let part = path("e.mcap");
    vitreo(&["cut", &late, "--from", "0.3", "--until", "0.9", "-o", &part]).expect_code(0);
    assert!(verified(&part, &report).iter().all(|count| *count > 10));
}

#[test]
fn what_cannot_be_cut_joined_or_is_not_whole_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [whole, out, damaged] = ["a.mcap", "o.mcap", "d.mcap"].map(path);
    let golden = repository().join("tests/data/golden/peel-2s.mcap");
    std::fs::copy(&golden, &whole).expect("a copy");
    let refused = |args: &[&str], code: i32, told: &[&str]| {
        let stderr = vitreo(args).expect_code(code).stderr;
        assert!(told.iter().all(|word| stderr.contains(word)), "{args:?}: {stderr}");
    };
    refused(&["cut", &whole, "--from", "60", "-o", &out], 2, &["--from 60", "a.mcap"]);
    refused(&["cut", &whole, "--from", "1", "-o", &whole], 1, &["a.mcap"]);
    refused(&["cut", "-", "--until", "1", "-o", &out], 1, &["standard input"]);
    let other = repository().join("tests/data/corpus/peeling.mcap").display().to_string();
    refused(&["merge", &whole, &other, "-o", &out], 1, &["different runs", "differ"]);
    refused(&["merge", &whole, "-o", &out], 2, &[]);
    assert!(!folder.path().join("o.mcap").exists(), "nothing half-written");
    let mut bytes = std::fs::read(golden).expect("the recording");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&damaged, bytes).expect("written");
    let told = vitreo(&["check", &damaged]).expect_code(3).stdout;
    assert!(told.contains("records   WRONG") && told.contains("d.mcap"), "{told}");
    let cut = vitreo(&["cut", &damaged, "--until", "2", "-o", &out]).expect_code(3);
    assert!(cut.stderr.contains("damaged"), "{}", cut.stderr);
}

#[test]
fn an_interrupted_command_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [pipe, rig, stream] = ["blobs", "rig.json", "stream.mcap"].map(path);
    let golden = repository().join("tests/data/golden/peel-2s.mcap").display().to_string();
    vitreo(&["export", &golden, "--blobs", &path("b.jsonl"), "--rig", &rig]).expect_code(0);
    let lines = std::fs::read(path("b.jsonl")).expect("blobs");
    let made = rustix::fs::mknodat(rustix::fs::CWD, &*pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0);
    made.expect("a pipe");
    let running = Running::start(&["import", "--rig", &rig, &pipe, "-o", &stream]);
    // It goes on reading as long as this end is open.
    let mut end = std::fs::File::options().write(true).open(&pipe).expect("the pipe");
    end.write_all(&lines[..lines.len() / 2]).expect("written");
    let parts = || {
        let names = std::fs::read_dir(folder.path()).expect("folder").flatten();
        names.filter(|entry| entry.path().extension().is_some_and(|end| end == "part")).count()
    };
    let begun = Instant::now();
    while parts() == 0 {
        assert!(begun.elapsed() < Duration::from_secs(60), "nothing is written");
        std::thread::yield_now();
    }
    interrupt(running.pid());
    running.finish().expect_code(130);
    assert!(parts() == 0 && !Path::new(&stream).exists());
}

/// The suite of the product itself.
#[test]
fn the_suite_holds_and_a_wrong_expectation_fails_it() {
    let folder = tempfile::tempdir().expect("folder");
    let xml = folder.path().join("suite.xml").display().to_string();
    let told = vitreo(&["suite", "tests/suite.toml", "--junit", &xml]).expect_code(0);
    assert!(told.stdout.contains("10 cases, 0 not as expected"), "{}", told.stdout);
    let text = std::fs::read_to_string(&xml).expect("a report");
    assert!(text.contains("tests=\"10\" failures=\"0\" errors=\"0\""), "{text}");
    let wrong = folder.path().join("wrong.toml");
    let golden = repository().join("tests/data/golden/peel-2s.mcap");
    let case =
        format!("[[case]]\nname = \"a\"\nrecording = {golden:?}\nevents = {{ \"tissue.torn\" = 500 }}\n");
    std::fs::write(&wrong, case).expect("written");
    let told = vitreo(&["suite", &wrong.display().to_string()]).expect_code(5).stdout;
    assert!(told.contains("FAILED a (2 compared") && told.contains("expected 500, found"), "{told}");
    std::fs::write(&wrong, "[[case]]\nname = \"a\"\ncolour = 1\n").expect("written");
    let told = vitreo(&["suite", &wrong.display().to_string()]).expect_code(1).stderr;
    assert!(told.contains("wrong.toml") && told.contains("colour"), "{told}");
}
