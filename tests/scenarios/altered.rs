//! A recording that was altered or misses something is noticed, and the place is named.

use recording::{Item, Note, NoteKind, Recording, Writer};
use std::path::Path;
use vitreo_tests::{Finished, instance_name, vitreo};

/// The field at which each alteration is made.
const FIELD: u64 = 30;

/// Copies a recording through `change`, which may drop an item or put others in its place.
fn rewrite(from: &Path, to: &Path, change: impl Fn(Item) -> Vec<Item>) {
    let recording = Recording::open(from).expect("recording");
    let mut writer = Writer::create(to, recording.provenance()).expect("copy");
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
