//! Checks of the commands on a store in a scratch folder.

use super::*;
use clap::Parser;
use results::Attempt;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    results: ResultsArgs,
}

fn parse(words: &[&str]) -> Result<ResultsArgs, String> {
    let line = Line::try_parse_from(std::iter::once(&"results").chain(words));
    line.map(|l| l.results).map_err(|e| e.to_string())
}

#[test]
fn a_damaged_attempt_is_left_out_and_the_exit_code_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (path, csv) = (folder.path().join("r.sqlite"), folder.path().join("a.csv"));
    let store = path.display().to_string();
    let mut made = Store::open_or_create(&path).unwrap();
    for module in ["shadow", "forgeable", "forceps"] {
        made.add("t7", &Attempt { module: module.into(), ..Attempt::default() }).unwrap();
    }
    drop(made);
    let mut bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(9).position(|w| w == b"forgeable").unwrap();
    let words = ["--store", &store, "--csv", &csv.display().to_string(), "--force"].map(str::to_owned);
    let show = || {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let code = run(&parse(&words).unwrap()).unwrap();
        (code, std::fs::read_to_string(&csv).unwrap().lines().count())
    };
    assert_eq!(show(), (ExitCode::SUCCESS, 4));
    // The first place is the row, the next one the index.
    bytes[at] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(show(), (ExitCode::from(LOSS), 3));
}

#[test]
fn a_trainee_or_attempt_that_is_not_there_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.sqlite");
    let store = path.display().to_string();
    let id = Store::open_or_create(&path).unwrap().add("t7", &Attempt::default()).unwrap().unwrap();
    let refused = |words: &[&str]| {
        let words = [words, &["--store", &store]].concat();
        format!("{:#}", run(&parse(&words).unwrap()).unwrap_err())
    };
    for words in [&["--trainee", "t9"][..], &["--trainee", "t9", "--csv", "-"], &["delete", "t9"]] {
        let problem = refused(words);
        assert!(problem.contains("no trainee 't9'") && problem.contains("t7 are in it"), "{problem}");
    }
    let missing = refused(&["delete", "t7", "--attempt", "99"]);
    assert!(missing.contains("t7 has no attempt 99"), "{missing}");
    run(&parse(&["delete", "t7", "--attempt", &id.to_string(), "--store", &store]).unwrap()).unwrap();
    assert_eq!(Store::open(&path).unwrap().trainees().unwrap(), [("t7".into(), 0)]);
}

#[test]
fn a_list_shows_what_was_not_finished() {
    let attempt =
        Attempt { module: "shadow".into(), level: 2, total: 40.0, took_s: 9.5, ..Attempt::default() };
    let stored = |attempt| Stored { id: 3, trainee: "t7".into(), at: "2002-09-25T08:30:00Z".into(), attempt };
    let broken = Attempt { broken_off: true, ..attempt.clone() };
    let surgeon = Some("expert".to_owned());
    let failed = Attempt { failed: Some("lens contact".into()), finished: true, surgeon, ..attempt.clone() };
    let text = list(&[stored(attempt), stored(broken), stored(failed)]);
    assert!(
        text.contains("  aborted\n") && text.contains("  failed: lens contact  (script: expert)\n"),
        "{text}"
    );
    assert!(text.contains("t7") && text.contains("40.00 ± 0.00") && text.contains("not finished"), "{text}");
    assert_eq!(list(&[]), "0 attempts\n");
}
