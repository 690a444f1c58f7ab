//! What a pedal's device does when a person presses it, as a mapping. Pure.

use crate::inputs::{Input, Inputs};
use crate::mapping::{AxisMap, Mapping, Range, ReportShape};
use protocol::handles::PedalMode;
use protocol::optics::PedalButton;
use settings::commands::controls::PedalInterface;

/// Share of the way by which an axis must move to be meant.
const LEAST_WAY: f64 = 0.1;
/// A way is written this much shorter at both ends, so that it is reached every time.
const PLAY: f64 = 0.02;
/// What a learnt axis counts as nothing.
const DEAD_ZONE: f64 = 0.05;

/// What moved between two looks at a device, and where it was then and is now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// The axis, the key, or the bits of a report.
    pub input: Input,
    /// Where it was.
    pub before: i64,
    /// Where it is.
    pub after: i64,
}

/// What moved most between two looks; an axis rather than a key that goes with it.
pub fn moved(before: &Inputs, after: &Inputs) -> Option<Moved> {
    if !after.report().is_empty() {
        return moved_bits(before.report(), after.report());
    }
    let moves = after.heard().filter_map(|(input, now)| {
        // A key that was never heard of was up.
        let then = before.get(input).or(matches!(input, Input::Key(_)).then_some(0))?;
        let range = after.range(input).map_or(now.abs().max(then.abs()), |[low, high]| high - low);
        let way = (now - then).abs() as f64 / range.max(1) as f64;
        Some((way, Moved { input, before: then, after: now }))
    });
    let rank = |(way, moved): &(f64, Moved)| (*way, u8::from(matches!(moved.input, Input::Axis(_))));
    let most = moves.filter(|(way, _)| *way >= LEAST_WAY);
    let most = most.max_by(|a, b| rank(a).partial_cmp(&rank(b)).unwrap_or(std::cmp::Ordering::Equal));
    most.map(|(_, moved)| moved)
}

/// What differs between two reports: a bit, a byte, or two bytes that lie side by side. Where several do,
/// the first.
fn moved_bits(before: &[u8], after: &[u8]) -> Option<Moved> {
    let differs = |at: usize| before.get(at).copied().unwrap_or(0) ^ after.get(at).copied().unwrap_or(0);
    let first = (0..after.len()).find(|at| differs(*at) != 0)?;
    let (byte, beside) = (differs(first), first + 1 < after.len() && differs(first + 1) != 0);
    let start = 8 * first as u32;
    let (first, count) = match (byte.count_ones(), beside) {
        (1, false) => (start + byte.trailing_zeros(), 1),
        (_, false) => (start, 8),
        (_, true) => (start, 16),
    };
    let input = Input::Bits { first, count, signed: false };
    let at = |report: &[u8]| {
        let mut inputs = Inputs::default();
        inputs.note_report(report);
        inputs.get(input).unwrap_or(0)
    };
    Some(Moved { input, before: at(before), after: at(after) })
}

/// A mapping that grows by what a person presses.
#[derive(Debug, Clone)]
pub struct Learner {
    mapping: Mapping,
}

impl Learner {
    /// Nothing is known yet.
    pub fn new(interface: PedalInterface, name: &str) -> Self {
        let (axes, buttons, modes) = (Vec::new(), Vec::new(), Vec::new());
        let (report, mode, name) = (None, PedalMode::Aspirate, name.into());
        Learner { mapping: Mapping { name, interface, report, grab: false, mode, axes, buttons, modes } }
    }

    /// Takes how the device looked with an axis of the pedal fully pressed, and let go again. Returns what
    /// it is; `None` where nothing moved, or what moved is known already.
    pub fn axis(&mut self, axis: usize, pressed: &Inputs, released: &Inputs) -> Option<Input> {
        let moved = moved(pressed, released).filter(|moved| !self.knows(moved.input))?;
        let (released_at, pressed_at) = (moved.after as f64, moved.before as f64);
        let play = (pressed_at - released_at) * PLAY;
        let is_switch = matches!(moved.input, Input::Key(_) | Input::Bits { count: 1, .. });
        let map = match is_switch {
            // One that opens when it is pressed is the other way round.
            true => {
                let own = AxisMap::plain(moved.input, axis);
                AxisMap { range: Some(Range::OneSided([released_at, pressed_at])), ..own }
            }
            false => AxisMap {
                range: Some(Range::OneSided([released_at + play, pressed_at - play])),
                dead_zone: DEAD_ZONE,
                ..AxisMap::plain(moved.input, axis)
            },
        };
        self.mapping.axes.push(map);
        self.shape(released);
        Some(moved.input)
    }

    /// As [`Learner::axis`], of a button.
    pub fn button(&mut self, button: PedalButton, pressed: &Inputs, released: &Inputs) -> Option<Input> {
        let moved = moved(pressed, released).filter(|moved| !self.knows(moved.input))?;
        if moved.before == 0 || moved.after != 0 {
            return None;
        }
        self.mapping.buttons.push((moved.input, button));
        self.shape(released);
        Some(moved.input)
    }

    /// The mapping; `None` where nothing was learnt.
    pub fn mapping(self) -> Option<Mapping> {
        self.mapping.inputs().next()?;
        Some(self.mapping)
    }

    fn knows(&self, input: Input) -> bool {
        self.mapping.inputs().any(|known| known == input)
    }

    fn shape(&mut self, seen: &Inputs) {
        if self.mapping.interface == PedalInterface::Hidraw {
            self.mapping.report = Some(ReportShape { bytes: seen.report().len(), id: None });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::events::{ABS, Event, KEY};

    fn at(events: &[(u16, u16, i32)]) -> Inputs {
        let mut inputs = Inputs::default();
        for &(kind, code, value) in events {
            inputs.note(Event { at_us: 0, kind, code, value });
        }
        inputs
    }

    fn report(bytes: &[u8]) -> Inputs {
        let mut inputs = Inputs::default();
        inputs.note_report(bytes);
        inputs
    }

    #[test]
    fn an_axis_is_learnt_with_its_ends_and_a_key_beside_it_is_not_taken_for_it() {
        let mut learner = Learner::new(PedalInterface::Evdev, "mine");
        let (down, up) = (at(&[(ABS, 2, 1000), (ABS, 5, 512), (KEY, 288, 1)]), [(ABS, 2, 0), (KEY, 288, 0)]);
        let up = at(&[&up[..], &[(ABS, 5, 514)]].concat());
        assert_eq!(learner.axis(0, &down, &up), Some(Input::Axis(2)));
        assert_eq!(learner.axis(1, &down, &up), None, "it is known, and the other hardly moved");
        let held = |value| at(&[(KEY, 30, value)]);
        assert_eq!(learner.button(PedalButton::Lens, &held(1), &held(0)), Some(Input::Key(30)));
        assert_eq!(learner.button(PedalButton::Filter, &held(1), &held(0)), None);
        let mapping = learner.mapping().unwrap();
        assert_eq!(mapping.axes[0].range, Some(Range::OneSided([20.0, 980.0])));
        assert_eq!(mapping.pressed(&down).axes, [1.0, 0.0]);
        assert_eq!(mapping.pressed(&up).axes, [0.0, 0.0]);
        assert_eq!(Mapping::parse(&mapping.to_toml(), "p.toml").unwrap(), mapping);
    }

    #[test]
    fn reports_are_learnt_by_what_differs() {
        let mut learner = Learner::new(PedalInterface::Hidraw, "mine");
        let bits = |first, count| Some(Input::Bits { first, count, signed: false });
        assert_eq!(learner.axis(0, &report(&[0, 0x34, 0x12, 4]), &report(&[0, 0, 0, 4])), bits(8, 16));
        assert_eq!(learner.axis(1, &report(&[0, 0, 0, 0xF4]), &report(&[0, 0, 0, 4])), bits(24, 8));
        let lens = learner.button(PedalButton::Lens, &report(&[2, 0, 0, 4]), &report(&[0, 0, 0, 4]));
        assert_eq!(lens, bits(1, 1));
        let mapping = learner.mapping().unwrap();
        assert_eq!(mapping.report, Some(ReportShape { bytes: 4, id: None }));
        assert_eq!(Mapping::parse(&mapping.to_toml(), "p.toml").unwrap(), mapping);
        assert_eq!(mapping.pressed(&report(&[2, 0, 0, 0xFF])).axes, [0.0, 1.0]);
        assert_eq!(mapping.pressed(&report(&[2, 0, 0, 4])).buttons, PedalButton::Lens as u32);
    }

    #[test]
    fn nothing_pressed_is_nothing_learnt() {
        let mut learner = Learner::new(PedalInterface::Evdev, "mine");
        let up = at(&[(ABS, 2, 5)]);
        assert_eq!(learner.axis(0, &up, &up), None);
        assert_eq!(learner.axis(0, &Inputs::default(), &up), None, "where it was is not known");
        assert_eq!(learner.mapping(), None);
    }
}
