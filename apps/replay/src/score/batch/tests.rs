//! Batches of recordings that are whole, torn, or named more than once.

use super::*;
use outputs::Force;
use recording::{Provenance, Writer};
use settings::commands::BatchArgs;
use surgeon::skill::EXPERT;

/// A recording of an attempt that was broken off before anything happened.
fn broken_off(file: &Path) {
    let scene = surgeon::compose(&surgeon::load("navigation").unwrap(), 1, &EXPERT, 1).unwrap();
    let mut provenance = Provenance { scene_toml: scene.to_toml(), ..Provenance::default() };
    provenance.rig_json = rig::Rig::load_or_shipped(None).unwrap().to_json();
    provenance.seeds.insert("cameras".into(), "42".into());
    provenance.config.insert(results::keeping::BEGAN.into(), "1032942600".into());
    Writer::create(file, &provenance).unwrap().finish().unwrap();
}

fn asked(batch: BatchArgs) -> ScoreArgs {
    ScoreArgs { files: vec![], batch, resimulate: false, json: false, doc: false }
}

/// What a command ends with: its exit code, or its error.
fn ends(batch: &BatchArgs) -> String {
    match run(&asked(batch.clone())) {
        Ok(code) => format!("{code:?}"),
        Err(problem) => format!("{problem:#}"),
    }
}

fn code(code: u8) -> String {
    format!("{:?}", ExitCode::from(code))
}

#[test]
fn a_batch_scores_what_it_can_and_writes_its_shards() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("in")).unwrap();
    for name in ["a", "b", "c", "d"] {
        broken_off(&at("in").join(format!("{name}.mcap")));
    }
    std::fs::write(at("in/c.mcap"), "torn").unwrap();
    std::fs::write(at("list.txt"), "in/a.mcap\nin/b.mcap\nin/c.mcap\nin/d.mcap\n").unwrap();
    let shard = |index| {
        let batch = BatchArgs {
            force: Force { force: true },
            manifest: Some(at("list.txt")),
            shard: Some([index, 2]),
            out: Some(at("out")),
            csv: Some(at(&format!("{index}.csv"))),
            jobs: Some(2),
            ..BatchArgs::default()
        };
        let code = run(&asked(batch)).unwrap();
        (format!("{code:?}"), std::fs::read_to_string(at(&format!("{index}.csv"))).unwrap())
    };
    let ((damaged, first), (whole, second)) = (shard(0), shard(1));
    assert_eq!([damaged, whole], [LOSS, 0].map(|code| format!("{:?}", ExitCode::from(code))));
    let rows: Vec<&str> = first.lines().skip(1).chain(second.lines().skip(1)).collect();
    let names: Vec<&str> = rows.iter().map(|r| &r[r.find(".mcap").unwrap() - 1..][..1]).collect();
    assert_eq!(names, ["a", "c", "b", "d"], "every second one");
    assert!(
        rows[0].contains(",navigation,1,") && rows[0].contains(",42,") && !rows[1].contains("navigation")
    );
    assert!(rows[1].contains("c.mcap") && rows[1].contains("is not an MCAP file"), "{}", rows[1]);
    assert!(
        at("out/scores-00000-of-00002.parquet").is_file()
            && at("out/scores-00001-of-00002.parquet").is_file()
    );
}

#[test]
fn what_cannot_be_scored_is_a_row_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    std::fs::write(&file, "torn").unwrap();
    let told = |(row, scored): &(Row, Option<ScoredRecording>)| -> serde_json::Value {
        serde_json::from_str(&json(row, scored).unwrap()).unwrap()
    };
    let store = Store::new();
    let score_one = |file: &Path| score_one(file, &store, false, &AtomicUsize::new(0)).unwrap();
    let one = score_one(&file);
    let (damaged, told_of_damaged) = (one.0.clone(), told(&one));
    assert_eq!(told_of_damaged["file"], file.display().to_string());
    assert!(told_of_damaged["problem"].as_str().is_some_and(|p| !p.is_empty()), "{told_of_damaged}");
    let odd: &std::ffi::OsStr = std::os::unix::ffi::OsStrExt::from_bytes(b"\xff.mcap");
    let told_of_odd = told(&score_one(&folder.path().join(odd)));
    assert!(told_of_odd["file"].as_str().is_some_and(|f| f.ends_with("\u{fffd}.mcap")), "{told_of_odd}");
    broken_off(&folder.path().join("b.mcap"));
    let whole = told(&score_one(&folder.path().join("b.mcap")));
    assert_eq!((whole["module"].as_str(), whole["ended"].as_bool()), (Some("navigation"), Some(false)));
    assert!(damaged.attempt.is_none() && damaged.problem.as_ref().is_some_and(|p| !p.contains("a.mcap")));
    let good = Row { attempt: Some(results::Attempt::default()), ended: true, ..Row::default() };
    let differing = Row { agrees: Some(false), ..good.clone() };
    let code = |rows: &[Row]| summary(&Table::of_batch(rows, &keys()), 0, Some(1.0));
    assert_eq!(code(std::slice::from_ref(&good)), 0);
    assert_eq!(code(&[good.clone(), damaged.clone()]), LOSS);
    assert_eq!(code(&[damaged, differing.clone(), good]), DIFFERS);
    assert!(line(&differing).contains("differs"));
}

/// Seven recordings of which the last is torn and the first has two names, a list of them that names
/// one twice, and a batch of three shards.
fn batch(folder: &Path) -> BatchArgs {
    let at = |name: String| folder.join(name);
    (0..6).for_each(|i| broken_off(&at(format!("{i}.mcap"))));
    std::fs::write(at("6.mcap".into()), "torn").unwrap();
    // Equal provenance makes equal files, of which all but two are to differ.
    (1..5).for_each(|i| append(&at(format!("{i}.mcap")), i));
    let lines: Vec<String> = [0, 1, 2, 3, 1, 4, 5, 6].iter().map(|i| format!("{i}.mcap\n")).collect();
    std::fs::write(at("list.txt".into()), lines.concat()).unwrap();
    BatchArgs {
        manifest: Some(at("list.txt".into())),
        out: Some(at("out".into())),
        resume: true,
        jobs: Some(2),
        ..BatchArgs::default()
    }
}

fn append(file: &Path, byte: u8) {
    let mut bytes = std::fs::read(file).unwrap();
    bytes.push(byte);
    std::fs::write(file, bytes).unwrap();
}

#[test]
fn shards_are_resumed_and_gathered_and_what_is_lost_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let batch = batch(folder.path());
    let shard = |index| BatchArgs { shard: Some([index, 3]), ..batch.clone() };
    let table = |index| folder.path().join("out").join(Shard { index, count: 3 }.file_name());
    let gather = |csv: &str| BatchArgs {
        gather: batch.out.clone(),
        csv: Some(folder.path().join(csv)),
        ..BatchArgs::default()
    };
    (0..2).for_each(|i| drop(ends(&shard(i))));
    assert!(ends(&gather("a.csv")).contains("incomplete batch (1 problems"), "shard 2 is missing");
    assert!(!folder.path().join("a.csv").exists());
    ends(&shard(2));
    assert_eq!(ends(&gather("a.csv")), code(LOSS), "a row tells of the torn one");
    let first = std::fs::read_to_string(folder.path().join("a.csv")).unwrap();
    let names: Vec<_> =
        first.lines().skip(1).map(|l| l[..l.find(".mcap").unwrap()].chars().last().unwrap()).collect();
    assert_eq!(String::from_iter(names), "0123456");
    assert!(first.lines().nth(6).unwrap().ends_with("0.mcap"), "5 is the same as 0: {first}");

    let inode = |index| std::os::unix::fs::MetadataExt::ino(&std::fs::metadata(table(index)).unwrap());
    let before = inode(1);
    let cut = std::fs::read(table(0)).unwrap();
    std::fs::write(table(0), &cut[..cut.len() / 2]).unwrap();
    std::fs::remove_file(table(2)).unwrap();
    assert!(ends(&gather("b.csv")).contains("(2 problems"));
    (0..3).for_each(|i| drop(ends(&shard(i))));
    assert_eq!(inode(1), before, "a shard that is whole is not done again");
    assert_eq!(ends(&gather("b.csv")), code(LOSS));
    assert_eq!(std::fs::read_to_string(folder.path().join("b.csv")).unwrap(), first);
    let refused = ends(&BatchArgs { resume: false, ..shard(1) });
    assert!(refused.contains("already exists; use --force"), "{refused}");
}

#[test]
fn shards_of_another_list_are_neither_resumed_nor_gathered() {
    let folder = tempfile::tempdir().unwrap();
    let batch = batch(folder.path());
    let other = BatchArgs { shard: Some([1, 2]), ..batch.clone() };
    ends(&other);
    std::fs::write(folder.path().join("list.txt"), "0.mcap\n1.mcap\n").unwrap();
    let refused = ends(&other);
    assert!(refused.contains("to another list (7 recordings, not 2)"), "{refused}");
    ends(&BatchArgs { shard: Some([0, 2]), ..batch.clone() });
    assert!(
        ends(&BatchArgs { gather: batch.out.clone(), ..BatchArgs::default() }).contains("incomplete batch")
    );
    let whole = BatchArgs { out: Some(folder.path().join("new")), ..batch.clone() };
    assert_eq!(ends(&whole), code(0));
    let gather = BatchArgs { gather: whole.out.clone(), ..BatchArgs::default() };
    assert_eq!(ends(&gather), code(0));
    assert_eq!(ends(&BatchArgs { manifest: batch.manifest.clone(), ..gather.clone() }), code(0));
    std::fs::write(folder.path().join("list.txt"), "1.mcap\n0.mcap\n").unwrap();
    assert!(ends(&BatchArgs { manifest: batch.manifest, ..gather }).contains("to another list"));
}

#[test]
fn an_address_is_refused_where_a_path_must_be() {
    for batch in [
        BatchArgs { csv: Some("s3://b/a.csv".into()), ..BatchArgs::default() },
        BatchArgs { parquet: Some("s3://b/a.parquet".into()), ..BatchArgs::default() },
        BatchArgs { out: Some("gs://b/scores".into()), ..BatchArgs::default() },
    ] {
        let refused = run(&asked(batch)).unwrap_err();
        assert_eq!(crate::exit::code_of(&refused), outputs::exit::WRONG_USE, "{refused:#}");
    }
}
