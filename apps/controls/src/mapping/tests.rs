//! Mappings that are read, refused, written, and what they make of a device.

use super::*;
use crate::events::{ABS, Event, KEY};
use proptest::prelude::*;

const ANALOGUE: &str = "
format = \"vitreo-pedal-1\"
name = \"test\"
interface = \"evdev\"
mode = \"aspirate\"
[[axes]]
input = \"ABS_Z\"
axis = 0
range = [20, 220]
dead_zone = 0.1
curve = 2.0
[[axes]]
input = \"ABS_X\"
axis = 1
range = [0, 128, 255]
[[buttons]]
input = \"BTN_TRIGGER\"
button = \"lens\"
[[modes]]
input = \"BTN_THUMB\"
mode = \"zoom\"
";

fn at(events: &[(u16, u16, i32)]) -> Inputs {
    let mut inputs = Inputs::default();
    for &(kind, code, value) in events {
        inputs.note(Event { at_us: 0, kind, code, value });
    }
    inputs
}

fn refused(from: &str, to: &str) -> String {
    let broken = ANALOGUE.replacen(from, to, 1);
    assert_ne!(broken, ANALOGUE, "{from} is not in the mapping");
    Mapping::parse(&broken, "p.toml").unwrap_err().to_string()
}

#[test]
fn the_shipped_mappings_are_whole_and_named_in_the_page() {
    let page = include_str!("../../../../docs/controls.md");
    for (name, _) in SHIPPED {
        let mapping = Mapping::load(name).unwrap();
        assert_eq!(shipped(name), Some(mapping.clone()));
        assert_eq!(Mapping::parse(&mapping.to_toml(), "again").unwrap(), mapping);
        assert!(mapping.axes.iter().any(|map| map.axis == 0), "{name}");
        assert!(page.contains(&format!("`{name}`")), "docs/controls.md lacks {name}");
    }
}

#[test]
fn an_axis_has_a_dead_zone_a_curve_and_ends() {
    let mapping = Mapping::parse(ANALOGUE, "p").unwrap();
    let axis = |value| mapping.pressed(&at(&[(ABS, 2, value)])).axes[0];
    assert_eq!([axis(-5), axis(20), axis(40), axis(220), axis(999)], [0.0, 0.0, 0.0, 1.0, 1.0]);
    // Half of the way is (0.5 − 0.1) / 0.9 beyond the dead zone, squared.
    assert!((axis(120) - (0.4f64 / 0.9).powi(2)).abs() < 1e-12);
    let side = |value| mapping.pressed(&at(&[(ABS, 0, value)])).axes[1];
    assert_eq!([side(0), side(64), side(128), side(255)], [-1.0, -0.5, 0.0, 1.0]);
    assert_eq!(mapping.pressed(&Inputs::default()), mapping.let_go(), "before anything is known");
}

#[test]
fn buttons_and_modes_count_while_they_are_held() {
    let mapping = Mapping::parse(ANALOGUE, "p").unwrap();
    let held = mapping.pressed(&at(&[(KEY, 288, 1), (KEY, 289, 2)]));
    assert_eq!((held.buttons, held.mode), (PedalButton::Lens as u32, PedalMode::Zoom));
    let state = held.state(5, 7);
    assert_eq!((state.seq, state.instant_ns, state.mode), (5, 7, PedalMode::Zoom as u32));
    let up = mapping.pressed(&at(&[(KEY, 288, 0)]));
    assert_eq!((up.buttons, up.mode), (0, PedalMode::Aspirate));
}

#[test]
fn an_axis_without_a_range_takes_that_of_its_device() {
    let open = Mapping::parse(&ANALOGUE.replace("range = [20, 220]\n", ""), "p").unwrap();
    let mut inputs = at(&[(ABS, 2, 1023)]);
    assert_eq!(open.without_range(&inputs), Some(Input::Axis(2)));
    inputs.set_range(Input::Axis(2), [0, 1023]);
    assert_eq!((open.without_range(&inputs), open.pressed(&inputs).axes[0]), (None, 1.0));
}

#[test]
fn reports_are_taken_by_their_bits() {
    let text = "format = \"vitreo-pedal-1\"\nname = \"t\"\ninterface = \"hidraw\"\nreport_bytes = 3\nreport_id = 1\n\
                mode = \"inject\"\n[[axes]]\nbits = [8, 16]\naxis = 0\nfull = -1.0\n";
    let mapping = Mapping::parse(text, "p").unwrap();
    assert_eq!(mapping.report, Some(ReportShape { bytes: 3, id: Some(1) }));
    let mut inputs = Inputs::default();
    inputs.note_report(&[1, 0xFF, 0xFF]);
    assert_eq!(mapping.pressed(&inputs).axes, [-1.0, 0.0]);
    let told = |from: &str, to: &str| Mapping::parse(&text.replace(from, to), "p").unwrap_err().to_string();
    assert!(
        told("[8, 16]", "[8, 17]").contains("axes[0].bits: expected [FIRST, COUNT], COUNT 1 to 32, within")
    );
    assert!(told("[8, 16]", "[8, 0]").contains("found [8, 0]"));
    assert!(told("[8, 16]", "[4294967295, 16]").contains("axes[0].bits"));
    assert!(told("bits = [8, 16]", "input = \"KEY_A\"").contains("axes[0]: expected bits = [FIRST, COUNT]"));
    assert!(told("report_bytes = 3\n", "").contains("report_bytes: expected the length"));
    assert!(told("report_bytes = 3", "report_bytes = 66").contains("found 66"));
    assert!(told("mode = ", "grab = true\nmode = ").contains("grab: expected interface"));
}

#[test]
fn slips_are_named_with_file_key_and_what_was_expected() {
    for (from, to, named) in [
        ("vitreo-pedal-1", "vitreo-pedal-7", "p.toml: format: expected vitreo-pedal-1"),
        ("\"ABS_Z\"", "\"ABS_ZZ\"", "axes[0].input: expected a key or axis of the kernel"),
        ("input = \"ABS_Z\"", "bits = [0, 8]", "axes[0]: expected input = \"NAME\" alone"),
        ("axis = 0", "axis = 2", "axes[0].axis: expected 0 or 1, found 2"),
        ("[20, 220]", "[20]", "axes[0].range: expected [RELEASED, PRESSED] or [LOW, MIDDLE, HIGH]"),
        ("[20, 220]", "[20, 20]", "axes[0].range: expected numbers that only rise or only fall"),
        ("[0, 128, 255]", "[0, 300, 255]", "axes[1].range"),
        ("[20, 220]", "[nan, 220]", "axes[0].range"),
        ("dead_zone = 0.1", "dead_zone = 1.0", "axes[0].dead_zone: expected 0 to 0.9, found 1"),
        ("curve = 2.0", "curve = 0.0", "axes[0].curve: expected 0.2 to 5"),
        ("curve = 2.0", "full = 0.0", "axes[0].full: expected −1 to 1, not 0"),
        ("\"lens\"", "\"glass\"", "buttons[0].button: expected one of magnify, reduce, lens"),
        ("\"zoom\"", "\"fly\"", "found fly"),
        ("dead_zone", "deadzone", "unknown key deadzone"),
        ("mode = \"aspirate\"\n", "", "missing key mode"),
        (
            "interface = \"evdev\"",
            "interface = \"evdev\"\nreport_bytes = 2",
            "report_bytes, report_id: expected interface",
        ),
    ] {
        let told = refused(from, to);
        assert!(told.contains("p.toml") && told.contains(named), "{from} → {to}: {told}");
    }
    let empty = &ANALOGUE[..ANALOGUE.find("[[").unwrap()];
    assert!(Mapping::parse(empty, "p").unwrap_err().to_string().contains("at least one entry"));
    let unknown = Mapping::load("four-pedals").unwrap_err().to_string();
    assert!(unknown.contains("one of keyboard-switch, analogue, three-pedals"), "{unknown}");
    assert!(
        Mapping::load("/nowhere/p.toml").unwrap_err().to_string().contains("/nowhere/p.toml: No such file")
    );
}

proptest! {
    #[test]
    fn what_a_pedal_says_is_always_valid(
        values in prop::collection::vec((any::<u16>(), 0u16..700, any::<i32>()), 0..40),
        report in prop::collection::vec(any::<u8>(), 0..70),
    ) {
        use protocol::message::Message;
        let mut inputs = at(&values);
        values.iter().for_each(|&(kind, _, value)| { inputs.note(Event { at_us: 0, kind: ABS, code: kind % 64, value }); });
        inputs.note_report(&report);
        let own = Mapping::parse(ANALOGUE, "p").unwrap();
        for mapping in SHIPPED.iter().filter_map(|(name, _)| shipped(name)).chain([own]) {
            prop_assert!(mapping.pressed(&inputs).state(0, 0).validate().is_ok());
        }
    }

    #[test]
    fn any_text_is_taken_or_refused(text in ".{0,200}") {
        let _ = Mapping::parse(&text, "p");
    }
}
