//! What a released version recorded is read for ever: a recording of each is kept, and read, described and
//! verified as far as its version allows.

use recording::Recording;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;
use vitreo_tests::verified::verify;
use vitreo_tests::{repository, vitreo};

/// Where they lie: `VERSION.mcap`, and `next.mcap` of what is to be released.
fn folder() -> PathBuf {
    repository().join("tests/data/recordings")
}

/// The versions in the list of changes.
fn released() -> BTreeSet<String> {
    let changes = std::fs::read_to_string(repository().join("CHANGELOG.md")).expect("changes");
    let versions = changes.lines().filter_map(|line| line.strip_prefix("## ")?.split_whitespace().next());
    versions.filter(|v| v.starts_with(|c: char| c.is_ascii_digit())).map(str::to_owned).collect()
}

#[test]
fn a_recording_of_each_release_is_kept() {
    let files = std::fs::read_dir(folder()).expect("recordings").flatten();
    let names: BTreeSet<String> = files
        .map(|file| file.file_name().to_string_lossy().into_owned())
        .filter_map(|name| name.strip_suffix(".mcap").map(str::to_owned))
        .collect();
    let released = released();
    assert!(released.len() >= 2 && released.is_subset(&names), "{released:?} of {names:?}");
    assert!(names.contains("next"), "{names:?}");
}

#[test]
fn recordings_of_every_release_are_read_described_and_verified() {
    let mut states_compared = 0;
    for version in released().iter().map(String::as_str).chain(["next"]) {
        let file = folder().join(format!("{version}.mcap"));
        let recording = Recording::open(&file).expect("a recording");
        assert!(recording.is_finished() && recording.matches_checksum().expect("readable"), "{version}");
        let mut items = 0u64;
        for item in recording.items() {
            item.unwrap_or_else(|e| panic!("{version}: {e}"));
            items += 1;
        }
        let count = |topic| recording.items_of(&[topic]).count() as u64;
        let (frames, steps) = (count("poses"), count("steps"));
        let path = file.display().to_string();
        let told = vitreo(&["info", &path, "--json"]).expect_code(0).stdout;
        let info: Value = serde_json::from_str(&told).expect("JSON");
        let all: u64 = info["messages"].as_object().expect("topics").values().filter_map(Value::as_u64).sum();
        assert_eq!(all, items, "{version}");
        if version != "next" {
            assert_eq!(info["versions"]["vitreo"].as_str(), Some(version));
        }
        vitreo(&["check", &path]).expect_code(0);
        let verified = verify(&file);
        let (poses, states) = (verified.poses(), verified.states());
        println!("{version}: {items} items; {poses:?}; {states:?}; {:?}", verified.reasons());
        // Every pose is made again, by this tracker; states where their hashes are of this version.
        assert!(frames >= 20 && (poses.recorded, poses.compared) == (frames, frames), "{version}: {poses:?}");
        let provenance = recording.provenance();
        let of_this_tracker = provenance.other_tracker_version().is_none();
        let of_these_states = provenance.other_state_hash_version().is_none();
        let code = if of_this_tracker && of_these_states { 0 } else { 3 };
        let told = verified.finished.expect_code(code).stdout;
        if of_this_tracker {
            assert_eq!(poses.identical, frames, "{version}: {told}");
        } else {
            let differences = verified.report["verify"]["poses"]["differences"].as_object().expect("bodies");
            for (body, difference) in differences {
                assert!(difference["rms_um"].as_f64() < Some(50.0), "{version}, {body}: {told}");
            }
        }
        if of_these_states {
            states_compared += steps;
            assert_eq!([states.recorded, states.compared, states.identical], [steps; 3], "{version}: {told}");
        } else {
            assert!(states.compared == 0 && told.contains("states cannot be compared"), "{version}: {told}");
        }
    }
    assert!(states_compared >= 20, "{states_compared}");
}
