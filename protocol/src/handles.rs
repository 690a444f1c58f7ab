//! `handles` and `pedal`: tool and jaw opening of the instruments, and the foot pedal.

use crate::limits::INSTRUMENTS;
use crate::message::{Invalid, Message, require};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};
use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

/// Tool of an instrument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u32)]
#[allow(missing_docs)]
pub enum Tool {
    Forceps = 1,
    LightPipe = 2,
    Pick = 3,
    Vitrector = 4,
    Needle = 5,
}

impl Tool {
    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        [Tool::Forceps, Tool::LightPipe, Tool::Pick, Tool::Vitrector, Tool::Needle]
            .into_iter()
            .find(|&t| t as u32 == code)
    }

    /// Opening of its jaws if they are not closed, rad; 0 without jaws.
    pub fn open_rad(self) -> f64 {
        if self == Tool::Forceps { OPEN_JAWS_RAD } else { 0.0 }
    }
}

/// Opening of forceps that are not closed, rad.
pub const OPEN_JAWS_RAD: f64 = 0.9;

/// Length of the forceps' jaws from pivot to tip, mm (23 to 25 gauge forceps: 1 to 2 mm). Collision
/// and picture use the same.
pub const JAW_LENGTH_MM: f64 = 1.5;
/// Radius of a jaw at its tip as a share of the shaft's.
pub const JAW_TAPER: f64 = 0.35;

/// Height of the middle of the vitrector's port over the tip, mm (23 to 25 gauge: 0.2 to 0.4 mm).
/// The port lies along +x.
pub const PORT_HEIGHT_MM: f64 = 0.3;
/// Radius of the vitrector's port, mm.
pub const PORT_RADIUS_MM: f64 = 0.15;
/// How far the pick's hook reaches from the shaft's axis along +x, mm.
pub const HOOK_LENGTH_MM: f64 = 0.6;
/// Thickness of the hook along the shaft, and its width where it begins, mm.
pub const HOOK_THICKNESS_MM: f64 = 0.12;

/// State of one handle.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct HandleState {
    /// Counts up by one with every message of this sender.
    #[wire(tag = 1)]
    pub seq: u64,
    /// Field it belongs to.
    #[wire(tag = 2)]
    pub field: u64,
    /// When it was read.
    #[wire(tag = 3)]
    pub instant_ns: Nanos,
    /// 0 or 1.
    #[wire(tag = 4)]
    pub instrument: u32,
    /// [`Tool`] on the wire.
    #[wire(tag = 5)]
    pub tool: u32,
    /// Opening between the jaws, rad.
    #[wire(tag = 6)]
    pub jaw_rad: f64,
}

impl Message for HandleState {
    const CHANNEL: &'static str = "handles";
    const VERSION: u32 = 1;
    const QUEUE: usize = 256;

    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected, found| require(holds, "HandleState", field, expected, found);
        let i = f64::from(self.instrument);
        check((self.instrument as usize) < INSTRUMENTS, "instrument", "0 or 1", i)?;
        check(Tool::from_wire(self.tool).is_some(), "tool", "a tool 1 to 5", f64::from(self.tool))?;
        let open = (0.0..=std::f64::consts::PI).contains(&self.jaw_rad);
        check(open, "jaw_rad", "0 to π", self.jaw_rad)
    }
}

/// Meaning of the pedal's axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u32)]
pub enum PedalMode {
    /// Both axes move the microscope.
    Move = 0,
    /// The first axis zooms, the second focuses.
    Zoom = 1,
    /// The first axis is the share of the full suction, the second that of the full cut rate; below
    /// 0 counts as 0.
    Aspirate = 2,
    /// The first axis is the share of the full injection pressure; below 0 counts as 0.
    Inject = 3,
    /// Fluid–air exchange: the first axis is the share of the full flow of air, the second that of
    /// fluid; below 0 counts as 0.
    Exchange = 4,
}

impl PedalMode {
    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        use PedalMode::{Aspirate, Exchange, Inject, Move, Zoom};
        [Move, Zoom, Aspirate, Inject, Exchange].into_iter().find(|&m| m as u32 == code)
    }
}

/// State of the foot pedal.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct PedalState {
    /// Counts up by one with every message of this sender.
    #[wire(tag = 1)]
    pub seq: u64,
    /// When it was read.
    #[wire(tag = 2)]
    pub instant_ns: Nanos,
    /// Two axes, −1 to 1.
    #[wire(tag = 3, columns = "axis0,axis1")]
    pub axes: [f64; 2],
    /// Held buttons: bits of [`crate::optics::PedalButton`].
    #[wire(tag = 4)]
    pub buttons: u32,
    /// Meaning of the axes: [`PedalMode`] on the wire.
    #[wire(tag = 5)]
    pub mode: u32,
}

impl Message for PedalState {
    const CHANNEL: &'static str = "pedal";
    /// 2: modes 3 (injection) and 4 (fluid–air exchange); states of version 1 mean what they meant.
    const VERSION: u32 = 2;
    const QUEUE: usize = 256;

    fn validate(&self) -> Result<(), Invalid> {
        for axis in self.axes {
            require((-1.0..=1.0).contains(&axis), "PedalState", "axes", "−1 to 1", axis)?;
        }
        let known = PedalMode::from_wire(self.mode).is_some();
        require(known, "PedalState", "mode", "0 to 4", f64::from(self.mode))
    }
}

/// Some of the channels `handles` and `pedal`; as text `handles,pedal`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ControlChannels {
    /// Channel `handles` is one of them.
    pub handles: bool,
    /// Channel `pedal` is one of them.
    pub pedal: bool,
}

impl FromStr for ControlChannels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut channels = ControlChannels::default();
        for name in text.split(',') {
            let channel = match name {
                HandleState::CHANNEL => &mut channels.handles,
                PedalState::CHANNEL => &mut channels.pedal,
                _ => return Err(format!("expected handles, pedal or both with a comma, found {text:?}")),
            };
            if std::mem::replace(channel, true) {
                return Err(format!("{name} is named twice in {text:?}"));
            }
        }
        Ok(channels)
    }
}

impl Display for ControlChannels {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let named = [(self.handles, HandleState::CHANNEL), (self.pedal, PedalState::CHANNEL)];
        let names: Vec<&str> =
            named.into_iter().filter(|(is_one, _)| *is_one).map(|(_, name)| name).collect();
        f.write_str(&names.join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_of_controls_are_read_as_they_are_written() {
        for (text, handles, pedal) in
            [("handles", true, false), ("pedal", false, true), ("handles,pedal", true, true)]
        {
            let channels: ControlChannels = text.parse().unwrap();
            assert_eq!(channels, ControlChannels { handles, pedal });
            assert_eq!(channels.to_string(), text);
        }
        for text in ["", "poses", "handles,", "pedal,pedal"] {
            let told = text.parse::<ControlChannels>().unwrap_err();
            assert!(told.contains("expected handles, pedal") || told.contains("twice"), "{told}");
        }
    }

    #[test]
    fn every_mode_of_the_pedal_is_taken_and_no_other() {
        for mode in 0..5 {
            let pedal = PedalState { mode, ..PedalState::zeroed() };
            pedal.validate().unwrap();
            assert_eq!(PedalMode::from_wire(mode).map(|m| m as u32), Some(mode));
        }
        let unknown = PedalState { mode: 5, ..PedalState::zeroed() };
        assert!(unknown.validate().unwrap_err().to_string().contains("mode"));
    }
}
