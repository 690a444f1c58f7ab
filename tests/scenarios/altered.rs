//! A recording that was altered or misses something is noticed, and the place is named.

use protocol::steps::STATE_HASH_VERSION;
use recording::{Item, Note, NoteKind, Provenance, Recording, STATE_HASH, Writer};
use std::path::Path;
use vitreo_tests::{Finished, instance_name, repository, vitreo};

/// The field at which each alteration is made.
const FIELD: u64 = 30;

/// Copies a recording through `change`, which may drop an item or put others in its place.
fn rewrite(from: &Path, to: &Path, change: impl Fn(Item) -> Vec<Item>) {
    let provenance = Recording::open(from).expect("recording").provenance().clone();
    rewrite_as(&provenance, from, to, change);
}

/// The same with another provenance.
fn rewrite_as(provenance: &Provenance, from: &Path, to: &Path, change: impl Fn(Item) -> Vec<Item>) {
    let recording = Recording::open(from).expect("recording");
    let mut writer = Writer::create(to, provenance).expect("copy");
    for item in recording.items() {
        let (at, item) = item.expect("item");
        change(item).iter().for_each(|item| writer.write(at, item).expect("written"));
    }
    writer.finish().expect("finished");
}

fn verify(file: &Path) -> Finished {
    let name = instance_name();
    vitreo(&["replay", &file.display().to_string(), "--lockstep", "--verify", "--instance", &name])
}

#[test]
fn alterations_and_losses_are_named_with_their_field() {
    let folder = tempfile::tempdir().expect("folder");
    let (original, altered) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let name = instance_name();
    let run = ["run", "--no-picture", "--direct", "--duration", "2", "--instance", &name, "--record"];
    vitreo(&[&run[..], &[&original.display().to_string()]].concat()).expect_code(0);
    verify(&original).expect_code(0);

    // A state that was never reached.
    rewrite(&original, &altered, |item| match item {
        Item::Step(mut step) if step.field == FIELD => {
            step.state_hash ^= 1;
            vec![Item::Step(step)]
        }
        other => vec![other],
    });
    let found = verify(&altered).expect_code(5);
    assert!(found.stdout.contains(&format!("differs at field {FIELD}")), "{found:?}");

    // A pose that was never published: one bit of one number.
    rewrite(&original, &altered, |item| match item {
        Item::Poses(mut frame) if frame.field == FIELD => {
            let x = &mut frame.bodies[0].world_from_body.position_mm[0];
            *x = f64::from_bits(x.to_bits() ^ 1);
            vec![Item::Poses(frame)]
        }
        other => vec![other],
    });
    let found = verify(&altered).expect_code(5);
    assert!(found.stdout.contains(&format!("differs at field {FIELD}")), "{found:?}");

    // A camera-field that the recorder missed.
    rewrite(&original, &altered, |item| match item {
        Item::Blobs(field) if field.field == FIELD && field.camera == 1 => vec![],
        other => vec![other],
    });
    let found = verify(&altered).expect_code(3);
    assert!(found.stdout.contains(&format!("field {FIELD}")), "{found:?}");

    // A loss that the recorder noticed and wrote down.
    rewrite(&original, &altered, |item| match item {
        Item::Poses(frame) if frame.field == FIELD => {
            let text = "7 items did not fit".to_string();
            let note = Note { instant_ns: 1, kind: NoteKind::Loss, process: None, count: 7, text };
            vec![Item::Note(note), Item::Poses(frame)]
        }
        other => vec![other],
    });
    let found = verify(&altered).expect_code(3);
    assert!(found.stdout.contains("7 items did not fit"), "{found:?}");
}

#[test]
fn states_of_another_hash_version_are_not_compared() {
    let folder = tempfile::tempdir().expect("folder");
    let copy = folder.path().join("golden.mcap");
    let golden = repository().join("tests/data/golden/peel-2s.mcap");
    let mut provenance = Recording::open(&golden).expect("golden").provenance().clone();
    provenance.versions.insert(STATE_HASH.into(), (STATE_HASH_VERSION + 1).to_string());

    rewrite_as(&provenance, &golden, &copy, |item| match item {
        Item::Step(mut step) => {
            step.state_hash ^= 1;
            vec![Item::Step(step)]
        }
        other => vec![other],
    });
    let found = verify(&copy).expect_code(3);
    assert!(found.stdout.contains("poses identical; states cannot be compared"), "{found:?}");

    // Poses are compared all the same.
    rewrite_as(&provenance, &golden, &copy, |item| match item {
        Item::Poses(mut frame) if frame.field == FIELD => {
            frame.bodies[0].residual_px += 1.0;
            vec![Item::Poses(frame)]
        }
        other => vec![other],
    });
    let found = verify(&copy).expect_code(5);
    assert!(found.stdout.contains(&format!("differs at field {FIELD}")), "{found:?}");
}
