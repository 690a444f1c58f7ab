//! Checks of the commands on a store in a scratch folder.

use super::*;
use clap::Parser;

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
fn a_plot_goes_to_the_terminal_or_into_a_file() {
    let plot = |words: &[&str]| parse(words).unwrap().plot;
    assert_eq!(plot(&[]), None);
    assert_eq!(plot(&["--plot"]), Some(TERMINAL.into()));
    assert_eq!(plot(&["--plot", "a.png", "--module", "shadow"]), Some("a.png".into()));
}

#[test]
fn a_recording_becomes_an_attempt_and_one_not_begun_is_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (file, store) = (folder.path().join("a.mcap"), folder.path().join("r.sqlite"));
    crate::score_batch::tests::broken_off(&file);
    let mut store = Store::open_or_create(&store).unwrap();
    let problem = keep(&mut store, "t7", &file).unwrap_err().to_string();
    assert!(problem.contains("a.mcap") && problem.contains("not begun"), "{problem}");
    let attempt = attempt_of(&Recording::open(&file).unwrap(), &score::score_file(&file).unwrap());
    assert_eq!((attempt.at_s, attempt.seed, attempt.surgeon.as_deref()), (1_032_942_600, Some(42), None));
    assert_eq!(attempt.categories.iter().map(|c| c.of).sum::<f64>(), 100.0);
    store.add("t7", &attempt).unwrap();
    let kept = store.attempts(&Filter::default()).unwrap();
    assert_eq!(kept[0].attempt, attempt);
    let table = Table::of_store(&kept, keys());
    let mut fresh = keys();
    fresh.widen(&attempt);
    assert_eq!(fresh, keys(), "the table has a column for everything that this build scores");
    assert!(table.columns.iter().any(|c| c.name == "value_speed_near_retina"));
}

#[test]
fn a_recording_is_one_trainees_attempt() {
    let attempt = Attempt { score_version: 5, ..Attempt::default() };
    let check = |holders: &[(String, i64, u32)]| check_holders(holders, "t7", &attempt, Path::new("a.mcap"));
    let other = check(&[("t8".into(), 4, 5)]).unwrap_err().to_string();
    assert!(other.contains("a.mcap: this recording is attempt 4 of t8"), "{other}");
    assert!(check(&[("t7".into(), 3, 4), ("t8".into(), 4, 4)]).is_err());
    check(&[("t7".into(), 3, 4)]).unwrap();
    check(&[]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open_or_create(&folder.path().join("r.sqlite")).unwrap();
    let with = |sha: &str| Attempt { recording_sha256: Some(sha.into()), ..attempt.clone() };
    let id = store.add("t8", &with("11")).unwrap().unwrap();
    assert_eq!(store.holders("11").unwrap(), [("t8".into(), id, 5)]);
    assert_eq!(store.holders("22").unwrap(), []);
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
    assert_eq!(show(), (ExitCode::from(crate::exit::LOSS), 3));
}

#[test]
fn deleting_needs_a_name() {
    assert!(parse(&["delete"]).is_err() && parse(&["delete", "t7", "--store", "s"]).is_ok());
    assert!(parse(&["--module", "shadow", "delete", "t7"]).is_err(), "filters do not choose what is deleted");
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
        text.contains("  broken off\n") && text.contains("  failed: lens contact  (script: expert)\n"),
        "{text}"
    );
    assert!(text.contains("t7") && text.contains("40.00 ± 0.00") && text.contains("not finished"), "{text}");
    assert_eq!(list(&[]), "0 attempts\n");
}
