//! Every way of making substeps that a scene can choose, in the whole world: a tip presses the
//! membrane, stays, and leaves. The sheet stays whole and calm, gives way by what the tip went,
//! comes back unless it is plastic, and a checkpoint on the way changes nothing.

use bytemuck::Zeroable;
use protocol::events::EventKind;
use protocol::geometry::Pose;
use protocol::handles::{HandleState, Tool};
use protocol::poses::TrackerFrame;
use protocol::steps::StepInput;
use scene::{ElementsLaw, ElementsScene, MembraneIntegrator, MembraneScene, MeshScene, SceneFile};
use simcore::world::{World, no_clock};
use tissue::sheet::guard::all_finite;

/// Height of the sheet's middle, eye frame, mm.
const TOP_MM: f64 = -11.0;
/// Height of its rim over its middle, mm.
const RIM_MM: f64 = 0.3;
/// How far the tip presses, mm.
const DEPTH_MM: f64 = 0.2;
/// Most that may be left of a dent once all is at rest, mm.
const LEFT_MM: f64 = 0.002;
/// Field at which the tip has come down, and at which it leaves.
const DOWN: u64 = 40;
const LEAVES: u64 = 90;
/// Field at which tissue that creeps through the fluid is back. Material that goes straight to its
/// balance needs no time for it.
const END: u64 = 240;
const EARLY_END: u64 = 130;
/// Field of the checkpoint: the tip presses.
const SAVED: u64 = 70;

/// A bowl of 96 triangles, its rim above its middle: whatever presses it stretches it. A dome would
/// give way without any stretch, by turning inside out around the tip, and stay so.
fn bowl() -> MeshScene {
    let (columns, rows) = (9u32, 7u32);
    let at = |c: u32, r: u32| {
        let [u, v] = [f64::from(c) / 4.0 - 1.0, f64::from(r) / 3.0 - 1.0];
        [1.6 * u, 1.2 * v, TOP_MM + RIM_MM - RIM_MM * (1.0 - u * u) * (1.0 - v * v)].map(|x| x as f32)
    };
    let corner = |c: u32, r: u32| r * columns + c;
    let square = |c: u32, r: u32| {
        let [a, b, d, e] = [corner(c, r), corner(c + 1, r), corner(c, r + 1), corner(c + 1, r + 1)];
        [[a, b, e], [a, e, d]]
    };
    let all = |columns: u32, rows: u32| (0..rows).flat_map(move |r| (0..columns).map(move |c| (c, r)));
    MeshScene {
        positions_mm: all(columns, rows).map(|(c, r)| at(c, r)).collect(),
        triangles: all(columns - 1, rows - 1).flat_map(|(c, r)| square(c, r)).collect(),
        ..MeshScene::default()
    }
}

/// The bowl of the shipped tissue, `change`d.
fn scene(change: impl Fn(&mut MembraneScene)) -> SceneFile {
    let mut scene = SceneFile::load("peel").unwrap();
    let m = scene.membrane.as_mut().unwrap();
    (m.towards_in_eye, m.size_mm, m.squares, m.lift_mm) = Default::default();
    // Nodes of three times the area; bending springs that smooth what would buckle between them.
    (m.mesh, m.node_mass_g, m.bending_un_per_mm) = (Some(bowl()), 0.03, 40.0);
    // It does not swing through.
    m.fluid_damping_per_s = 60.0;
    (m.rim_warn_un, m.rim_tear_un) = (1e6, 1e6);
    change(m);
    scene.instruments[0].tool = Tool::LightPipe;
    SceneFile::parse(&scene.to_toml(), "options").unwrap()
}

/// Height of the tip at a field, mm: down at a steady speed, rest, and away.
fn tip_mm(field: u64) -> f64 {
    let share = |from: u64, to: u64| (field.clamp(from, to) - from) as f64 / (to - from) as f64;
    TOP_MM + 0.2 - (0.2 + DEPTH_MM) * share(0, DOWN) + 2.0 * share(LEAVES, LEAVES + 20)
}

/// A step with the tip over the middle of the sheet, the other instrument lost; its hash.
fn step(world: &mut World, field: u64) -> u64 {
    let mut frame = TrackerFrame::zeroed();
    (frame.field, frame.frame) = (field, field);
    frame.instants.exposed = 1_000_000_000 + field * 20_000_000;
    frame.bodies.iter_mut().for_each(|b| (b.world_from_body, b.validity) = (Pose::IDENTITY, 2));
    frame.bodies[0].world_from_body = Pose { position_mm: [0.03, 0.02, tip_mm(field)], ..Pose::IDENTITY };
    frame.bodies[1].validity = 0;
    let mut handle = HandleState::zeroed();
    (handle.seq, handle.tool) = (field, Tool::LightPipe as u32);
    let hash = world.step(&StepInput { frame: &frame, handles: &[handle], pedals: &[] }, &mut no_clock);
    world.audit().unwrap_or_else(|e| panic!("field {field}: {e}"));
    let bad = [EventKind::TissueDisabled, EventKind::TissueTorn, EventKind::RimDetached].map(|k| k as u32);
    let bad = world.events().iter().find(|e| bad.contains(&e.kind));
    assert!(bad.is_none(), "field {field}: {bad:?}");
    hash.state_hash
}

/// Largest distance of a node from where it began, mm.
fn dent_mm(world: &World) -> f64 {
    let (now, start) = (&world.state().membrane, world.sheet().start());
    let ways = (0..now.nodes()).map(|n| f64::from((now.position(n) - start.position(n)).norm()));
    ways.fold(0.0, f64::max)
}

/// Largest speed of a node, mm/s.
fn speed_mm_s(world: &World) -> f32 {
    let now = &world.state().membrane;
    (0..now.nodes()).map(|n| now.velocity(n).norm()).fold(0.0, f32::max)
}

/// Presses and leaves; dents while the tip rests and at the end, mm.
fn press(change: impl Fn(&mut MembraneScene), end: u64) -> [f64; 2] {
    let scene = scene(change);
    let mut world = World::new(&scene).unwrap();
    let (mut saved, mut hashes, mut pressed, mut fastest) = (Vec::new(), Vec::new(), 0.0, 0.0f32);
    for field in 0..end {
        hashes.push(step(&mut world, field));
        fastest = fastest.max(speed_mm_s(&world));
        match field {
            SAVED => world.save(&mut saved).unwrap(),
            LEAVES => pressed = dent_mm(&world),
            _ => {}
        }
    }
    assert!(all_finite(&world.state().membrane));
    // The tip itself comes at 10 mm/s.
    assert!(fastest < 60.0, "{fastest} mm/s");
    assert!(speed_mm_s(&world) < 0.05, "at rest: {} mm/s", speed_mm_s(&world));
    let mut again = World::new(&scene).unwrap();
    again.restore(&saved).unwrap();
    for field in SAVED + 1..end {
        assert_eq!(step(&mut again, field), hashes[field as usize], "field {field} after a checkpoint");
    }
    [pressed, dent_mm(&world)]
}

/// Presses a sheet that must come back by field `end`.
fn is_back(change: impl Fn(&mut MembraneScene), end: u64) {
    let [pressed, stays] = press(change, end);
    // The tip is flat, and the sheet goes down towards its middle: nodes beside the middle go
    // farther than the tip came.
    assert!((DEPTH_MM..1.4 * DEPTH_MM).contains(&pressed), "{pressed} mm under the tip");
    assert!(stays < LEFT_MM, "{stays} mm of {pressed} stay");
}

fn comes_back(change: impl Fn(&mut MembraneScene)) {
    is_back(change, END);
}

fn by(integrator: MembraneIntegrator) -> impl Fn(&mut MembraneScene) {
    move |m| m.integrator = integrator
}

#[test]
fn semi_implicit_tissue_comes_back() {
    comes_back(|_| ());
}

#[test]
fn explicit_tissue_comes_back() {
    comes_back(by(MembraneIntegrator::Explicit));
}

#[test]
fn implicit_tissue_comes_back() {
    comes_back(by(MembraneIntegrator::Implicit));
}

#[test]
fn quasi_static_tissue_comes_back() {
    is_back(by(MembraneIntegrator::QuasiStatic), EARLY_END);
}

/// The paper's own quasi-static system: no velocity outlives a substep.
#[test]
fn tissue_without_speed_comes_back() {
    comes_back(|m| (m.v_max_mm_s, m.node_mass_g) = (0.0, 0.004));
}

#[test]
fn tissue_of_limited_strain_comes_back() {
    use MembraneIntegrator::{Implicit, SemiImplicit};
    for integrator in [SemiImplicit, Implicit] {
        comes_back(|m| (m.integrator, m.strain_limit) = (integrator, 0.02));
    }
    is_back(|m| (m.integrator, m.strain_limit) = (MembraneIntegrator::QuasiStatic, 0.02), EARLY_END);
    comes_back(|m| (m.v_max_mm_s, m.node_mass_g, m.strain_limit) = (0.0, 0.004, 0.02));
}

#[test]
fn a_continuum_comes_back() {
    let (young_un_per_mm, poisson) = (400.0, None);
    comes_back(|m| {
        m.integrator = MembraneIntegrator::Implicit;
        m.elements = Some(ElementsScene { law: ElementsLaw::NeoHookean, young_un_per_mm, poisson });
    });
}

/// Material that yields below the strain of the press keeps a dent; tissue that yields beyond it
/// does not.
#[test]
fn only_plastic_tissue_keeps_a_dent() {
    use MembraneIntegrator::{Explicit, SemiImplicit};
    for integrator in [SemiImplicit, Explicit] {
        let plastic = |yield_strain: f64| {
            press(|m| (m.integrator, m.yield_strain, m.creep_per_s) = (integrator, yield_strain, 10.0), END)
        };
        let [pressed, stays] = plastic(0.002);
        assert!(stays > 0.3 * pressed, "{stays} mm of {pressed} stay");
        let [pressed, stays] = plastic(0.5);
        assert!(stays < LEFT_MM, "{stays} mm of {pressed} stay");
    }
}

/// Glued tissue that nobody touches: its loose edge curls as far however its substeps are made, and
/// no bond breaks.
#[test]
fn adhesion_and_curl_balance_under_every_integrator() {
    use MembraneIntegrator::{Implicit, QuasiStatic, SemiImplicit};
    let [semi, implicit, quasi] = [SemiImplicit, Implicit, QuasiStatic].map(|integrator| {
        let mut scene = SceneFile::load("erm").unwrap();
        scene.membrane.as_mut().unwrap().integrator = integrator;
        let mut world = World::new(&scene).unwrap();
        let mut frame = TrackerFrame::zeroed();
        (frame.bodies[2].world_from_body, frame.bodies[2].validity) = (Pose::IDENTITY, 2);
        for field in 0..200 {
            (frame.field, frame.frame) = (field, field);
            frame.instants.exposed = 1_000_000_000 + field * 20_000_000;
            world.step(&StepInput { frame: &frame, handles: &[], pedals: &[] }, &mut no_clock);
        }
        assert_eq!(world.state().membrane.adhesion.as_ref().unwrap().freed_mm2, 0.0, "{integrator:?}");
        dent_mm(&world)
    });
    assert!((0.02..0.05).contains(&semi), "{semi} mm");
    assert!((implicit / semi - 1.0).abs() < 0.02, "{implicit} mm, explicitly {semi}");
    assert!((quasi / semi - 1.0).abs() < 0.02, "{quasi} mm, explicitly {semi}");
}
