//! Mappings of pedals (`vitreo-pedal-1`, TOML): what the axes and buttons of a device mean. Pure.
//!
//! `docs/controls.md` lists every key.

mod file;
mod write;

pub use file::{FORMAT, SHIPPED, shipped};

use crate::inputs::{Input, Inputs};
use protocol::handles::{PedalMode, PedalState};
use protocol::optics::PedalButton;
use protocol::time::Nanos;
use settings::commands::controls::PedalInterface;

/// Why a mapping was refused.
#[derive(Debug, thiserror::Error)]
pub enum MappingError {
    /// The file cannot be read.
    #[error("mapping {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// It is no mapping in TOML; the message has line and column.
    #[error("mapping {path}: {problem}")]
    Parse {
        /// The file.
        path: String,
        /// The parser's message.
        problem: String,
    },
    /// A value makes no sense.
    #[error("mapping {path}: {key}: expected {expected}, found {found}")]
    Value {
        /// The file.
        path: String,
        /// Where in the file.
        key: String,
        /// What would be right.
        expected: String,
        /// What is there.
        found: String,
    },
}

/// How reports of a device look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReportShape {
    /// Length of a report, its number included, bytes.
    pub bytes: usize,
    /// Its number, the first byte, where the device numbers its reports; others are passed over.
    pub id: Option<u8>,
}

/// What an axis of a device does.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisMap {
    /// The axis or button.
    pub input: Input,
    /// The axis of the pedal: 0 or 1.
    pub axis: usize,
    /// Where it is let go and where it is pressed fully; `None`: the device's own range.
    pub range: Option<Range>,
    /// Share of the way that counts as nothing.
    pub dead_zone: f64,
    /// Exponent of the way: above 1 it begins softly.
    pub curve: f64,
    /// What the axis of the pedal is then, −1 to 1.
    pub full: f64,
}

/// The way of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// From let go to pressed fully: 0 to 1.
    OneSided([f64; 2]),
    /// From one end over the middle to the other: −1 to 1.
    TwoSided([f64; 3]),
}

/// A mapping.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    /// What it is of, for people.
    pub name: String,
    /// By which interface of the kernel it is read.
    pub interface: PedalInterface,
    /// How its reports look; of [`PedalInterface::Hidraw`] alone.
    pub report: Option<ReportShape>,
    /// No other program gets its events while it is open, so that a pedal that is a keyboard types nothing.
    pub grab: bool,
    /// Meaning of the axes where no button says another.
    pub mode: PedalMode,
    /// Axes.
    pub axes: Vec<AxisMap>,
    /// Buttons that are buttons of the pedal.
    pub buttons: Vec<(Input, PedalButton)>,
    /// Buttons that give the axes another meaning while they are held.
    pub modes: Vec<(Input, PedalMode)>,
}

/// What a pedal says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pressed {
    /// −1 to 1.
    pub axes: [f64; 2],
    /// Bits of [`PedalButton`].
    pub buttons: u32,
    /// Meaning of the axes.
    pub mode: PedalMode,
}

impl Pressed {
    /// As a message.
    pub fn state(&self, seq: u64, instant_ns: Nanos) -> PedalState {
        let Pressed { axes, buttons, mode } = *self;
        PedalState { seq, instant_ns, axes, buttons, mode: mode as u32 }
    }
}

impl Mapping {
    /// The state of a released pedal.
    pub fn let_go(&self) -> Pressed {
        Pressed { axes: [0.0; 2], buttons: 0, mode: self.mode }
    }

    /// What the pedal says where its device stands so.
    pub fn pressed(&self, inputs: &Inputs) -> Pressed {
        let mut axes = [0.0; 2];
        for map in &self.axes {
            axes[map.axis] += map.value(inputs);
        }
        let is_down = |input| inputs.get(input).is_some_and(|value| value != 0);
        let held = self.buttons.iter().filter(|(input, _)| is_down(*input));
        let mode = self.modes.iter().find(|(input, _)| is_down(*input));
        Pressed {
            axes: axes.map(|axis| axis.clamp(-1.0, 1.0)),
            buttons: held.fold(0, |bits, (_, button)| bits | *button as u32),
            mode: mode.map_or(self.mode, |(_, mode)| *mode),
        }
    }

    /// Everything of the device that it names.
    pub fn inputs(&self) -> impl Iterator<Item = Input> {
        let axes = self.axes.iter().map(|map| map.input);
        let buttons = self.buttons.iter().map(|(input, _)| *input);
        axes.chain(buttons).chain(self.modes.iter().map(|(input, _)| *input))
    }

    /// The first axis whose range neither the mapping nor the device states.
    pub fn without_range(&self, inputs: &Inputs) -> Option<Input> {
        let open = |map: &&AxisMap| map.range.is_none() && inputs.range(map.input).is_none();
        self.axes.iter().find(open).map(|map| map.input)
    }
}

impl AxisMap {
    /// The input alone, over its whole range.
    pub fn plain(input: Input, axis: usize) -> Self {
        AxisMap { input, axis, range: None, dead_zone: 0.0, curve: 1.0, full: 1.0 }
    }

    /// What it adds to its axis of the pedal.
    fn value(&self, inputs: &Inputs) -> f64 {
        let Some(value) = inputs.get(self.input).map(|value| value as f64) else { return 0.0 };
        let own = || inputs.range(self.input).map(|range| Range::OneSided(range.map(|end| end as f64)));
        let Some(range) = self.range.or_else(own) else { return 0.0 };
        let way = range.way(value);
        let beyond = (way.abs() - self.dead_zone) / (1.0 - self.dead_zone);
        if beyond <= 0.0 { 0.0 } else { libm::pow(beyond, self.curve).copysign(way) * self.full }
    }
}

impl Range {
    /// How far a value is on its way: 0 to 1, or −1 to 1.
    fn way(self, value: f64) -> f64 {
        let share = |from: f64, to: f64| if to == from { 0.0 } else { (value - from) / (to - from) };
        match self {
            Range::OneSided([released, pressed]) => share(released, pressed).clamp(0.0, 1.0),
            Range::TwoSided([low, middle, high]) => {
                let up = share(middle, high);
                if up >= 0.0 { up.min(1.0) } else { -share(middle, low).clamp(0.0, 1.0) }
            }
        }
    }
}

#[cfg(test)]
mod tests;
