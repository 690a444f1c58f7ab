//! Tests with a command line that has every kind of option, and with files that set them.

use super::*;
use crate::apply::matches;
use crate::files::Files;
use clap::CommandFactory;
use clap::error::ErrorKind;
use std::path::PathBuf;

const PROGRAM: Program = Program { prefix: "", without: &["man"], elsewhere: Some(&["blobs"]) };

#[derive(Debug, clap::Parser)]
#[command(name = "vitreo")]
struct Cli {
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    #[arg(long, global = true)]
    log: Option<String>,
    #[command(flatten)]
    settings: SettingsArgs,
    #[command(subcommand)]
    command: Sub,
}

#[derive(Debug, clap::Subcommand)]
enum Sub {
    Run(Run),
    Results(Results),
    Man,
    Blobs,
}

#[derive(Debug, clap::Args)]
struct Run {
    file: Option<String>,
    #[arg(long, default_value_t = 1)]
    level: u32,
    #[arg(long, value_parser = ["left", "right"])]
    arrange: Option<String>,
    #[arg(long, conflicts_with = "window")]
    headless: bool,
    #[arg(long)]
    window: bool,
    #[arg(long, requires = "file")]
    again: bool,
    #[arg(long, requires = "rig")]
    blobs: Option<String>,
    #[arg(long)]
    rig: Option<String>,
    #[arg(long, num_args = 2..)]
    pair: Vec<String>,
    #[arg(long)]
    each: Vec<String>,
    #[arg(long, num_args = 0..=1, default_missing_value = "terminal")]
    plot: Option<String>,
    #[arg(long)]
    force: bool,
}

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
struct Results {
    #[command(subcommand)]
    what: Option<What>,
    #[arg(long)]
    trainee: Option<String>,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Delete {
        trainee: String,
        #[arg(long)]
        store: Option<String>,
    },
}

/// Settings files in a folder that is deleted on drop.
struct Scratch {
    _folder: tempfile::TempDir,
    files: Files,
}

fn files(texts: &[&str]) -> Scratch {
    let folder = tempfile::tempdir().unwrap();
    let place = |(number, text): (usize, &&str)| {
        let path: PathBuf = folder.path().join(format!("{number}.toml"));
        std::fs::write(&path, text).unwrap();
        path
    };
    let paths = texts.iter().enumerate().map(place).collect();
    Scratch { _folder: folder, files: Files { paths, ..Files::default() } }
}

fn parse(files: &Files, words: &[&str]) -> Result<Cli, Refusal> {
    let typed = std::iter::once("vitreo").chain(words.iter().copied()).map(OsString::from).collect();
    let mut found = matches(Cli::command(), &PROGRAM, files, typed)?;
    Cli::from_arg_matches_mut(&mut found).map_err(Refusal::CommandLine)
}

fn run(texts: &[&str], words: &[&str]) -> Run {
    match parse(&files(texts).files, &[&["run"], words].concat()).unwrap().command {
        Sub::Run(run) => run,
        other => panic!("{other:?}"),
    }
}

fn refused(text: &str) -> String {
    match parse(&files(&[text]).files, &["run"]) {
        Err(Refusal::File(problem, _)) => problem.to_string().rsplit('/').next().unwrap().to_owned(),
        other => panic!("{text}: {other:?}"),
    }
}

#[test]
fn later_files_win_and_the_command_line_wins_over_all() {
    let texts = ["[run]\nlevel = 2\nrig = \"a\"", "[run]\nlevel = 3", "[run]\nrig = \"b\""];
    let own = run(&texts, &[]);
    assert_eq!((own.level, own.rig.as_deref()), (3, Some("b")));
    let typed = run(&texts, &["--level", "9", "--rig=c"]);
    assert_eq!((typed.level, typed.rig.as_deref()), (9, Some("c")));
    assert_eq!(run(&[], &[]).level, 1);
    assert_eq!(run(&texts, &["--no-config"]).level, 1);
}

#[test]
fn a_flag_is_turned_off_by_a_later_file_and_on_the_command_line() {
    let on = "[run]\nheadless = true";
    assert!(run(&[on], &[]).headless);
    assert!(!run(&[on, "[run]\nheadless = false"], &[]).headless);
    assert!(!run(&[on], &["--headless=false"]).headless);
    assert!(run(&["[run]\nheadless = false"], &["--headless"]).headless);
    assert!(run(&[], &["--headless=true"]).headless);
}

#[test]
fn what_excludes_a_typed_option_or_a_later_file_is_left_out() {
    let on = "[run]\nheadless = true";
    let typed = run(&[on], &["--window"]);
    assert!(typed.window && !typed.headless);
    let later = run(&[on, "[run]\nwindow = true"], &[]);
    assert!(later.window && !later.headless);
    let both = refused("[run]\nwindow = true\nheadless = true");
    assert_eq!(both, "0.toml: line 3: [run] headless: cannot be together with window of line 2");
}

#[test]
fn what_needs_another_option_is_used_with_it_only() {
    let needs = "[run]\nagain = true\nblobs = \"b\"\nlevel = 4";
    let alone = run(&[needs], &[]);
    assert_eq!((alone.again, alone.blobs, alone.level), (false, None, 4));
    let typed = run(&[needs], &["file", "--rig", "r"]);
    assert_eq!((typed.again, typed.blobs.as_deref()), (true, Some("b")));
    assert!(run(&[needs, "[run]\nrig = \"r\""], &[]).blobs.is_some(), "another setting will do");
}

#[test]
fn lists_counts_and_optional_values() {
    let text = "verbose = 2\n[run]\npair = [\"a\", \"b\", \"c\"]\neach = [\"-x\", \"y\"]\nplot = true\n";
    let own = run(&[text], &[]);
    assert_eq!(
        (own.pair.len(), own.each, own.plot.as_deref()),
        (3, vec!["-x".into(), "y".into()], Some("terminal"))
    );
    // A typed value replaces a list instead of being added to it.
    let typed = run(&[text], &["--each", "z", "--plot=p.png", "file"]);
    assert_eq!((typed.each, typed.plot.as_deref()), (vec!["z".to_owned()], Some("p.png")));
    assert_eq!(parse(&files(&[text]).files, &["run"]).unwrap().verbose, 2);
}

#[test]
fn options_of_all_commands_stand_at_the_top_and_in_tables() {
    let scratch = files(&["log = \"info\"\n[run]\nlog = \"debug\""]);
    let log = |files: &Files, words: &[&str]| parse(files, words).unwrap().log;
    assert_eq!(log(&scratch.files, &["run"]).as_deref(), Some("debug"));
    assert_eq!(log(&scratch.files, &["results"]).as_deref(), Some("info"));
    assert_eq!(log(&scratch.files, &["--log", "run", "run"]).as_deref(), Some("run"));
    assert_eq!(log(&scratch.files, &["results", "--log", "warn"]).as_deref(), Some("warn"));
    // Another option for the same purpose, and the environment variable.
    assert_eq!(log(&scratch.files, &["results", "-v"]), None);
    let variable = Files { log_variable: true, ..scratch.files.clone() };
    assert_eq!(log(&variable, &["run"]), None);
}

#[test]
fn a_sub_command_of_a_sub_command_has_its_own_table() {
    let text = "[results]\ntrainee = \"t\"\n[results.delete]\nstore = \"s\"";
    let what = |words: &[&str]| match parse(&files(&[text]).files, words).unwrap().command {
        Sub::Results(results) => results,
        other => panic!("{other:?}"),
    };
    assert_eq!(what(&["results"]).trainee.as_deref(), Some("t"));
    let Some(What::Delete { store, .. }) = what(&["results", "delete", "x"]).what else {
        panic!("no delete")
    };
    assert_eq!(store.as_deref(), Some("s"));
}

#[test]
fn what_is_wrong_is_told_with_file_line_key_and_what_was_expected() {
    for (text, told) in [
        (
            "\n[run]\nlevel = \"x\"",
            "0.toml: line 3: [run] level: expected a whole number of 0 or more, found \"x\"",
        ),
        ("[run]\nlevel = -1", "line 2: [run] level: expected a whole number of 0 or more, found -1"),
        (
            "[run]\narrange = \"lefd\"",
            "line 2: [run] arrange: expected one of left, right, found \"lefd\"; did you mean left?",
        ),
        ("[run]\nheadless = \"yes\"", "[run] headless: expected true or false, found \"yes\""),
        ("[run]\nlevel = [1, 2]", "[run] level: expected one value, found [1, 2]"),
        ("[run]\npair = [\"a\"]", "[run] pair: expected"),
        (
            "[run]\nlevle = 1",
            "line 2: [run] levle: expected an option that vitreo run takes, found levle; did you mean level?",
        ),
        ("[run]\nforce = true", "force: works on the command line only"),
        ("[run]\nfile = \"f\"", "file: is not an option"),
        ("level = 2", "line 1: level: expected an option that all commands take, found level"),
        ("verbose = \"loud\"", "verbose: expected a count, 0 to 255, found \"loud\""),
        (
            "[rnu]\nlevel = 2",
            "line 2: [rnu]: expected the name of a command that takes settings, found rnu; did you mean run?",
        ),
        ("[man]\nx = 2", "[man]: expected the name of a command"),
        ("[results.delte]\nstore = 2", "found delte; did you mean delete?"),
    ] {
        let found = refused(text);
        assert!(found.contains(told), "{text:?}: {found}");
    }
}

#[test]
fn other_programs_tables_help_and_wrong_use_are_left_alone() {
    let broken = files(&["[blobs]\nanything = 1\n[run]\nlevel = \"x\""]);
    let theirs = "[blobs]\nanything = 1\n[blobs.below]\nmore = 2";
    assert_eq!(run(&[theirs], &[]).level, 1, "what that program reads is not judged here");
    for words in [&["man"][..], &["blobs"], &["run", "--no-config"], &["--no-config", "run"]] {
        parse(&broken.files, words).unwrap();
    }
    let kind = |words: &[&str]| match parse(&broken.files, words) {
        Err(Refusal::CommandLine(error)) => error.kind(),
        other => panic!("{other:?}"),
    };
    assert_eq!(kind(&["run", "--help"]), ErrorKind::DisplayHelp);
    assert_eq!(kind(&["rnu"]), ErrorKind::InvalidSubcommand);
    let fine = files(&["[run]\nlevel = 2\nagain = true"]);
    match parse(&fine.files, &["run", "--nothing"]) {
        Err(Refusal::CommandLine(error)) => assert_eq!(error.kind(), ErrorKind::UnknownArgument),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_program_below_a_prefix_reads_its_own_tables() {
    #[derive(Debug, clap::Parser)]
    struct Below {
        #[command(subcommand)]
        what: What,
    }
    let program = Program { prefix: "calibrate", without: &[], elsewhere: None };
    let scratch = files(&["[calibrate.delete]\nstore = \"s\"\n[run]\nanything = 1"]);
    let typed = ["x", "delete", "t"].map(OsString::from).to_vec();
    let mut found = matches(Below::command(), &program, &scratch.files, typed.clone()).unwrap();
    let What::Delete { store, .. } = Below::from_arg_matches_mut(&mut found).unwrap().what;
    assert_eq!(store.as_deref(), Some("s"));
    for wrong in ["[calibrate.delete]\nstroe = \"s\"", "[calibrate.delte]\nstore = \"s\"", "store = \"s\""] {
        let wrong = files(&[wrong]);
        let refused = matches(Below::command(), &program, &wrong.files, typed.clone());
        assert!(matches!(refused, Err(Refusal::File(..))), "{refused:?}");
    }
    let others = files(&["[delete]\nanything = 1"]);
    assert!(matches(Below::command(), &program, &others.files, typed).is_ok());
    let keys: Vec<String> = describe::options(Below::command(), &program)
        .into_iter()
        .map(|o| format!("{}.{}", o.table, o.key))
        .collect();
    assert_eq!(keys, ["calibrate.delete.store"]);
}

#[test]
fn every_option_is_described_and_its_example_is_taken() {
    let all = describe::options(Cli::command(), &PROGRAM);
    assert_eq!(describe::from_json(&describe::to_json(&all)).unwrap(), all);
    let level = all.iter().find(|o| o.table == "run" && o.key == "level").unwrap();
    assert_eq!((level.default.as_deref(), level.example.as_str()), (Some("1"), "1"));
    assert!(all.iter().any(|o| o.table == "results.delete" && o.key == "store"));
    assert!(all.iter().all(|o| o.key != "force" && o.key != "help" && o.key != "no-config"));
}
