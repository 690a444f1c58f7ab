//! A person at the desk: level 1 of navigation is finished by inputs alone, through every process,
//! with a restart, a pause and the next level; and what the launcher says to inputs and requests
//! that make no sense.

use protocol::control::{Command, Request};
use protocol::health::{Process, STATE_RUNNING};
use protocol::inputs::{Input, InputEvent, Key, Origin};
use protocol::limits::MAX_STEP_NS;
use protocol::steps::StepRecord;
use rustix::process::Signal;
use std::path::Path;
use vitreo_tests::{Observer, Running, instance_name, kill, next, signal, vitreo};

/// The inputs: six balls, 2.2 s each.
const INPUTS: &str = "tests/data/inputs/navigation-1.txt";

fn scored(file: &Path, how: &[&str]) -> serde_json::Value {
    let file = file.display().to_string();
    let told = vitreo(&[&["score", "--json", &file], how].concat()).expect_code(0);
    serde_json::from_str(&told.stdout).expect("JSON")
}

#[test]
fn level_1_of_navigation_is_finished_by_inputs_alone() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (record, store, name) = (path("a.mcap"), path("results.sqlite"), instance_name());
    let play = ["play", "navigation", "--inputs", INPUTS, "--no-picture", "--instance", &name];
    let kept = ["--record", &record, "--trainee", "t7", "--store", &store];
    let told = vitreo(&[&play[..], &kept].concat()).expect_code(0);
    // Three attempts, three recordings: broken off, finished, begun.
    let [broken, finished, begun] = ["a.mcap", "a-2.mcap", "a-3.mcap"].map(|f| folder.path().join(f));
    let first = scored(&broken, &[]);
    assert_eq!((&first["ended"], &first["level"]), (&false.into(), &1.into()), "{first}");
    let score = scored(&finished, &[]);
    assert_eq!((&score["ended"], &score["finished"]), (&true.into(), &true.into()), "{score}");
    assert_eq!((&score["agrees"], &score["unmatched"]), (&true.into(), &0.into()), "{score}");
    assert!(score["total"].as_f64().expect("points") > 95.0, "{score}");
    // Six balls; the pause of 3 s and the help of 3 s are not among it.
    let took = score["took_s"].as_f64().expect("time");
    assert!((10.0..15.5).contains(&took), "{took}");
    // The recording holds every input since the restart: simulated again it gives the same score.
    assert_eq!(scored(&finished, &["--resimulate"])["agrees"], true);
    assert_eq!(scored(&begun, &[])["level"], 2);
    // It is replayed, with its picture, though there are no blobs.
    let (of_desk, stills) = (finished.display().to_string(), folder.path().join("stills"));
    let drawn = ["--stills", &stills.display().to_string(), "--until", "2", "--every", "1", "--tier", "8"];
    vitreo(&[&["replay", &of_desk][..], &drawn].concat()).expect_code(0);
    assert_eq!(std::fs::read_dir(stills).expect("stills").count(), 3);
    let replay = vitreo(&["replay", &of_desk, "--lockstep", "--assert-tracking", "0.5"]).expect_code(1);
    assert!(replay.stderr.contains("desk"), "{}", replay.stderr);
    // What was finished is kept, and what was broken off with a mark.
    let results = |words: &[&str]| vitreo(&[&["results", "--store", &store], words].concat());
    let list = results(&["--csv", "-"]).expect_code(0).stdout;
    let marked: Vec<bool> = list.lines().skip(1).map(|row| row.split(',').nth(3) == Some("true")).collect();
    assert_eq!(marked, [true, false, true], "{list}");
    vitreo(&["results", "delete", "t7", "--attempt", "1", "--store", &store]).expect_code(0);
    assert_eq!(results(&["--trainee", "t7", "--csv", "-"]).expect_code(0).stdout.lines().count(), 3);
    let typo = results(&["--trainee", "t8"]).expect_code(1).stderr;
    assert!(typo.contains("no trainee 't8'") && typo.contains("t7"), "{typo}");
    assert!(told.stdout.contains("level 1: score"), "{}", told.stdout);
}

/// As `timeout` and a terminal that closes send them: only a later one is impatience.
#[test]
fn signals_that_come_together_end_a_run_in_order() {
    let folder = tempfile::tempdir().expect("folder");
    let (file, name) = (folder.path().join("a.mcap").display().to_string(), instance_name());
    let running =
        Running::start(&["run", "--no-picture", "--direct", "--record", &file, "--instance", &name]);
    Observer::join(&name).health(Process::Simcore, |h| h.received > 0);
    for kind in [Signal::INT, Signal::TERM, Signal::HUP] {
        signal(running.pid(), kind);
    }
    running.finish().expect_code(0);
    vitreo(&["info", &file]).expect_code(0);
}

#[test]
fn a_run_is_paused_restarted_and_ended_from_a_command_line() {
    let name = instance_name();
    let run = ["run", "--module", "navigation", "--stay", "--no-picture", "--direct", "--instance", &name];
    let running = Running::start(&run);
    let ctl = |what: &str| vitreo(&["ctl", what, "--instance", &name]);
    let mut observer = Observer::join(&name);
    let mut steps = observer.receiver::<StepRecord>();
    observer.health(Process::VirtualRig, |h| h.state == STATE_RUNNING);
    let before = next(&mut steps, |s| s.step >= 40);
    ctl("pause").expect_code(0);
    // Everything that was on its way is in the queue now; nothing follows.
    let mut last = before;
    while let Some(step) = steps.next_valid().expect("steps") {
        last = step;
    }
    ctl("pause").expect_code(0);
    assert!(steps.next_valid().expect("steps").is_none(), "a step while everything stands still");
    ctl("resume").expect_code(0);
    let on = next(&mut steps, |_| true);
    let gap_ns = on.instants.exposed - last.instants.exposed;
    let advances = on.advanced_ns > 0;
    assert_eq!((on.step, advances), (last.step + 1, gap_ns <= MAX_STEP_NS), "time does not run in a pause");
    ctl("restart").expect_code(0);
    next(&mut steps, |s| s.step == 1);
    ctl("next").expect_code(0);
    next(&mut steps, |s| s.step == 1);
    ctl("next").expect_code(0);
    let refused = ctl("next").expect_code(1);
    assert!(refused.stderr.contains("level 3 of navigation is the last"), "{}", refused.stderr);
    ctl("quit").expect_code(0);
    drop((steps, observer));
    running.finish().expect_code(0);
    let gone = ctl("pause").expect_code(1);
    assert!(gone.stderr.contains(&name) && gone.stderr.contains("no simulator"), "{}", gone.stderr);
}

/// The launcher alone knows whether help is open: a renderer that begins anew shows it again, and the
/// next press of its key closes it.
#[test]
fn help_stays_open_while_the_renderer_restarts_and_its_key_closes_it() {
    let name = instance_name();
    let run = ["run", "--module", "navigation", "--stay", "--headless", "--direct", "--instance", &name];
    let running = Running::start(&run);
    let mut observer = Observer::join(&name);
    let (mut requests, mut inputs) = (observer.receiver::<Request>(), observer.sender::<InputEvent>());
    let mut press_f1 = || {
        let key = Key::named("f1").expect("a key");
        inputs.send(&InputEvent::new(Input::Press(key), Origin::Window, 1)).expect("sent");
    };
    let is_help = |r: &Request| r.is_for(Process::Renderer) && r.command == Command::Help as u32;
    let renderer = observer.health(Process::Renderer, |h| h.state == STATE_RUNNING);
    press_f1();
    next(&mut requests, |r| is_help(r) && r.argument == 1);
    kill(renderer.pid);
    observer.health(Process::Renderer, |h| h.pid != renderer.pid && h.state == STATE_RUNNING);
    assert_eq!(next(&mut requests, is_help).argument, 1, "the new renderer shows it too");
    press_f1();
    assert_eq!(next(&mut requests, is_help).argument, 0, "the key closes it");
    vitreo(&["ctl", "quit", "--instance", &name]).expect_code(0);
    drop((requests, inputs, observer));
    running.finish().expect_code(0);
}

#[test]
fn inputs_that_make_no_sense_are_refused_by_file_and_line() {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("bad.txt");
    std::fs::write(&file, "0.5 tap tab\n1.0 press any-key\n").expect("written");
    let file = file.display().to_string();
    let play =
        |words: &[&str]| vitreo(&[&["play", "--no-picture", "--instance", &instance_name()], words].concat());
    let told = play(&["--inputs", &file]).expect_code(1).stderr;
    for word in ["bad.txt", "line 2", "any-key", "mouse-left"] {
        assert!(told.contains(word), "{word} is missing: {told}");
    }
    let missing = play(&["--inputs", "/nowhere/moves.txt"]).expect_code(1).stderr;
    assert!(missing.contains("/nowhere/moves.txt"), "{missing}");
    let module = play(&["juggling", "--inputs", INPUTS]).expect_code(2).stderr;
    assert!(module.contains("juggling") && module.contains("navigation"), "{module}");
    let level = play(&["navigation", "--level", "9", "--inputs", INPUTS]).expect_code(2).stderr;
    assert!(level.contains("1 to 3") && level.contains('9'), "{level}");
    // What is wrong with the arguments is reported before a missing display is.
    for (words, code, expected) in [
        (&["juggling"][..], 2, "juggling"),
        (&["navigation", "--level", "9"], 2, "1 to 3"),
        (&["--scene", "garden"], 2, "garden"),
        (&["--scene", "/nowhere/s.toml"], 1, "/nowhere/s.toml"),
        (&["--rig", "/nowhere/rig.json"], 1, "/nowhere/rig.json"),
    ] {
        let refused = vitreo(&[&["play", "--instance", &instance_name()], words].concat());
        let refused = refused.expect_code(code).stderr;
        assert!(refused.contains(expected), "{words:?}: {refused}");
    }
}
