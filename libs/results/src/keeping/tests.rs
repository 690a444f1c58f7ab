//! Recordings that become attempts.

use super::*;
use crate::store::Filter;
use crate::table::Table;
use recording::{Provenance, Writer};
use surgeon::skill::EXPERT;

/// A recording of an attempt that was broken off before anything happened.
fn broken_off(file: &Path) {
    let scene = surgeon::compose(&surgeon::load("navigation").unwrap(), 1, &EXPERT, 1).unwrap();
    let mut provenance = Provenance { scene_toml: scene.to_toml(), ..Provenance::default() };
    provenance.rig_json = rig::Rig::load_or_shipped(None).unwrap().to_json();
    provenance.seeds.insert("cameras".into(), "42".into());
    provenance.config.insert(BEGAN.into(), "1032942600".into());
    Writer::create(file, &provenance).unwrap().finish().unwrap();
}

#[test]
fn a_recording_becomes_an_attempt_and_one_not_begun_is_not_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (file, store) = (folder.path().join("a.mcap"), folder.path().join("r.sqlite"));
    broken_off(&file);
    let mut store = Store::open_or_create(&store).unwrap();
    let problem = keep(&mut store, "t7", &file).unwrap_err().to_string();
    assert!(problem.contains("a.mcap") && problem.contains("never started"), "{problem}");
    let attempt = attempt_of(&Recording::open(&file).unwrap(), &score_file(&file).unwrap());
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
    let older = check(&[("t7".into(), 3, 4)]).unwrap();
    assert!(older.len() == 1 && older[0].contains("also attempt 3 of t7, with score version 4"), "{older:?}");
    assert!(check(&[]).unwrap().is_empty());
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open_or_create(&folder.path().join("r.sqlite")).unwrap();
    let with = |sha: &str| Attempt { recording_sha256: Some(sha.into()), ..attempt.clone() };
    let id = store.add("t8", &with("11")).unwrap().unwrap();
    assert_eq!(store.holders("11").unwrap(), [("t8".into(), id, 5)]);
    assert_eq!(store.holders("22").unwrap(), []);
}
