//! The help of every command stands in `tests/data/help.txt`, so that a change of it shows as a difference.
//! `make help-texts` renews the file.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use vitreo_tests::{binaries, repository};

/// Width of the texts, in characters. clap reads it from `COLUMNS` where no stream is a terminal.
const WIDTH: &str = "100";
/// Begins the help of a command in the file.
const TITLE: &str = "==== ";
/// Lines of each text in a message about a difference.
const SHOWN: usize = 6;
/// Most options of a command under one heading.
const MOST_OPTIONS: usize = 10;
/// Most of them without a heading, besides `--help` and `--version`.
const MOST_WITHOUT_HEADING: usize = 8;

/// A command with its long help.
struct Help {
    /// As it is typed, such as `vitreo calibrate waved`.
    command: String,
    text: String,
}

fn file() -> PathBuf {
    repository().join("tests/data/help.txt")
}

fn help_of(words: &[String]) -> String {
    let mut command = Command::new(binaries().join("vitreo"));
    command.args(words).arg("--help").env("COLUMNS", WIDTH);
    let done = command.stdin(Stdio::null()).stderr(Stdio::piped()).output().expect("it starts");
    assert!(done.status.success(), "{words:?}: {}", String::from_utf8_lossy(&done.stderr));
    String::from_utf8(done.stdout).expect("UTF-8")
}

/// The sub-commands that a help lists.
fn sub_commands(text: &str) -> Vec<&str> {
    let listed = text.lines().skip_while(|line| *line != "Commands:").skip(1);
    let listed = listed.take_while(|line| line.starts_with("  "));
    // Descriptions that go on in a second line are indented further.
    let names =
        listed.filter(|line| !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").collect()
}

/// Adds the help of a command and of all below it.
fn collect(words: &[String], all: &mut Vec<Help>) {
    let text = help_of(words);
    let names: Vec<String> = sub_commands(&text).into_iter().map(str::to_owned).collect();
    let command =
        ["vitreo"].into_iter().chain(words.iter().map(String::as_str)).collect::<Vec<_>>().join(" ");
    all.push(Help { command, text });
    for name in names {
        collect(&[words, &[name]].concat(), all);
    }
}

fn all() -> Vec<Help> {
    let mut all = Vec::new();
    collect(&[], &mut all);
    all
}

/// The texts as the file has them.
fn joined(all: &[Help]) -> String {
    all.iter().map(|Help { command, text }| format!("{TITLE}{command}\n\n{}\n\n", text.trim_end())).collect()
}

/// The first lines that differ, with the command that they belong to; `None` where nothing differs.
fn first_difference(expected: &str, found: &str) -> Option<String> {
    let [old, new] = [expected, found].map(|text| text.lines().collect::<Vec<_>>());
    let at = (0..old.len().max(new.len())).find(|&i| old.get(i) != new.get(i))?;
    let title = new.iter().take(at + 1).rev().find_map(|line| line.strip_prefix(TITLE));
    let part = |mark: &str, lines: &[&str]| {
        let shown = lines.iter().skip(at).take(SHOWN);
        shown.map(|line| format!("{mark} {line}\n")).collect::<String>()
    };
    let command = title.unwrap_or("vitreo");
    Some(format!("{command} --help, line {} of the file:\n{}{}", at + 1, part("-", &old), part("+", &new)))
}

#[test]
fn the_help_of_every_command_is_that_of_the_file() {
    let all = all();
    assert!(
        all.len() > 60 && all.iter().any(|help| help.command == "vitreo calibrate waved"),
        "{}",
        all.len()
    );
    let written = std::fs::read_to_string(file()).expect("tests/data/help.txt: `make help-texts` writes it");
    if let Some(difference) = first_difference(&written, &joined(&all)) {
        panic!("tests/data/help.txt: `make help-texts` renews it where this is intended; {difference}");
    }
}

/// Number of options under each heading of a help.
fn options_by_heading(text: &str) -> Vec<(&str, usize)> {
    let mut found: Vec<(&str, usize)> = Vec::new();
    for line in text.lines() {
        if let Some(heading) = line.strip_suffix(':').filter(|heading| !heading.starts_with(' ')) {
            found.push((heading, 0));
        }
        let begins_option = line.trim_start().starts_with('-') && line.len() - line.trim_start().len() <= 6;
        let is_own = !line.contains("--help") && !line.contains("--version");
        if let Some((_, count)) = found.last_mut().filter(|_| begins_option && is_own) {
            *count += 1;
        }
    }
    found
}

#[test]
fn options_stand_in_groups() {
    for Help { command, text } in all() {
        for (heading, count) in options_by_heading(&text) {
            let most = if heading == "Options" { MOST_WITHOUT_HEADING } else { MOST_OPTIONS };
            assert!(count <= most, "{command}: {count} options under {heading}, at most {most} are expected");
        }
    }
}

#[test]
fn a_difference_is_shown_with_its_command() {
    let text = |help: &str| joined(&[Help { command: "vitreo cut".into(), text: help.into() }]);
    assert_eq!(first_difference(&text("a\nb\n"), &text("a\nb\n")), None);
    let shown = first_difference(&text("a\nb\n"), &text("a\nc\n")).expect("a difference");
    assert_eq!(shown, "vitreo cut --help, line 4 of the file:\n- b\n- \n+ c\n+ \n");
    assert_eq!(
        sub_commands("Commands:\n  cut  Cut\n       a part\n  help  Print\n\nOptions:\n  -h"),
        ["cut"]
    );
    let help = "Options:\n  -a\n      --bc <N>\n          - text\n  -h, --help\n\nOutputs:\n  -o\n";
    assert_eq!(options_by_heading(help), [("Options", 2), ("Outputs", 1)]);
}

#[test]
#[ignore = "writes tests/data/help.txt; `make help-texts` runs it"]
fn renew() {
    std::fs::write(file(), joined(&all())).expect("written");
}
