//! Loose retina under tools: the shipped macular translocation, vitrectors that take retina, tips
//! that drag it and press it on.

use bytemuck::Zeroable;
use nalgebra::{UnitVector3, Vector3};
use protocol::events::{Event, EventKind};
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalMode, PedalState, Tool};
use protocol::poses::TrackerFrame;
use protocol::scene::{NODE_FREE, SceneHome, SceneTriangle, TISSUE_GONE, TISSUE_RETINA, section};
use protocol::steps::StepInput;
use scene::{RetinaOperation, SceneFile};
use simcore::scene_block::{SceneWriter, bytes_needed};
use simcore::world::{World, no_clock};
use std::ops::Range;
use surgeon::rehearsal::Rehearsal;
use tissue::retina::state::RetinaState;
use tissue::sheet::state::NODE_PINNED;

/// Polar angles of what the scene has cut free; the cut goes round at 1.2 rad, along the ring of
/// nodes before it.
const CUT_FREE_RAD: Range<f64> = 0.0..1.15;
/// Polar angles of the strip beyond the cut.
const BEYOND_CUT_RAD: Range<f64> = 1.21..1.3;

fn retina(world: &World) -> &RetinaState {
    world.state().retina.as_ref().expect("the scene has a retina")
}

fn of(events: &[Event], kind: EventKind) -> Vec<&Event> {
    events.iter().filter(|e| e.kind == kind as u32).collect()
}

/// Turns of the nodes at these polar angles from the fovea that are at least 2 mm from the disc's
/// axis: least, middle one and most, rad.
fn turns(world: &World, disc: &UnitVector3<f64>, polar_rad: Range<f64>) -> [f64; 3] {
    let (state, model) = (retina(world), world.retina().unwrap());
    let flat = |p: Vector3<f32>| {
        let p = p.map(f64::from);
        p - disc.into_inner() * p.dot(disc)
    };
    let mut turns = Vec::new();
    for (n, home) in model.home_mm.iter().enumerate() {
        let polar = f64::from(-home.z / 11.5).acos();
        let (was, is) = (flat(*home), flat(state.sheet.position(n)));
        if polar_rad.contains(&polar) && was.norm() > 2.0 {
            turns.push(was.cross(&is).dot(disc).atan2(was.dot(&is)));
        }
    }
    turns.sort_by(f64::total_cmp);
    [turns[0], turns[turns.len() / 2], turns[turns.len() - 1]]
}

#[test]
fn the_shipped_translocation_turns_the_retina_as_a_whole_and_lays_it_on() {
    let scene = SceneFile::load("translocation").unwrap();
    let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
    let disc =
        UnitVector3::new_normalize(Vector3::from(scene.retina.as_ref().unwrap().disc_in_eye_mm.unwrap()));
    let whole = retina(&world).sheet.flag.iter().filter(|&&f| f == NODE_FREE).count();
    let mut events = Vec::new();
    for field in 0..46 * 50 {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        events.extend(world.events());
        if field % 100 == 0 {
            world.audit().unwrap_or_else(|e| panic!("field {field}: {e}"));
        }
        if field == 24 * 50 {
            // Led by one grip, turned by half a radian: the rest has followed.
            let [least, middle, most] = turns(&world, &disc, CUT_FREE_RAD);
            assert!(least > 0.3 && most < 0.65, "{least} to {most} rad before the air");
            assert!((0.4..0.5).contains(&middle), "{middle} rad in the middle before the air");
        }
    }
    assert!(
        of(&events, EventKind::RetinaRipped).is_empty() && of(&events, EventKind::TissueDisabled).is_empty()
    );
    assert!(of(&events, EventKind::GripSlipped).is_empty());
    let state = retina(&world);
    let loose = state.sheet.flag.iter().filter(|&&f| f != NODE_PINNED).count();
    assert!(loose * 100 <= whole, "all of it lies again but for a fold: {loose} nodes of {whole} do not");
    let [least, middle, most] = turns(&world, &disc, CUT_FREE_RAD);
    assert!(least > 0.42 && most < 0.54, "{least} to {most} rad");
    assert!((0.44..0.49).contains(&middle), "{middle} rad in the middle");
    // Beyond the cut it came off too, but hangs at the ora and stays.
    let [back, _, forth] = turns(&world, &disc, BEYOND_CUT_RAD);
    assert!(back > -0.02 && forth < 0.02, "{back} to {forth} rad beyond the cut");
    // That strip counts in the mean of all that came off.
    let mean = state.turn_about_rad(&world.retina().unwrap().home_mm, &disc);
    assert!(mean > 0.3 && mean < middle, "{mean} rad on average");
    the_picture_turns_with_it(&world, whole);
}

/// The scene block has every triangle that lies elsewhere than at the start, those that are gone,
/// and where all of it lay.
fn the_picture_turns_with_it(world: &World, whole: usize) {
    let mut payload = vec![
        0u128;
        bytes_needed(world.sheet(), false, None, world.retina().map(|r| &r.body.mesh))
            .div_ceil(16)
    ];
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut payload);
    let header = SceneWriter::new(world).write(world, Zeroable::zeroed(), 0, bytes);
    let triangles = section::<SceneTriangle>(bytes, header.triangles).unwrap();
    let count = |tissue| triangles.iter().filter(|t| t.tissue == tissue).count();
    let gone = retina(world).sheet.triangle_alive.iter().filter(|&&a| a == 0).count();
    assert_eq!(count(TISSUE_GONE), gone);
    assert!(count(TISSUE_RETINA) > whole, "{} triangles for {whole} nodes", count(TISSUE_RETINA));
    let homes = section::<SceneHome>(bytes, header.homes).unwrap();
    let lay = world.retina().unwrap().home_mm.iter().map(|p| <[f32; 3]>::from(*p));
    assert!(
        lay.eq(homes.iter().map(|h| h.position_mm)) && homes.iter().map(|h| h.node).eq(0..homes.len() as u32)
    );
}

/// A retina that is off up to an angle over so much fluid, with what `change` does to the scene.
fn lifted(detached_rad: f64, fluid_mm3: f64, change: impl FnOnce(&mut SceneFile)) -> World {
    let mut scene = SceneFile::load("relocation").unwrap();
    let retina = scene.retina.as_mut().unwrap();
    retina.operation = Some(RetinaOperation { detached_rad, fluid_mm3, cut_rad: 0.0 });
    change(&mut scene);
    World::new(&SceneFile::parse(&scene.to_toml(), "lifted").unwrap()).unwrap()
}

/// A step with instrument 0 at `pose`, without rotation of the eye, instrument 1 lost.
fn step(world: &mut World, field: u64, pose: Pose, tool: Tool, pedal: PedalState) -> Vec<Event> {
    let mut frame = TrackerFrame::zeroed();
    (frame.field, frame.frame) = (field, field);
    frame.instants.exposed = 1_000_000_000 + field * 20_000_000;
    frame.bodies.iter_mut().for_each(|b| (b.world_from_body, b.validity) = (Pose::IDENTITY, 2));
    frame.bodies[0].world_from_body = pose;
    frame.bodies[1].validity = 0;
    let mut handle = HandleState::zeroed();
    (handle.seq, handle.tool) = (field, tool as u32);
    world.step(&StepInput { frame: &frame, handles: &[handle], pedals: &[pedal] }, &mut no_clock);
    world.audit().unwrap_or_else(|e| panic!("field {field}: {e}"));
    world.events().to_vec()
}

fn upright(tip: [f64; 3]) -> Pose {
    Pose { position_mm: tip, ..Pose::IDENTITY }
}

/// The shaft lies across, its port looks down at the retina.
fn lying(tip: [f64; 3]) -> Pose {
    let half = 0.5f64.sqrt();
    Pose { position_mm: tip, rotation_wxyz: [half, 0.0, half, 0.0] }
}

fn top_mm(world: &World) -> f64 {
    let tissue = &retina(world).sheet;
    f64::from((0..tissue.nodes()).map(|n| 11.5 - tissue.position(n).norm()).fold(0.0f32, f32::max))
}

fn aspirate(axes: [f64; 2]) -> PedalState {
    PedalState { mode: PedalMode::Aspirate as u32, axes, ..PedalState::zeroed() }
}

/// With the pump alone the retina comes to the port; with the blade it loses area, which is
/// counted, and its fluid, which is accounted for.
#[test]
fn a_vitrector_sucks_loose_retina_and_takes_it_and_none_that_lies_on() {
    let reach = |fluid_mm3: f64, detached_rad: f64, axes: [f64; 2]| {
        let mut world = lifted(detached_rad, fluid_mm3, |_| {});
        let before = top_mm(&world);
        let tip = [-0.4, 0.0, before - 11.5 + 0.7];
        let mut events = Vec::new();
        for field in 0..60 {
            let pedal = aspirate(if field < 10 { [0.0; 2] } else { axes });
            events.extend(step(&mut world, field, lying(tip), Tool::Vitrector, pedal));
        }
        let rise = top_mm(&world) - before;
        (world, events, rise)
    };
    let (still, ..) = reach(60.0, 0.5, [0.0, 0.0]);
    let (sucked, events, rise) = reach(60.0, 0.5, [0.5, 0.0]);
    assert!(rise > 0.1, "{rise} mm towards the port");
    assert_eq!((retina(&sucked).sheet.removed.triangles, of(&events, EventKind::RetinaCut).len()), (0, 0));
    assert!((retina(&sucked).under_mm3() - retina(&still).under_mm3()).abs() < 1e-9, "it has no hole yet");
    let (cut, events, _) = reach(60.0, 0.5, [0.5, 1.0]);
    let (state, model) = (retina(&cut), cut.retina().unwrap());
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|n| model.home_mm[n as usize].map(f64::from));
        0.5 * (b - a).cross(&(c - a)).norm()
    };
    let gone = model.body.mesh.triangles.iter().zip(&state.sheet.triangle_alive).filter(|(_, a)| **a == 0);
    let missing: Vec<f64> = gone.map(|(t, _)| area(t)).collect();
    assert!(of(&events, EventKind::RetinaRipped).is_empty(), "cut, not torn");
    assert!(!missing.is_empty() && state.sheet.removed.triangles == missing.len() as u64);
    let told: f64 = of(&events, EventKind::RetinaCut).iter().map(|e| e.value).sum();
    let sum: f64 = missing.iter().sum();
    // Each triangle is counted in whole µm².
    assert!(
        (told - sum).abs() < 1e-6 * missing.len() as f64
            && (told - state.sheet.removed.area_mm2()).abs() < 1e-9
    );
    // Drawn up by the port, the retina draws in fluid through its hole.
    assert!(state.account.leaked_mm3 < -0.1, "{:?}", state.account);
    // Where it lies on, the port finds nothing.
    let mut world = lifted(0.1, 0.5, |_| {});
    for field in 0..30 {
        step(&mut world, field, lying([4.0, 0.0, -10.4]), Tool::Vitrector, aspirate([1.0, 1.0]));
    }
    assert_eq!(retina(&world).sheet.removed.triangles, 0);
}

/// A tip that presses on a bleb and goes sideways takes the retina under it along by the scene's
/// share of its way, and none without friction.
#[test]
fn a_pressing_tip_drags_by_its_share() {
    let dragged = |drag: f64| {
        let mut world = lifted(0.5, 60.0, |s| s.retina.as_mut().unwrap().drag = drag);
        let depth = top_mm(&world) - 11.5 - 0.25;
        let mut field = 0;
        for z in [0.6, 0.3, 0.1, 0.0, 0.0] {
            step(&mut world, field, upright([0.0, 0.0, depth + z]), Tool::LightPipe, PedalState::zeroed());
            field += 1;
        }
        let tissue = &retina(&world).sheet;
        let under = |n: &usize| tissue.position(*n).xy().norm() < 0.7;
        let under: Vec<usize> = (0..tissue.nodes()).filter(under).collect();
        let before: Vec<f32> = under.iter().map(|&n| tissue.position(n).x).collect();
        for k in 1..=10 {
            let tip = [0.04 * f64::from(k), 0.0, depth];
            step(&mut world, field, upright(tip), Tool::LightPipe, PedalState::zeroed());
            field += 1;
        }
        let tissue = &retina(&world).sheet;
        let ways = under.iter().zip(&before).map(|(&n, x)| f64::from(tissue.position(n).x - x));
        ways.sum::<f64>() / under.len() as f64
    };
    let [none, half, most] = [0.0, 0.4, 0.8].map(dragged);
    assert!(none.abs() < 0.05, "{none} mm without friction");
    assert!(none < half && half < most && most < 0.8 * 0.4, "{none} {half} {most}");
}

/// A shallow bleb that a tip presses to the choroid holds there, and stays when the tip leaves; its
/// fluid goes aside and is not lost.
#[test]
fn what_is_pressed_on_holds() {
    let mut world = lifted(0.3, 2.5, |_| {});
    let before = retina(&world).sheet.flag.iter().filter(|&&f| f == NODE_FREE).count();
    let (mut events, mut field) = (Vec::new(), 0);
    for k in 0..60 {
        let z = (-10.9 - 0.02 * f64::from(k)).max(-11.5);
        events.extend(step(
            &mut world,
            field,
            upright([0.05, 0.05, z]),
            Tool::LightPipe,
            PedalState::zeroed(),
        ));
        field += 1;
    }
    let lies = |world: &World| {
        let tissue = &retina(world).sheet;
        (0..tissue.nodes()).any(|n| tissue.flag[n] == NODE_PINNED && tissue.position(n).xy().norm() < 0.4)
    };
    assert!(lies(&world) && !of(&events, EventKind::RetinaReattached).is_empty());
    for _ in 0..25 {
        step(&mut world, field, upright([0.0, 0.0, -9.0]), Tool::LightPipe, PedalState::zeroed());
        field += 1;
    }
    assert!(lies(&world), "it holds when the tip has left");
    let after = retina(&world).sheet.flag.iter().filter(|&&f| f == NODE_FREE).count();
    assert!(
        after < before && (retina(&world).under_mm3() - 2.5).abs() < 0.1,
        "{}",
        retina(&world).under_mm3()
    );
}
