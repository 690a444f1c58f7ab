//! Sources of handles and pedal: `--pedal` and `--handles`.

use super::processes::Arguments;
use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

/// Prefix of a pedal that is read through kernel input events.
const EVDEV: &str = "evdev:";
/// Prefix of a pedal that is read through raw HID reports.
const HIDRAW: &str = "hidraw:";
/// Prefix of the handles' serial port.
const SERIAL: &str = "serial:";
/// Option of the serial port after its path.
const BAUD: &str = "?baud=";
/// Default baud rate.
pub const DEFAULT_BAUD: u32 = 115_200;
/// Lowest and highest baud rate accepted.
const BAUDS: [u32; 2] = [1_200, 4_000_000];

/// Kernel interface of a pedal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PedalInterface {
    /// Events of the kernel's input devices, `/dev/input/event*`.
    Evdev,
    /// Raw HID reports, `/dev/hidraw*`.
    Hidraw,
}

/// A foot pedal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PedalSpec {
    /// Kernel interface.
    pub interface: PedalInterface,
    /// Device, pipe or recorded file.
    pub path: PathBuf,
    /// Mapping of axes and buttons: a shipped mapping's name, or a .toml file.
    pub mapping: Option<String>,
}

/// Serial port of the handles of both instruments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HandlesSpec {
    /// Device or pipe.
    pub path: PathBuf,
    /// Baud rate, bits per second.
    pub baud: u32,
}

impl PedalInterface {
    /// Prefix before the path on the command line.
    pub fn prefix(self) -> &'static str {
        match self {
            PedalInterface::Evdev => EVDEV,
            PedalInterface::Hidraw => HIDRAW,
        }
    }
}

impl FromStr for PedalSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "evdev:/dev/input/eventN[,MAPPING] or hidraw:/dev/hidrawN[,MAPPING]";
        let refused = || format!("expected {expected}, found {text:?}");
        let interfaces = [PedalInterface::Evdev, PedalInterface::Hidraw];
        let found = interfaces
            .into_iter()
            .find_map(|interface| Some((interface, text.strip_prefix(interface.prefix())?)));
        let (interface, rest) = found.ok_or_else(refused)?;
        let (path, mapping) = match rest.split_once(',') {
            None => (rest, None),
            Some((_, "")) => return Err(refused()),
            Some((path, mapping)) => (path, Some(mapping.to_owned())),
        };
        if path.is_empty() { Err(refused()) } else { Ok(PedalSpec { interface, path: path.into(), mapping }) }
    }
}

impl FromStr for HandlesSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused =
            || format!("expected serial:/dev/ttyUSB0 or serial:/dev/ttyUSB0?baud=115200, found {text:?}");
        let rest = text.strip_prefix(SERIAL).ok_or_else(refused)?;
        let (path, baud) = match rest.split_once('?') {
            None => (rest, DEFAULT_BAUD),
            Some((path, _)) => {
                let baud = rest[path.len()..].strip_prefix(BAUD).and_then(|n| n.parse().ok());
                let known = baud.filter(|baud| (BAUDS[0]..=BAUDS[1]).contains(baud));
                let [least, most] = BAUDS;
                let named =
                    || format!("expected ?baud=N after the path, N {least} to {most}, found {text:?}");
                (path, known.ok_or_else(named)?)
            }
        };
        if path.is_empty() { Err(refused()) } else { Ok(HandlesSpec { path: path.into(), baud }) }
    }
}

impl Display for PedalSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.interface.prefix(), self.path.display())?;
        self.mapping.as_ref().map_or(Ok(()), |mapping| write!(f, ",{mapping}"))
    }
}

impl Display for HandlesSpec {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{SERIAL}{}", self.path.display())?;
        if self.baud == DEFAULT_BAUD { Ok(()) } else { write!(f, "{BAUD}{}", self.baud) }
    }
}

/// A real pedal and real handles.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Pedal and handles")]
pub struct ControlsArgs {
    /// Foot pedal: evdev:/dev/input/eventN[,MAPPING] or hidraw:/dev/hidrawN,MAPPING. MAPPING is the name of a
    /// shipped mapping or a .toml file (docs/controls.md); vitreo pedal shows and learns mappings.
    #[arg(long, value_name = "evdev:PATH[,MAPPING]|hidraw:PATH,MAPPING")]
    pub pedal: Option<PedalSpec>,
    /// Serial port of the encoders in the handles, which select tools and move jaws:
    /// serial:/dev/ttyUSB0[?baud=115200]. Needs a rig with a handles section, which vitreo handles writes
    /// (docs/handles.md).
    #[arg(long, value_name = "serial:PATH[?baud=N]")]
    pub handles: Option<HandlesSpec>,
}

impl ControlsArgs {
    /// True if a device is given.
    pub fn any(&self) -> bool {
        self.pedal.is_some() || self.handles.is_some()
    }

    /// Adds the options to the arguments of the process that reads the devices.
    pub fn hand_on(&self, to: &mut Arguments) {
        to.value("--pedal", self.pedal.as_ref());
        to.value("--handles", self.handles.as_ref());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_form_is_read_as_it_is_written() {
        for text in [
            "evdev:/dev/input/event5",
            "evdev:/dev/input/event5,keyboard-switch",
            "hidraw:/dev/hidraw0,./a.toml",
            "hidraw:f",
        ] {
            let read: PedalSpec = text.parse().unwrap();
            assert_eq!(read.to_string(), text);
        }
        let read: PedalSpec = "hidraw:/dev/hidraw0,m.toml".parse().unwrap();
        assert_eq!((read.interface, read.mapping.as_deref()), (PedalInterface::Hidraw, Some("m.toml")));
        for (text, baud) in [("serial:/dev/ttyUSB0", DEFAULT_BAUD), ("serial:a?baud=9600", 9_600)] {
            let read: HandlesSpec = text.parse().unwrap();
            assert_eq!((read.baud, read.to_string().as_str()), (baud, text));
        }
    }

    #[test]
    fn slips_are_named() {
        for text in ["", "evdev:", "hidraw:,m", "evdev:a,", "usb:a", "/dev/input/event1"] {
            let told = text.parse::<PedalSpec>().unwrap_err();
            assert!(told.contains("expected evdev:/dev/input/eventN"), "{text:?}: {told}");
        }
        for (text, named) in [
            ("", "expected serial:"),
            ("serial:", "expected serial:"),
            ("tcp:3", "expected serial:"),
            ("serial:a?baud=0", "1200 to 4000000"),
            ("serial:a?baud=9600.5", "1200 to 4000000"),
            ("serial:a?speed=9600", "1200 to 4000000"),
            ("serial:?baud=9600", "expected serial:"),
        ] {
            let told = text.parse::<HandlesSpec>().unwrap_err();
            assert!(told.contains(named), "{text:?}: {told}");
        }
    }
}
