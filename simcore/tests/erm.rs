//! The adherent membrane: what the scripted peel costs, what it does to the retina, and what is
//! free curls.

use bytemuck::Zeroable;
use nalgebra::{UnitQuaternion, Vector3};
use protocol::events::{Event, EventKind};
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PORT_HEIGHT_MM, PedalMode, PedalState, Tool};
use protocol::poses::TrackerFrame;
use protocol::scene::NODE_DEAD;
use protocol::steps::StepInput;
use scene::{SceneFile, VitrectorScene};
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::tearing::check_mesh;

fn erm(change: impl FnOnce(&mut SceneFile)) -> (Rehearsal, World) {
    let mut scene = SceneFile::load("erm").unwrap();
    change(&mut scene);
    (Rehearsal::shipped(&scene), World::new(&scene).unwrap())
}

fn play(rehearsal: &Rehearsal, world: &mut World, fields: std::ops::Range<u64>) -> Vec<Event> {
    let mut events = Vec::new();
    for field in fields {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        events.extend(world.events());
        world.audit().unwrap();
    }
    events
}

fn at(events: &[Event], kind: EventKind) -> Option<u64> {
    events.iter().find(|e| e.kind == kind as u32).map(|e| e.field)
}

/// One published figure was fitted (23G forceps, 6.63 mN: Velez-Montoya et al. 2013), one is
/// predicted: the RMS while experts peeled in rabbits, 7.41 mN (Zheng et al. 2023). docs/peeling.md
/// has what is not predicted.
#[test]
fn the_scripted_peel_costs_what_was_measured() {
    let (rehearsal, mut world) = erm(|_| {});
    let (mut pulls_mn, mut freed, mut events) = (Vec::new(), 0.0, Vec::new());
    for field in 0..rehearsal.fields() {
        events.extend(play(&rehearsal, &mut world, field..field + 1));
        let now = world.state().membrane.adhesion.as_ref().unwrap().freed_mm2;
        let pull_mn = world.pull_un(0) * 1e-3;
        if now > freed && pull_mn > 0.0 {
            pulls_mn.push(pull_mn);
        }
        freed = now;
    }
    let mean = pulls_mn.iter().sum::<f64>() / pulls_mn.len() as f64;
    let rms = (pulls_mn.iter().map(|p| p * p).sum::<f64>() / pulls_mn.len() as f64).sqrt();
    println!("mean {mean:.2} mN, RMS {rms:.2} mN, {freed:.1} mm² off");
    assert!((mean / 6.63 - 1.0).abs() < 0.03, "fitted: {mean}");
    assert!((rms / 7.41 - 1.0).abs() < 0.15, "predicted: {rms}");
    let grabbed = at(&events, EventKind::TissueGrabbed).expect("grabbed");
    let peeled = at(&events, EventKind::MembranePeeled).expect("peeled");
    let pulled = at(&events, EventKind::RetinaPulled).expect("the epicentre pulls at the retina");
    assert!(grabbed < peeled && peeled < pulled, "{grabbed} {peeled} {pulled}");
    for never in
        [EventKind::RetinaLifted, EventKind::RetinaTorn, EventKind::GripSlipped, EventKind::TissueDisabled]
    {
        assert_eq!(at(&events, never), None, "{never:?}");
    }
    assert!(freed > 0.6 * world.adhesion().unwrap().bonded_mm2(), "most of it is off: {freed} mm²");
}

#[test]
fn a_retina_that_holds_less_than_the_adhesion_is_lifted_and_tears() {
    let (rehearsal, mut world) = erm(|s| {
        let adhesion = s.membrane.as_mut().unwrap().adhesion.as_mut().unwrap();
        (adhesion.retina_warn_pa, adhesion.retina_lift_pa, adhesion.retina_tear_mm) = (6000.0, 9000.0, 0.3);
    });
    let events = play(&rehearsal, &mut world, 190..500);
    let warned = at(&events, EventKind::RetinaPulled).expect("warned");
    let lifted = at(&events, EventKind::RetinaLifted).expect("lifted");
    let torn = at(&events, EventKind::RetinaTorn).expect("torn");
    assert!(warned <= lifted && lifted < torn, "{warned} {lifted} {torn}");
    let bonds = world.state().membrane.adhesion.as_ref().unwrap();
    assert!(bonds.lifted_mm.iter().all(|&mm| (0.0..=0.3).contains(&mm)));
    assert!(bonds.torn_mm2 > 0.0 && bonds.torn_mm2 <= bonds.freed_mm2);
    assert!(!world.state().marks.is_empty(), "a torn retina bleeds");
}

#[test]
fn the_loose_edge_curls_away_from_the_retina() {
    let height_mm = |curls: bool| {
        let (rehearsal, mut world) = erm(|s| {
            let m = s.membrane.as_mut().unwrap();
            m.curl = m.curl.take().filter(|_| curls);
            m.adhesion.as_mut().unwrap().patches.last_mut().unwrap().radius_mm = 1.5;
        });
        play(&rehearsal, &mut world, 0..150);
        let m = &world.state().membrane;
        (0..m.nodes()).map(|n| 11.5 - m.position(n).norm()).fold(0.0, f32::max)
    };
    // A roll of 1.2 mm that is free over 1.5 mm would rise by 0.8 mm; the adhesion around it holds
    // it back.
    let (with, without) = (height_mm(true), height_mm(false));
    println!("{with} mm with curl, {without} without");
    assert!((0.1..0.85).contains(&with) && without < 1e-3, "{with} {without}");
}

#[test]
fn a_peel_continues_bit_for_bit_from_a_checkpoint() {
    let (rehearsal, mut world) = erm(|_| {});
    play(&rehearsal, &mut world, 190..450);
    let mut saved = Vec::new();
    world.save(&mut saved).unwrap();
    let mut restored = World::new(world.scene()).unwrap();
    restored.restore(&saved).unwrap();
    for field in 450..480 {
        let [a, b] = [&mut world, &mut restored]
            .map(|w| w.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash);
        assert_eq!(a, b, "field {field}");
    }
    let (_, mut other) = erm(|s| s.membrane.as_mut().unwrap().adhesion = None);
    assert!(other.restore(&saved).is_err(), "another scene's state is refused");
}

#[test]
fn adhesion_too_stiff_for_the_mass_is_refused_with_the_mass_that_would_do() {
    let mut scene = SceneFile::load("erm").unwrap();
    scene.membrane.as_mut().unwrap().node_mass_g = 1e-5;
    let refused = World::new(&scene).unwrap_err().to_string();
    assert!(refused.contains("node_mass_g") && refused.contains("at least"), "{refused}");
}

/// Instrument 0 in a hand that goes where a test wants it; instrument 1 is lost, the eye at rest.
struct Hand {
    world: World,
    tool: Tool,
    turn: UnitQuaternion<f64>,
    pedal: PedalState,
    field: u64,
    events: Vec<Event>,
}

impl Hand {
    fn step(&mut self, tip: Vector3<f64>) {
        let mut frame = TrackerFrame::zeroed();
        (frame.field, frame.frame) = (self.field, self.field);
        frame.instants.exposed = 1_000_000_000 + self.field * 20_000_000;
        frame.bodies.iter_mut().for_each(|b| (b.world_from_body, b.validity) = (Pose::IDENTITY, 2));
        let [x, y, z, w] = self.turn.coords.into();
        frame.bodies[0].world_from_body = Pose { position_mm: tip.into(), rotation_wxyz: [w, x, y, z] };
        frame.bodies[1].validity = 0;
        let mut handle = HandleState::zeroed();
        (handle.seq, handle.tool) = (self.field, self.tool as u32);
        let input = StepInput { frame: &frame, handles: &[handle], pedals: &[self.pedal] };
        self.world.step(&input, &mut no_clock);
        self.field += 1;
        self.events.extend(self.world.events());
        self.world.audit().unwrap();
        assert_eq!(check_mesh(self.world.sheet(), &self.world.state().membrane), Ok(()));
    }

    /// In a straight line at `mm_s`.
    fn go(&mut self, from: [f64; 3], to: [f64; 3], mm_s: f64) {
        let (from, to) = (Vector3::from(from), Vector3::from(to));
        let steps = ((to - from).norm() / mm_s * 50.0).ceil().max(1.0) as u64;
        (1..=steps).for_each(|k| self.step(from + (to - from) * (k as f64 / steps as f64)));
    }
}

/// The port over bonded tissue, looking down at it from 0.1 mm: suction alone leaves it bonded or
/// lifts it, the blade cuts it, and what it cut is bonded no longer.
#[test]
fn the_vitrector_cuts_bonded_tissue() {
    let cut = |axes: [f64; 2]| {
        let (_, world) = erm(|s| s.vitrector = Some(VitrectorScene::default()));
        // +x of the instrument, to which the port opens, turned down by 60°.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_3);
        let pedal = PedalState { mode: PedalMode::Aspirate as u32, axes, ..PedalState::zeroed() };
        let mut hand = Hand { world, tool: Tool::Vitrector, turn, pedal, field: 0, events: Vec::new() };
        let port = turn * Vector3::new(0.3, 0.0, PORT_HEIGHT_MM);
        (0..50).for_each(|_| hand.step(Vector3::new(0.0, 0.0, -11.38) - port));
        hand
    };
    let idle = cut([0.0, 0.0]);
    let before = idle.world.state().membrane.adhesion.as_ref().unwrap().freed_mm2;
    assert_eq!((idle.world.state().membrane.removed.triangles, before), (0, 0.0));
    let sucked = cut([1.0, 0.0]);
    assert_eq!(sucked.world.state().membrane.removed.triangles, 0, "no blade, no cut");
    let hand = cut([1.0, 0.6]);
    let (state, sheet) = (hand.world.state(), hand.world.sheet());
    let missing = state.membrane.triangle_alive.iter().filter(|a| **a == 0).count() as u64;
    assert!(missing > 0 && state.membrane.removed.triangles == missing, "{missing} triangles");
    assert!(at(&hand.events, EventKind::TissueCut).is_some());
    // Far from the port everything is bonded as it was.
    let (adhesion, bonds) = (hand.world.adhesion().unwrap(), state.membrane.adhesion.as_ref().unwrap());
    for node in (0..sheet.nodes()).filter(|&n| adhesion.place(bonds, n).xy().norm() > 1.6) {
        assert!(adhesion.holds(bonds, node) == (adhesion.holds(&adhesion.start(), node)), "node {node}");
    }
    let dead = (0..sheet.nodes()).filter(|&n| state.membrane.flag[n] == NODE_DEAD).count();
    println!("{missing} triangles and {dead} nodes cut, {:.3} mm² freed", bonds.freed_mm2);
}

/// The pick goes under the curled edge, hook first, and up: the edge comes along and peels off.
#[test]
fn the_pick_lifts_an_edge_and_peels_it() {
    let (_, world) = erm(|s| {
        let membrane = s.membrane.as_mut().unwrap();
        membrane.adhesion.as_mut().unwrap().patches.last_mut().unwrap().radius_mm = 2.0;
        membrane.curl.as_mut().unwrap().radius_mm = 0.6;
    });
    // The hook, along the instrument's +x, points to −x.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    let pedal = PedalState::zeroed();
    let mut hand = Hand { world, tool: Tool::Pick, turn, pedal, field: 0, events: Vec::new() };
    // The edge needs its time to curl.
    (0..150).for_each(|_| hand.step(Vector3::new(4.4, 0.0, -10.0)));
    hand.go([4.4, 0.0, -10.0], [3.9, 0.0, -10.78], 1.0);
    hand.go([3.9, 0.0, -10.78], [3.0, 0.0, -11.06], 0.5);
    let height = |world: &World| {
        let m = &world.state().membrane;
        (0..m.nodes()).map(|n| 11.5 - m.position(n).norm()).fold(0.0, f32::max)
    };
    let (before, freed) =
        (height(&hand.world), hand.world.state().membrane.adhesion.as_ref().unwrap().freed_mm2);
    hand.go([3.0, 0.0, -11.06], [1.8, 0.0, -8.6], 0.8);
    let (after, off) =
        (height(&hand.world), hand.world.state().membrane.adhesion.as_ref().unwrap().freed_mm2);
    println!("{before:.2} -> {after:.2} mm high, {freed:.2} -> {off:.2} mm² off");
    assert!(at(&hand.events, EventKind::TissueHooked).is_some(), "hooked");
    assert!(after > before + 0.5, "lifted from {before} to {after} mm");
    assert!(off > freed, "peeled: {freed} {off}");
}
