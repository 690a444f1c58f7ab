//! A recording that was altered or misses something is noticed, the place is named, and what is left is
//! verified.

use protocol::steps::STATE_HASH_VERSION;
use recording::{Item, Note, NoteKind, Provenance, Recording, STATE_HASH, TRACKER, TRACKER_VERSION, Writer};
use std::path::{Path, PathBuf};
use vitreo_tests::verified::{Verified, WITHOUT_FRAME, verify};
use vitreo_tests::{instance_name, repository, vitreo};

/// The field at which each alteration is made, and how many may be missing from it on.
const FIELD: u64 = 130;
const MISSING: u64 = 50;

/// Copies a recording through `change`, which may drop an item or put others in its place.
fn rewrite(from: &Path, to: &Path, change: impl FnMut(Item) -> Vec<Item>) {
    let provenance = Recording::open(from).expect("recording").provenance().clone();
    rewrite_as(&provenance, from, to, change);
}

/// The same with another provenance.
fn rewrite_as(provenance: &Provenance, from: &Path, to: &Path, mut change: impl FnMut(Item) -> Vec<Item>) {
    let recording = Recording::open(from).expect("recording");
    let mut writer = Writer::create(to, provenance).expect("copy");
    for item in recording.items() {
        let (at, item) = item.expect("item");
        change(item).iter().for_each(|item| writer.write(at, item).expect("written"));
    }
    writer.finish().expect("finished");
}

/// A run of 12 s with its checkpoints, and where copies of it go.
struct Recorded {
    folder: tempfile::TempDir,
    original: PathBuf,
    /// Steps that follow the first checkpoint after all that is missing.
    behind: u64,
    /// Numbers of the newest pedal states that the field's step consumed, and that after what is missing.
    pedals: [u64; 2],
    verified: Verified,
}

fn record() -> Recorded {
    let folder = tempfile::tempdir().expect("folder");
    let original = folder.path().join("a.mcap");
    let name = instance_name();
    let run = ["run", "--no-picture", "--direct", "--duration", "12", "--instance", &name, "--record"];
    vitreo(&[&run[..], &[&original.display().to_string()]].concat()).expect_code(0);
    let items: Vec<Item> =
        Recording::open(&original).expect("recording").items().map(|i| i.expect("item").1).collect();
    let checkpoint = items.iter().find_map(|item| match item {
        Item::Checkpoint(header, _) if header.field > FIELD + MISSING => Some(header.step),
        _ => None,
    });
    let checkpoint = checkpoint.expect("a checkpoint after the field");
    let behind = items.iter().filter(|i| matches!(i, Item::Step(s) if s.step > checkpoint)).count() as u64;
    assert!(behind > 50, "{behind} steps behind the checkpoint");
    let pedals = [FIELD, FIELD + MISSING].map(|field| {
        let of_field = |item: &Item| match item {
            Item::Step(step) if step.field == field => Some(step.pedals_below - 1),
            _ => None,
        };
        items.iter().find_map(of_field).expect("the field's step")
    });
    let verified = verify(&original).expect_but([400, 400], &[WITHOUT_FRAME]);
    Recorded { folder, original, behind, pedals, verified }
}

impl Recorded {
    fn altered(&self, change: impl FnMut(Item) -> Vec<Item>) -> Verified {
        let copy = self.folder.path().join("b.mcap");
        rewrite(&self.original, &copy, change);
        verify(&copy)
    }

    /// What is left of a recording without what `lost` selects verifies; the states behind the next
    /// checkpoint among it.
    fn without(&self, lost: impl Fn(&Item) -> bool, words: &str) {
        let mut dropped = 0;
        let found = self.altered(|item| {
            let lost = lost(&item);
            dropped += u64::from(lost);
            if lost { vec![] } else { vec![item] }
        });
        assert!(dropped > 0, "{words}: nothing was dropped");
        let before = FIELD / 2;
        let found = found.expect([before, before + self.behind]);
        assert_eq!(found.finished.code, Some(3), "{words}");
        assert!(found.reasons().join("; ").contains(words), "{words}: {:?}", found.reasons());
    }
}

#[test]
fn alterations_and_losses_are_named_with_their_field_and_the_rest_is_verified() {
    let recorded = record();
    let all = recorded.verified.states().recorded;

    // A state that was never reached.
    let found = recorded.altered(|item| match item {
        Item::Step(mut step) if step.field == FIELD => {
            step.state_hash ^= 1;
            vec![Item::Step(step)]
        }
        other => vec![other],
    });
    let states = found.states();
    assert_eq!((states.compared, states.identical), (all, all - 1));
    let found = found.finished.expect_code(5);
    assert!(found.stdout.contains(&format!("differs at field {FIELD}")), "{found:?}");

    // A pose that was never published: one bit of one number. What follows it in the tracker is as before.
    let found = recorded.altered(|item| match item {
        Item::Poses(mut frame) if frame.field == FIELD => {
            let x = &mut frame.bodies[0].world_from_body.position_mm[0];
            *x = f64::from_bits(x.to_bits() ^ 1);
            vec![Item::Poses(frame)]
        }
        other => vec![other],
    });
    assert_eq!(found.poses().identical + 1, found.poses().compared);
    let found = found.finished.expect_code(5);
    assert!(found.stdout.contains(&format!("differs at field {FIELD}")), "{found:?}");

    // A loss that the recorder noticed and wrote down, of nothing that was needed.
    let text = "7 items did not fit".to_string();
    let found = recorded.altered(|item| match item {
        Item::Poses(frame) if frame.field == FIELD => {
            let note =
                Note { instant_ns: 1, kind: NoteKind::Loss, process: None, count: 7, text: text.clone() };
            vec![Item::Note(note), Item::Poses(frame)]
        }
        other => vec![other],
    });
    let found = found.expect([all - 1, all]);
    assert!(found.finished.code == Some(3) && found.reasons()[0].contains(&text), "{found:?}");

    // A step's record alone is as after a restart of the simulation: the step is made again in silence.
    let found = recorded.altered(|item| match item {
        Item::Step(s) if s.field == FIELD => vec![],
        other => vec![other],
    });
    found.expect([all - 1, all - 1]);

    // What the recorder missed.
    let at_field = |field| field == FIELD;
    recorded.without(
        |item| matches!(item, Item::Blobs(b) if at_field(b.field) && b.camera == 1),
        &format!("field {FIELD}"),
    );
    recorded.without(|item| matches!(item, Item::Poses(p) if at_field(p.field)), "tracker frame");
    recorded.without(|item| matches!(item, Item::Handle(h) if at_field(h.field)), "handle state");
    recorded.without(|item| matches!(item, Item::Pedal(p) if p.seq == recorded.pedals[0]), "pedal state");
    // A second in which the disk took nothing.
    let full = |field| (FIELD..FIELD + MISSING).contains(&field);
    let full = |item: &Item| match item {
        Item::Blobs(b) => full(b.field),
        Item::Poses(p) => full(p.field),
        Item::Step(s) => full(s.field),
        Item::Handle(h) => full(h.field),
        Item::Pedal(p) => (recorded.pedals[0]..recorded.pedals[1]).contains(&p.seq),
        _ => false,
    };
    recorded.without(full, WITHOUT_FRAME);
}

#[test]
fn a_flipped_byte_in_a_chunk_costs_what_lies_in_it() {
    let recorded = record();
    let mut bytes = std::fs::read(&recorded.original).expect("bytes");
    let at = bytes.len() / 5;
    bytes[at] ^= 0x40;
    let copy = recorded.folder.path().join("flipped.mcap");
    std::fs::write(&copy, bytes).expect("copy");
    let found = verify(&copy).expect([50, recorded.behind]);
    assert_eq!(found.finished.code, Some(3));
    assert!(found.reasons().join("; ").contains("damaged at byte"), "{:?}", found.reasons());
}

/// No picture is made for the time between the machine's start and the first step that is left.
#[test]
fn a_film_of_a_recording_with_damaged_first_chunks_is_no_longer_than_the_recording() {
    let recorded = record();
    let mut bytes = std::fs::read(&recorded.original).expect("bytes");
    // MCAP: 8 bytes, then records of a kind, 6 for a chunk, and a length of 8 bytes.
    let (mut at, mut damaged) = (8, 0);
    while damaged < 4 {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("8 bytes")) as usize;
        if bytes[at] == 6 {
            bytes[at + 9 + length / 2] ^= 0x40;
            damaged += 1;
        }
        at += 9 + length;
    }
    let copy = recorded.folder.path().join("damaged.mcap");
    std::fs::write(&copy, bytes).expect("copy");
    let stills = recorded.folder.path().join("stills");
    let [copy, folder] = [&copy, &stills].map(|p| p.display().to_string());
    let film = ["film", &copy, "--tier", "8", "--every", "1", "--stills", &folder];
    assert!(vitreo(&film).expect_code(3).stderr.contains("damaged at byte"));
    let drawn = std::fs::read_dir(&stills).expect("stills").count();
    // It begins at the first checkpoint that is left.
    assert!((5..=12).contains(&drawn), "{drawn} stills of 12 s, one a second");
}

fn golden() -> PathBuf {
    repository().join("tests/data/golden/peel-2s.mcap")
}

/// A copy of the golden recording.
fn golden_as(versions: &[(&str, Option<u32>)], change: impl FnMut(Item) -> Vec<Item>) -> Verified {
    let folder = tempfile::tempdir().expect("folder");
    let copy = folder.path().join("golden.mcap");
    let mut provenance = Recording::open(&golden()).expect("golden").provenance().clone();
    for (key, version) in versions {
        match version {
            Some(version) => provenance.versions.insert((*key).into(), version.to_string()),
            None => provenance.versions.remove(*key),
        };
    }
    rewrite_as(&provenance, &golden(), &copy, change);
    verify(&copy)
}

/// Every state hash is another one.
fn other_hashes(item: Item) -> Vec<Item> {
    match item {
        Item::Step(mut step) => {
            step.state_hash ^= 1;
            vec![Item::Step(step)]
        }
        other => vec![other],
    }
}

#[test]
fn states_of_another_hash_version_are_not_compared_and_poses_are_all_the_same() {
    let other = [(TRACKER, Some(TRACKER_VERSION)), (STATE_HASH, Some(STATE_HASH_VERSION + 1))];
    let found = golden_as(&other, other_hashes).expect([50, 0]);
    assert_eq!((found.finished.code, found.states().compared), (Some(3), 0));
    assert!(found.states().recorded > 50 && found.reasons()[0].contains("states cannot be compared"));
    let found = golden_as(&other, |item| match item {
        Item::Poses(mut frame) if frame.field == 30 => {
            frame.bodies[0].residual_px += 1.0;
            vec![Item::Poses(frame)]
        }
        other => vec![other],
    });
    assert!(found.finished.expect_code(5).stdout.contains("differs at field 30"));
}

#[test]
fn poses_of_another_tracker_are_measured_and_the_states_are_verified() {
    let all = Recording::open(&golden()).expect("golden").items_of(&["steps"]).count() as u64;
    for (version, words) in
        [(None, "computed by a tracker without a version"), (Some(99), "made by tracker 99")]
    {
        let found = golden_as(&[(TRACKER, version)], |item| vec![item]).expect([50, all]);
        assert_eq!(found.finished.code, Some(3));
        let words = format!("{words}, this is {TRACKER_VERSION}");
        assert!(found.finished.stdout.contains(&words), "{found:?}");
        assert!(found.reasons().contains(&words), "{found:?}");
    }
}

#[test]
fn blobs_without_poses_and_poses_without_blobs_are_said() {
    let only = |topics: &'static [&'static str]| {
        golden_as(&[], move |item| if topics.contains(&item.topic()) { vec![item] } else { vec![] })
    };
    let found = only(&["blobs"]);
    assert_eq!((found.poses().recorded, found.states().recorded), (0, 0));
    let told = found.finished.expect_code(1).stderr;
    for words in ["nothing could be compared", "no poses were recorded", WITHOUT_FRAME] {
        assert!(told.contains(words), "{words}: {told}");
    }
    // The states are made of the poses all the same.
    let found = only(&["poses", "steps", "handles", "pedal", "checkpoints"]).expect([0, 50]);
    assert_eq!((found.finished.code, found.poses().compared), (Some(3), 0));
    assert!(found.poses().recorded > 50 && found.states().identical == found.states().recorded);
    assert!(found.reasons().join("; ").contains("no camera-fields were recorded"), "{:?}", found.reasons());
    let found = only(&["blobs", "poses"]).expect([50, 0]);
    assert_eq!(found.finished.code, Some(3));
    assert!(found.reasons().join("; ").contains("no steps were recorded"), "{:?}", found.reasons());
}

/// A tracker that withholds its frames from some field on leaves a recording that says so.
#[test]
fn fields_without_a_frame_fail_verification_and_the_share_that_is_asserted() {
    let found = golden_as(&[], |item| match &item {
        Item::Poses(p) if p.field >= 60 => vec![],
        Item::Step(s) if s.field >= 60 => vec![],
        _ => vec![item],
    });
    let found = found.expect([50, 50]);
    assert_eq!(found.finished.code, Some(3));
    assert!(found.reasons().join("; ").contains(WITHOUT_FRAME), "{:?}", found.reasons());
    let share = found.report["tracking"]["bodies"]["eye"]["tracked_share"].as_f64().expect("a share");
    assert!((0.5..0.7).contains(&share), "{share} of 100 fields, of which 60 have frames");
    let folder = tempfile::tempdir().expect("folder");
    let copy = folder.path().join("withheld.mcap");
    rewrite(&golden(), &copy, |item| match &item {
        Item::Poses(p) if p.field >= 60 => vec![],
        Item::Step(s) if s.field >= 60 => vec![],
        _ => vec![item],
    });
    let path = copy.display().to_string();
    let asserted = vitreo(&["replay", &path, "--lockstep", "--assert-tracking", "0.9"]);
    assert!(asserted.expect_code(6).stderr.contains("of the frames that should have been"));
}

#[test]
fn a_recording_that_was_not_closed_is_said_to_be_so() {
    let folder = tempfile::tempdir().expect("folder");
    let open = folder.path().join("open.mcap");
    let mut bytes = std::fs::read(golden()).expect("golden");
    // Without MCAP's summary, its footer and the record before them that ends the data.
    let footer = bytes.len() - 28;
    let summary = u64::from_le_bytes(bytes[footer..footer + 8].try_into().expect("8 bytes"));
    bytes.truncate(summary as usize - 13);
    std::fs::write(&open, bytes).expect("copy");
    let told = vitreo(&["info", &open.display().to_string()]).expect_code(3);
    assert!(told.stderr.contains("not closed properly") && told.stdout.contains("poses"), "{told:?}");
    let verified = verify(&open).expect_but([50, 50], &["not closed properly"]);
    assert_eq!(verified.finished.code, Some(3));
}
