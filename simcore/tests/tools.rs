//! The tools on the membrane, in the shipped scenes that use them: pick and forceps in `lift`,
//! vitrector in `trim`; and the needle.

use bytemuck::Zeroable;
use nalgebra::Vector3;
use protocol::events::{Event, EventKind};
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalMode, PedalState, Tool};
use protocol::poses::TrackerFrame;
use protocol::scene::NODE_DEAD;
use protocol::steps::StepInput;
use scene::{NeedleScene, SceneFile};
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::tearing::check_mesh;

fn scene(name: &str) -> (Rehearsal, World) {
    let scene = SceneFile::load(name).unwrap();
    (Rehearsal::shipped(&scene), World::new(&scene).unwrap())
}

/// Plays seconds of a script; the mesh must be whole after each field.
fn play(world: &mut World, rehearsal: &Rehearsal, from_s: f64, to_s: f64) -> Vec<Event> {
    let mut events = Vec::new();
    for field in (from_s * 50.0) as u64..(to_s * 50.0) as u64 {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        events.extend(world.events());
        assert_eq!(check_mesh(world.sheet(), &world.state().membrane), Ok(()), "field {field}");
    }
    events
}

fn of(events: &[Event], kind: EventKind) -> Vec<&Event> {
    events.iter().filter(|e| e.kind == kind as u32).collect()
}

/// Living nodes in the instrument's frame that lie beside the shaft over the hook.
fn over_hook(world: &World) -> Vec<Vector3<f64>> {
    let pose = world.state().instruments[0].eye_from_instrument.inverse();
    let membrane = &world.state().membrane;
    let living = (0..membrane.nodes()).filter(|&n| membrane.flag[n] != NODE_DEAD);
    let seen = living.map(|n| pose * nalgebra::Point3::from(membrane.position(n).map(f64::from)));
    seen.map(|p| p.coords).filter(|p| (0.27..0.58).contains(&p.x) && p.y.abs() < 0.03).collect()
}

#[test]
fn the_pick_lifts_the_free_edge_and_the_forceps_take_it() {
    let (rehearsal, mut world) = scene("lift");
    let edge = |world: &World| {
        let m = &world.state().membrane;
        let near = |n: &usize| m.position(*n).x > 2.5 && m.position(*n).y.abs() < 0.4;
        (0..m.nodes()).filter(near).map(|n| m.position(n).norm()).fold(f32::INFINITY, f32::min)
    };
    let before = edge(&world);
    let mut events = play(&mut world, &rehearsal, 1.5, 7.0);
    assert_eq!(of(&events, EventKind::TissueHooked).len(), 1, "reported once");
    let contact = &world.state().membrane.contact[0];
    assert!(contact.under && contact.hooked);
    let lifted = before - edge(&world);
    assert!(lifted > 0.2, "the edge rose by {lifted} mm");
    let over = over_hook(&world);
    assert!(!over.is_empty());
    for p in over {
        assert!(p.z > 0.0, "nothing of the flap is under the hook: {p}");
    }
    events.extend(play(&mut world, &rehearsal, 7.0, 15.0));
    let changed = of(&events, EventKind::ToolChanged);
    assert_eq!((changed.len(), changed[0].value), (1, f64::from(Tool::Forceps as u32)));
    assert_eq!(of(&events, EventKind::TissueGrabbed).len(), 1);
    assert!(!world.state().membrane.contact[0].under && !world.state().membrane.contact[0].hooked);
    assert!(!world.state().membrane.held[0].is_empty());
    let m = &world.state().membrane;
    let held = world.state().membrane.held[0].iter().map(|h| m.position(h.node as usize).norm());
    let highest = held.fold(f32::INFINITY, f32::min);
    assert!(highest < before - 0.8, "the forceps lift it higher: {highest} {before}");
    assert!(of(&events, EventKind::TissueTorn).is_empty());
}

#[test]
fn what_the_vitrector_has_taken_is_what_is_missing() {
    let (rehearsal, mut world) = scene("trim");
    let area_um2: Vec<u64> = {
        let (m, sheet) = (&world.state().membrane, world.sheet());
        let at = |n: u32| m.position(n as usize).map(f64::from);
        let area = |t: &[u32; 3]| 0.5e6 * (at(t[1]) - at(t[0])).cross(&(at(t[2]) - at(t[0]))).norm();
        sheet.triangles.iter().map(|t| area(t).round() as u64).collect()
    };
    let events = play(&mut world, &rehearsal, 2.0, 9.0);
    let removed = world.state().membrane.removed;
    let missing: Vec<u64> = area_um2
        .iter()
        .zip(&world.state().membrane.triangle_alive)
        .filter(|(_, alive)| **alive == 0)
        .map(|(area, _)| *area)
        .collect();
    assert!(of(&events, EventKind::TissueTorn).is_empty(), "the scene does not tear");
    assert!(missing.len() > 15, "{} triangles", missing.len());
    assert_eq!((removed.triangles, removed.area_um2), (missing.len() as u64, missing.iter().sum()));
    let told: f64 = of(&events, EventKind::TissueCut).iter().map(|e| e.value).sum();
    assert!((told - removed.area_mm2()).abs() < 1e-9, "{told} {}", removed.area_mm2());
    let volume = removed.volume_mm3(world.scene().vitrector.unwrap().membrane_thickness_mm);
    assert!((volume - 0.02 * told).abs() < 1e-12);
}

#[test]
fn without_the_foot_nothing_is_sucked_or_cut_and_without_the_blade_nothing_is_cut() {
    let scene = SceneFile::load("trim").unwrap();
    let reach = |axes: Option<[f64; 2]>| {
        let mut scene = scene.clone();
        match axes {
            Some(axes) => scene.script.as_mut().unwrap().pedal[0].axes = axes,
            None => scene.script.as_mut().unwrap().pedal.clear(),
        }
        let rehearsal = Rehearsal::shipped(&scene);
        let mut world = World::new(&scene).unwrap();
        play(&mut world, &rehearsal, 2.0, 3.4);
        let m = &world.state().membrane;
        let farthest = (0..m.nodes()).map(|n| m.position(n).x).fold(f32::NEG_INFINITY, f32::max);
        (farthest, world.state().membrane.removed.triangles)
    };
    let (still, sucked) = (reach(None), reach(Some([1.0, 0.0])));
    assert_eq!((still.1, sucked.1), (0, 0));
    assert!(sucked.0 > still.0 + 0.05, "the edge comes to the port: {} {}", still.0, sucked.0);
}

/// A step with instrument 0 upright at `tip`, without rotation of the eye, instrument 1 lost.
fn step_at(world: &mut World, field: u64, tip: [f64; 3], tool: Tool, pedal: PedalState) -> Vec<Event> {
    let mut frame = TrackerFrame::zeroed();
    (frame.field, frame.frame) = (field, field);
    frame.instants.exposed = 1_000_000_000 + field * 20_000_000;
    frame.bodies.iter_mut().for_each(|b| (b.world_from_body, b.validity) = (Pose::IDENTITY, 2));
    frame.bodies[0].world_from_body.position_mm = tip;
    frame.bodies[1].validity = 0;
    let mut handle = HandleState::zeroed();
    (handle.seq, handle.tool) = (field, tool as u32);
    let input = StepInput { frame: &frame, handles: &[handle], pedals: &[pedal] };
    world.step(&input, &mut no_clock);
    assert_eq!(check_mesh(world.sheet(), &world.state().membrane), Ok(()));
    world.events().to_vec()
}

#[test]
fn a_needle_pushes_goes_through_and_takes_the_hole_along() {
    let mut scene = SceneFile::load("peel").unwrap();
    // The sheet of this scene is soft: it gives way before anything sharp can go through it.
    scene.needle = Some(NeedleScene { pierce_un: 2.0, ..NeedleScene::default() });
    let mut world = World::new(&scene).unwrap();
    let mut events = Vec::new();
    let mut at = |world: &mut World, field: u64, tip: [f64; 3]| {
        let inject = PedalState { mode: PedalMode::Inject as u32, axes: [0.5, 0.0], ..PedalState::zeroed() };
        events.extend(step_at(world, field, tip, Tool::Needle, inject));
    };
    // Down through the middle of the sheet, 11 mm deep, to 11.35 mm.
    for field in 0..100 {
        at(&mut world, field, [0.05, 0.03, -10.9 - 0.0045 * field as f64]);
    }
    let hole = |world: &World| {
        let pierced = world.state().membrane.contact[0].pierced?;
        let corners = world.sheet().triangles[pierced.triangle as usize];
        let weighed = corners.iter().zip(pierced.weights);
        Some(
            weighed
                .map(|(&n, w)| world.state().membrane.position(n as usize).map(f64::from) * w)
                .sum::<Vector3<f64>>(),
        )
    };
    let first = hole(&world).expect("pierced");
    assert!(first.z > -11.3, "the membrane stays behind the tip: {first}");
    assert_eq!(world.state().tools.injection_pa, 0.5 * 82_740.0);
    // Sideways, by less than tears the sheet: the hole follows the shaft. Out again: it is left.
    for field in 100..130 {
        at(&mut world, field, [0.05 + 0.005 * (field - 99) as f64, 0.03, -11.35]);
    }
    let moved = hole(&world).expect("still in") - first;
    assert!((moved.x - 0.15).abs() < 0.03, "{moved}");
    for field in 130..190 {
        at(&mut world, field, [0.2, 0.03, -11.35 + 0.01 * (field - 129) as f64]);
    }
    assert!(hole(&world).is_none());
    // The sheet that springs back may meet the tip again; but what went in came out.
    let pierced = of(&events, EventKind::MembranePierced);
    assert_eq!(pierced.iter().filter(|e| e.field < 130).count(), 1, "once on the way down and sideways");
    assert_eq!(pierced.len(), of(&events, EventKind::NeedleOut).len());
    let pierced = pierced[0];
    assert!(pierced.value > pierced.limit && pierced.limit == 2.0, "{}", pierced.value);
}

#[test]
fn the_scenes_end_in_the_same_bits_after_a_checkpoint_in_their_middle() {
    for (name, from_s, half_s, to_s) in [("lift", 4.0, 6.0, 6.6), ("trim", 2.2, 3.6, 4.2)] {
        let (rehearsal, mut world) = scene(name);
        play(&mut world, &rehearsal, from_s, half_s);
        let mut bytes = Vec::new();
        world.save(&mut bytes).unwrap();
        let mut again = World::new(world.scene()).unwrap();
        again.restore(&bytes).unwrap();
        play(&mut world, &rehearsal, half_s, to_s);
        play(&mut again, &rehearsal, half_s, to_s);
        assert_eq!(world.state(), again.state(), "{name}");
    }
}
