//! From a copy the same comes again, to the bit.

use crate::engine::{Made, Recorded};
use crate::perception::perform;
use crate::test_runs::{begin, golden};
use proptest::prelude::*;
use recording::{Item, Recording, Writer};
use scene::module::{self, Module};
use scene::{SHIPPED, SceneFile};
use simcore::world::World;
use std::ops::ControlFlow;
use std::sync::LazyLock;
use surgeon::rehearsal::Rehearsal;
use tempfile::TempDir;

/// What comes of a recording, and how it ends.
#[derive(Debug, PartialEq, Clone, Default)]
struct Told {
    made: Vec<Vec<u8>>,
    end: String,
}

impl Told {
    /// Notes what was made; enough once no step is `left`.
    fn take(&mut self, made: Made<'_>, left: &mut usize) -> ControlFlow<()> {
        self.made.push(match made {
            Made::Frame(turn, frame, _) => {
                let mut bytes = bytemuck::bytes_of(frame).to_vec();
                bytes.extend(format!("{} {:?}", turn.determined, turn.lost).bytes());
                bytes
            }
            Made::Step(again) => {
                *left -= 1;
                let mut bytes = bytemuck::bytes_of(&again.step).to_vec();
                again.world.events().iter().for_each(|event| bytes.extend(bytemuck::bytes_of(event)));
                bytes.extend(again.left_out.to_le_bytes());
                bytes
            }
        });
        if *left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

/// A copy of the golden recording in which `kept` says which items there are; cut off where it is to be.
fn copy(folder: &TempDir, kept: impl Fn(usize, &Item) -> bool, cut: bool) -> Recording {
    let (from, path) = (golden(), folder.path().join("copy.mcap"));
    let mut writer = Writer::create(&path, from.provenance()).unwrap();
    for (i, item) in from.items().enumerate() {
        let (at, item) = item.unwrap();
        if kept(i, &item) {
            writer.write(at, &item).unwrap();
        }
    }
    writer.finish().unwrap();
    if cut {
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() * 4 / 5]).unwrap();
    }
    Recording::open(&path).unwrap()
}

/// Runs until so many further steps have been done, or to the end.
fn go_on(run: &mut Recorded, steps: usize) -> Told {
    let (mut told, mut left) = (Told::default(), steps);
    let stopped = run.run(|made| Ok(told.take(made, &mut left)));
    if !stopped.unwrap() {
        let (done, lost, frames) = (&run.steps.done, &run.steps.lost, &run.frames);
        told.end = format!("{done:?} {lost:?} {frames:?} {:?}", run.damage);
    }
    told
}

/// What comes of a run on two cores, up to so many steps or to the end, and what it counts.
fn on_two_cores(recording: &Recording, steps: usize) -> (Told, String) {
    let (mut told, mut left) = (Told::default(), steps);
    let ended = begin(recording).run_to_end(|made| Ok(told.take(made, &mut left))).unwrap();
    (
        told,
        format!(
            "{} {:?} {:?} {:?} {:?}",
            ended.stopped, ended.due, ended.steps.done, ended.steps.lost, ended.damage
        ),
    )
}

/// The same in one thread.
fn on_one_core(recording: &Recording, steps: usize) -> (Told, String) {
    let (mut told, mut left) = (Told::default(), steps);
    let mut run = begin(recording);
    let stopped = run.run(|made| Ok(told.take(made, &mut left))).unwrap();
    (
        told,
        format!("{stopped} {:?} {:?} {:?} {:?}", run.frames.due, run.steps.done, run.steps.lost, run.damage),
    )
}

/// After `steps` steps a copy is taken; the run goes on, goes back to it and goes on again, and so does
/// another run of the same recording, which has come elsewhere.
fn comes_again(recording: &Recording, whole: &Told, steps: usize) -> Result<(), TestCaseError> {
    let mut run = begin(recording);
    let before = go_on(&mut run, steps);
    let snapshot = run.snapshot();
    let after = Told { made: whole.made[before.made.len()..].to_vec(), end: whole.end.clone() };
    prop_assert!(go_on(&mut run, usize::MAX) == after, "without going back, after step {}", steps);
    run.restore(&snapshot).unwrap();
    prop_assert!(run.snapshot().step() == snapshot.step());
    prop_assert!(go_on(&mut run, usize::MAX) == after, "back from the end to step {}", steps);
    let mut other = begin(recording);
    go_on(&mut other, steps / 2 + 1);
    other.restore(&snapshot).unwrap();
    prop_assert!(go_on(&mut other, usize::MAX) == after, "another run, from step {}", steps);
    Ok(())
}

fn whole(recording: &Recording) -> Told {
    go_on(&mut begin(recording), usize::MAX)
}

static GOLDEN: LazyLock<(Recording, Told)> = LazyLock::new(|| {
    let recording = golden();
    let told = whole(&recording);
    assert!(told.made.len() > 150, "{} frames and steps", told.made.len());
    (recording, told)
});

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() })]

    #[test]
    fn the_golden_recording_comes_again_from_any_step(step in 1usize..90) {
        comes_again(&GOLDEN.0, &GOLDEN.1, step)?;
    }

    #[test]
    fn a_recording_with_gaps_comes_again_from_any_step(
        step in 1usize..60,
        gap in any::<prop::sample::Index>(),
        length in 1usize..80,
        cut in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let from = gap.index(1000);
        let recording = copy(&folder, |i, _| !(from..from + length).contains(&i), cut);
        let told = whole(&recording);
        let steps = told.made.len() / 4;
        comes_again(&recording, &told, step.min(steps.max(1)))?;
        for steps in [step, usize::MAX] {
            prop_assert!(on_two_cores(&recording, steps) == on_one_core(&recording, steps), "{} steps", steps);
        }
    }
}

/// Every shipped scene, and every shipped module at its last level.
fn scenes() -> Vec<SceneFile> {
    let scenes = SHIPPED.iter().map(|(name, _)| SceneFile::load(name).unwrap());
    let last = |name| Module::load(name).and_then(|m| m.level_scene(m.levels())).unwrap();
    scenes.chain(module::names().map(last)).collect()
}

/// Hash and events of every field of a script from `from` on.
fn play(rehearsal: &Rehearsal, world: &mut World, fields: std::ops::Range<u64>) -> Vec<(u64, Vec<u8>)> {
    let mut rehearsal = rehearsal.clone();
    let played = fields.map(|field| {
        let (_, report) = perform(&mut rehearsal, world, field);
        let events = world.events().iter().flat_map(|e| bytemuck::bytes_of(e).to_vec());
        (report.state_hash, events.collect())
    });
    played.collect()
}

#[test]
fn every_shipped_scene_comes_again_to_the_bit() {
    const AHEAD: u64 = 30;
    for scene in scenes() {
        let mut world = World::new(&scene).unwrap();
        let mut other = World::new(&scene).unwrap().unseen();
        let mut rehearsal = Rehearsal::shipped(&scene);
        let mut copies = Vec::new();
        for field in 0..700 {
            perform(&mut rehearsal, &mut world, field);
            if [20, 150, 333, 699].contains(&field) {
                let fields = field + 1..field + 1 + AHEAD;
                let (copy, state) = (world.snapshot(), world.state().clone());
                let first = play(&rehearsal, &mut world, fields.clone());
                world.restore_snapshot(&copy).unwrap();
                assert!(world.state() == &state, "{}: field {field}", scene.title);
                assert!(play(&rehearsal, &mut world, fields.clone()) == first, "{}: {field}", scene.title);
                world.restore_snapshot(&copy).unwrap();
                copies.push((copy, fields, first, rehearsal.clone()));
            }
        }
        // Of a world that comes from elsewhere, in another order.
        for (copy, fields, first, rehearsal) in copies.iter().rev() {
            other.restore_snapshot(copy).unwrap();
            assert!(play(rehearsal, &mut other, fields.clone()) == *first, "{}: another world", scene.title);
        }
    }
}

#[test]
fn what_is_drawn_follows_the_state_at_once() {
    let scene = SceneFile::load("vitrectomy").unwrap();
    let (mut world, rehearsal) = (World::new(&scene).unwrap(), Rehearsal::shipped(&scene));
    let bricks = |world: &World| bytemuck::cast_slice(world.vitreous().unwrap().0.haze().bricks()).to_vec();
    play(&rehearsal, &mut world, 0..400);
    let (copy, drawn): (_, Vec<u8>) = (world.snapshot(), bricks(&world));
    play(&rehearsal, &mut world, 400..700);
    assert!(bricks(&world) != drawn);
    world.restore_snapshot(&copy).unwrap();
    assert!(bricks(&world) == drawn);
    let unseen = World::new(&scene).unwrap().unseen();
    world.restore_snapshot(&unseen.snapshot()).unwrap();
    assert!(bricks(&world) == bricks(&World::new(&scene).unwrap()), "a copy without densities");
}

#[test]
fn copies_of_another_scene_are_refused() {
    let world = |name: &str| World::new(&SceneFile::load(name).unwrap()).unwrap();
    let (mut peel, erm) = (world("peel"), world("erm"));
    let before = peel.state_hash();
    assert!(peel.restore_snapshot(&erm.snapshot()).is_err());
    assert_eq!(peel.state_hash(), before);
}
