//! Mappings as files.

use super::file::{BUTTONS, FORMAT, FileAxis, FileButton, FileMapping, FileMode};
use super::{Mapping, Range};
use crate::inputs::Input;
use protocol::optics::PedalButton;

/// How a file names an input.
fn named(input: Input) -> (Option<String>, Option<[u32; 2]>, bool) {
    match input {
        Input::Bits { first, count, signed } => (None, Some([first, count]), signed),
        _ => (Some(input.to_string()), None, false),
    }
}

impl Mapping {
    /// As the text of a file.
    pub fn to_toml(&self) -> String {
        let axes = self.axes.iter().map(|map| {
            let (input, bits, signed) = named(map.input);
            let range = map.range.map(|range| match range {
                Range::OneSided(ends) => ends.to_vec(),
                Range::TwoSided(ends) => ends.to_vec(),
            });
            let (axis, dead_zone, curve, full) = (map.axis, map.dead_zone, map.curve, map.full);
            FileAxis { input, bits, signed, axis, range, dead_zone, curve, full }
        });
        let name_of = |button: PedalButton| BUTTONS.into_iter().find(|(_, b)| *b == button);
        let buttons = self.buttons.iter().map(|(input, button)| {
            let (input, bits, signed) = named(*input);
            let button = name_of(*button).map_or_else(String::new, |(name, _)| name.into());
            FileButton { input, bits, signed, button }
        });
        let modes = self.modes.iter().map(|(input, mode)| {
            let (input, bits, signed) = named(*input);
            FileMode { input, bits, signed, mode: *mode }
        });
        let file = FileMapping {
            format: FORMAT.into(),
            name: self.name.clone(),
            interface: self.interface,
            report_bytes: self.report.map(|shape| shape.bytes),
            report_id: self.report.and_then(|shape| shape.id),
            grab: self.grab,
            mode: self.mode,
            axes: axes.collect(),
            buttons: buttons.collect(),
            modes: modes.collect(),
        };
        toml::to_string(&file).expect("a mapping has string keys only")
    }
}
