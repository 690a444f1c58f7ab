//! A gamepad of this machine, read from the kernel (evdev). Buttons and sticks become [`Input`]s;
//! what they mean is in `protocol::bindings`.

use anyhow::Context;
use evdev::{AbsoluteAxisCode, Device, EventSummary, KeyCode};
use protocol::inputs::{Axis, Input, Key};
use std::io::ErrorKind;

/// A stick's trigger counts as pressed from this share of its way on.
const TRIGGER: f64 = 0.5;

/// An open gamepad.
pub struct Gamepad {
    device: Device,
    name: String,
    state: State,
}

/// What an axis was last, where only changes matter.
#[derive(Debug, Default)]
struct State {
    /// Triggers and the cross as keys: which of them are down.
    down: u128,
}

/// Range of an axis.
#[derive(Debug, Clone, Copy)]
struct Range {
    low: i32,
    high: i32,
}

impl Range {
    /// Place of `value`, −1 to 1.
    fn place(self, value: i32) -> f64 {
        let (low, high) = (f64::from(self.low), f64::from(self.high));
        if high <= low { 0.0 } else { ((f64::from(value) - low) / (high - low) * 2.0 - 1.0).clamp(-1.0, 1.0) }
    }
}

impl Gamepad {
    /// The first gamepad of this machine; `None` if there is none that this user may read.
    pub fn find() -> Option<Self> {
        let is_gamepad =
            |d: &Device| d.supported_keys().is_some_and(|keys| keys.contains(KeyCode::BTN_SOUTH));
        let (_, device) = evdev::enumerate().find(|(_, d)| is_gamepad(d))?;
        device.set_nonblocking(true).ok()?;
        let name = device.name().unwrap_or("gamepad").to_owned();
        Some(Gamepad { device, name, state: State::default() })
    }

    /// The gamepad, which must be there.
    ///
    /// # Errors
    /// If there is none that this user may read.
    pub fn require() -> anyhow::Result<Self> {
        Self::find().context(
            "no gamepad: none of /dev/input/event* that this user may read has a gamepad's buttons; plug one in, \
             or join the group input, or use --input mouse",
        )
    }

    /// What the maker calls it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Hands on what was done since the last call.
    ///
    /// # Errors
    /// If the gamepad is gone.
    pub fn read(&mut self, mut done: impl FnMut(Input)) -> anyhow::Result<()> {
        let axes = self.device.get_absinfo().context("gamepad")?;
        let range = |low, high| Range { low, high };
        let ranges: Vec<_> = axes.map(|(code, i)| (code, range(i.minimum(), i.maximum()))).collect();
        let events = match self.device.fetch_events() {
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
            events => events.context("gamepad")?,
        };
        for event in events {
            match event.destructure() {
                EventSummary::Key(_, code, value) => button(code, value).into_iter().for_each(&mut done),
                EventSummary::AbsoluteAxis(_, code, value) => {
                    let own = ranges.iter().find(|(c, _)| *c == code);
                    let range = own.map_or(range(-1, 1), |(_, r)| *r);
                    self.state.axis(code, range.place(value), &mut done);
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// A button as an input; `value` is 1 when it goes down, 0 when it goes up.
fn button(code: KeyCode, value: i32) -> Option<Input> {
    let name = match code {
        KeyCode::BTN_SOUTH => "pad-south",
        KeyCode::BTN_EAST => "pad-east",
        KeyCode::BTN_WEST => "pad-west",
        KeyCode::BTN_NORTH => "pad-north",
        KeyCode::BTN_TL => "pad-l1",
        KeyCode::BTN_TR => "pad-r1",
        KeyCode::BTN_TL2 => "pad-l2",
        KeyCode::BTN_TR2 => "pad-r2",
        KeyCode::BTN_SELECT => "pad-select",
        KeyCode::BTN_START => "pad-start",
        KeyCode::BTN_MODE => "pad-mode",
        KeyCode::BTN_THUMBL => "pad-l3",
        KeyCode::BTN_THUMBR => "pad-r3",
        KeyCode::BTN_DPAD_UP => "pad-up",
        KeyCode::BTN_DPAD_DOWN => "pad-down",
        KeyCode::BTN_DPAD_LEFT => "pad-left",
        KeyCode::BTN_DPAD_RIGHT => "pad-right",
        _ => return None,
    };
    let key = Key::named(name)?;
    match value {
        0 => Some(Input::Release(key)),
        1 => Some(Input::Press(key)),
        _ => None,
    }
}

impl State {
    /// An axis that stands at `place`, −1 to 1.
    fn axis(&mut self, code: AbsoluteAxisCode, place: f64, done: &mut impl FnMut(Input)) {
        match code {
            AbsoluteAxisCode::ABS_X => done(Input::Axis(Axis::LeftX, place)),
            AbsoluteAxisCode::ABS_Y => done(Input::Axis(Axis::LeftY, place)),
            AbsoluteAxisCode::ABS_RX => done(Input::Axis(Axis::RightX, place)),
            AbsoluteAxisCode::ABS_RY => done(Input::Axis(Axis::RightY, place)),
            // Triggers rest at the low end of their range.
            AbsoluteAxisCode::ABS_Z => self.as_key("pad-l2", (place + 1.0) / 2.0 > TRIGGER, done),
            AbsoluteAxisCode::ABS_RZ => self.as_key("pad-r2", (place + 1.0) / 2.0 > TRIGGER, done),
            AbsoluteAxisCode::ABS_HAT0X => {
                self.as_key("pad-left", place < -TRIGGER, done);
                self.as_key("pad-right", place > TRIGGER, done);
            }
            AbsoluteAxisCode::ABS_HAT0Y => {
                self.as_key("pad-up", place < -TRIGGER, done);
                self.as_key("pad-down", place > TRIGGER, done);
            }
            _ => {}
        }
    }

    fn as_key(&mut self, name: &str, is_down: bool, done: &mut impl FnMut(Input)) {
        let Some(key) = Key::named(name) else { return };
        if (self.down & key.bit() != 0) == is_down {
            return;
        }
        self.down ^= key.bit();
        done(if is_down { Input::Press(key) } else { Input::Release(key) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buttons_are_keys_and_repeats_are_none() {
        let south = Key::named("pad-south").unwrap();
        assert_eq!(button(KeyCode::BTN_SOUTH, 1), Some(Input::Press(south)));
        assert_eq!(button(KeyCode::BTN_SOUTH, 0), Some(Input::Release(south)));
        assert_eq!((button(KeyCode::BTN_SOUTH, 2), button(KeyCode::KEY_A, 1)), (None, None));
    }

    #[test]
    fn the_buttons_in_the_middle_are_the_course_of_the_attempt() {
        use protocol::bindings::Action;
        let asked = |code| match button(code, 1) {
            Some(Input::Press(key)) => Action::of(key),
            _ => None,
        };
        let buttons = [KeyCode::BTN_START, KeyCode::BTN_SELECT, KeyCode::BTN_MODE];
        assert_eq!(buttons.map(asked), [Action::Pause, Action::Restart, Action::Next].map(Some));
    }

    #[test]
    fn sticks_are_axes_and_triggers_keys() {
        let range = Range { low: 0, high: 255 };
        assert_eq!((range.place(0), range.place(255), range.place(900)), (-1.0, 1.0, 1.0));
        assert_eq!(Range { low: 5, high: 5 }.place(5), 0.0);
        let (mut state, mut seen) = (State::default(), Vec::new());
        let mut pass = |code, value| state.axis(code, range.place(value), &mut |i| seen.push(i));
        pass(AbsoluteAxisCode::ABS_RY, 255);
        for value in [0, 100, 200, 255, 90] {
            pass(AbsoluteAxisCode::ABS_RZ, value);
        }
        for value in [127, 0, 255, 128] {
            pass(AbsoluteAxisCode::ABS_HAT0X, value);
        }
        let key = |name| Key::named(name).unwrap();
        let expected = [
            Input::Axis(Axis::RightY, 1.0),
            Input::Press(key("pad-r2")),
            Input::Release(key("pad-r2")),
            Input::Press(key("pad-left")),
            Input::Release(key("pad-left")),
            Input::Press(key("pad-right")),
            Input::Release(key("pad-right")),
        ];
        assert_eq!(seen, expected);
    }
}
