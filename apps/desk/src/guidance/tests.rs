//! Limits that hold for any inputs.

use super::*;
use crate::workspace::{BELOW_TROCAR_MM, WALL_MM};
use proptest::prelude::*;
use protocol::handles::OPEN_JAWS_RAD;
use protocol::message::Message;

const FIELD_S: f64 = 0.02;

fn desk(scene: &str) -> (Guidance, Rig) {
    let rig = Rig::load_or_shipped(None).unwrap();
    (Guidance::new(&SceneFile::load(scene).unwrap(), &rig), rig)
}

fn key(name: &str) -> Key {
    Key::named(name).unwrap()
}

fn inputs() -> impl Strategy<Value = Input> {
    let keys: Vec<Key> = Key::all().collect();
    let key = prop::sample::select(keys);
    let axis = prop::sample::select(vec![Axis::LeftX, Axis::LeftY, Axis::RightX, Axis::RightY]);
    prop_oneof![
        key.clone().prop_map(Input::Press),
        key.prop_map(Input::Release),
        [prop::num::f64::ANY, prop::num::f64::ANY].prop_map(Input::Move),
        [-3e3..3e3, -3e3..3e3].prop_map(Input::Move),
        prop::num::f64::ANY.prop_map(Input::Wheel),
        (-80.0..80.0).prop_map(Input::Wheel),
        (axis, prop::num::f64::ANY).prop_map(|(a, v)| Input::Axis(a, v)),
        Just(Input::LetGo),
    ]
}

proptest! {
    #[test]
    fn whatever_is_done_hands_move_as_hands_can(
        done in prop::collection::vec((inputs(), 0u8..6), 1..120), odd_dt in prop::num::f64::ANY,
    ) {
        let (mut guidance, rig) = desk("peel");
        guidance.advance(odd_dt);
        for (input, fields) in done {
            guidance.apply(input);
            for _ in 0..fields {
                let before = guidance.instruments.map(|h| h.tip_mm);
                guidance.advance(FIELD_S);
                for (i, hand) in guidance.instruments.iter().enumerate() {
                    let tip = hand.tip_mm;
                    prop_assert!(tip.norm() <= 11.5 + WALL_MM + 1e-9, "{tip}");
                    prop_assert!(tip.z <= rig.trocars[i].p_eye[2] - BELOW_TROCAR_MM + 1e-9, "{tip}");
                    prop_assert!((tip - before[i]).norm() <= MAX_SPEED_MM_S * FIELD_S + 1e-9);
                    prop_assert!(hand.velocity_mm_s.norm() <= MAX_SPEED_MM_S + 1e-9);
                    prop_assert!(hand.angular_velocity_rad_s.iter().all(|c| c.is_finite()));
                    prop_assert!((0.0..=OPEN_JAWS_RAD).contains(&hand.jaw_rad) && hand.roll_rad.abs() < 3.2);
                    let trocar = hand.pose().inverse_transform_point(&rig.trocars[i].p_eye.into());
                    prop_assert!(trocar.x.abs() < 1e-9 && trocar.y.abs() < 1e-9 && trocar.z > 0.0);
                }
                prop_assert!(guidance.pedal().validate().is_ok());
            }
        }
    }
}

#[test]
fn the_mouse_leads_the_tip_as_the_picture_shows_it() {
    let (mut guidance, _) = desk("peel");
    let start = guidance.instruments[0].tip_mm;
    guidance.apply(Input::Move([50.0, -25.0]));
    guidance.apply(Input::Wheel(2.0));
    (0..50).for_each(|_| guidance.advance(FIELD_S));
    let moved = guidance.instruments[0].tip_mm - start;
    // Right in the picture is −x, up −y, deeper −z.
    assert!((moved - Vector3::new(-1.0, -0.5, -0.4)).norm() < 1e-3, "{moved}");
    guidance.apply(Input::Press(key("tab")));
    guidance.apply(Input::Press(key("shift")));
    let other = guidance.instruments[1].tip_mm;
    guidance.apply(Input::Move([0.0, 100.0]));
    (0..50).for_each(|_| guidance.advance(FIELD_S));
    assert!(
        (guidance.instruments[1].tip_mm - other - Vector3::new(0.0, 0.5, 0.0)).norm() < 1e-3,
        "fine: a quarter"
    );
    assert!((guidance.instruments[0].tip_mm - start - moved).norm() < 1e-3, "the first hand stays");
}

#[test]
fn a_jump_of_the_mouse_becomes_a_movement_without_overshoot() {
    let (mut guidance, _) = desk("peel");
    let (start, mut farthest) = (guidance.instruments[0].tip_mm, 0.0f64);
    guidance.apply(Input::Move([200.0, 0.0]));
    let mut reached = None;
    for field in 0..100 {
        guidance.advance(FIELD_S);
        let x = start.x - guidance.instruments[0].tip_mm.x;
        farthest = farthest.max(x);
        reached = reached.or((x > 3.9).then_some(field));
    }
    assert!(farthest < 4.0 + 1e-6, "4 mm asked for, {farthest} gone");
    let reached = reached.unwrap();
    assert!((16..60).contains(&reached), "12 mm/s and a soft end: field {reached}");
}

#[test]
fn keys_and_sticks_lead_at_their_speeds() {
    let (mut led, _) = desk("peel");
    let start = led.instruments[0].tip_mm;
    led.apply(Input::Press(key("f")));
    (0..50).for_each(|_| led.advance(FIELD_S));
    led.apply(Input::LetGo);
    (0..50).for_each(|_| led.advance(FIELD_S));
    assert!((start.z - led.instruments[0].tip_mm.z - KEY_MM_S).abs() < 0.05, "one second deeper");
    let (mut pad, _) = desk("peel");
    pad.apply(Input::Axis(Axis::LeftX, -0.5));
    pad.apply(Input::Axis(Axis::RightY, 0.1));
    (0..100).for_each(|_| pad.advance(FIELD_S));
    let moved = pad.instruments[0].tip_mm - start;
    let expected = 2.0 * 0.25 * STICK_MM_S - 0.25 * STICK_MM_S * 2.0 / FOLLOW_PER_S;
    assert!((moved.x - expected).abs() < 0.02 && moved.z.abs() < 1e-9, "{moved}, expected {expected}");
}

#[test]
fn jaws_close_while_used_or_kept() {
    let (mut guidance, _) = desk("peel");
    let after = |guidance: &mut Guidance, fields: u32| {
        (0..fields).for_each(|_| guidance.advance(FIELD_S));
        guidance.instruments[0].jaw_rad
    };
    assert_eq!(after(&mut guidance, 5), OPEN_JAWS_RAD);
    guidance.apply(Input::Press(key("mouse-left")));
    assert!((after(&mut guidance, 5) - (OPEN_JAWS_RAD - 0.1 * JAW_RAD_S)).abs() < 1e-9, "not at once");
    assert_eq!(after(&mut guidance, 50), 0.0);
    guidance.apply(Input::Press(key("c")));
    guidance.apply(Input::Release(key("mouse-left")));
    assert_eq!(
        (after(&mut guidance, 50), guidance.hint().as_str()),
        (0.0, "Hand 1: forceps, Space: close, kept")
    );
    guidance.apply(Input::Press(key("c")));
    assert_eq!(after(&mut guidance, 50), OPEN_JAWS_RAD);
}

#[test]
fn the_foot_does_what_the_keys_say() {
    let (mut guidance, _) = desk("vitrectomy");
    let pressed = |guidance: &mut Guidance, name: &str| {
        guidance.apply(Input::Press(key(name)));
        let pedal = guidance.pedal();
        guidance.apply(Input::Release(key(name)));
        (pedal.mode, pedal.axes, pedal.buttons)
    };
    let aspirate = PedalMode::Aspirate as u32;
    assert_eq!(pressed(&mut guidance, "space"), (aspirate, [1.0, 1.0], 0));
    assert_eq!(pressed(&mut guidance, "v"), (aspirate, [1.0, 0.0], 0));
    assert_eq!(pressed(&mut guidance, "up"), (PedalMode::Move as u32, [0.0, 1.0], 0));
    assert_eq!(pressed(&mut guidance, "minus"), (PedalMode::Zoom as u32, [-1.0, 0.0], 0));
    assert_eq!(pressed(&mut guidance, "x"), (PedalMode::Exchange as u32, [1.0, 0.0], 0));
    // A tap that is over before the field ends is reported once.
    guidance.apply(Input::Press(key("3")));
    guidance.apply(Input::Release(key("3")));
    assert_eq!((guidance.pedal().buttons, guidance.pedal().buttons), (PedalButton::Lens as u32, 0));
    // Pick and forceps use no pedal; a needle injects.
    (0..3).for_each(|_| guidance.apply(Input::Press(key("t"))));
    let tool = guidance.instruments[0].tool;
    guidance.apply(Input::Press(key("space")));
    assert_eq!((tool, guidance.pedal().mode), (Tool::Forceps, PedalMode::Move as u32));
    (0..3).for_each(|_| guidance.apply(Input::Press(key("t"))));
    assert_eq!(
        (guidance.instruments[0].tool, guidance.pedal().mode),
        (Tool::Needle, PedalMode::Inject as u32)
    );
}

#[test]
fn a_key_that_does_nothing_is_answered_for_a_while() {
    let (mut guidance, _) = desk("relocation");
    let said = |guidance: &mut Guidance, name: &str| {
        guidance.apply(Input::Press(key(name)));
        guidance.apply(Input::Release(key(name)));
        guidance.hint()
    };
    assert_eq!(guidance.hint(), "Hand 1: needle, Space: inject");
    assert_eq!(said(&mut guidance, "y"), "Y does nothing. F1: all keys");
    assert_eq!(said(&mut guidance, "other"), "This key does nothing. F1: all keys");
    assert_eq!(said(&mut guidance, "v"), "V needs the vitrector. T: next tool");
    assert_eq!(said(&mut guidance, "tab"), "Hand 2: light pipe", "a key that does something answers itself");
    assert_eq!(said(&mut guidance, "space"), "Space does nothing with the light pipe. T: next tool");
    (0..100).for_each(|_| guidance.advance(FIELD_S));
    assert!(guidance.hint().starts_with("Space does nothing"), "2 s later");
    (0..50).for_each(|_| guidance.advance(FIELD_S));
    assert_eq!(guidance.hint(), "Hand 2: light pipe");
    for binding in protocol::bindings::BINDINGS.iter().filter(|b| b.action != Action::Suck) {
        let (mut guidance, _) = desk("peel");
        let hint = said(&mut guidance, binding.keys[0]);
        assert!(!hint.contains("nothing"), "{}: {hint}", binding.keys[0]);
    }
}
