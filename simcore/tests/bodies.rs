//! The scene `bodies` as its script plays it: a bead is picked up, carried and placed.

use protocol::events::EventKind;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;

#[test]
fn the_script_picks_a_bead_up_and_places_it() {
    let scene = SceneFile::load("bodies").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = World::new(&scene).unwrap();
    let (mut gripped, mut released, mut highest) = (Vec::new(), Vec::new(), 0.0f64);
    let (mut saved, mut hash) = (Vec::new(), None);
    let depth = |world: &World, body: usize| {
        11.5 - world.state().bodies.as_ref().unwrap().body[body].eye_from_body.translation.vector.norm()
    };
    let fields = rehearsal.fields() - 25;
    for field in 0..fields {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        for event in world.events() {
            match EventKind::from_wire(event.kind) {
                Some(EventKind::BodyGripped) => gripped.push((field, event.subject)),
                Some(EventKind::BodyReleased) => released.push((field, event.subject)),
                Some(EventKind::GripSlipped) => panic!("slipped in field {field}"),
                _ => {}
            }
        }
        highest = highest.max(depth(&world, 0));
        if field == 400 {
            assert!(
                world.state().bodies.as_ref().unwrap().grip[0].is_some(),
                "carried: {:?}",
                world.state().bodies
            );
            world.save(&mut saved).unwrap();
        }
    }
    let [(taken, 0)] = gripped[..] else { panic!("the red bead, once: {gripped:?}") };
    let [(placed, 0)] = released[..] else { panic!("the red bead, once: {released:?}") };
    assert!(taken < 300 && placed > 550, "{taken} {placed}");
    assert!(highest > 1.8, "carried over the retina: {highest}");
    for (body, clearance) in [(0, 0.4), (1, 0.5)] {
        assert!(
            (depth(&world, body) - clearance).abs() < 0.01,
            "rests on the retina: {}",
            depth(&world, body)
        );
    }
    let at = world.state().bodies.as_ref().unwrap().body[0].eye_from_body.translation.vector;
    assert!(at.x < 0.3, "on the other side: {at}");
    // From the checkpoint in the middle of the way everything comes again.
    hash.get_or_insert(world.state_hash());
    world.restore(&saved).unwrap();
    for field in 401..fields {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
    }
    assert_eq!(Some(world.state_hash()), hash);
}

#[test]
fn a_checkpoint_of_other_bodies_is_refused() {
    let scene = SceneFile::load("bodies").unwrap();
    let mut other = scene.clone();
    other.bodies.as_mut().unwrap().body.pop();
    let mut saved = Vec::new();
    World::new(&other).unwrap().save(&mut saved).unwrap();
    assert!(World::new(&scene).unwrap().restore(&saved).is_err());
}

/// What the forceps carry in the module lies between their jaws near the tips, and the jaws are nearly closed:
/// less than 26°, where bars as wide as high took 36°.
#[test]
fn jaws_are_nearly_closed_about_a_bar_that_they_carry() {
    let module = surgeon::load("forceps").unwrap();
    let mut carried = 0;
    for level in 1..=3 {
        let scene = surgeon::compose(&module, level, &surgeon::skill::EXPERT, 1).unwrap();
        let rehearsal = Rehearsal::shipped(&scene);
        let (mut world, mut held) = (World::new(&scene).unwrap(), None);
        for field in 0..rehearsal.fields() - 25 {
            world.step(&rehearsal.inputs(field).input(), &mut no_clock);
            let grip = world.state().bodies.as_ref().unwrap().grip[0];
            if let (Some(grip), None) = (grip, held) {
                let at = grip.instrument_from_body;
                let [x, y, z] = at.translation.vector.into();
                let told = format!(
                    "level {level}, bar {}: open by {:.3} rad, at {x:.2} {y:.2} {z:.2} mm",
                    grip.body, grip.opening_rad
                );
                println!("{told}");
                assert!(grip.opening_rad < 0.45, "{told}");
                assert!(x.abs() < 0.1 && y.abs() < 0.6 && (0.0..0.4).contains(&z), "{told}");
                carried += 1;
            }
            held = grip;
        }
    }
    assert_eq!(carried, 2 + 3 + 3, "bars carried");
}
