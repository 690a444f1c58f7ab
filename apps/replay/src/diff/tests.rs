//! Recordings beside changed copies of themselves.

use super::causes::{Cause, Confidence};
use super::comparison::{Comparison, StageName};
use super::side::Side;
use super::{instant, read, text};
use recording::{Item, Recording, Writer};
use std::path::{Path, PathBuf};

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/golden/peel-2s.mcap")
}

/// The golden recording with its items changed, beside itself.
fn compared(change: impl Fn(Item) -> Option<Item>) -> Comparison {
    let (_folder, [a, b]) = sides(change);
    Comparison::of(&a, &b, 0.0)
}

/// The golden recording, and with its items changed; in a folder.
fn sides(change: impl Fn(Item) -> Option<Item>) -> (tempfile::TempDir, [Side; 2]) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("b.mcap");
    let recording = Recording::open(&golden()).unwrap();
    let mut writer = Writer::create(&file, recording.provenance()).unwrap();
    for (at, item) in recording.items().map(Result::unwrap) {
        if let Some(item) = change(item) {
            writer.write(at, &item).unwrap();
        }
    }
    writer.finish().unwrap();
    let sides = read(&golden(), &file, true).unwrap();
    (folder, sides)
}

#[test]
fn a_recording_is_the_same_as_itself() {
    let [a, b] = read(&golden(), &golden(), true).unwrap();
    let same = Comparison::of(&a, &b, 0.0);
    assert!(
        same.same && same.causes.is_empty() && same.stages.is_empty(),
        "{:?} {:?}",
        same.stages,
        same.causes
    );
    assert!(
        same.inputs.fields_compared > 250 && same.poses.frames_compared > 90 && same.states.compared > 90
    );
    assert!(same.inputs.handles_compared > 100);
    assert!(text::text(&same).contains("same: "));
}

#[test]
fn a_clock_that_began_elsewhere_and_other_numbers_are_no_difference() {
    const LATER_NS: u64 = 5_000_000_000;
    let other = compared(|mut item| {
        match &mut item {
            Item::Blobs(field) => {
                field.exposed_ns += LATER_NS;
                field.field += 10_000;
            }
            Item::Poses(frame) => {
                frame.instants.exposed += LATER_NS;
                frame.field += 10_000;
            }
            Item::Handle(handle) => handle.instant_ns += LATER_NS,
            Item::Step(step) => step.field += 10_000,
            Item::Event(event) => event.field += 10_000,
            _ => {}
        }
        Some(item)
    });
    // Handles name their field, and are paired by their own numbers.
    let differing: Vec<StageName> = other.stages.iter().map(|s| s.stage).collect();
    assert_eq!(differing, [], "{:?}", other.stages);
    assert_eq!((other.inputs.clock_offset_s, other.poses.identical), (5.0, other.poses.frames_compared));
}

#[test]
fn a_lost_field_a_lost_handle_and_a_changed_pose_are_named() {
    let lost = compared(|item| {
        Some(item).filter(|i| !matches!(i, Item::Blobs(f) if f.camera == 1 && f.field == 40))
    });
    assert!(
        matches!(&lost.causes[..], [f] if matches!(&f.cause, Cause::InputMissing { what, count: 1, lacking: 'B' } if what == "field 40 of camera 1")),
        "{:?}",
        lost.causes
    );
    assert_eq!(
        (lost.stages[0].stage, lost.stages[0].field, lost.stages.len()),
        (StageName::Inputs, Some(40), 1)
    );
    let lost = compared(|item| Some(item).filter(|i| !matches!(i, Item::Handle(h) if h.seq == 30)));
    assert!(
        matches!(&lost.causes[..], [f] if matches!(&f.cause, Cause::InputMissing { what, .. } if what.starts_with("handle state 30"))),
        "{:?}",
        lost.causes
    );
    let moved = compared(|mut item| {
        if let Item::Poses(frame) = &mut item
            && frame.field == 50
        {
            frame.bodies[0].world_from_body.position_mm[2] += 0.010;
        }
        Some(item)
    });
    let stage = &moved.stages[0];
    assert_eq!((stage.stage, stage.field), (StageName::Poses, Some(50)));
    assert!(stage.entry.starts_with("bodies.inst0.pose"), "{stage:?}");
    assert!(
        matches!(&moved.causes[..], [f] if f.confidence == Confidence::Possible && matches!(f.cause, Cause::Unexplained { .. })),
        "{:?}",
        moved.causes
    );
    assert!((moved.poses.bodies[0].max_um - 10.0).abs() < 1e-6 && moved.poses.bodies[0].max_field == 50);
}

#[test]
fn a_page_needs_no_network_and_escapes_what_it_shows() {
    let [mut a, b] = read(&golden(), &golden(), false).unwrap();
    a.file = "<b>&\".mcap".into();
    let page = super::page::html(&Comparison::of(&a, &b, 0.0), None).unwrap();
    assert!(
        page.contains("&lt;b&gt;&amp;&quot;.mcap") && page.contains("<svg") && page.contains("are the same")
    );
    assert!(!page.contains("<b>") && !page.contains("src=") && !page.contains("href=\"http"), "{page}");
}

#[test]
fn a_recording_that_ends_earlier_is_shorter_and_has_lost_no_camera() {
    let shorter = compared(|item| {
        let field = match &item {
            Item::Blobs(field) => field.field,
            Item::Poses(frame) => frame.field,
            _ => 0,
        };
        (field < 60).then_some(item)
    });
    let found: Vec<&Cause> = shorter.causes.iter().map(|finding| &finding.cause).collect();
    assert!(matches!(found[..], [Cause::Shorter { lacking: 'B', fields: 120 }]), "{found:?}");
}

#[test]
fn recordings_differ_most_at_the_largest_distance_else_at_the_first_event_or_entry() {
    let worst = |change: &dyn Fn(Item) -> Option<Item>| {
        let (_folder, [a, b]) = sides(change);
        instant::of(&Comparison::of(&a, &b, 0.0), &a, &b)
    };
    assert!(worst(&Some).is_none(), "nothing differs");
    let moved = worst(&|mut item| {
        if let Item::Poses(frame) = &mut item
            && [40, 50].contains(&frame.field)
        {
            frame.bodies[1].world_from_body.position_mm[0] += frame.field as f64 * 1e-3;
        }
        Some(item)
    });
    let moved = moved.expect("poses differ");
    assert!(moved.why.contains("inst1 is 50.00 µm apart"), "{moved:?}");
    assert_eq!((moved.fields, moved.bodies.len()), ([Some(50); 2], 3));
    assert!((moved.bodies[1].apart_um.unwrap() - 50.0).abs() < 1e-6 && moved.bodies[0].apart_um == Some(0.0));
    let state = worst(&|mut item| {
        if let Item::Step(step) = &mut item
            && step.field >= 60
        {
            step.state_hash ^= 1;
        }
        Some(item)
    });
    let state = state.expect("states differ");
    assert!(state.why.contains("in states: state_hash of step"), "{state:?}");
    assert!(state.fields[0].is_some_and(|field| field.abs_diff(60) <= 1) && state.at_s[0] > 1.0, "{state:?}");
    assert!(state.differs.iter().any(|what| what.contains("state_hash")), "{state:?}");
}
