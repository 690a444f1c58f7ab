//! A run that goes to a place is, to the bit, one that was played there.

use super::player::Player;
use super::{Moment, Target, Timeline, saving};
use crate::engine::{Made, Recorded};
use crate::stop::StopSignal;
use crate::test_runs::{begin, golden};
use bytemuck::Zeroable;
use proptest::prelude::*;
use protocol::events::Event;
use recording::{Item, Note, NoteKind, Recording, Writer};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// What is read before a checkpoint: more than anything was under way in the golden recording.
const WINDOW_NS: u64 = 600_000_000;

/// What comes of a run: frames and steps, in the order in which they come.
#[derive(Debug, Clone, PartialEq)]
enum Came {
    Frame(Vec<u8>),
    Step(Moment, Vec<u8>),
}

fn came(made: &Made<'_>) -> Came {
    match made {
        Made::Frame(turn, frame, _) => {
            let mut bytes = bytemuck::bytes_of(*frame).to_vec();
            bytes.extend(format!("{} {:?}", turn.determined, turn.lost).bytes());
            Came::Frame(bytes)
        }
        Made::Step(again) => {
            let mut bytes = bytemuck::bytes_of(&again.step).to_vec();
            again.world.events().iter().for_each(|event| bytes.extend(bytemuck::bytes_of(event)));
            Came::Step(Moment::of(&again.recorded), bytes)
        }
    }
}

/// Plays to the end.
fn rest(mut play: impl FnMut(&mut dyn FnMut(Made<'_>) -> anyhow::Result<ControlFlow<()>>)) -> Vec<Came> {
    let mut all = Vec::new();
    play(&mut |made| {
        all.push(came(&made));
        Ok(ControlFlow::Continue(()))
    });
    all
}

fn whole(recording: &Recording) -> Vec<Came> {
    let mut run = begin(recording);
    rest(|visit| assert!(!run.run(visit).unwrap()))
}

fn rest_of(player: &mut Player) -> Vec<Came> {
    rest(|visit| assert!(!player.play(visit).unwrap()))
}

/// A copy of the golden recording, with checkpoints after every `every` frames, of the items that `kept` says.
/// Checkpoints stand behind the items that followed `late` after theirs. Every 23rd step has two events.
fn copy(folder: &Path, every: u64, late: usize, kept: impl Fn(usize, &Item) -> bool) -> Recording {
    let (from, path) = (golden(), folder.join("copy.mcap"));
    let (mut saved, mut count) = (BTreeMap::<u64, Vec<Item>>::new(), 0);
    let due = |_| {
        count += 1;
        count % every == 1
    };
    let keep = |at, item: &Item| {
        saved.entry(at).or_default().push(item.clone());
        Ok(())
    };
    saving::save(&mut begin(&from), &StopSignal::default(), |_| {}, due, keep).unwrap();
    let mut writer = Writer::create(&path, from.provenance()).unwrap();
    let mut waiting = Vec::new();
    for (i, item) in from.items().enumerate() {
        let (at, item) = item.unwrap();
        if kept(i, &item) {
            writer.write(at, &item).unwrap();
        }
        if let Item::Step(step) = &item
            && step.step % 23 == 0
        {
            let event =
                Event { exposed_ns: step.instants.exposed, field: step.field, kind: 1, ..Event::zeroed() };
            (0..2).for_each(|_| writer.write(at, &Item::Event(event)).unwrap());
        }
        let its = matches!(item, Item::Step(_) | Item::Poses(_)).then(|| saved.remove(&at)).flatten();
        waiting.extend(its.into_iter().flatten().map(|checkpoint| (i + late, at, checkpoint)));
        while waiting.first().is_some_and(|(due, ..)| *due <= i) {
            let (_, at, checkpoint) = waiting.remove(0);
            writer.write(at, &checkpoint).unwrap();
        }
    }
    writer.finish().unwrap();
    assert!(saved.is_empty(), "{} checkpoints have no item", saved.len());
    Recording::open(&path).unwrap()
}

fn player(recording: &Recording) -> Player {
    let run = begin(recording);
    let mut timeline = Timeline::open(recording).unwrap();
    // Of two seconds, all would be read.
    timeline.window_ns = WINDOW_NS;
    Player::new(timeline, run.steps.world).unwrap()
}

/// The steps among what came.
fn steps(all: &[Came]) -> Vec<Moment> {
    all.iter().filter_map(|came| if let Came::Step(at, _) = came { Some(*at) } else { None }).collect()
}

fn step_place(all: &[Came], step: usize) -> usize {
    let places = all.iter().enumerate().filter(|(_, came)| matches!(came, Came::Step(..)));
    places.map(|(i, _)| i).nth(step).unwrap()
}

/// Tracker and world of a run, as bytes.
fn known(run: &Recorded) -> [Vec<u8>; 2] {
    let mut bytes = [Vec::new(), Vec::new()];
    run.tracker.as_ref().unwrap().0.save(&mut bytes[0]).unwrap();
    run.steps.world.save(&mut bytes[1]).unwrap();
    bytes
}

struct Whole {
    _folder: TempDir,
    recording: Recording,
    came: Vec<Came>,
    known: Vec<[Vec<u8>; 2]>,
}

static GOLDEN: LazyLock<Whole> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let recording = copy(folder.path(), 20, 4, |_, _| true);
    let (mut run, mut all) = (begin(&recording), Vec::new());
    while run.run(|made| Ok(super::player::until(matches!(made, Made::Step(_))))).unwrap() {
        all.push(known(&run));
    }
    let came = whole(&recording);
    assert!(all.len() > 80 && all.len() == steps(&came).len());
    Whole { _folder: folder, recording, came, known: all }
});

#[test]
fn a_recording_says_where_it_begins_and_ends_and_what_checkpoints_it_has() {
    let Whole { recording, came, .. } = &*GOLDEN;
    let timeline = Timeline::open(recording).unwrap();
    let played = steps(came);
    assert_eq!(timeline.ends(), Some([played[0], *played.last().unwrap()]));
    let pairs = timeline.pairs().unwrap();
    let events: Vec<Vec<u8>> = timeline.events().iter().map(|e| bytemuck::bytes_of(e).to_vec()).collect();
    let recorded = recording.items_of(&["events"]).map(|item| item.unwrap().1);
    let recorded = recorded.filter_map(|item| match item {
        Item::Event(event) => Some(bytemuck::bytes_of(&event).to_vec()),
        _ => None,
    });
    assert!(events.iter().cloned().eq(recorded) && !events.is_empty());
    // Of every checkpoint, with the tracker's of the same field.
    let count = pairs.heads().len();
    assert!(count > 4);
    for number in 0..count {
        let known = pairs.read(number, true).unwrap();
        assert_eq!(known.tracker.unwrap().0.field, known.world.0.field);
    }
    assert!(!Timeline::open(&golden()).unwrap().has_checkpoints());
}

#[test]
fn every_step_is_reached_and_goes_on_as_if_it_had_been_played() {
    let Whole { recording, came, known: all, .. } = &*GOLDEN;
    let mut player = player(recording);
    let played = steps(came);
    for (i, at) in played.iter().enumerate().rev() {
        let targets = [Target::Step(at.step), Target::Field(at.field), Target::Exposed(at.exposed_ns)];
        let arrival = player.seek(targets[i % 3]).unwrap();
        assert_eq!((arrival.at, arrival.left_out, arrival.lost), (Some(*at), 0, None), "step {i}");
        assert!(known(player.run()) == all[i], "step {i}");
        if i % 7 == 0 {
            assert!(rest_of(&mut player) == came[step_place(came, i) + 1..], "behind step {i}");
            assert!(player.run().steps.done.differs_at.is_none());
        }
    }
    let behind = played.last().unwrap().step + 1;
    assert_eq!(player.seek(Target::Step(behind)).unwrap().at, None);
    assert!(rest_of(&mut player).is_empty());
}

#[test]
fn steps_back_lead_to_the_step_before() {
    // Commands run on the main thread, which has four times the stack of a check's.
    let thread = std::thread::Builder::new().stack_size(8 << 20).spawn(step_back_through_all);
    thread.unwrap().join().unwrap();
}

fn step_back_through_all() {
    let Whole { recording, came, known: all, .. } = &*GOLDEN;
    let played = steps(came);
    let mut player = player(recording);
    player.seek(Target::Step(played.last().unwrap().step)).unwrap();
    for i in (0..played.len() - 1).rev() {
        assert_eq!(player.step_back().unwrap(), Some(played[i]));
        assert!(known(player.run()) == all[i], "step {i}");
    }
    assert_eq!(player.step_back().unwrap(), None);
    assert!(rest_of(&mut player) == *came);
    player.seek(Target::Step(played[50].step)).unwrap();
    assert_eq!(player.step_back().unwrap(), Some(played[49]));
    assert_eq!(player.step_forward().unwrap(), Some(played[50]));
    assert!(known(player.run()) == all[50]);
}

#[test]
fn events_are_reached_one_after_the_other_both_ways() {
    let mut player = player(&GOLDEN.recording);
    let mut instants: Vec<u64> = player.timeline().events().iter().map(|e| e.exposed_ns).collect();
    instants.sort_unstable();
    instants.dedup();
    assert!(instants.len() > 2);
    for at in &instants {
        assert_eq!(player.next_event().unwrap().map(|e| e.exposed_ns), Some(*at));
        assert_eq!(player.at().map(|m| m.exposed_ns), Some(*at));
    }
    assert!(player.next_event().unwrap().is_none());
    for at in instants.iter().rev().skip(1) {
        assert_eq!(player.previous_event().unwrap().map(|e| e.exposed_ns), Some(*at));
    }
    assert!(player.previous_event().unwrap().is_none());
}

/// Frames, and steps, of what came.
fn apart(all: &[Came]) -> [Vec<&Came>; 2] {
    let (frames, steps) = all.iter().partition(|came| matches!(came, Came::Frame(_)));
    [frames, steps]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() })]

    #[test]
    fn gaps_and_damage_leave_the_same_frames_and_steps(
        from in 0usize..1000,
        length in 0usize..80,
        late in 0usize..30,
        every in 8u64..40,
        cut in any::<bool>(),
        hit in prop::option::of(any::<prop::sample::Index>()),
        restart in any::<bool>(),
        places in prop::collection::vec(any::<prop::sample::Index>(), 4),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let kept = |i: usize, item: &Item| {
            // A tracker that was gone for a while.
            let gone = restart && matches!(item, Item::Poses(frame) if (30..38).contains(&frame.frame));
            !gone && !(from..from + length).contains(&i)
        };
        let path = copy(folder.path(), every, late, kept).path().to_owned();
        let mut bytes = std::fs::read(&path).unwrap();
        if cut {
            bytes.truncate(bytes.len() * 4 / 5);
        }
        if let Some(hit) = hit {
            // Behind the provenance.
            let at = bytes.len() / 2 + hit.index(bytes.len() / 2);
            bytes[at] ^= 0x55;
        }
        std::fs::write(&path, &bytes).unwrap();
        let recording = Recording::open(&path).unwrap();
        let came = whole(&recording);
        let (played, [frames, all]) = (steps(&came), apart(&came));
        prop_assume!(!played.is_empty());
        let mut player = player(&recording);
        for place in places {
            let i = place.index(played.len());
            let arrival = player.seek(Target::Step(played[i].step)).unwrap();
            prop_assert_eq!(arrival.at, Some(played[i]));
            let rest = rest_of(&mut player);
            let [frames_left, steps_left] = apart(&rest);
            prop_assert!(steps_left == all[i + 1..], "steps behind {}", i);
            prop_assert!(frames.ends_with(&frames_left), "frames behind {}", i);
        }
    }
}

#[test]
fn a_checkpoint_of_another_state_is_not_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (from, path) = (&GOLDEN.recording, folder.path().join("a.mcap"));
    let mut writer = Writer::create(&path, from.provenance()).unwrap();
    for item in from.items() {
        let (at, item) = item.unwrap();
        let item = match item {
            Item::Checkpoint(mut header, state) if header.step % 2 == 1 => {
                header.state_hash ^= 1;
                Item::Checkpoint(header, state)
            }
            Item::TrackerCheckpoint(header, mut state) if header.frame > 40 => {
                state.truncate(1000);
                Item::TrackerCheckpoint(header, state)
            }
            other => other,
        };
        writer.write(at, &item).unwrap();
    }
    let text = "a note".to_string();
    writer
        .write(1, &Item::Note(Note { instant_ns: 1, kind: NoteKind::Log, process: None, count: 0, text }))
        .unwrap();
    writer.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    let mut player = player(&recording);
    for (i, at) in steps(&GOLDEN.came).iter().enumerate().step_by(11) {
        assert_eq!(player.seek(Target::Step(at.step)).unwrap().at, Some(*at));
        assert!(known(player.run()) == GOLDEN.known[i], "step {i}");
    }
}
