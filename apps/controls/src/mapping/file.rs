//! Mapping files as they are read, with refusals that name file, key, and what was expected.

use super::{AxisMap, Mapping, MappingError, Range, ReportShape};
use crate::inputs::{Input, Inputs, LONGEST_REPORT};
use protocol::file::{MAX_SETTINGS_BYTES, other_format, other_format_in, read_text};
use protocol::handles::PedalMode;
use protocol::optics::PedalButton;
use protocol::parse_error;
use serde::{Deserialize, Serialize};
use settings::commands::controls::PedalInterface;
use std::fmt::Display;
use std::path::Path;

/// The one format this build reads and writes.
pub const FORMAT: &str = "vitreo-pedal-1";

/// The shipped mappings: name and text.
pub const SHIPPED: [(&str, &str); 3] = [
    ("keyboard-switch", include_str!("../../../../assets/pedals/keyboard-switch.toml")),
    ("analogue", include_str!("../../../../assets/pedals/analogue.toml")),
    ("three-pedals", include_str!("../../../../assets/pedals/three-pedals.toml")),
];

/// The buttons of the pedal by their names in files.
pub const BUTTONS: [(&str, PedalButton); 8] = [
    ("magnify", PedalButton::Magnify),
    ("reduce", PedalButton::Reduce),
    ("lens", PedalButton::Lens),
    ("inverter", PedalButton::Inverter),
    ("filter", PedalButton::Filter),
    ("pause", PedalButton::Pause),
    ("restart", PedalButton::Restart),
    ("next", PedalButton::Next),
];

/// A mapping as the file has it.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FileMapping {
    pub(super) format: String,
    pub(super) name: String,
    pub(super) interface: PedalInterface,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) report_bytes: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) report_id: Option<u8>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) grab: bool,
    pub(super) mode: PedalMode,
    #[serde(default)]
    pub(super) axes: Vec<FileAxis>,
    #[serde(default)]
    pub(super) buttons: Vec<FileButton>,
    #[serde(default)]
    pub(super) modes: Vec<FileMode>,
}

/// What every entry names: an input of the kernel, or bits of a report.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(super) struct FileInput {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) input: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) bits: Option<[u32; 2]>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) signed: bool,
}

/// Declares an entry: serde cannot flatten where unknown keys are refused.
macro_rules! entry {
    ($name:ident { $($(#[$attribute:meta])* $field:ident: $kind:ty),* $(,)? }) => {
        #[derive(Debug, Deserialize, Serialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct $name {
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(super) input: Option<String>,
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub(super) bits: Option<[u32; 2]>,
            #[serde(default, skip_serializing_if = "std::ops::Not::not")]
            pub(super) signed: bool,
            $($(#[$attribute])* pub(super) $field: $kind,)*
        }

        impl $name {
            fn input(&self) -> FileInput {
                FileInput { input: self.input.clone(), bits: self.bits, signed: self.signed }
            }
        }
    };
}

entry!(FileAxis {
    axis: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    range: Option<Vec<f64>>,
    #[serde(default)]
    dead_zone: f64,
    #[serde(default = "one")]
    curve: f64,
    #[serde(default = "one")]
    full: f64,
});
entry!(FileButton { button: String });
entry!(FileMode { mode: PedalMode });

fn one() -> f64 {
    1.0
}

/// A key that is refused, what would be right, and what is there.
type Defect = (String, String, String);

fn defect(key: impl Display, expected: impl Display, found: impl Display) -> Defect {
    (key.to_string(), expected.to_string(), found.to_string())
}

/// A shipped mapping.
pub fn shipped(name: &str) -> Option<Mapping> {
    let (name, text) = SHIPPED.into_iter().find(|(shipped, _)| *shipped == name)?;
    Mapping::parse(text, name).ok()
}

impl Mapping {
    /// By a shipped one's name, or from a file.
    ///
    /// # Errors
    /// Where there is none of that name, the file cannot be read, or what it says cannot be.
    pub fn load(name: &str) -> Result<Self, MappingError> {
        if let Some((name, text)) = SHIPPED.into_iter().find(|(shipped, _)| *shipped == name) {
            return Self::parse(text, name);
        }
        if !name.ends_with(".toml") && !name.contains('/') {
            let names = SHIPPED.map(|(name, _)| name).join(", ");
            let expected = format!("a file that ends in .toml, or one of {names}");
            return Err(MappingError::Value {
                path: name.into(),
                key: "name".into(),
                expected,
                found: format!("{name:?}"),
            });
        }
        let text = read_text(Path::new(name), MAX_SETTINGS_BYTES);
        let text = text.map_err(|source| MappingError::Read { path: name.into(), source })?;
        Self::parse(&text, name)
    }

    /// Reads and checks the text of a mapping; `path` is for messages.
    ///
    /// # Errors
    /// Where it is none, or what it says cannot be.
    pub fn parse(text: &str, path: &str) -> Result<Self, MappingError> {
        let value = |(key, expected, found)| MappingError::Value { path: path.into(), key, expected, found };
        let file: FileMapping =
            toml::from_str(text).map_err(|problem| match other_format_in(text, FORMAT) {
                Some(found) => value(defect("format", FORMAT, found)),
                None => MappingError::Parse { path: path.into(), problem: parse_error::toml(text, &problem) },
            })?;
        file.mapping().map_err(value)
    }
}

impl FileMapping {
    fn mapping(self) -> Result<Mapping, Defect> {
        if self.format != FORMAT {
            let found = other_format(&self.format, FORMAT).unwrap_or_default();
            return Err(defect("format", FORMAT, found));
        }
        let report = self.report()?;
        if self.grab && self.interface == PedalInterface::Hidraw {
            return Err(defect("grab", "interface = \"evdev\" with it", "interface = \"hidraw\""));
        }
        let input = |key: String, file: FileInput| file.of(report, &key);
        let axes = self.axes.iter().enumerate();
        let axes = axes.map(|(i, a)| a.map(input(format!("axes[{i}]"), a.input())?, i));
        let buttons = self.buttons.iter().enumerate();
        let buttons = buttons.map(|(i, b)| Ok((input(format!("buttons[{i}]"), b.input())?, b.button(i)?)));
        let modes = self.modes.iter().enumerate();
        let modes = modes.map(|(i, m)| Ok((input(format!("modes[{i}]"), m.input())?, m.mode)));
        let mapping = Mapping {
            axes: axes.collect::<Result<_, Defect>>()?,
            buttons: buttons.collect::<Result<_, Defect>>()?,
            modes: modes.collect::<Result<_, Defect>>()?,
            name: self.name,
            interface: self.interface,
            report,
            grab: self.grab,
            mode: self.mode,
        };
        if mapping.inputs().next().is_none() {
            return Err(defect("axes, buttons, modes", "at least one entry", "none"));
        }
        Ok(mapping)
    }

    fn report(&self) -> Result<Option<ReportShape>, Defect> {
        match (self.interface, self.report_bytes) {
            (PedalInterface::Evdev, None) if self.report_id.is_none() => Ok(None),
            (PedalInterface::Evdev, _) => Err(defect(
                "report_bytes, report_id",
                "interface = \"hidraw\" with them",
                "interface = \"evdev\"",
            )),
            (PedalInterface::Hidraw, Some(bytes)) if (1..=LONGEST_REPORT).contains(&bytes) => {
                Ok(Some(ReportShape { bytes, id: self.report_id }))
            }
            (PedalInterface::Hidraw, bytes) => {
                let found = bytes.map_or("nothing".into(), |bytes| bytes.to_string());
                Err(defect("report_bytes", "the length of a report, 1 to 65 bytes", found))
            }
        }
    }
}

impl FileInput {
    fn of(self, report: Option<ReportShape>, key: &str) -> Result<Input, Defect> {
        match (report, &self.input, self.bits) {
            (None, Some(name), None) if !self.signed => Input::named(name).ok_or_else(|| {
                let expected = "a key or axis of the kernel: KEY_A, BTN_TRIGGER, ABS_Z, KEY:30 or ABS:2";
                defect(format!("{key}.input"), expected, format!("{name:?}"))
            }),
            (Some(shape), None, Some([first, count])) => {
                let room = 8 * shape.bytes as u64;
                let fits = u64::from(first) + u64::from(count) <= room;
                if (1..=32).contains(&count) && fits {
                    return Ok(Input::Bits { first, count, signed: self.signed });
                }
                let expected = format!("[FIRST, COUNT], COUNT 1 to 32, within the report's {room} bits");
                Err(defect(format!("{key}.bits"), expected, format!("[{first}, {count}]")))
            }
            (None, ..) => {
                let found = "bits, signed, or no input";
                Err(defect(key, "input = \"NAME\" alone, since interface = \"evdev\"", found))
            }
            (Some(_), ..) => {
                let found = "input, or no bits";
                Err(defect(key, "bits = [FIRST, COUNT], since interface = \"hidraw\"", found))
            }
        }
    }
}

impl FileAxis {
    fn map(&self, input: Input, i: usize) -> Result<AxisMap, Defect> {
        let key = |name: &str| format!("axes[{i}].{name}");
        let range = match self.range.as_deref() {
            None => None,
            Some(&[released, pressed]) => Some(Range::OneSided([released, pressed])),
            Some(&[low, middle, high]) => Some(Range::TwoSided([low, middle, high])),
            Some(other) => {
                let expected = "[RELEASED, PRESSED] or [LOW, MIDDLE, HIGH]";
                return Err(defect(key("range"), expected, format!("{} numbers", other.len())));
            }
        };
        let ends = self.range.as_deref().unwrap_or(&[0.0, 1.0]);
        let finite = ends.iter().all(|end| end.is_finite() && end.abs() < 1e10);
        let ordered = ends.windows(2).all(|w| w[0] < w[1]) || ends.windows(2).all(|w| w[0] > w[1]);
        let checks = [
            (self.axis < 2, "axis", "0 or 1", self.axis.to_string()),
            (finite && ordered, "range", "numbers that only rise or only fall", format!("{ends:?}")),
            ((0.0..=0.9).contains(&self.dead_zone), "dead_zone", "0 to 0.9", self.dead_zone.to_string()),
            ((0.2..=5.0).contains(&self.curve), "curve", "0.2 to 5", self.curve.to_string()),
            (
                (-1.0..=1.0).contains(&self.full) && self.full != 0.0,
                "full",
                "−1 to 1, not 0",
                self.full.to_string(),
            ),
        ];
        if let Some((_, name, expected, found)) = checks.into_iter().find(|(holds, ..)| !holds) {
            return Err(defect(key(name), expected, found));
        }
        // A key is down or up, whatever the file says of its way.
        let range = range.or_else(|| own_range(input));
        let (dead_zone, curve, full) = (self.dead_zone, self.curve, self.full);
        Ok(AxisMap { input, axis: self.axis, range, dead_zone, curve, full })
    }
}

/// The range of an input that does not depend on the device.
fn own_range(input: Input) -> Option<Range> {
    let range = Inputs::default().range(input)?;
    Some(Range::OneSided(range.map(|end| end as f64)))
}

impl FileButton {
    fn button(&self, i: usize) -> Result<PedalButton, Defect> {
        let known = BUTTONS.into_iter().find(|(name, _)| *name == self.button);
        let names = || BUTTONS.map(|(name, _)| name).join(", ");
        let refused = || defect(format!("buttons[{i}].button"), format!("one of {}", names()), &self.button);
        known.map(|(_, button)| button).ok_or_else(refused)
    }
}
