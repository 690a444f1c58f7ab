//! A run as a recorder sees it, whole and with something missing, repeated.

use super::*;
use bytemuck::Zeroable;
use protocol::steps::InputsDigest;
use scene::SceneFile;
use surgeon::rehearsal::Rehearsal;

/// A run of `fields` fields as a recorder sees it, with a checkpoint after each of `saves`.
fn record(fields: u64, saves: &[u64]) -> (World, Vec<Entry>) {
    let scene = SceneFile::load("peel").unwrap();
    let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
    let mut items = Vec::new();
    for field in 200..200 + fields {
        let (frame, handles) = rehearsal.field(field);
        let pedal = PedalState { seq: field, axes: [0.5, 0.1], ..PedalState::zeroed() };
        items.extend(handles.map(Entry::Handle));
        items.push(Entry::Pedal(pedal));
        items.push(Entry::Poses(Box::new(frame)));
        let input = StepInput { frame: &frame, handles: &handles, pedals: &[pedal] };
        let report = world.step(&input, &mut no_clock);
        let mut step = StepRecord::zeroed();
        (step.step, step.field, step.frame) = (world.state().step, frame.field, frame.frame);
        (step.instants, step.state_hash) = (frame.instants, report.state_hash);
        step = step.with_inputs(report.inputs);
        step.handles_below = world.state().handles_below;
        step.pedals_below = world.state().pedals_below;
        items.push(Entry::Step(step));
        if saves.contains(&(field - 200)) {
            items.push(checkpoint(&world, &step));
        }
    }
    (world, items)
}

fn checkpoint(world: &World, step: &StepRecord) -> Entry {
    let mut bytes = Vec::new();
    world.save(&mut bytes).unwrap();
    let mut header = CheckpointHeader::zeroed();
    (header.step, header.field, header.state_hash) = (step.step, step.field, step.state_hash);
    (header.handles_below, header.pedals_below) = (step.handles_below, step.pedals_below);
    header.bytes = bytes.len() as u64;
    Entry::Checkpoint(header, bytes)
}

fn repeat(items: Vec<Entry>) -> (World, ResumeOutcome) {
    let mut world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
    let mut past = InputHistory::default();
    items.into_iter().for_each(|i| past.note(i));
    let resumed = past.replay(&mut world).unwrap();
    (world, resumed)
}

#[test]
fn goes_on_from_the_newest_checkpoint_to_the_last_step() {
    let (world, items) = record(100, &[10, 60]);
    let (again, resumed) = repeat(items);
    assert_eq!(resumed, ResumeOutcome { steps: 39, missing: 0, agrees: true });
    assert_eq!(again.state(), world.state());
}

#[test]
fn a_checkpoint_may_come_before_the_record_of_its_step() {
    for save in [10, 0] {
        let (world, mut items) = record(30, &[save]);
        let at = items.iter().position(|i| matches!(i, Entry::Checkpoint(..))).unwrap();
        assert!(matches!(items[at - 1], Entry::Step(_)));
        items.swap(at - 1, at);
        let mut again = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut past = InputHistory::default();
        items.into_iter().for_each(|i| past.note(i));
        let resumed = past.replay(&mut again).unwrap();
        assert_eq!(resumed, ResumeOutcome { steps: 29 - save, missing: 0, agrees: true });
        assert_eq!(again.state(), world.state());
        assert_eq!(past.unconsumed().2, 0, "poses that no step has consumed");
    }
}

#[test]
fn over_a_gap_it_goes_on_from_a_later_checkpoint() {
    let (world, items) = record(100, &[10, 60]);
    let mut again = World::new(&SceneFile::load("peel").unwrap()).unwrap();
    let mut past = InputHistory::default();
    let mut checkpoints = Vec::new();
    let lost = |item: &Entry| matches!(item, Entry::Handle(h) if h.field == 230);
    for item in items.into_iter().filter(|item| !lost(item)) {
        match item {
            Entry::Checkpoint(header, bytes) => checkpoints.push((header, bytes)),
            other => past.note(other),
        }
    }
    let mut steps = 0;
    while past.advance(&mut again).is_some() {
        steps += 1;
    }
    assert_eq!((steps, past.waiting().map(|s| s.step)), (30, Some(31)));
    let (header, bytes) = &checkpoints[1];
    assert_eq!(past.jump(&mut again, header, bytes).unwrap(), 31);
    while past.advance(&mut again).is_some() {
        steps += 1;
    }
    assert_eq!(steps, 30 + 39);
    assert_eq!(again.state(), world.state());
}

#[test]
fn without_a_checkpoint_it_begins_at_the_start() {
    let (world, items) = record(30, &[]);
    let (again, resumed) = repeat(items);
    assert_eq!(resumed, ResumeOutcome { steps: 30, missing: 0, agrees: true });
    assert_eq!(again.state_hash(), world.state_hash());
}

#[test]
fn a_missing_pose_ends_it_there() {
    let (_, mut items) = record(40, &[5]);
    let gone = items.iter().rposition(|i| matches!(i, Entry::Poses(p) if p.field == 220)).unwrap();
    items.remove(gone);
    let (world, resumed) = repeat(items);
    assert_eq!((resumed.missing, resumed.agrees), (20, true));
    assert_eq!(world.state().field, 219);
}

#[test]
fn inputs_that_no_step_consumed_are_left() {
    let (_, mut items) = record(20, &[5]);
    // The last step was not made: its pose and handles wait.
    items.pop();
    let mut world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
    let mut past = InputHistory::default();
    items.into_iter().for_each(|i| past.note(i));
    past.replay(&mut world).unwrap();
    let (handles, pedals, poses) = past.unconsumed();
    assert_eq!((handles.len(), pedals.len(), poses), (2, 1, 1));
    assert_eq!((pedals[0].seq, world.state().field), (219, 218));
}

/// Puts `other` before the first item that `is_before` finds.
fn forge(items: &mut Vec<Entry>, is_before: impl Fn(&Entry) -> bool, other: Entry) {
    let at = items.iter().position(is_before).unwrap();
    items.insert(at, other);
}

#[test]
fn of_frames_of_one_name_a_step_takes_the_one_that_it_consumed() {
    let (world, mut items) = record(20, &[]);
    let is_its = |i: &Entry| matches!(i, Entry::Poses(p) if p.field == 210);
    let Some(Entry::Poses(frame)) = items.iter().find(|i| is_its(i)).cloned() else { panic!() };
    let mut forged = frame;
    forged.bodies[0].world_from_body.position_mm[0] += 0.5;
    forge(&mut items, is_its, Entry::Poses(forged));
    let (again, resumed) = repeat(items);
    assert_eq!(resumed, ResumeOutcome { steps: 20, missing: 0, agrees: true });
    assert_eq!(again.state(), world.state());
}

#[test]
fn a_step_that_consumed_something_else_is_not_made_up() {
    let handle_of = |i: &Entry| matches!(i, Entry::Handle(h) if h.field == 210);
    let (_, items) = record(20, &[]);
    for lie in 0..2 {
        let mut items = items.clone();
        let at = items.iter().position(handle_of).unwrap();
        let Entry::Handle(handle) = &mut items[at] else { panic!() };
        match lie {
            // The recorder saw another one of the same number.
            0 => handle.jaw_rad += 0.1,
            // Or one that the simulation did not see, between two that it saw.
            _ => {
                let twice = Entry::Handle(*handle);
                items.insert(at, twice);
            }
        }
        let mut world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut past = InputHistory::default();
        items.into_iter().for_each(|i| past.note(i));
        let resumed = past.replay(&mut world).unwrap();
        assert_eq!(resumed, ResumeOutcome { steps: 10, missing: 10, agrees: true }, "lie {lie}");
        let lacking = past.lacking(&world).unwrap();
        assert!(lacking.contains("(field 210)"), "lie {lie}: {lacking}");
    }
}

#[test]
fn a_record_of_a_build_without_digests_is_repeated_by_its_numbers() {
    let (world, items) = record(20, &[5]);
    let without = |item| match item {
        Entry::Step(step) => Entry::Step(step.with_inputs(InputsDigest::default())),
        other => other,
    };
    let (again, resumed) = repeat(items.into_iter().map(without).collect());
    assert_eq!(resumed, ResumeOutcome { steps: 14, missing: 0, agrees: true });
    assert_eq!(again.state(), world.state());
}

#[test]
fn another_state_is_noticed() {
    let (_, mut items) = record(20, &[5]);
    let last = items.last_mut().unwrap();
    if let Entry::Step(step) = last {
        step.state_hash ^= 1;
    }
    assert!(!repeat(items).1.agrees);
}
