//! What rough handling leads to: slipping, tearing off the retina, bleeding; and tools that only
//! push.

use bytemuck::Zeroable;
use protocol::events::{Event, EventKind};
use protocol::geometry::Pose;
use protocol::handles::{HandleState, Tool};
use protocol::poses::TrackerFrame;
use protocol::scene::NODE_BOUND;
use protocol::steps::StepInput;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::state::NODE_PINNED;

fn peel(change: impl FnOnce(&mut SceneFile)) -> (Rehearsal, World) {
    let mut scene = SceneFile::load("peel").unwrap();
    change(&mut scene);
    (Rehearsal::shipped(&scene), World::new(&scene).unwrap())
}

fn play_round(rehearsal: &Rehearsal, world: &mut World) -> Vec<Event> {
    let mut events = Vec::new();
    for field in 190..rehearsal.fields() {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        events.extend(world.events());
    }
    events
}

fn of(events: &[Event], kind: EventKind) -> Vec<&Event> {
    events.iter().filter(|e| e.kind == kind as u32).collect()
}

/// A step with instrument 0 (upright, no eye rotation) at `tip`, instrument 1 far away.
fn step_at(world: &mut World, field: u64, tip: [f64; 3], tool: Tool, jaw_rad: f64) -> Vec<Event> {
    let mut frame = TrackerFrame::zeroed();
    (frame.field, frame.frame) = (field, field);
    frame.instants.exposed = 1_000_000_000 + field * 20_000_000;
    frame.bodies.iter_mut().for_each(|b| (b.world_from_body, b.validity) = (Pose::IDENTITY, 2));
    frame.bodies[0].world_from_body.position_mm = tip;
    let mut handle = HandleState::zeroed();
    (handle.seq, handle.tool, handle.jaw_rad) = (field, tool as u32, jaw_rad);
    world.step(&StepInput { frame: &frame, handles: &[handle], pedals: &[] }, &mut no_clock);
    world.events().to_vec()
}

#[test]
fn a_weak_grip_slips_before_anything_tears() {
    let (rehearsal, mut world) = peel(|s| s.contact.grip_un = 60.0);
    let events = play_round(&rehearsal, &mut world);
    let slipped = of(&events, EventKind::GripSlipped);
    assert_eq!(slipped.len(), 1, "jaws that have slipped hold nothing until they close again");
    assert!(slipped[0].value > 60.0 && slipped[0].limit == 60.0);
    assert!(of(&events, EventKind::TissueTorn).is_empty());
    assert!(world.state().membrane.flag.iter().all(|&f| f < NODE_BOUND));
}

#[test]
fn a_rim_pulled_too_hard_comes_off_after_the_warning() {
    let (rehearsal, mut world) = peel(|s| {
        let membrane = s.membrane.as_mut().unwrap();
        membrane.rim_tear_un = 100.0;
        membrane.tear_tension_n_per_m = 0.0;
    });
    let pinned = |w: &World| w.state().membrane.flag.iter().filter(|&&f| f == NODE_PINNED).count();
    let before = pinned(&world);
    let events = play_round(&rehearsal, &mut world);
    let (warned, off) = (of(&events, EventKind::RimForceHigh), of(&events, EventKind::RimDetached));
    assert!(warned[0].seq < off[0].seq && off[0].value > 100.0);
    assert!(pinned(&world) < before);
}

#[test]
fn a_light_pipe_pushes_and_never_grabs() {
    let (_, mut world) = peel(|_| {});
    let mut events = Vec::new();
    for (field, z) in (0..60).map(|i| (i, -10.8 - 0.4 * (i as f64 / 59.0))) {
        let jaw = if field < 30 { 0.5 } else { 0.0 };
        events.extend(step_at(&mut world, field, [0.0, 0.0, z], Tool::LightPipe, jaw));
    }
    assert!(of(&events, EventKind::TissueGrabbed).is_empty());
    let node = world.sheet().nodes() / 2;
    assert!(world.state().membrane.position(node).z < -11.1);
}

#[test]
fn an_instrument_that_came_round_an_edge_does_not_push_what_lies_over_it() {
    let (_, mut world) = peel(|_| {});
    // First seen with the tip beyond the membrane: it cannot have come through.
    for field in 0..10 {
        step_at(&mut world, field, [0.0, 0.0, -11.4], Tool::LightPipe, 0.0);
    }
    let state = world.state();
    assert!(state.membrane.contact[0].under);
    let node = world.sheet().nodes() / 2;
    assert!((state.membrane.position(node).z + 11.0).abs() < 0.02, "the membrane lies where it lay");
    // Drawn back until it is clear, it pushes again.
    for (field, z) in (10..110).map(|f| (f, -11.4 + 0.01 * (f - 10) as f64)) {
        step_at(&mut world, field, [0.0, 0.0, z], Tool::LightPipe, 0.0);
    }
    assert!(!world.state().membrane.contact[0].under);
}

#[test]
fn a_tip_in_the_retina_leaves_a_mark_and_says_how_long() {
    let (_, mut world) = peel(|_| {});
    let mut events = Vec::new();
    for field in 0..50 {
        // 0.2 mm into the retina beside the membrane, and out again.
        let depth = 0.2 - 0.04 * (field as f64 - 25.0).abs();
        events.extend(step_at(&mut world, field, [0.0, 11.5 + depth, 0.0], Tool::LightPipe, 0.0));
    }
    let deepest = of(&events, EventKind::RetinaPenetrated).iter().map(|e| e.value).fold(0.0, f64::max);
    assert!((0.1..=0.2).contains(&deepest), "{deepest}");
    let left = of(&events, EventKind::RetinaLeft);
    assert_eq!(left.len(), 1);
    assert!((0.5..1.0).contains(&left[0].value), "{} s", left[0].value);
    assert_eq!(world.state().marks.len(), 1);
}
