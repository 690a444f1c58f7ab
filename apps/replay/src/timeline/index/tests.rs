//! Indexes of recordings without checkpoints, and files that are none.

use super::*;
use crate::engine::{Made, Streamed, stream};
use crate::test_runs::golden;
use crate::timeline::player::Player;
use crate::timeline::{Moment, Target};
use proptest::prelude::*;
use recording::Item;
use std::fs;
use std::ops::ControlFlow;
use std::sync::LazyLock;

/// Hash of the state behind every step.
type States = Vec<(Moment, u64)>;

/// The golden recording, which has no checkpoints of its tracker, in a folder of its own.
fn copied(folder: &Path) -> Recording {
    let path = folder.join("a.mcap");
    fs::copy(golden().path(), &path).unwrap();
    Recording::open(&path).unwrap()
}

/// The camera-fields of the golden recording as an imported stream.
fn imported(folder: &Path) -> Recording {
    let path = folder.join("stream.mcap");
    let provenance = Provenance { source: Source::Import, ..golden().provenance().clone() };
    let mut writer = Writer::create(&path, &provenance).unwrap();
    for item in golden().items_of(&["blobs"]) {
        let (at, item) = item.unwrap();
        writer.write(at, &item).unwrap();
    }
    writer.finish().unwrap();
    Recording::open(&path).unwrap()
}

fn open_in(recording: &Recording, places: &[PathBuf]) -> Timeline {
    open_at(recording, places, &StopSignal::default()).unwrap()
}

fn player(timeline: Timeline) -> Player {
    let world = World::new(&scene_of(timeline.recording()).unwrap()).unwrap().unseen();
    Player::new(timeline, world).unwrap()
}

fn rest(player: &mut Player) -> States {
    let mut states = Vec::new();
    let ended = player.play(|made| {
        if let Made::Step(again) = made {
            assert_eq!(again.step.state_hash, again.recorded.state_hash);
            states.push((Moment::of(&again.recorded), again.step.state_hash));
        }
        Ok(ControlFlow::Continue(()))
    });
    assert!(!ended.unwrap());
    states
}

/// Every place is reached, and what follows is what follows there in a run from the beginning.
fn leads_everywhere(timeline: Timeline) -> States {
    assert!(timeline.pairs().unwrap().heads().len() >= 1);
    let mut player = player(timeline);
    let all = rest(&mut player);
    assert!(all.len() > 80);
    for i in (0..all.len()).step_by(9) {
        assert_eq!(player.seek(Target::Exposed(all[i].0.exposed_ns)).unwrap().at, Some(all[i].0));
        assert_eq!(player.world().state_hash(), all[i].1);
        assert_eq!(rest(&mut player), all[i + 1..]);
    }
    all
}

#[test]
fn a_recording_without_checkpoints_is_indexed_once() {
    let folder = tempfile::tempdir().unwrap();
    let recording = copied(folder.path());
    let before = fs::read(recording.path()).unwrap();
    let places = places(recording.path(), |_| None);
    assert_eq!(places, [folder.path().join("a.mcap.index")]);
    leads_everywhere(open_in(&recording, &places));
    let made = fs::read(&places[0]).unwrap();
    leads_everywhere(open_in(&recording, &places));
    assert!(fs::read(&places[0]).unwrap() == made, "it was made again");
    assert!(fs::read(recording.path()).unwrap() == before);
}

#[test]
fn an_imported_stream_is_played_from_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let recording = imported(folder.path());
    let all = leads_everywhere(open_in(&recording, &places(recording.path(), |_| None)));
    let scene = scene_of(&recording).unwrap();
    let rig = Rig::parse(&recording.provenance().rig_json, "golden").unwrap();
    let mut hashes = Vec::new();
    let damage = stream(&recording, &rig, World::new(&scene).unwrap().unseen(), |made| {
        if let Streamed::Frame { report, .. } = made {
            hashes.push(report.state_hash);
        }
        Ok(ControlFlow::Continue(()))
    });
    assert!(damage.unwrap().is_none());
    assert!(hashes.iter().copied().eq(all.iter().map(|(_, hash)| *hash)));
}

#[test]
fn where_the_folder_takes_no_file_the_index_lies_in_the_cache() {
    let folder = tempfile::tempdir().unwrap();
    let recording = copied(folder.path());
    let cache = folder.path().join("cache");
    let found = places(recording.path(), |name| (name == "XDG_CACHE_HOME").then(|| cache.clone()));
    assert!(found[1].starts_with(cache.join("vitreo")), "{found:?}");
    let home = places(recording.path(), |name| (name == "HOME").then(|| folder.path().into()));
    assert!(home[1].starts_with(folder.path().join(".cache/vitreo")), "{home:?}");
    let relative = places(recording.path(), |_| Some("cache".into()));
    assert_eq!(relative.len(), 1, "a relative path is passed over");
    let closed = [PathBuf::from("/sys/a.index"), found[1].clone()];
    assert!(open_in(&recording, &closed).has_checkpoints() && found[1].exists());
    let nowhere = open_in(&recording, &closed[..1]);
    assert!(!nowhere.has_checkpoints());
    let mut player = player(nowhere);
    let step = player.timeline().ends().unwrap()[1].step;
    assert_eq!(player.seek(Target::Step(step)).unwrap().at.unwrap().step, step);
}

#[test]
fn a_stop_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let recording = copied(folder.path());
    let stop = StopSignal::default();
    stop.raise();
    let stopped = open_at(&recording, &places(recording.path(), |_| None), &stop);
    assert!(stopped.unwrap_err().is::<crate::pace::Stopped>());
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["a.mcap"]);
}

#[test]
fn an_index_of_another_recording_or_version_is_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let recording = copied(folder.path());
    let place = places(recording.path(), |_| None).remove(0);
    open_in(&recording, std::slice::from_ref(&place));
    let wanted = identity(&recording).unwrap();
    assert!(checked(&place, &wanted).is_ok());
    let refused = |provenance: &Provenance| {
        let mut writer = Writer::create(&place, provenance).unwrap();
        writer.write(1, &Item::Pedal(bytemuck::Zeroable::zeroed())).unwrap();
        writer.finish().unwrap();
        checked(&place, &wanted).unwrap_err().to_string()
    };
    let good = checked(&place, &wanted).unwrap().provenance().clone();
    assert!(refused(recording.provenance()).contains("it is of nothing"));
    let mut other = good.clone();
    other.versions.insert(TRACKER.into(), "1".into());
    assert!(refused(&other).contains("another version"));
    let mut other = good;
    other.config.insert(INDEX_OF.into(), "7 bytes".into());
    assert!(refused(&other).contains("it is of 7 bytes"));
    open_in(&recording, std::slice::from_ref(&place));
    assert!(checked(&place, &wanted).is_ok(), "it was made again");
    // A recording that has changed.
    let mut bytes = fs::read(recording.path()).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(recording.path(), &bytes).unwrap();
    assert!(identity(&Recording::open(recording.path()).unwrap()).unwrap() != wanted);
}

/// A good index, and the recording that it is of.
static INDEX: LazyLock<(Recording, Vec<u8>, tempfile::TempDir)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let recording = copied(folder.path());
    let place = places(recording.path(), |_| None).remove(0);
    open_in(&recording, std::slice::from_ref(&place));
    let bytes = fs::read(&place).unwrap();
    (recording, bytes, folder)
});

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..Default::default() })]

    #[test]
    fn hostile_indexes_are_refused_or_lead_nowhere_wrong(
        hits in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 0..4),
        cut in prop::option::of(any::<prop::sample::Index>()),
        step in 2u64..90,
    ) {
        let (recording, good, folder) = &*INDEX;
        let place = folder.path().join("hostile.index");
        let mut bytes = good.clone();
        hits.iter().for_each(|(at, xor)| {
            let at = at.index(bytes.len());
            bytes[at] ^= xor;
        });
        cut.iter().for_each(|at| bytes.truncate(at.index(bytes.len())));
        fs::write(&place, &bytes).unwrap();
        let wanted = identity(recording).unwrap();
        if bytes == *good {
            prop_assert!(checked(&place, &wanted).is_ok());
        } else {
            prop_assert!(checked(&place, &wanted).is_err());
        }
        // Also what no checksum keeps away leads to true states only.
        if let Ok(index) = Recording::open(&place) {
            let timeline = with_index(Timeline::open(recording).unwrap(), index).unwrap();
            let mut player = player(timeline);
            prop_assert_eq!(player.seek(Target::Step(step)).unwrap().at.unwrap().step, step);
            let rest = rest(&mut player);
            prop_assert!(rest.iter().all(|(at, _)| at.step > step) && !rest.is_empty());
        }
    }
}
