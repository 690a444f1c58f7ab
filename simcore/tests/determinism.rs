//! The same inputs give the same state, to the bit: on every run, in every build, across a
//! checkpoint.

use protocol::phases::{Phase, PhaseClock};
use protocol::steps::StepProfile;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;

/// Hash after the fields [`GOLDEN_FIELDS`] of the shipped scene's script: forceps push, grab, lift
/// and tear. It moves when the scene, the state's content or any arithmetic of the step changes;
/// say so in the commit.
const GOLDEN_HASH: u64 = 0x5832_11dc_76dd_e083;
const GOLDEN_FIELDS: std::ops::Range<u64> = 190..390;

fn peel() -> (Rehearsal, World) {
    let scene = SceneFile::load("peel").unwrap();
    (Rehearsal::shipped(&scene), World::new(&scene).unwrap())
}

#[test]
fn a_scripted_run_ends_in_the_golden_state() {
    let (rehearsal, mut world) = peel();
    let mut hash = 0;
    for field in GOLDEN_FIELDS {
        hash = world.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash;
    }
    assert_eq!(hash, GOLDEN_HASH, "{hash:#018x}");
}

#[test]
fn the_clock_lent_for_times_changes_nothing() {
    let (rehearsal, mut world) = peel();
    let mut again = world_of(&world);
    let mut ticks = 0u64;
    let mut sum = [0; StepProfile::PHASES.len()];
    for field in 225..275 {
        let plain = world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        let timed = again.step(&rehearsal.inputs(field).input(), &mut || {
            ticks += 7919;
            ticks
        });
        assert_eq!(plain.state_hash, timed.state_hash);
        sum.iter_mut().zip(timed.profile.phases_ns()).for_each(|(sum, ns)| *sum += ns);
        assert_eq!(plain.profile, Default::default());
    }
    // The transfer is timed by the process.
    let untimed = StepProfile::PHASES.into_iter().zip(sum).filter(|(_, ns)| *ns == 0);
    assert!(untimed.map(|(phase, _)| phase).eq(["transfer"]), "{sum:?}");
}

/// A clock that goes on by one with each reading, and keeps the laps.
#[derive(Default)]
struct Laps {
    now: u64,
    laps: Vec<(Phase, [u64; 2])>,
}

impl PhaseClock for Laps {
    fn read(&mut self) -> u64 {
        self.now += 1;
        self.now
    }

    fn lap(&mut self, phase: Phase, from_to: [u64; 2]) {
        self.laps.push((phase, from_to));
    }
}

#[test]
fn the_phases_of_a_step_follow_without_a_gap_and_add_up_to_its_profile() {
    let (rehearsal, mut world) = peel();
    let mut again = world_of(&world);
    for field in 225..245 {
        let plain = world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        let mut clock = Laps::default();
        let noted = again.step_in_phases(&rehearsal.inputs(field).input(), &mut clock);
        assert_eq!(plain.state_hash, noted.state_hash);
        let mut profile = StepProfile::default();
        clock.laps.iter().for_each(|(phase, [from, to])| *profile.time_of(*phase) += to - from);
        assert_eq!(profile, noted.profile);
        assert!(clock.laps.windows(2).all(|pair| pair[0].1[1] == pair[1].1[0]), "field {field}");
        assert_eq!((clock.laps[0].1[0], clock.laps.len()), (1, clock.now as usize - 1));
    }
}

#[test]
fn a_checkpoint_continues_bit_for_bit() {
    let (rehearsal, mut world) = peel();
    let mut saved = Vec::new();
    // In the middle of a peel: nodes are held and springs are torn.
    let (begin, half, end) = (190, 390, 490);
    for field in begin..half {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
    }
    world.save(&mut saved).unwrap();
    assert!(!world.state().membrane.held[0].is_empty());
    let mut restored = world_of(&world);
    restored.restore(&saved).unwrap();
    for field in half..end {
        let straight = world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        let resumed = restored.step(&rehearsal.inputs(field).input(), &mut no_clock);
        assert_eq!(straight.state_hash, resumed.state_hash, "field {field}");
        assert_eq!(world.events(), restored.events());
    }
    assert_eq!(world.state(), restored.state());
}

#[test]
fn a_reset_world_is_a_new_world() {
    let (rehearsal, mut world) = peel();
    let fresh = world.state_hash();
    for field in 225..300 {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
    }
    assert_ne!(world.state_hash(), fresh);
    world.reset();
    assert_eq!(world.state_hash(), fresh);
    let (_, mut new) = peel();
    for field in 225..240 {
        let again = world.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash;
        assert_eq!(again, new.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash);
    }
}

fn world_of(world: &World) -> World {
    World::new(world.scene()).unwrap()
}
