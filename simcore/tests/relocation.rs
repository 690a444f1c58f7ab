//! The shipped relocation, from the first prick to the turned retina: what must have happened, and
//! what must hold all the way.

use protocol::events::EventKind;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use surgeon::rehearsal::Rehearsal;
use tissue::retina::state::RetinaState;
use tissue::sheet::state::NODE_PINNED;

/// The retina of a world.
fn retina(world: &World) -> &RetinaState {
    world.state().retina.as_ref().expect("the scene has a retina")
}

/// The figures of the events of a kind.
fn values(events: &[(EventKind, f64)], kind: EventKind) -> Vec<f64> {
    events.iter().filter(|e| e.0 == kind).map(|e| e.1).collect()
}

fn check_fluid(world: &World, field: u64) {
    let (state, model) = (retina(world), world.retina().unwrap());
    let account = state.account;
    let balance = account.injected_mm3 - account.leaked_mm3 - state.under_mm3();
    assert!(balance.abs() < 1e-9, "field {field}: in − out − under = {balance:e}");
    for (bleb, kept) in state.blebs.iter().enumerate() {
        let error = model.measured_mm3(state, bleb) - kept.volume_mm3;
        assert!(
            error.abs() < 2e-4,
            "field {field}, bleb {bleb}: the mesh holds {error:e} mm³ more than its account"
        );
    }
    model.check(state).unwrap_or_else(|e| panic!("field {field}: {e}"));
}

#[test]
fn the_shipped_relocation_lifts_merges_turns_and_lays_on() {
    let scene = SceneFile::load("relocation").unwrap();
    let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
    let (mut events, mut most_under, mut most_turn, mut saved) = (Vec::new(), 0.0f64, 0.0f64, Vec::new());
    let mut led = Vec::new();
    for field in 0..rehearsal.fields() {
        world.step(&rehearsal.inputs(field).input(), &mut no_clock);
        events.extend(world.events().iter().map(|e| (EventKind::from_wire(e.kind).unwrap(), e.value)));
        check_fluid(&world, field);
        most_under = most_under.max(retina(&world).under_mm3());
        most_turn = most_turn.max(retina(&world).turn_rad(&world.retina().unwrap().home_mm));
        if field == 1300 {
            world.save(&mut saved).unwrap();
        }
        if field == 2300 {
            led.extend(retina(&world).sheet.held[0].iter().map(|h| h.node));
        }
        if field == 1400 {
            assert_eq!(retina(&world).blebs.len(), 1, "two blebs became one under the fovea");
        }
    }
    let state = retina(&world);
    assert_eq!(values(&events, EventKind::RetinaPierced).len(), 2);
    assert!(values(&events, EventKind::BlebFilled).iter().all(|v| *v > 15.0), "each bleb took its fluid");
    assert!(!values(&events, EventKind::TissueGrabbed).is_empty());
    for kind in [
        EventKind::RetinaRipped,
        EventKind::NeedleFast,
        EventKind::RetinaPenetrated,
        EventKind::TissueDisabled,
    ] {
        assert!(values(&events, kind).is_empty(), "{kind:?}: {:?}", values(&events, kind));
    }
    assert!(most_under > 30.0, "{most_under}");
    // All of it lies on the choroid again, at another place.
    assert_eq!((state.blebs.len(), state.under_mm3()), (0, 0.0));
    assert!(state.sheet.flag.iter().all(|&f| f == NODE_PINNED));
    let off = |n: usize| (state.sheet.position(n).norm() - 11.5).abs();
    assert!((0..state.sheet.nodes()).all(|n| off(n) < 1e-5));
    let turned = state.turn_rad(&world.retina().unwrap().home_mm);
    assert!(turned > 0.004 && most_turn > turned, "{turned} rad on average, {most_turn} while held");
    what_the_jaws_led_has_turned(&world, &led);
    replay_from(&scene, &rehearsal, &saved);
}

/// Turn of a node about the axis from the fovea to the lens since the start, rad.
fn turn_of(world: &World, node: usize) -> f64 {
    let home = world.retina().unwrap().home_mm[node].map(f64::from);
    let now = retina(world).sheet.position(node).map(f64::from);
    (home.x * now.y - home.y * now.x).atan2(home.x * now.x + home.y * now.y)
}

/// The scene leads a grip 2 mm from the fovea by 0.45 rad about it. What was held has turned by
/// that, and nothing that went along by more than 0.5 mm stayed behind in a fold or was pushed past
/// the fovea: all of it has turned the same way.
fn what_the_jaws_led_has_turned(world: &World, led: &[u32]) {
    let home = &world.retina().unwrap().home_mm;
    let way = |n: usize| (retina(world).sheet.position(n) - home[n]).norm();
    let moved: Vec<usize> = (0..home.len()).filter(|&n| way(n) > 0.5).collect();
    assert!(moved.len() >= 12, "what the jaws led lies elsewhere: {}", moved.len());
    let least = moved.iter().map(|&n| turn_of(world, n)).fold(f64::MAX, f64::min);
    assert!(least > 0.1, "{least} rad");
    // Jaws lead all that they hold by the same way, so that what is nearer to the fovea turns
    // further: the middle one decides.
    let mut held: Vec<f64> = led.iter().map(|&n| turn_of(world, n as usize)).collect();
    held.sort_by(f64::total_cmp);
    let middle = (held[(held.len() - 1) / 2] + held[held.len() / 2]) / 2.0;
    assert!(held[0] > 0.3 && (0.4..0.6).contains(&middle), "{held:?}");
}

/// A checkpoint in the middle of it goes on like the first run: nothing of the retina is outside
/// the state.
fn replay_from(scene: &SceneFile, rehearsal: &Rehearsal, saved: &[u8]) {
    let mut hashes = [0; 2];
    for hash in &mut hashes {
        let mut world = World::new(scene).unwrap();
        world.restore(saved).unwrap();
        assert!(!retina(&world).blebs.is_empty(), "in the middle of it");
        for field in 1301..1340 {
            *hash = world.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash;
        }
        world.reset();
        assert_eq!(world.state_hash(), World::new(scene).unwrap().state_hash());
    }
    assert_eq!(hashes[0], hashes[1]);
}

#[test]
fn a_checkpoint_that_does_not_fit_is_refused() {
    let with = SceneFile::load("relocation").unwrap();
    let mut finer = with.clone();
    finer.retina.as_mut().unwrap().rings += 1;
    let (world, mut other) = (World::new(&with).unwrap(), World::new(&finer).unwrap());
    let mut bytes = Vec::new();
    world.save(&mut bytes).unwrap();
    assert!(other.restore(&bytes).is_err());
}
