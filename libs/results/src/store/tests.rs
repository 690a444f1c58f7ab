//! Checks of the store against a file on disk, partly through connections of SQLite's own.

use super::*;
use crate::attempt::{Points, Stored};
use tempfile::TempDir;

fn place() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/results.sqlite");
    (folder, path)
}

fn points(key: &str, value: Option<f64>, points: f64) -> Points {
    Points { key: key.into(), value, sigma: value.map(|v| v / 16.0), points, of: 20.0 }
}

fn attempt(at_s: i64, module: &str, total: f64) -> Attempt {
    Attempt {
        at_s,
        module: module.into(),
        level: 2,
        surgeon: Some("novice".into()),
        program: "0.1.0".into(),
        score_version: 3,
        seed: Some(u64::MAX - 4),
        total,
        sigma: 0.1 + 0.2,
        finished: false,
        broken_off: true,
        failed: Some("lens contact".into()),
        took_s: 31.25,
        categories: vec![points("target", None, 19.0), points("tissue", None, -7.5)],
        metrics: vec![points("goals", Some(1.0 / 3.0), 12.0), points("grip", None, 0.0)],
        recording: Some(format!("/data/{at_s}.mcap")),
        recording_sha256: Some(format!("{at_s:064x}")),
    }
}

#[test]
fn an_attempt_comes_back_as_it_was_added_and_once() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    // 2002-09-25 is the day on which the paper was given; `date -d 2002-09-25T08:30:00Z +%s`.
    let first = attempt(1_032_942_600, "navigation", 81.5);
    let id = store.add("trainee-7", &first).unwrap().unwrap();
    assert_eq!(store.add("trainee-7", &first).unwrap(), None, "the same recording counts once");
    let other = store.add("trainee-8", &first).unwrap().unwrap();
    let again = store.add("trainee-7", &Attempt { score_version: 4, ..first.clone() }).unwrap();
    assert!(again.is_some_and(|n| n > other), "another version of the score is another row");
    drop(store);
    let store = Store::open(&path).unwrap();
    let all = store.attempts(&Filter::default()).unwrap();
    assert_eq!(all.len(), 3);
    assert_eq!(
        (all[0].id, all[0].trainee.as_str(), all[0].at.as_str()),
        (id, "trainee-7", "2002-09-25T08:30:00Z")
    );
    assert_eq!(all[0].attempt, first, "to the bit");
}

#[test]
fn filters_choose_and_time_orders() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    for (at, trainee, module) in
        [(30, "a", "shadow"), (10, "a", "forceps"), (20, "b", "shadow"), (5, "a", "shadow")]
    {
        store.add(trainee, &attempt(at, module, at as f64)).unwrap();
    }
    let of = |trainee: Option<&str>, module: Option<&str>, level| {
        let filter = Filter { trainee: trainee.map(Into::into), module: module.map(Into::into), level };
        store.attempts(&filter).unwrap().iter().map(|s| s.attempt.at_s).collect::<Vec<_>>()
    };
    assert_eq!(of(None, None, None), [5, 10, 20, 30]);
    assert_eq!(of(Some("a"), Some("shadow"), Some(2)), [5, 30]);
    assert_eq!(of(Some("a"), None, Some(1)), [0; 0]);
    assert_eq!(of(Some("' OR 1 = 1 --"), None, None), [0; 0]);
    assert_eq!(store.trainees().unwrap(), [("a".into(), 3), ("b".into(), 1)]);
}

#[test]
fn a_deleted_trainee_leaves_no_trace_in_the_file() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    store.add("Pseudonym-Magnolia", &attempt(1, "shadow", 1.0)).unwrap();
    store.add("Pseudonym-Magnolia", &attempt(2, "shadow", 2.0)).unwrap();
    store.add("other", &attempt(3, "shadow", 3.0)).unwrap();
    let bytes = || std::fs::read(&path).unwrap();
    let holds = |needle: &str| bytes().windows(needle.len()).any(|w| w == needle.as_bytes());
    assert!(holds("Pseudonym-Magnolia") && holds("/data/2.mcap"));
    let (attempts, recordings) = store.delete("Pseudonym-Magnolia").unwrap().unwrap();
    let paths: Vec<&str> = recordings.iter().map(|r| r.path.as_str()).collect();
    assert_eq!((attempts, paths), (2, vec!["/data/1.mcap", "/data/2.mcap"]));
    assert_eq!(store.delete("Pseudonym-Magnolia").unwrap(), None);
    drop(store);
    assert!(!holds("Magnolia") && !holds("/data/1.mcap") && !holds("/data/2.mcap"));
    let raw = Connection::open(&path).unwrap();
    let left: i64 = raw.query_row("SELECT count(*) FROM points", [], |r| r.get(0)).unwrap();
    assert_eq!(left, 4, "only the points of the other's attempt");
}

#[test]
fn one_attempt_is_deleted_and_no_other() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    let ids: Vec<i64> =
        (1..4).map(|at| store.add("a", &attempt(at, "shadow", 1.0)).unwrap().unwrap()).collect();
    let others = store.add("b", &attempt(9, "shadow", 1.0)).unwrap().unwrap();
    assert_eq!(store.delete_attempt("a", others).unwrap(), None, "it is another trainee's");
    assert_eq!(store.delete_attempt("a", 99).unwrap(), None);
    let recordings = store.delete_attempt("a", ids[1]).unwrap().unwrap();
    assert_eq!(recordings.iter().map(|r| r.path.as_str()).collect::<Vec<_>>(), ["/data/2.mcap"]);
    let left: Vec<i64> = store.attempts(&Filter::default()).unwrap().iter().map(|s| s.id).collect();
    assert_eq!(left, [ids[0], ids[2], others]);
}

/// A store as version 1 of the schema had it, written with SQL alone.
fn old_store(path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let old = Connection::open(path).unwrap();
    old.execute_batch(STEPS[0]).unwrap();
    old.execute_batch(
        "PRAGMA application_id = 1986622578; PRAGMA user_version = 1;
         INSERT INTO trainees VALUES (4, 'veteran');
         INSERT INTO attempts VALUES (9, 4, 100, 'peeling', 1, '0.0.9', 1, NULL, 55.5, 0, 12.0, '/r.mcap', 'ab');
         INSERT INTO attempts VALUES (10, 4, 101, 'peeling', 1, '0.0.9', 1, NULL, 55.5, 0, 12.0, '/r.mcap', 'ab');
         INSERT INTO points VALUES (9, 'metric', 0, 'goals', 0.5, 10.0, 20.0);
         INSERT INTO points VALUES (10, 'metric', 0, 'goals', 0.5, 10.0, 20.0);",
    )
    .unwrap();
}

#[test]
fn an_older_schema_is_brought_up_to_date() {
    let (_folder, path) = place();
    old_store(&path);
    let mut store = Store::open(&path).unwrap();
    let all = store.attempts(&Filter::default()).unwrap();
    assert_eq!(all.len(), 1, "what was there twice is there once");
    let Stored { id, trainee, attempt: a, .. } = &all[0];
    assert_eq!((*id, trainee.as_str(), a.total, a.sigma, &a.surgeon), (9, "veteran", 55.5, 0.0, &None));
    assert_eq!((a.metrics[0].value, a.metrics[0].sigma), (Some(0.5), None));
    store.add("veteran", &attempt(1, "shadow", 3.0)).unwrap().unwrap();
    let fresh = path.with_file_name("fresh.sqlite");
    let schema = |store: &Store| -> Vec<String> {
        let mut columns = store
            .connection
            .prepare("SELECT m.name || '.' || c.name || ' ' || c.type FROM sqlite_schema m, pragma_table_info(m.name) c")
            .unwrap();
        let mut all: Vec<String> = columns.query_map([], |r| r.get(0)).unwrap().map(Result::unwrap).collect();
        all.sort();
        all
    };
    assert_eq!(schema(&store), schema(&Store::open_or_create(&fresh).unwrap()));
    assert_eq!(store.identity().unwrap()[0], VERSION as i64);
}

#[test]
fn a_newer_schema_and_foreign_files_are_refused_untouched() {
    let (_folder, path) = place();
    drop(Store::open_or_create(&path).unwrap());
    Connection::open(&path).unwrap().pragma_update(None, "user_version", 99).unwrap();
    let error = Store::open(&path).unwrap_err();
    assert!(matches!(&error, StoreError::Newer { found: 99, .. }), "{error}");
    assert!(error.to_string().contains("results.sqlite"));
    let text = path.with_file_name("notes.txt");
    std::fs::write(
        &text,
        "not a database, but long enough to have a header of one hundred bytes. ".repeat(4),
    )
    .unwrap();
    let before = std::fs::read(&text).unwrap();
    assert!(matches!(Store::open(&text), Err(StoreError::Foreign { .. })));
    assert_eq!(std::fs::read(&text).unwrap(), before);
    let other = path.with_file_name("other.sqlite");
    Connection::open(&other).unwrap().execute_batch("CREATE TABLE trainees (name TEXT)").unwrap();
    assert!(matches!(Store::open(&other), Err(StoreError::Foreign { .. })));
    assert!(matches!(Store::open(&path.with_file_name("none")), Err(StoreError::Missing { .. })));
}

#[test]
fn eight_that_make_the_store_at_once_all_get_it() {
    for _ in 0..40 {
        let (_folder, path) = place();
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let together = std::sync::Barrier::new(8);
        std::thread::scope(|scope| {
            let make = || {
                together.wait();
                Store::open_or_create(&path).map(drop)
            };
            let makers: Vec<_> = (0..8).map(|_| scope.spawn(make)).collect();
            makers.into_iter().for_each(|maker| maker.join().unwrap().unwrap());
        });
    }
}

#[test]
fn a_deleted_recording_that_another_names_is_told() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    let of = |trainee: &str, at, recording: &str, sha256: &str, store: &mut Store| {
        let (recording, recording_sha256) = (Some(recording.into()), Some(sha256.into()));
        store.add(trainee, &Attempt { recording, recording_sha256, ..attempt(at, "shadow", 1.0) }).unwrap()
    };
    of("a", 1, "/r/one", "11", &mut store);
    of("a", 2, "/r/two", "22", &mut store);
    of("a", 3, "/r/three", "33", &mut store);
    of("b", 4, "/r/two", "44", &mut store);
    of("b", 5, "/r/copy-of-three", "33", &mut store);
    let (_, recordings) = store.delete("a").unwrap().unwrap();
    let shared: Vec<_> = recordings.iter().map(|r| (r.path.as_str(), r.shared)).collect();
    assert_eq!(shared, [("/r/one", false), ("/r/three", true), ("/r/two", true)]);
}

#[test]
fn a_locked_store_says_so_and_changes_nothing() {
    let (_folder, path) = place();
    drop(Store::open_or_create(&path).unwrap());
    let holder = Connection::open(&path).unwrap();
    let mut store = Store::open_with(&path, Duration::ZERO).unwrap();
    holder.execute_batch("BEGIN EXCLUSIVE").unwrap();
    let error = store.add("a", &attempt(1, "shadow", 1.0)).unwrap_err();
    assert!(matches!(error, StoreError::Locked { .. }), "{error}");
    assert!(matches!(store.attempts(&Filter::default()), Err(StoreError::Locked { .. })));
    assert!(matches!(Store::open_with(&path, Duration::ZERO), Err(StoreError::Locked { .. })));
    holder.execute_batch("ROLLBACK").unwrap();
    assert!(store.add("a", &attempt(1, "shadow", 1.0)).unwrap().is_some());
}

#[test]
fn a_full_disk_says_so_and_leaves_what_was_there() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    store.add("a", &attempt(1, "shadow", 1.0)).unwrap();
    // SQLite answers a full disk and its own limit of pages alike (SQLITE_FULL).
    store.connection.pragma_update(None, "max_page_count", 1).unwrap();
    let long = Attempt { recording: Some("x".repeat(200_000)), ..attempt(2, "shadow", 2.0) };
    let error = store.add("newcomer", &long).unwrap_err();
    assert!(matches!(error, StoreError::Full { .. }), "{error}");
    drop(store);
    let store = Store::open(&path).unwrap();
    assert_eq!(store.trainees().unwrap(), [("a".into(), 1)], "half an attempt is none");
}

#[test]
fn odd_names_are_refused() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    for wrong in ["", "-x", "a b", "a,b", "a/b", "..", "x\n", &"n".repeat(65)] {
        assert!(
            matches!(store.add(wrong, &attempt(1, "m", 1.0)), Err(StoreError::Value { .. })),
            "{wrong:?}"
        );
    }
    for right in ["t7", "Ärztin_3", "a.b@c-d"] {
        check_name(right).unwrap();
    }
}

#[test]
fn the_default_place_follows_the_specification() {
    let place = |data: Option<&str>, home: Option<&str>| {
        default_place(data.map(Path::new), home.map(Path::new)).map(|p| p.display().to_string())
    };
    assert_eq!(place(Some("/d"), Some("/h")).as_deref(), Some("/d/vitreo/results.sqlite"));
    assert_eq!(place(Some("relative"), Some("/h")).as_deref(), Some("/h/.local/share/vitreo/results.sqlite"));
    assert_eq!(place(None, None), None);
}

#[test]
fn a_store_is_its_owners_alone_and_syncs_the_removal_of_its_journal() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vitreo/results.sqlite");
    let mode = |path: &Path| path.metadata().unwrap().permissions().mode() & 0o777;
    let store = Store::open_or_create(&path).unwrap();
    let level: i64 = store.connection.pragma_query_value(None, "synchronous", |row| row.get(0)).unwrap();
    assert_eq!(level, 3, "EXTRA");
    assert!(store.notices().is_empty(), "a new store is closed from the start: {:?}", store.notices());
    assert_eq!((mode(&path), mode(path.parent().unwrap())), (0o600, 0o700));
    drop(store);
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    Store::open(&path).unwrap();
    assert_eq!(mode(&path), 0o600, "the mode of an older store is mended");
}

/// A store as version 3 of the schema had it, with attempts of two trainees.
fn store_without_checksums(path: &Path) {
    let mut store = Store::open_or_create(path).unwrap();
    for at in 1..6 {
        store.add(if at < 4 { "t7" } else { "t8" }, &attempt(at, "shadow", 60.0 + at as f64)).unwrap();
    }
    let raw = &store.connection;
    raw.execute_batch("ALTER TABLE attempts DROP COLUMN checksum; PRAGMA user_version = 3").unwrap();
}

#[test]
fn attempts_of_an_older_store_get_checksums_and_that_is_said() {
    use std::os::unix::fs::PermissionsExt;
    let (_folder, path) = place();
    store_without_checksums(&path);
    let recording = path.with_file_name("a.mcap");
    let elsewhere = path.parent().unwrap().parent().unwrap().join("b.mcap");
    let raw = Connection::open(&path).unwrap();
    for (id, file) in [(1, &recording), (2, &elsewhere)] {
        std::fs::write(file, "").unwrap();
        std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o644)).unwrap();
        let real = file.canonicalize().unwrap().display().to_string();
        raw.execute("UPDATE attempts SET recording = ?2 WHERE id = ?1", params![id, real]).unwrap();
    }
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o664)).unwrap();
    let store = Store::open(&path).unwrap();
    let said = store.notices().join("\n");
    for part in
        ["5 attempts were given a checksum", "1 recordings in", "results.sqlite: it was open to other users"]
    {
        assert!(said.contains(part), "{part}: {said}");
    }
    let mode = |path: &Path| path.metadata().unwrap().permissions().mode() & 0o777;
    assert_eq!([mode(&path), mode(&recording), mode(&elsewhere)], [0o600, 0o600, 0o644]);
    assert_eq!(store.attempts(&Filter::default()).unwrap().len(), 5);
    assert!(Store::open(&path).unwrap().notices().is_empty(), "once");
}

#[test]
fn a_damaged_attempt_is_named_and_the_others_are_given() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    let ids: Vec<i64> =
        (1..4).map(|at| store.add("t7", &attempt(at, "shadow", 5.0)).unwrap().unwrap()).collect();
    let changes = [
        "UPDATE attempts SET total = 95.0 WHERE id = 2",
        "UPDATE points SET points = 19.5 WHERE attempt = 2 AND kind = 'category' AND place = 0",
        "DELETE FROM points WHERE attempt = 2 AND kind = 'metric' AND place = 1",
        "UPDATE attempts SET checksum = NULL WHERE id = 2",
        "UPDATE attempts SET level = -1 WHERE id = 2",
        "UPDATE attempts SET recording = NULL WHERE id = 2",
    ];
    let whole = std::fs::read(&path).unwrap();
    for change in changes {
        std::fs::write(&path, &whole).unwrap();
        Connection::open(&path).unwrap().execute_batch(change).unwrap();
        let mut store = Store::open(&path).unwrap();
        let Reading { attempts, damage } = store.read(&Filter::default()).unwrap();
        assert_eq!(attempts.iter().map(|s| s.id).collect::<Vec<_>>(), [ids[0], ids[2]], "{change}");
        let [error] = &damage[..] else { panic!("{change}: {damage:?}") };
        assert!(error.to_string().contains("results.sqlite: attempt 2 of t7 is damaged"), "{error}");
        assert!(matches!(store.attempts(&Filter::default()), Err(StoreError::Attempt { .. })));
        // Others are added and this one can be removed.
        store.add("t7", &attempt(9, "shadow", 5.0)).unwrap().unwrap();
        assert!(store.delete_attempt("t7", 2).unwrap().is_some());
        assert_eq!(store.attempts(&Filter::default()).unwrap().len(), 3);
    }
}

/// Attempts and trainees of a store.
type Output = (Vec<Stored>, Vec<(String, usize)>);

/// Them, or the first error.
fn output(path: &Path) -> Result<Output, String> {
    let give = || {
        let store = Store::open(path)?;
        Ok((store.attempts(&Filter::default())?, store.trainees()?))
    };
    give().map_err(|e: StoreError| e.to_string())
}

#[test]
fn a_flipped_bit_gives_the_same_attempts_or_an_error() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    for at in 1..9 {
        store.add(["a", "b"][at as usize % 2], &attempt(at, "shadow", 60.0 + at as f64)).unwrap();
    }
    // Half a page of attempts and one of points are free, and hold what was deleted.
    store.delete_attempt("a", 2).unwrap();
    drop(store);
    let whole = std::fs::read(&path).unwrap();
    let expected = output(&path).unwrap();
    let (mut same, mut refused) = (0, 0);
    // Multiplicative steps over the whole file (Knuth's constant), the same in every run.
    let bits = whole.len() as u64 * 8;
    for n in 0..800_u64 {
        let bit = (n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20) % bits;
        let mut flipped = whole.clone();
        flipped[(bit / 8) as usize] ^= 1 << (bit % 8);
        std::fs::write(&path, &flipped).unwrap();
        match output(&path) {
            Ok(found) => {
                assert_eq!(found, expected, "bit {bit}");
                same += 1;
            }
            Err(error) => {
                assert!(error.contains("results.sqlite"), "{error}");
                refused += 1;
            }
        }
        let _ = std::fs::remove_file(path.with_extension("sqlite-journal"));
    }
    println!(
        "{} bits of {} bytes flipped: {same} give the same attempts, {refused} an error",
        same + refused,
        whole.len()
    );
    assert!(same > 50 && refused > 50);
}

#[test]
fn a_truncated_store_is_refused_at_every_length() {
    let (_folder, path) = place();
    let mut store = Store::open_or_create(&path).unwrap();
    for at in 1..30 {
        store.add("a", &attempt(at, "shadow", 1.0)).unwrap();
    }
    drop(store);
    let whole = std::fs::read(&path).unwrap();
    let lengths: Vec<usize> =
        [0, 1, 50, 99, 100, 512].into_iter().chain((1000..whole.len()).step_by(1777)).collect();
    for length in &lengths {
        std::fs::write(&path, &whole[..*length]).unwrap();
        let Err(error) = output(&path) else { panic!("{length} bytes of {} are taken", whole.len()) };
        let named = error.contains("damaged") || error.contains("not a database");
        assert!(named && error.contains("results.sqlite"), "{length}: {error}");
        assert_eq!(std::fs::read(&path).unwrap(), whole[..*length], "it is left unchanged");
    }
    println!("{} lengths of {} bytes refused", lengths.len(), whole.len());
}
