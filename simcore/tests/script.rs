//! The shipped scene does what its title says, for a whole round and again.

use protocol::events::{Event, EventKind};
use protocol::limits::SUBSTEP_NS;
use protocol::message::Message;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::tearing::check_mesh;

struct Round {
    events: Vec<Event>,
    fastest_mm_s: f32,
    fastest_at_rest_mm_s: f32,
}

fn fastest(world: &World) -> f32 {
    let m = &world.state().membrane;
    (0..m.nodes()).map(|i| m.velocity(i).norm()).fold(0.0, f32::max)
}

fn play(world: &mut World, rehearsal: &Rehearsal, fields: std::ops::Range<u64>) -> Round {
    let mut round = Round { events: Vec::new(), fastest_mm_s: 0.0, fastest_at_rest_mm_s: 0.0 };
    for field in fields {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        round.events.extend(world.events());
        round.fastest_mm_s = round.fastest_mm_s.max(fastest(world));
        assert_eq!(check_mesh(world.sheet(), &world.state().membrane), Ok(()), "field {field}");
    }
    round.fastest_at_rest_mm_s = fastest(world);
    round
}

fn at(events: &[Event], kind: EventKind) -> Option<u64> {
    events.iter().find(|e| e.kind == kind as u32).map(|e| e.field)
}

#[test]
fn the_script_grabs_lifts_tears_a_little_and_lets_go() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene).unwrap();
    let round = play(&mut world, &rehearsal, 0..rehearsal.fields());
    let e = &round.events;
    let grabbed = at(e, EventKind::TissueGrabbed).expect("grabbed");
    let torn = at(e, EventKind::TissueTorn).expect("torn");
    let released = at(e, EventKind::TissueReleased).expect("released");
    assert!(grabbed < torn && torn < released, "{grabbed} {torn} {released}");
    assert!(at(e, EventKind::RetinaGrazed).is_some() && at(e, EventKind::RimForceHigh).is_some());
    for never in [
        EventKind::RetinaPenetrated,
        EventKind::RimDetached,
        EventKind::TissueDisabled,
        EventKind::GripSlipped,
        EventKind::TrackingLost,
    ] {
        assert_eq!(at(e, never), None, "{never:?}");
    }
    let left = world.state().membrane.triangle_alive.iter().filter(|a| **a != 0).count();
    assert!((900..1000).contains(&left), "a little is torn: {left} of 1,000 triangles left");
    assert!(e.windows(2).all(|w| w[1].seq == w[0].seq + 1), "events count up by one");
    e.iter().for_each(|e| e.validate().unwrap());
}

#[test]
fn every_explicit_step_is_stable() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene).unwrap();
    for round in 0..3 {
        let fields = rehearsal.fields();
        let moved = play(&mut world, &rehearsal, round * fields..(round + 1) * fields);
        assert!(moved.fastest_mm_s < 200.0, "round {round}: {} mm/s", moved.fastest_mm_s);
        // Some seconds after the jaws have let go, only the tissue's slow creep is left.
        assert!(moved.fastest_at_rest_mm_s < 1.0, "round {round}: {} mm/s", moved.fastest_at_rest_mm_s);
    }
    let state = world.state();
    let advanced = state.substeps * SUBSTEP_NS + state.remainder_ns;
    assert_eq!(advanced, (3 * rehearsal.fields() - 1) * 20_000_000, "no time is lost");
}

#[test]
fn open_jaws_push_the_membrane_before_they_close() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene).unwrap();
    let deepest = |world: &World| {
        let m = &world.state().membrane;
        let near = |i: &usize| (m.position(*i).xy() - nalgebra::Vector2::new(1.2, 0.4)).norm() < 0.2;
        (0..m.nodes()).filter(near).map(|i| m.position(i).z).fold(f32::INFINITY, f32::min)
    };
    let before = deepest(&world);
    play(&mut world, &rehearsal, 150..201);
    // Pushed nodes move on a little by themselves, so that not every look of a resting tip finds
    // contact.
    let mut touched = 0;
    for field in 201..226 {
        play(&mut world, &rehearsal, field..field + 1);
        let forceps = &world.state().membrane.contact[0];
        touched += u32::from(forceps.in_contact);
        assert!(!forceps.under);
    }
    let after = deepest(&world);
    assert!(touched > 0);
    assert!(after < before - 0.02, "{before} {after}");
}
