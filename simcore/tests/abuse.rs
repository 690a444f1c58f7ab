//! Whatever comes in, the world does not panic, its numbers stay finite and its mesh stays whole.

use bytemuck::Zeroable;
use proptest::prelude::*;
use protocol::events::EventKind;
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::message::Message;
use protocol::poses::{EYE, TrackerFrame};
use protocol::steps::StepInput;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::guard::all_finite;
use tissue::sheet::tearing::check_mesh;

fn world() -> World {
    World::new(&SceneFile::load("peel").unwrap()).unwrap()
}

fn pose(near: bool) -> impl Strategy<Value = Pose> {
    let reach = if near { 3.0 } else { 5e5 };
    let depth = if near { -11.8..-9.5 } else { -1e5..1e5 };
    let wild = prop::array::uniform4(-1.0f64..1.0);
    (-reach..reach, -reach..reach, depth, wild).prop_map(|(x, y, z, [a, b, c, d])| {
        // Mostly handle up, sometimes any way round.
        let q = if a > 0.5 { [a, b, c, d] } else { [1.0, b * 0.3, c * 0.3, d] };
        let n = q.iter().map(|c| c * c).sum::<f64>().sqrt();
        Pose { position_mm: [x, y, z], rotation_wxyz: q.map(|c| c / n) }
    })
}

/// Advance (ns, may be negative), two poses, validity of three bodies, two jaws.
type Move = (i64, [Pose; 2], [u32; 3], [f64; 2]);

fn movement() -> impl Strategy<Value = Move> {
    let advance = prop_oneof![
        6 => 15_000_000i64..25_000_000,
        1 => 0i64..3_000_000,
        1 => Just(20_000_000),
        1 => -1_000_000_000i64..10_000_000_000,
    ];
    let poses = prop_oneof![8 => [pose(true), pose(true)], 1 => [pose(false), pose(true)]];
    let validity = prop::array::uniform3(prop_oneof![9 => Just(2u32), 1 => 0u32..4]);
    (advance, poses, validity, [0.0f64..0.4, 0.0f64..3.0])
}

fn apply(world: &mut World, moves: &[Move]) -> u64 {
    let mut exposed = 1_000_000_000_000u64;
    for (i, (advance, poses, validity, jaws)) in moves.iter().enumerate() {
        exposed = exposed.saturating_add_signed(*advance).max(1);
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.frame, frame.instants.exposed) = (i as u64, i as u64, exposed);
        frame.bodies[EYE].world_from_body = Pose::IDENTITY;
        for (body, pose) in frame.bodies.iter_mut().zip(poses) {
            body.world_from_body = *pose;
        }
        for (body, &v) in frame.bodies.iter_mut().zip(validity) {
            body.validity = v;
        }
        let handles: [HandleState; 2] = std::array::from_fn(|j| HandleState {
            seq: i as u64,
            field: i as u64,
            instant_ns: exposed,
            instrument: j as u32,
            tool: 1 + (j as u32),
            jaw_rad: jaws[j],
        });
        let pedals = [PedalState { axes: [jaws[0], -0.3], mode: i as u32 % 3, ..PedalState::zeroed() }];
        world.step(&StepInput { frame: &frame, handles: &handles, pedals: &pedals }, &mut no_clock);
        let membrane = &world.state().membrane;
        assert!(all_finite(membrane));
        assert_eq!(check_mesh(world.sheet(), membrane), Ok(()));
        world.events().iter().for_each(|e| e.validate().unwrap());
        let free = (0..membrane.nodes()).filter(|&n| membrane.flag[n] == protocol::scene::NODE_FREE);
        assert!(free.into_iter().all(|n| membrane.position(n).norm() < 11.5 + 1e-3));
    }
    let mut saved = Vec::new();
    world.save(&mut saved).unwrap();
    let hash = world.state_hash();
    world.restore(&saved).expect("whatever state it came to can be restored");
    assert_eq!(world.state_hash(), hash);
    hash
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn random_movement_does_no_harm_and_repeats(moves in prop::collection::vec(movement(), 1..60)) {
        prop_assert_eq!(apply(&mut world(), &moves), apply(&mut world(), &moves));
    }
}

#[test]
fn a_lost_instrument_touches_nothing_and_sweeps_nothing_when_it_comes_back() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = world();
    let before = world.state().membrane.clone();
    let at = |field: u64, tip: [f64; 3], valid: bool| {
        let (mut frame, handles) = rehearsal.field(field);
        frame.bodies[EYE].world_from_body = Pose::IDENTITY;
        frame.bodies[0].world_from_body = Pose { position_mm: tip, ..Pose::IDENTITY };
        frame.bodies[0].validity = if valid { 2 } else { 0 };
        (frame, handles)
    };
    // Over the membrane, lost, back again on its other side: 11.3 mm deep where the membrane is at
    // 11.
    let way = [([0.0, 0.0, -10.0], true), ([0.0, 0.0, -10.5], false), ([0.0, 0.0, -11.3], true)];
    let mut kinds = Vec::new();
    for (field, (tip, valid)) in way.into_iter().enumerate() {
        let (frame, handles) = at(field as u64, tip, valid);
        world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[] }, &mut no_clock);
        kinds.extend(world.events().iter().map(|e| e.kind));
    }
    for node in 0..before.nodes() {
        let moved = (world.state().membrane.position(node) - before.position(node)).norm();
        assert!(moved < 1e-4, "node {node} moved by {moved}");
    }
    assert!(kinds.contains(&(EventKind::TrackingLost as u32)));
    assert!(kinds.contains(&(EventKind::TrackingRegained as u32)));
}

#[test]
fn a_fast_tip_does_not_jump_through_the_membrane() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = world();
    for (field, z) in [-10.0, -10.8, -11.25].into_iter().enumerate() {
        let (mut frame, mut handles) = rehearsal.field(field as u64);
        frame.bodies[EYE].world_from_body = Pose::IDENTITY;
        frame.bodies[0].world_from_body = Pose { position_mm: [0.03, 0.02, z], ..Pose::IDENTITY };
        handles[0].jaw_rad = 0.2;
        world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[] }, &mut no_clock);
    }
    let m = &world.state().membrane;
    let under = |n: &usize| m.position(*n).xy().norm() < 0.12;
    let highest = (0..m.nodes()).filter(under).map(|n| m.position(n).z).fold(f32::NEG_INFINITY, f32::max);
    assert!(highest < -11.15, "the membrane was carried along: {highest}");
}

#[test]
fn a_pause_advances_nothing_and_a_foreign_handle_is_refused() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let mut world = world();
    world.step(&rehearsal.inputs(0).input(), &mut no_clock);
    let (mut frame, mut handles) = rehearsal.field(1);
    frame.instants.exposed += 5_000_000_000;
    handles[1].jaw_rad = f64::NAN;
    let report = world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[] }, &mut no_clock);
    assert_eq!((report.advanced_ns, world.state().refused), (0, 1));
    assert!(world.events().iter().any(|e| e.kind == EventKind::InputRefused as u32));
}

/// A fast tip of every instrument on a random way: either it ends on the side of the membrane where
/// it began, or the world knows of the contact. The crossing is found by hand: where the way cuts
/// each triangle's plane, at the rest shape.
#[test]
fn a_tip_that_moves_five_millimetres_in_a_field_never_passes_unseen() {
    let scene = SceneFile::load("peel").unwrap();
    let rehearsal = Rehearsal::shipped(&scene);
    let tools = [Tool::Forceps, Tool::Pick, Tool::Vitrector, Tool::Needle, Tool::LightPipe];
    let mut passed = [0; 5];
    for number in 0..200usize {
        let tool = tools[number % tools.len()];
        let share = number as f64 / 200.0;
        let turn = number as f64 * 2.399_963;
        let lean = 0.9 * share;
        let way = nalgebra::Vector3::new(lean.sin() * turn.cos(), lean.sin() * turn.sin(), -lean.cos());
        let target = nalgebra::Vector3::new(0.6 * (1.7 * turn).sin(), 0.6 * (2.3 * turn).cos(), -11.05);
        let mut world = world();
        let rest: Vec<[nalgebra::Vector3<f64>; 3]> = (world.sheet().triangles.iter())
            .map(|t| t.map(|n| world.state().membrane.position(n as usize).map(f64::from)))
            .collect();
        // Ends between 0.4 and 1.6 mm beyond the membrane, as deep as the way is long in one look
        // and more.
        let to = target + way * (0.4 + 1.2 * share);
        let path = [to - way * 5.2, to - way * 5.0, to];
        let mut pierced = false;
        for (field, at) in path.iter().enumerate() {
            let (mut frame, mut handles) = rehearsal.field(field as u64);
            frame.bodies[EYE].world_from_body = Pose::IDENTITY;
            frame.bodies[0].world_from_body = Pose { position_mm: (*at).into(), ..Pose::IDENTITY };
            (handles[0].jaw_rad, handles[0].tool) = (0.2, tool as u32);
            world.step(&StepInput { frame: &frame, handles: &handles, pedals: &[] }, &mut no_clock);
            // A needle goes through and says so; torn aside, it may be out of its hole again.
            pierced |= world.events().iter().any(|e| e.kind == EventKind::MembranePierced as u32);
        }
        assert_eq!(world.state().instruments[0].tool, tool as u32);
        let crossed = rest.iter().any(|[a, b, c]| {
            let normal = (b - a).cross(&(c - a));
            let (before, after) = (normal.dot(&(path[1] - a)), normal.dot(&(to - a)));
            let at = path[1] + (to - path[1]) * (before / (before - after));
            let inside = |p: nalgebra::Vector3<f64>, q: &nalgebra::Vector3<f64>| {
                normal.dot(&(q - p).cross(&(at - p))) > 0.0
            };
            before * after < 0.0 && inside(*a, b) && inside(*b, c) && inside(*c, a)
        });
        let seen = pierced || world.state().membrane.contact[0].in_contact;
        assert!(seen || !crossed, "way {number} of a {tool:?} passed unseen");
        passed[number % tools.len()] += usize::from(crossed);
    }
    assert!(passed.iter().all(|&n| n > 20), "every instrument must cross: {passed:?}");
}
