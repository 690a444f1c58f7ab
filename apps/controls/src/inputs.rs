//! Where the axes and buttons of a pedal's device stand: by events, or by the newest report. Pure.

use crate::events::{ABS, Event, KEY};
use evdev::{AbsoluteAxisCode, KeyCode};
use std::collections::BTreeMap;
use std::fmt::{self, Display, Formatter};

/// Longest report, bytes: full-speed USB sends 64, and a number may stand before it.
pub const LONGEST_REPORT: usize = 65;

/// One axis or button of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Input {
    /// An axis of the kernel.
    Axis(u16),
    /// A key or button of the kernel.
    Key(u16),
    /// Bits of a report, the lowest first, as HID counts them.
    Bits {
        /// The first; 8 is the lowest bit of the second byte.
        first: u32,
        /// How many, 1 to 32.
        count: u32,
        /// The highest is a sign.
        signed: bool,
    },
}

impl Input {
    /// By the kernel's name (`ABS_Z`, `KEY_A`, `BTN_TRIGGER`) or as `ABS:2`, `KEY:30` by number.
    pub fn named(name: &str) -> Option<Self> {
        let code = |prefix| name.strip_prefix(prefix).and_then(|n: &str| n.parse().ok());
        let axis = name.parse::<AbsoluteAxisCode>().ok().map(|axis| axis.0).or_else(|| code("ABS:"));
        let key = || name.parse::<KeyCode>().ok().map(|key| key.0).or_else(|| code("KEY:"));
        axis.map(Input::Axis).or_else(|| key().map(Input::Key))
    }
}

impl Display for Input {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        // What the crate knows no name of it calls so.
        let named = |name: String, prefix: &str, code: u16| match name.starts_with("unknown") {
            true => format!("{prefix}:{code}"),
            false => name,
        };
        match *self {
            Input::Axis(code) => f.write_str(&named(format!("{:?}", AbsoluteAxisCode(code)), "ABS", code)),
            Input::Key(code) => f.write_str(&named(format!("{:?}", KeyCode(code)), "KEY", code)),
            Input::Bits { first, count, .. } => write!(f, "bits {first}+{count}"),
        }
    }
}

/// Where everything stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Inputs {
    /// Axes and keys that have been heard of.
    values: BTreeMap<Input, i64>,
    /// Ranges of axes, where the device states them.
    ranges: BTreeMap<Input, [i64; 2]>,
    /// The newest report.
    report: Vec<u8>,
}

impl Inputs {
    /// Takes an event. Returns true if it says something of an axis or a key.
    pub fn note(&mut self, event: Event) -> bool {
        let input = match event.kind {
            KEY => Input::Key(event.code),
            ABS => Input::Axis(event.code),
            _ => return false,
        };
        // A key that is held repeats itself.
        let value = if event.kind == KEY { i64::from(event.value != 0) } else { i64::from(event.value) };
        self.values.insert(input, value);
        true
    }

    /// Takes where the device says that an input stands.
    pub fn set(&mut self, input: Input, value: i64) {
        self.values.insert(input, value);
    }

    /// Sets the range that the device states for an axis.
    pub fn set_range(&mut self, input: Input, range: [i64; 2]) {
        self.ranges.insert(input, range);
    }

    /// Takes a report.
    pub fn note_report(&mut self, report: &[u8]) {
        self.report.clear();
        self.report.extend_from_slice(&report[..report.len().min(LONGEST_REPORT)]);
    }

    /// Where an input stands; `None` while nothing is known of it.
    pub fn get(&self, input: Input) -> Option<i64> {
        match input {
            Input::Bits { first, count, signed } => bits(&self.report, first, count, signed),
            _ => self.values.get(&input).copied(),
        }
    }

    /// The range of an input: the device's, 0 and 1 of a key, what bits can hold.
    pub fn range(&self, input: Input) -> Option<[i64; 2]> {
        match input {
            Input::Key(_) => Some([0, 1]),
            Input::Axis(_) => self.ranges.get(&input).copied(),
            Input::Bits { count, signed, .. } => Some(match signed {
                true => [-(1 << (count - 1)), (1 << (count - 1)) - 1],
                false => [0, (1 << count) - 1],
            }),
        }
    }

    /// Axes and keys that have been heard of, and where they stand.
    pub fn heard(&self) -> impl Iterator<Item = (Input, i64)> {
        self.values.iter().map(|(input, value)| (*input, *value))
    }

    /// The newest report; empty before the first.
    pub fn report(&self) -> &[u8] {
        &self.report
    }

    /// Forgets where everything stands; ranges are as they were.
    pub fn let_go(&mut self) {
        self.values.clear();
        self.report.clear();
    }
}

/// Bits of a report as a number; `None` where it is too short.
fn bits(report: &[u8], first: u32, count: u32, signed: bool) -> Option<i64> {
    let bit = |at: u32| report.get(at as usize / 8).map(|byte| i64::from(byte >> (at % 8) & 1));
    let value = (0..count).try_fold(0, |value, i| Some(value | bit(first + i)? << i))?;
    let is_negative = signed && value >> (count - 1) & 1 == 1;
    Some(if is_negative { value - (1 << count) } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn inputs_are_named_as_the_kernel_names_them() {
        for (name, input) in [
            ("ABS_Z", Input::Axis(2)),
            ("KEY_A", Input::Key(30)),
            ("BTN_TRIGGER", Input::Key(288)),
            ("ABS:60", Input::Axis(60)),
            ("KEY:760", Input::Key(760)),
        ] {
            assert_eq!(Input::named(name), Some(input), "{name}");
            assert_eq!(Input::named(&input.to_string()), Some(input), "{input}");
        }
        for odd in ["", "abs_z", "ABS:", "KEY:70000", "REL_X"] {
            assert_eq!(Input::named(odd), None, "{odd}");
        }
    }

    #[test]
    fn bits_are_counted_as_hid_counts_them() {
        let report = [0b0000_0101, 0xFE, 0xFF];
        let read = |first, count, signed| bits(&report, first, count, signed);
        assert_eq!([read(0, 1, false), read(1, 1, false), read(2, 1, false)], [Some(1), Some(0), Some(1)]);
        assert_eq!([read(8, 16, false), read(8, 16, true)], [Some(0xFFFE), Some(-2)]);
        assert_eq!(read(8, 8, true), Some(-2));
        assert_eq!([read(23, 1, false), read(24, 1, false)], [Some(1), None]);
    }

    #[test]
    fn held_keys_are_down_and_other_events_say_nothing() {
        let mut inputs = Inputs::default();
        let event = |kind, value| Event { at_us: 0, kind, code: 30, value };
        assert!(inputs.note(event(KEY, 2)) && !inputs.note(event(4, 9)) && !inputs.note(event(0, 0)));
        assert_eq!(inputs.heard().collect::<Vec<_>>(), [(Input::Key(30), 1)]);
        inputs.let_go();
        assert_eq!(inputs.get(Input::Key(30)), None);
    }

    proptest! {
        #[test]
        fn bits_lie_within_their_range(
            report in prop::collection::vec(any::<u8>(), 0..70),
            (first, count, signed) in (0u32..520, 1u32..=32, any::<bool>()),
        ) {
            let mut inputs = Inputs::default();
            inputs.note_report(&report);
            let input = Input::Bits { first, count, signed };
            let [low, high] = inputs.range(input).unwrap();
            prop_assert!(inputs.get(input).is_none_or(|v| (low..=high).contains(&v)));
        }
    }
}
