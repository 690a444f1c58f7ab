//! Tests that files can set every option of every command, and that the source of each value is shown.

use super::*;
use crate::cli::Cli;
use clap::Arg;
use clap::CommandFactory;
use settings::apply::matches;
use settings::check::can_be_set;
use settings::describe::options;
use std::ffi::OsString;
use std::path::Path;

fn files(folder: &Path, text: &str) -> Files {
    let path = folder.join("vitreo.toml");
    std::fs::write(&path, text).unwrap();
    Files { paths: vec![path], ..Files::default() }
}

/// A TOML value that the option accepts, found by trying.
fn value_of(command: &clap::Command, arg: &Arg) -> String {
    let possible = arg.get_possible_values();
    let first = possible.first().map(|v| format!("\"{}\"", v.get_name()));
    let tried = [
        "true",
        "1",
        "0.5",
        "99",
        "\"a.mp4\"",
        "\"a.png\"",
        "\"a.html\"",
        "\"tracker.gate=10\"",
        "\"tracker.gate=10:60:6\"",
        "\"a\"",
        "\"1/2\"",
        "\"tracking=1\"",
        "[\"a\", \"b\"]",
        "\"640x480\"",
        "\"7x5,10,7.5\"",
        "\"evdev:a\"",
        "\"serial:a\"",
        "\"0.4,0.5\"",
        "45",
        "\"info\"",
        "\"pedal\"",
        "\"igtl:h:1\"",
    ];
    let mut tried = first.into_iter().chain(tried.map(str::to_owned));
    let entry = |value: &str| {
        let text = format!("[alone]\n{} = {value}", arg.get_long().unwrap());
        settings::toml_file::read(&text, "f", 0).unwrap()
    };
    let alone = settings::Program { prefix: "alone", without: &[], elsewhere: None };
    let found = tried.find(|value| check(command, &alone, &entry(value)).is_ok());
    found.unwrap_or_else(|| panic!("no value for {} --{}", command.get_name(), arg.get_long().unwrap()))
}

/// All commands below `command`, with their paths.
fn commands(command: &clap::Command, path: &[String], to: &mut Vec<(Vec<String>, clap::Command)>) {
    for below in command.get_subcommands().filter(|c| c.get_name() != "help") {
        let path = [path, &[below.get_name().to_owned()]].concat();
        commands(below, &path, to);
        to.push((path, below.clone()));
    }
}

/// Arguments with a value for each required argument of a command.
fn required(command: &clap::Command) -> Vec<String> {
    let needed = command.get_arguments().filter(|a| a.is_required_set());
    let word = |arg: &Arg| {
        let value = arg.get_possible_values().first().map_or("x".to_owned(), |v| v.get_name().to_owned());
        arg.get_long().map_or(value.clone(), |long| format!("--{long}={value}"))
    };
    needed.map(word).collect()
}

#[test]
fn every_option_of_every_command_can_be_set() {
    let folder = tempfile::tempdir().unwrap();
    let (mut built, mut all) = (Cli::command(), Vec::new());
    built.build();
    commands(&built, &[], &mut all);
    let elsewhere = SETTINGS.elsewhere.unwrap();
    let own = |path: &[String]| {
        !elsewhere.contains(&path[0].as_str()) && !SETTINGS.without.contains(&path[0].as_str())
    };
    let mut tried = 0;
    for (path, command) in all.iter().filter(|(path, _)| own(path)) {
        for arg in command.get_arguments().filter(|arg| can_be_set(arg)) {
            let (key, value) = (arg.get_long().unwrap(), value_of(command, arg));
            let text = format!("[{}]\n{key} = {value}\n", path.join("."));
            let files = files(folder.path(), &text);
            let words = std::iter::once("vitreo".to_owned()).chain(path.clone()).chain(required(command));
            let typed: Vec<OsString> = words.map(OsString::from).collect();
            let without = matches(Cli::command(), &SETTINGS, &Files::default(), typed.clone());
            // If the option requires another option, the setting is ignored and the command behaves as
            // without it.
            let with = matches(Cli::command(), &SETTINGS, &files, typed);
            let kind = |e: &settings::Refusal| match e {
                settings::Refusal::CommandLine(error) => Some(error.kind()),
                settings::Refusal::File(problem, _) => panic!("{text}: {problem}"),
            };
            let (without, with) = (without.as_ref().err().map(kind), with.as_ref().err().map(kind));
            assert!(with.is_none() || with == without, "{text}: {with:?}");
            tried += 1;
        }
    }
    assert!(tried > 100, "only {tried} options");
}

#[test]
fn a_setting_reaches_the_command() {
    let folder = tempfile::tempdir().unwrap();
    let files =
        files(folder.path(), "quiet = 1\n[run]\nseed = 7\nno-picture = true\nlevel = 2\n[play]\nlevel = 3\n");
    let parse = |words: &[&str]| {
        let typed = std::iter::once("vitreo").chain(words.iter().copied()).map(OsString::from).collect();
        let mut found = matches(Cli::command(), &SETTINGS, &files, typed).expect("taken");
        <Cli as clap::FromArgMatches>::from_arg_matches_mut(&mut found).expect("complete")
    };
    let cli = parse(&["run", "--module", "peeling", "--seed", "8"]);
    let crate::cli::Command::Run(run) = cli.command else { panic!("no run") };
    assert_eq!(
        (cli.log.quiet, run.virtual_rig.seed, run.view.no_picture, run.training.level),
        (1, 8, true, 2)
    );
    // `--window` on the command line excludes `no-picture` of the file.
    let cli = parse(&["run", "--window"]);
    let crate::cli::Command::Run(run) = cli.command else { panic!("no run") };
    assert!(run.view.window && !run.view.no_picture);
    let crate::cli::Command::Play(play) = parse(&["play"]).command else { panic!("no play") };
    assert_eq!(play.level, 3);
}

#[test]
fn each_value_says_where_it_comes_from() {
    let options = options(Cli::command(), &SETTINGS);
    let text = "log = \"info\"\n[run]\n\nseed = 7\nmax-restarts = 3\n";
    let entries = settings::toml_file::read(text, "a.toml", 0).unwrap();
    let of = |log: Option<&str>, table: &str, key: &str| {
        let all = values(&options, &entries, log);
        all.into_iter().find(|s| s.table == table && s.key == key).map(|s| (s.value, s.from, s.line))
    };
    assert_eq!(of(None, "run", "seed"), Some(("7".into(), Origin::File, Some(4))));
    assert_eq!(of(None, "run", "level"), Some(("1".into(), Origin::Default, None)));
    assert_eq!(of(None, "run", "rig"), None);
    assert_eq!(of(None, "", "log"), Some(("\"info\"".into(), Origin::File, Some(1))));
    assert_eq!(of(Some("debug"), "", "log"), Some(("\"debug\"".into(), Origin::Environment, None)));
    assert!(of(None, "run", "max-restarts").is_some(), "a hidden option that is set is shown");
    let shown = table(&values(&options, &entries, None));
    assert!(shown.contains("# a.toml, line 4") && shown.contains("# default"), "{shown}");
    let again = settings::toml_file::read(&shown, "shown", 0).unwrap();
    assert!(again.iter().any(|e| e.key == "seed" && e.value.to_string() == "7"), "it is a file itself");
}

#[test]
fn a_new_file_sets_nothing_and_every_line_of_it_may() {
    let options = options(Cli::command(), &SETTINGS);
    let text = template(&options);
    assert_eq!(settings::toml_file::read(&text, "f", 0).unwrap(), []);
    let tables: Vec<&str> = text.lines().filter(|l| l.starts_with('[')).collect();
    assert!(tables.contains(&"[run]") && tables.contains(&"[results.delete]"), "{tables:?}");
    let on: String = text
        .lines()
        .map(|l| l.strip_prefix('#').filter(|r| !r.starts_with(' ')).unwrap_or(l).to_owned() + "\n")
        .collect();
    let entries = settings::toml_file::read(&on, "f", 0).unwrap();
    let listed = options.iter().filter(|o| !o.hidden).count();
    assert_eq!(entries.len(), listed, "each option once");
}
