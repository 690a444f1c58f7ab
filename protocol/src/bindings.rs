//! Bindings of keys, mouse and gamepad, in one table.
//!
//! The desk moves instruments by it, the launcher takes pause and restart from it, the window shows
//! it as help, and `vitreo play --keys` prints it for `docs/play.md`.

use crate::inputs::Key;
use crate::scene_text::capitalised;

/// Action of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Action {
    // While they are held: the chosen instrument.
    Left,
    Right,
    Up,
    Down,
    Deeper,
    Higher,
    RollLeft,
    RollRight,
    Fine,
    Use,
    // While they are held: the pedal.
    Suck,
    Air,
    Fluid,
    ScopeLeft,
    ScopeRight,
    ScopeUp,
    ScopeDown,
    ZoomIn,
    ZoomOut,
    FocusUp,
    FocusDown,
    // The pedal's buttons.
    Magnify,
    Reduce,
    Lens,
    Inverter,
    Filter,
    // When they are pressed: the instruments.
    OtherHand,
    NextTool,
    Keep,
    // When they are pressed: the course of the attempt.
    Pause,
    Restart,
    Next,
    Quit,
    // When they are pressed: the window.
    Help,
    Dose,
    FullScreen,
    Mouse,
}

/// Keys of one action.
#[derive(Debug, Clone, Copy)]
pub struct Binding {
    /// The action.
    pub action: Action,
    /// Names of the keys, see [`Key::named`].
    pub keys: &'static [&'static str],
    /// In words.
    pub text: &'static str,
}

const fn bind(action: Action, keys: &'static [&'static str], text: &'static str) -> Binding {
    Binding { action, keys, text }
}

/// Every action with its keys.
pub const BINDINGS: &[Binding] = &[
    bind(Action::OtherHand, &["tab", "mouse-back", "mouse-forward", "pad-l1", "pad-r1"], "the other hand"),
    bind(Action::Left, &["a"], "tip to the left"),
    bind(Action::Right, &["d"], "tip to the right"),
    bind(Action::Up, &["w"], "tip up in the picture"),
    bind(Action::Down, &["s"], "tip down in the picture"),
    bind(Action::Deeper, &["f"], "tip deeper"),
    bind(Action::Higher, &["r"], "tip higher"),
    bind(Action::RollLeft, &["q"], "turn to the left"),
    bind(Action::RollRight, &["e"], "turn to the right"),
    bind(Action::Fine, &["shift", "pad-l2"], "slow movement (a quarter) while held"),
    bind(
        Action::Use,
        &["space", "mouse-left", "pad-r2"],
        "jaws close; vitrector sucks and cuts; needle injects",
    ),
    bind(
        Action::Keep,
        &["c", "mouse-middle", "pad-south"],
        "keep jaws closed or pedal down; press again to release",
    ),
    bind(Action::NextTool, &["t", "pad-north"], "next tool"),
    bind(Action::Suck, &["v", "mouse-right", "pad-west"], "suction without cutting"),
    bind(Action::Air, &["x"], "let air in"),
    bind(Action::Fluid, &["z"], "let fluid in"),
    bind(Action::ScopeLeft, &["left"], "microscope to the left"),
    bind(Action::ScopeRight, &["right"], "microscope to the right"),
    bind(Action::ScopeUp, &["up"], "microscope up"),
    bind(Action::ScopeDown, &["down"], "microscope down"),
    bind(Action::ZoomIn, &["plus"], "zoom in"),
    bind(Action::ZoomOut, &["minus"], "zoom out"),
    bind(Action::FocusUp, &["page-up"], "focus higher"),
    bind(Action::FocusDown, &["page-down"], "focus deeper"),
    bind(Action::Magnify, &["1", "pad-up"], "next step of magnification"),
    bind(Action::Reduce, &["2", "pad-down"], "step of magnification back"),
    bind(Action::Lens, &["3", "pad-right"], "wide-angle lens in or out"),
    bind(Action::Inverter, &["4"], "inverter on or off"),
    bind(Action::Filter, &["5", "pad-left"], "next filter of the lamp"),
    bind(Action::Pause, &["p", "pause", "pad-start"], "pause, go on"),
    bind(Action::Restart, &["f5", "pad-select"], "begin the attempt again"),
    bind(Action::Next, &["n", "pad-mode"], "next level"),
    bind(Action::Quit, &["f10"], "end the program"),
    bind(Action::Help, &["f1", "h"], "show or hide these keys"),
    bind(Action::Dose, &["l"], "show or hide the retina's light dose"),
    bind(Action::FullScreen, &["f11"], "full screen or window"),
    bind(Action::Mouse, &["escape"], "free the mouse; a click takes it again"),
];

/// Actions of mouse and sticks, in words.
pub const MOVEMENTS: [(&str, &str); 4] = [
    ("mouse", "tip sideways"),
    ("wheel", "tip deeper (away from you) or higher"),
    ("left stick", "tip sideways"),
    ("right stick", "tip deeper or higher; turn"),
];

impl Action {
    /// The action of a key, if it has one.
    pub fn of(key: Key) -> Option<Action> {
        let own = |b: &&Binding| b.keys.contains(&key.name());
        BINDINGS.iter().find(own).map(|b| b.action)
    }

    /// Bits of all its keys.
    pub fn keys(self) -> u128 {
        let own = BINDINGS.iter().filter(|b| b.action == self).flat_map(|b| b.keys);
        own.filter_map(|name| Key::named(name)).fold(0, |bits, key| bits | key.bit())
    }
}

/// The table in rows: keys and action.
pub fn rows() -> impl Iterator<Item = (String, &'static str)> {
    let moves = MOVEMENTS.iter().map(|(what, text)| ((*what).to_owned(), *text));
    moves.chain(BINDINGS.iter().map(|b| (b.keys.join(", "), b.text)))
}

/// Actions that share a line of the help.
const HELP: &[(&[Action], &str)] = &[
    (&[Action::Left, Action::Right, Action::Up, Action::Down], "tip sideways"),
    (&[Action::Deeper, Action::Higher], "tip deeper, higher"),
    (&[Action::RollLeft, Action::RollRight], "turn"),
    (&[Action::Fine], "finer"),
    (&[Action::OtherHand], "other hand"),
    (&[Action::NextTool], "next tool"),
    (&[Action::Use], "jaws, cut, inject"),
    (&[Action::Keep], "keep it so"),
    (&[Action::Suck], "suction"),
    (&[Action::Air, Action::Fluid], "air, fluid in"),
    (&[Action::ScopeLeft, Action::ScopeRight, Action::ScopeUp, Action::ScopeDown], "microscope"),
    (&[Action::ZoomIn, Action::ZoomOut], "zoom"),
    (&[Action::FocusUp, Action::FocusDown], "focus"),
    (&[Action::Magnify, Action::Reduce], "magnify, reduce"),
    (&[Action::Lens, Action::Inverter, Action::Filter], "lens, inverter, filter"),
    (&[Action::Pause, Action::Restart, Action::Next], "pause, restart, next"),
    (&[Action::Mouse], "free the mouse"),
    (&[Action::Dose], "light on the retina"),
    (&[Action::FullScreen], "full screen"),
    (&[Action::Help, Action::Quit], "this help, quit"),
];

/// Those of them that a window offers where a rig or a script moves the instruments.
const WITHOUT_DESK: [Action; 6] =
    [Action::Pause, Action::Restart, Action::Next, Action::FullScreen, Action::Help, Action::Quit];

/// The first key of keyboard or mouse of an action.
fn first_key(action: &Action) -> &'static str {
    let own = BINDINGS.iter().filter(|b| b.action == *action).flat_map(|b| b.keys);
    own.copied().find(|k| !k.starts_with("pad-")).unwrap_or_default()
}

/// A key as people write it: a letter or an F key in capitals, a word with one.
pub fn shown(key: &str) -> String {
    let is_word = key == "up" || key.len() > 2 && !key.starts_with('f');
    if is_word { capitalised(key).collect() } else { key.to_uppercase() }
}

/// The first key of keyboard or mouse of an action, as people write it.
pub fn key_of(action: Action) -> String {
    shown(first_key(&action))
}

/// Marks in texts of tasks, and the actions whose keys stand for them at a desk.
const MARKS: [(&str, Action); 8] = [
    ("{use}", Action::Use),
    ("{keep}", Action::Keep),
    ("{suck}", Action::Suck),
    ("{air}", Action::Air),
    ("{fluid}", Action::Fluid),
    ("{tool}", Action::NextTool),
    ("{hand}", Action::OtherHand),
    ("{help}", Action::Help),
];
/// Mark of the inputs that move a tip.
const MOVE: (&str, &str) = ("{move}", "mouse, wheel");

/// Appends `text` with the keys of its marks: `close the jaws {use}` becomes `close the jaws
/// (Space)` where a person works `at_desk`, and loses the mark and the blank before it elsewhere. What
/// is no mark stays as it stands.
pub fn push_with_keys(text: &str, at_desk: bool, out: &mut String) {
    let mut rest = text;
    while let Some(begin) = rest.find('{') {
        let (before, from) = rest.split_at(begin);
        let end = from.find('}').map_or(from.len(), |end| end + 1);
        let mark = &from[..end];
        let action = MARKS.iter().find(|(name, _)| *name == mark).map(|(_, action)| *action);
        let keys = action.map(key_of).or((mark == MOVE.0).then(|| MOVE.1.to_owned()));
        match keys {
            None => (out.push_str(before), out.push_str(mark)),
            Some(keys) if at_desk => (out.push_str(before), out.push_str(&format!("({keys})"))),
            Some(_) => (out.push_str(before.strip_suffix(' ').unwrap_or(before)), ()),
        };
        rest = &from[end..];
    }
    out.push_str(rest);
}

/// What a window offers when an attempt is over, with its keys.
pub fn next_steps() -> String {
    let offers = [(Action::Next, "next level"), (Action::Restart, "again"), (Action::Quit, "end")];
    offers.map(|(action, what)| format!("{}: {what}", first_key(&action).to_uppercase())).join(", ")
}

/// The help of a window, a line each: the first key of keyboard or mouse of every action. With
/// `at_desk` a person moves the instruments by them.
pub fn help(at_desk: bool) -> String {
    let mut text =
        if at_desk { "mouse: tip sideways\nwheel: tip deeper, higher\n".to_owned() } else { String::new() };
    let useful = |actions: &[Action]| at_desk || actions.iter().all(|a| WITHOUT_DESK.contains(a));
    for (actions, meaning) in HELP.iter().filter(|(actions, _)| useful(actions)) {
        let keys: Vec<&str> = actions.iter().map(first_key).collect();
        text.push_str(&format!("{}: {meaning}\n", keys.join(" ")));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_key_exists_and_means_one_thing() {
        let mut seen = 0u128;
        for binding in BINDINGS {
            for name in binding.keys {
                let key = Key::named(name).unwrap_or_else(|| panic!("no key {name}"));
                assert_eq!(seen & key.bit(), 0, "{name} means two things");
                seen |= key.bit();
                assert_eq!(Action::of(key), Some(binding.action));
                assert!(binding.action.keys() & key.bit() != 0);
            }
            assert_eq!(BINDINGS.iter().filter(|b| b.action == binding.action).count(), 1);
        }
        assert_eq!(Action::of(Key::named("y").unwrap()), None);
    }

    #[test]
    fn marks_become_keys_at_a_desk_and_nothing_elsewhere() {
        let with = |text: &str, at_desk| {
            let mut out = String::new();
            push_with_keys(text, at_desk, &mut out);
            out
        };
        let text = "take the pick {tool}, move {move}; help {help}";
        assert_eq!(with(text, true), "take the pick (T), move (mouse, wheel); help (F1)");
        assert_eq!(with(text, false), "take the pick, move; help");
        assert_eq!(with("{use}", true), "(Space)");
        for odd in ["", "plain", "{", "}", "{use", "{dance}", "a {b} c", "é {é}"] {
            assert_eq!((with(odd, true), with(odd, false)), (odd.to_owned(), odd.to_owned()));
        }
        for (mark, action) in MARKS {
            assert!(!first_key(&action).is_empty(), "{mark}");
        }
    }

    proptest! {
        #[test]
        fn text_around_marks_comes_back(parts in prop::collection::vec("[a-zé {}]{0,12}|\\{use\\}", 0..6)) {
            let (text, mut shown) = (parts.concat(), String::new());
            push_with_keys(&text, true, &mut shown);
            prop_assert_eq!(shown.replace("(Space)", "{use}"), text);
        }
    }

    #[test]
    fn the_end_of_an_attempt_offers_what_keys_do() {
        assert_eq!(next_steps(), "N: next level, F5: again, F10: end");
    }

    #[test]
    fn the_help_fits_the_picture() {
        let help = help(true);
        assert!(help.lines().count() <= 30 && help.chars().count() < 1_900, "letters that a picture holds");
        assert!(help.lines().all(|l| l.chars().count() <= 60));
        assert!(!help.contains("pad-"), "{help}");
        let told = |b: &Binding| HELP.iter().any(|(actions, _)| actions.contains(&b.action));
        assert!(BINDINGS.iter().all(told), "every action is listed");
        let few = super::help(false);
        assert!(few.contains("p f5 n: pause") && few.contains("f10") && !few.contains("tip"), "{few}");
    }
}
