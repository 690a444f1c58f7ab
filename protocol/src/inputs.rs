//! `inputs` and `hints`: events of keyboard, mouse and gamepad, and the desk's notices about them.
//!
//! A window, a gamepad and a file of inputs send the same events; [`crate::bindings`] has their
//! meaning.

use crate::limits::TEXT_BYTES;
use crate::message::{Invalid, Message, require, text_of};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Names of the keys and buttons that may be bound, by their codes; `other` is every key of the
/// keyboard without a name here, and is never bound.
const KEYS: [&str; 95] = words(
    "a b c d e f g h i j k l m n o p q r s t u v w x y z \
     0 1 2 3 4 5 6 7 8 9 \
     f1 f2 f3 f4 f5 f6 f7 f8 f9 f10 f11 f12 \
     tab space enter escape backspace delete insert home end page-up page-down up down left right \
     shift control alt minus plus comma period \
     mouse-left mouse-middle mouse-right mouse-back mouse-forward \
     pad-south pad-east pad-west pad-north pad-l1 pad-r1 pad-l2 pad-r2 pad-select pad-start pad-l3 \
     pad-r3 pad-up pad-down pad-left pad-right pad-mode \
     pause caps-lock other",
);

/// The words of a text that stand one blank apart.
const fn words<const N: usize>(mut text: &str) -> [&str; N] {
    let mut words = [""; N];
    let mut at = 0;
    while at < N {
        let mut end = 0;
        while end < text.len() && text.as_bytes()[end] != b' ' {
            end += 1;
        }
        assert!(end > 0, "fewer words than names");
        let next = if end < text.len() { end + 1 } else { end };
        (words[at], text) = (text.split_at(end).0, text.split_at(next).1);
        at += 1;
    }
    assert!(text.is_empty(), "more words than names");
    words
}

/// Names of the axes of a gamepad, by their codes; right and down are positive.
const AXES: [&str; 4] = ["left-x", "left-y", "right-x", "right-y"];
/// Largest movement or turn of one event.
const MAX_VALUE: f64 = 10_000.0;

const _: () = assert!(KEYS.len() <= 128, "the keys that are held fit one word of 128 bits");

/// A key of the keyboard, or a button of mouse or gamepad.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key(u32);

impl Key {
    /// By its name, as in files of inputs: `a`, `f1`, `page-up`, `mouse-left`, `pad-south`.
    pub fn named(name: &str) -> Option<Self> {
        KEYS.iter().position(|k| *k == name).map(|i| Key(i as u32))
    }

    /// Every key there is.
    pub fn all() -> impl Iterator<Item = Key> {
        (0..KEYS.len() as u32).map(Key)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        KEYS[self.0 as usize]
    }

    /// Its bit in a word of held keys.
    pub fn bit(self) -> u128 {
        1 << self.0
    }
}

/// An axis of a gamepad.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
#[allow(missing_docs)]
pub enum Axis {
    LeftX = 0,
    LeftY = 1,
    RightX = 2,
    RightY = 3,
}

/// How many axes there are.
pub const AXIS_COUNT: usize = AXES.len();

impl Axis {
    fn from_wire(code: u32) -> Option<Self> {
        [Axis::LeftX, Axis::LeftY, Axis::RightX, Axis::RightY].get(code as usize).copied()
    }

    /// By its name: `left-x`, `left-y`, `right-x`, `right-y`.
    pub fn named(name: &str) -> Option<Self> {
        AXES.iter().position(|a| *a == name).and_then(|i| Self::from_wire(i as u32))
    }
}

/// Source of an input event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Origin {
    /// The window with the picture.
    Window = 0,
    /// A gamepad.
    Gamepad = 1,
    /// A file of inputs.
    File = 2,
}

/// What a person did at keyboard, mouse or gamepad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Input {
    /// A key went down; a key that repeats is not pressed again.
    Press(Key),
    /// A key went up.
    Release(Key),
    /// The mouse moved: right and down, px.
    Move([f64; 2]),
    /// The wheel turned away from the person, notches.
    Wheel(f64),
    /// A stick of a gamepad stands there, −1 to 1.
    Axis(Axis, f64),
    /// Nothing is held any more: the window lost the keyboard, the gamepad its plug.
    LetGo,
}

/// An [`Input`] on the wire.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct InputEvent {
    /// When it happened.
    pub instant_ns: Nanos,
    /// 0 release, 1 press, 2 move, 3 wheel, 4 axis, 5 let go.
    pub kind: u32,
    /// Key or axis.
    pub code: u32,
    /// Movement in px, notches, or an axis' place.
    pub values: [f64; 2],
    /// [`Origin`] on the wire.
    pub origin: u32,
    /// 0.
    pub reserved: u32,
}

impl InputEvent {
    /// The event of an input; a value that is not finite becomes 0.
    pub fn new(input: Input, origin: Origin, instant_ns: Nanos) -> Self {
        let fit = |v: f64| if v.is_finite() { v.clamp(-MAX_VALUE, MAX_VALUE) } else { 0.0 };
        let (kind, code, values) = match input {
            Input::Release(key) => (0, key.0, [0.0; 2]),
            Input::Press(key) => (1, key.0, [0.0; 2]),
            Input::Move(by) => (2, 0, by.map(fit)),
            Input::Wheel(notches) => (3, 0, [fit(notches), 0.0]),
            Input::Axis(axis, at) => (4, axis as u32, [fit(at).clamp(-1.0, 1.0), 0.0]),
            Input::LetGo => (5, 0, [0.0; 2]),
        };
        InputEvent { instant_ns, kind, code, values, origin: origin as u32, reserved: 0 }
    }

    /// The input; `None` for an unknown kind, key or axis.
    pub fn input(&self) -> Option<Input> {
        let key = Some(Key(self.code)).filter(|k| (k.0 as usize) < KEYS.len());
        match self.kind {
            0 => key.map(Input::Release),
            1 => key.map(Input::Press),
            2 => Some(Input::Move(self.values)),
            3 => Some(Input::Wheel(self.values[0])),
            4 => Axis::from_wire(self.code).map(|axis| Input::Axis(axis, self.values[0])),
            5 => Some(Input::LetGo),
            _ => None,
        }
    }
}

impl Message for InputEvent {
    const CHANNEL: &'static str = "inputs";
    const VERSION: u32 = 1;
    const QUEUE: usize = 512;

    fn validate(&self) -> Result<(), Invalid> {
        let known = self.input().is_some();
        require(known, "InputEvent", "kind", "0 to 5, with a known key or axis", f64::from(self.kind))?;
        for value in self.values {
            require(value.abs() <= MAX_VALUE, "InputEvent", "values", "−10000 to 10000", value)?;
        }
        require(self.origin <= 2, "InputEvent", "origin", "0 to 2", f64::from(self.origin))
    }
}

/// A line of the desk for the picture: the instrument that is moved, and its tool.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Wire, Zeroable)]
pub struct Hint {
    /// When it was sent.
    pub instant_ns: Nanos,
    /// Zero-padded text.
    pub text: [u8; TEXT_BYTES],
}

impl Hint {
    /// The text.
    pub fn text(&self) -> String {
        text_of(&self.text)
    }
}

impl Message for Hint {
    const CHANNEL: &'static str = "hints";
    const VERSION: u32 = 1;
    const QUEUE: usize = 16;

    fn validate(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn keys_have_one_name_each() {
        for key in Key::all() {
            assert_eq!(Key::named(key.name()), Some(key));
        }
        assert_eq!((Key::named("any"), Axis::named("up")), (None, None));
        assert_eq!(Axis::named("right-y"), Some(Axis::RightY));
    }

    fn inputs() -> impl Strategy<Value = Input> {
        let key = (0..KEYS.len() as u32).prop_map(Key);
        let px = -9_000.0..9_000.0f64;
        prop_oneof![
            key.clone().prop_map(Input::Press),
            key.prop_map(Input::Release),
            [px.clone(), px].prop_map(Input::Move),
            (-9.0..9.0f64).prop_map(Input::Wheel),
            ((0u32..4), -1.0..1.0f64).prop_map(|(a, v)| Input::Axis(Axis::from_wire(a).unwrap(), v)),
            Just(Input::LetGo),
        ]
    }

    proptest! {
        #[test]
        fn what_was_done_comes_back(input in inputs()) {
            let event = InputEvent::new(input, Origin::File, 7);
            prop_assert!(event.validate().is_ok());
            prop_assert_eq!(event.input(), Some(input));
        }

        #[test]
        fn any_block_is_valid_or_refused(kind: u32, code: u32, values: [f64; 2], origin: u32) {
            let event = InputEvent { instant_ns: 1, kind, code, values, origin, reserved: 0 };
            if event.validate().is_ok() {
                prop_assert!(event.input().is_some() && values.iter().all(|v| v.is_finite()));
            }
        }
    }

    #[test]
    fn nonsense_is_made_harmless_on_the_way_out() {
        let event = InputEvent::new(Input::Move([f64::NAN, 1e300]), Origin::Window, 0);
        assert_eq!(event.input(), Some(Input::Move([0.0, MAX_VALUE])));
        let stick = InputEvent::new(Input::Axis(Axis::LeftX, 7.0), Origin::Gamepad, 0);
        assert_eq!(stick.input(), Some(Input::Axis(Axis::LeftX, 1.0)));
    }
}
