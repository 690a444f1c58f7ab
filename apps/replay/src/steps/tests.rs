//! Whole and lossy recordings as steps of a real world.

use super::*;
use bytemuck::Zeroable;
use protocol::handles::PedalState;
use protocol::steps::StepInput;
use scene::SceneFile;
use simcore::world::no_clock;
use surgeon::rehearsal::Rehearsal;

const PERIOD_NS: Nanos = 20_000_000;
/// Field of the script from which on an instrument works.
const FIRST: u64 = 200;

fn world() -> World {
    World::new(&SceneFile::load("peel").unwrap()).unwrap().unseen()
}

/// A run of `fields` fields as a recorder sees it, with a checkpoint after each of `saves`.
fn record(fields: u64, saves: &[u64]) -> Vec<(Nanos, Item)> {
    record_from(FIRST, fields, saves)
}

fn record_from(first: u64, fields: u64, saves: &[u64]) -> Vec<(Nanos, Item)> {
    let rehearsal = Rehearsal::shipped(&SceneFile::load("peel").unwrap());
    let (mut world, mut items) = (world(), Vec::new());
    for field in first..first + fields {
        let at = (field - FIRST) * PERIOD_NS;
        let (frame, handles) = rehearsal.field(field);
        let pedal = PedalState { seq: field, axes: [0.5, 0.1], ..PedalState::zeroed() };
        let report =
            world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[pedal] }, &mut no_clock);
        let state = world.state();
        let step = StepRecord {
            step: state.step,
            field: frame.field,
            frame: frame.frame,
            instants: frame.instants,
            handles_below: state.handles_below,
            pedals_below: state.pedals_below,
            advanced_ns: report.advanced_ns,
            state_hash: report.state_hash,
            ..StepRecord::zeroed()
        };
        let inputs = handles.into_iter().map(Item::Handle).chain([Item::Pedal(pedal)]);
        items.extend(inputs.chain([Item::Poses(Box::new(frame)), Item::Step(step)]).map(|item| (at, item)));
        if saves.contains(&step.step) {
            items.push((at, checkpoint(&world, &step)));
        }
    }
    items
}

fn checkpoint(world: &World, step: &StepRecord) -> Item {
    let mut bytes = Vec::new();
    world.save(&mut bytes).unwrap();
    let header = CheckpointHeader {
        step: step.step,
        field: step.field,
        handles_below: step.handles_below,
        pedals_below: step.pedals_below,
        state_hash: step.state_hash,
        bytes: bytes.len() as u64,
    };
    Item::Checkpoint(header, bytes)
}

/// Numbers of the steps that were done, each identical; what came of it, and what was lost first.
fn again(items: Vec<(Nanos, Item)>) -> (Vec<u64>, Resimulated, Option<String>) {
    let provenance = Provenance {
        versions: [("state-hash".to_owned(), protocol::steps::STATE_HASH_VERSION.to_string())].into(),
        ..Provenance::default()
    };
    let (mut steps, mut numbers) = (Steps::new(world(), &provenance), Vec::new());
    assert_eq!(steps.done.other_state_hash_version, None);
    let mut left_out = 0;
    let mut drain = |steps: &mut Steps| {
        while let Some(again) = steps.next_step() {
            let of = |s: &StepRecord| (s.step, s.field, s.advanced_ns, s.state_hash);
            assert_eq!(of(&again.step), of(&again.recorded));
            left_out += again.left_out;
            numbers.push(again.recorded.step);
        }
    };
    for (at, item) in items {
        steps.note(at, item);
        drain(&mut steps);
    }
    steps.end();
    drain(&mut steps);
    assert_eq!(left_out + steps.left_out(), steps.done.undone);
    (numbers, steps.done, steps.lost)
}

/// Without what `is_lost` names.
fn without(items: Vec<(Nanos, Item)>, is_lost: impl Fn(&Item) -> bool) -> Vec<(Nanos, Item)> {
    let before = items.len();
    let rest: Vec<_> = items.into_iter().filter(|(_, item)| !is_lost(item)).collect();
    assert!(rest.len() < before, "something is lost");
    rest
}

#[test]
fn a_whole_run_comes_out_to_the_bit() {
    let (numbers, done, lost) = again(record(60, &[10, 40]));
    assert_eq!(numbers, (1..=60).collect::<Vec<_>>());
    assert_eq!((done.steps, done.gaps, done.undone, done.missing, lost), (60, 0, 0, 0, None));
}

#[test]
fn over_a_lost_input_it_goes_on_from_the_next_checkpoint() {
    let check = |is_lost: &dyn Fn(&Item) -> bool, told: &str| {
        let (numbers, done, lost) = again(without(record(60, &[10, 40, 55]), is_lost));
        assert_eq!(numbers, (1..=20).chain(41..=60).collect::<Vec<_>>(), "{told}");
        assert_eq!((done.gaps, done.undone, done.missing), (1, 20, 0));
        assert!(lost.as_ref().is_some_and(|lost| lost.contains(told)), "{told}: {lost:?}");
    };
    check(&|item| matches!(item, Item::Handle(h) if h.field == FIRST + 20), "handle state");
    check(
        &|item| matches!(item, Item::Pedal(p) if p.seq == FIRST + 20),
        "pedal state 220 is missing (field 220)",
    );
    check(
        &|item| matches!(item, Item::Poses(p) if p.field == FIRST + 20),
        "the poses of step 21 (field 220) are missing",
    );
}

#[test]
fn a_step_that_was_not_recorded_is_counted_and_bridged() {
    let is_lost = |item: &Item| matches!(item, Item::Step(s) if s.step == 30);
    let (numbers, done, lost) = again(without(record(60, &[10, 30]), is_lost));
    assert_eq!(numbers, (1..=29).chain(31..=60).collect::<Vec<_>>(), "the checkpoint is of the step itself");
    assert_eq!((done.gaps, done.undone, done.missing), (1, 0, 1));
    assert_eq!(lost.as_deref(), Some("step 31 follows 29 (field 230)"));
    let (numbers, done, _) = again(without(record(60, &[10]), is_lost));
    assert_eq!((numbers.len(), done.undone, done.missing), (29, 30, 1), "no checkpoint leads over it");
}

#[test]
fn a_checkpoint_that_was_filed_seconds_late_is_found() {
    let mut items =
        without(record(60, &[40]), |item| matches!(item, Item::Poses(p) if p.field == FIRST + 20));
    let at = items.iter().position(|(_, item)| matches!(item, Item::Checkpoint(..))).unwrap();
    let (_, late) = items.remove(at);
    items.push((5_000_000_000, late));
    let (numbers, ..) = again(items);
    assert_eq!(numbers, (1..=20).chain(41..=60).collect::<Vec<_>>());
}

#[test]
fn inputs_that_stand_a_little_behind_their_step_are_waited_for() {
    let mut items = record(30, &[]);
    for (at, item) in &mut items {
        if matches!(item, Item::Handle(_) | Item::Poses(_)) {
            *at += 4 * PERIOD_NS;
        }
    }
    items.sort_by_key(|(at, _)| *at);
    assert_eq!(again(items).0, (1..=30).collect::<Vec<_>>());
}

#[test]
fn what_a_simulation_lacked_is_over_where_another_begins_anew() {
    let is_lost = |item: &Item| matches!(item, Item::Pedal(p) if p.seq == FIRST + 20);
    let first = without(record(40, &[]), is_lost).into_iter();
    let (numbers, done, lost) = again(first.chain(record_from(FIRST + 40, 40, &[])).collect());
    assert_eq!(numbers, (1..=20).chain(1..=40).collect::<Vec<_>>());
    assert_eq!((done.gaps, done.undone), (0, 20));
    assert!(lost.is_some_and(|lost| lost.contains("pedal state")));
}

#[test]
fn a_step_without_a_record_is_made_where_the_next_state_proves_it() {
    let mut items = record(60, &[40]);
    let instant = |field: u64| 1_000_000_000 + field * PERIOD_NS;
    for (_, item) in &mut items {
        match item {
            Item::Handle(h) => h.instant_ns = instant(h.field),
            Item::Pedal(p) => p.instant_ns = instant(p.seq),
            Item::Poses(p) => p.instants.tracked = instant(p.field) + 5_000_000,
            Item::Step(s) => s.instants.stepped = instant(s.field) + 6_000_000,
            _ => {}
        }
    }
    let lost_record = |item: &Item| matches!(item, Item::Step(s) if (30..32).contains(&s.step));
    let (numbers, done, lost) = again(without(items.clone(), lost_record));
    assert_eq!(numbers, (1..=29).chain(32..=60).collect::<Vec<_>>());
    assert_eq!((done.gaps, done.undone, done.missing, lost), (0, 0, 2, None));
    for (_, item) in &mut items {
        if let Item::Step(step) = item
            && step.step == 32
        {
            step.state_hash ^= 1;
        }
    }
    let (numbers, done, lost) = again(without(items, lost_record));
    assert_eq!(numbers, (1..=29).chain(41..=60).collect::<Vec<_>>());
    assert_eq!((done.gaps, done.undone), (1, 9));
    assert_eq!(lost.as_deref(), Some("what led to step 32 (field 231) is missing"));
}

#[test]
fn a_simulation_that_began_anew_is_followed_and_old_checkpoints_are_forgotten() {
    let (first, second) = (record(40, &[35]), record(40, &[]));
    let later = second.into_iter().map(|(at, item)| (at + 40 * PERIOD_NS, item));
    let is_lost = |item: &Item| matches!(item, Item::Pedal(p) if p.seq == FIRST + 20);
    let second = without(later.collect(), is_lost);
    let (numbers, done, _) = again(first.into_iter().chain(second).collect());
    assert_eq!(numbers, (1..=40).chain(1..=20).collect::<Vec<_>>());
    assert_eq!((done.gaps, done.undone), (0, 20), "a state of the earlier run leads nowhere");
}

#[test]
fn steps_that_nothing_leads_to_do_not_wait_for_ever() {
    let mut items = without(record(30, &[]), |item| matches!(item, Item::Step(s) if s.step == 20));
    let last = items.iter().rev().find_map(|(_, item)| match item {
        Item::Step(step) => Some(*step),
        _ => None,
    });
    for n in 1..=2 * WAITING as u64 {
        let mut step = last.expect("a step");
        step.step += n;
        items.push((30 * PERIOD_NS + n, Item::Step(step)));
    }
    let (numbers, done, lost) = again(items);
    assert_eq!(numbers, (1..=19).collect::<Vec<_>>());
    assert_eq!((done.undone, done.missing), (10 + 2 * WAITING as u64, 1));
    assert_eq!(lost.as_deref(), Some("step 21 follows 19 (field 220)"));
}
