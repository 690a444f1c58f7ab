//! Sources of a run's camera pictures: `--cameras`.

use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

/// Name of the virtual cameras.
const VIRTUAL: &str = "virtual";
/// Forms of a source, for error messages.
const FORMS: &str = "y4m:PATH, mcap:FILE, v4l2:/dev/videoN or genicam:NAME";
/// Maximum exposure, µs.
const MAX_EXPOSURE_US: u32 = 1_000_000;

/// Parsed value of `--cameras`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cameras {
    /// The virtual rig, which is also the default.
    Virtual,
    /// The user's own program.
    Program(PathBuf),
    /// Streams of pictures, one for each camera of the rig in its order.
    Streams(Streams),
}

/// Sources of pictures, in the order of the rig's cameras.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Streams(pub Vec<Stream>);

/// Kind of a camera's source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamKind {
    /// YUV4MPEG2 through a pipe or from a file.
    Y4m,
    /// A recording of pixels.
    Mcap,
    /// A local camera (Video4Linux2).
    V4l2,
    /// A GenICam camera (GigE Vision, USB3 Vision).
    Genicam,
}

impl StreamKind {
    /// All kinds.
    const ALL: [StreamKind; 4] = [StreamKind::Y4m, StreamKind::Mcap, StreamKind::V4l2, StreamKind::Genicam];

    /// Prefix of such a source on the command line.
    fn prefix(self) -> &'static str {
        match self {
            StreamKind::Y4m => "y4m:",
            StreamKind::Mcap => "mcap:",
            StreamKind::V4l2 => "v4l2:",
            StreamKind::Genicam => "genicam:",
        }
    }

    /// True for a camera with settings, false for a pipe or a file.
    pub fn is_camera(self) -> bool {
        matches!(self, StreamKind::V4l2 | StreamKind::Genicam)
    }

    /// True if the source is a path on this machine.
    pub fn has_path(self) -> bool {
        self != StreamKind::Genicam
    }
}

/// What starts an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trigger {
    /// The camera's own clock.
    Internal,
    /// An external signal.
    External,
}

impl Trigger {
    /// Name in the options of a source.
    pub fn name(self) -> &'static str {
        match self {
            Trigger::Internal => "internal",
            Trigger::External => "external",
        }
    }
}

/// Requested camera settings; those that are `None` stay unchanged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Exposure, µs.
    pub exposure_us: Option<u32>,
    /// Gain, in the driver's unit.
    pub gain: Option<i32>,
    /// Trigger of the exposures.
    pub trigger: Option<Trigger>,
}

/// One source of pictures.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stream {
    /// Its kind.
    pub kind: StreamKind,
    /// Pipe, file or device; for a GenICam camera its name or address.
    pub path: PathBuf,
    /// Parity of field 0 (0 or 1), if given.
    pub parity: Option<u32>,
    /// Requested camera settings.
    pub wanted: Wanted,
}

impl FromStr for Cameras {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == VIRTUAL {
            return Ok(Cameras::Virtual);
        }
        if StreamKind::ALL.iter().any(|kind| text.starts_with(kind.prefix())) {
            return text.parse().map(Cameras::Streams);
        }
        let kind = text.split_once(':').map_or("", |(kind, _)| kind);
        let is_kind = kind.len() > 1 && kind.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
        if text.is_empty() || is_kind {
            let expected =
                format!("virtual, a program, or {FORMS} for each camera of the rig, separated by commas");
            return Err(format!("expected {expected}, found {text:?} (a program of that name: ./{text})"));
        }
        Ok(Cameras::Program(text.into()))
    }
}

impl Streams {
    /// Returns one source per camera; a single recording serves all cameras.
    pub fn spread(&self, cameras: usize) -> Vec<Stream> {
        match &self.0[..] {
            [one] if one.kind == StreamKind::Mcap => vec![one.clone(); cameras],
            all => all.to_vec(),
        }
    }
}

impl FromStr for Streams {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split(',').map(str::parse).collect::<Result<_, _>>().map(Streams)
    }
}

impl FromStr for Stream {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || format!("expected {FORMS} for each camera, found {text:?}");
        let found =
            StreamKind::ALL.into_iter().find_map(|kind| Some((kind, text.strip_prefix(kind.prefix())?)));
        let (kind, place) = found.ok_or_else(refused)?;
        let (path, options) = place.split_once('?').map_or((place, None), |(p, o)| (p, Some(o)));
        if path.is_empty() {
            return Err(refused());
        }
        let mut stream = Stream { kind, path: path.into(), parity: None, wanted: Wanted::default() };
        for option in options.into_iter().flat_map(|o| o.split('&')) {
            stream.take(option).map_err(|problem| format!("{problem}, found {option:?} in {text:?}"))?;
        }
        Ok(stream)
    }
}

impl Stream {
    /// Parses one option of a source. The error states the expected form.
    fn take(&mut self, option: &str) -> Result<(), String> {
        let (key, value) = option.split_once('=').unwrap_or((option, ""));
        let again = match key {
            "parity" if self.kind != StreamKind::Mcap => self.parity.is_some(),
            "exposure_us" => self.wanted.exposure_us.is_some(),
            "gain" => self.wanted.gain.is_some(),
            "trigger" => self.wanted.trigger.is_some(),
            _ if self.kind == StreamKind::Mcap => {
                return Err("expected nothing after the file: a recording describes its own fields".into());
            }
            _ if !self.kind.is_camera() => {
                return Err("expected ?parity=0 or ?parity=1 after the path".into());
            }
            _ => return Err("expected parity, exposure_us, gain or trigger after the device".into()),
        };
        if again {
            return Err(format!("expected {key} once"));
        }
        if key != "parity" && !self.kind.is_camera() {
            return Err(format!("expected no {key}: a pipe or a file has no such setting"));
        }
        match key {
            "parity" => {
                let parity = ["0", "1"].iter().position(|p| *p == value);
                self.parity = Some(parity.ok_or("expected ?parity=0 or ?parity=1 after the path")? as u32);
            }
            "exposure_us" => {
                let exposure = value.parse().ok().filter(|us| (1..=MAX_EXPOSURE_US).contains(us));
                self.wanted.exposure_us =
                    Some(exposure.ok_or_else(|| format!("expected exposure_us=1 to {MAX_EXPOSURE_US}"))?);
            }
            "gain" => {
                self.wanted.gain =
                    Some(value.parse().map_err(|_| "expected gain=NUMBER, in the driver's unit")?)
            }
            _ => {
                let trigger = [Trigger::Internal, Trigger::External].into_iter().find(|t| t.name() == value);
                self.wanted.trigger = Some(trigger.ok_or("expected trigger=internal or trigger=external")?);
            }
        }
        Ok(())
    }
}

impl Display for Cameras {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Cameras::Virtual => f.write_str(VIRTUAL),
            Cameras::Program(program) => program.display().fmt(f),
            Cameras::Streams(streams) => streams.fmt(f),
        }
    }
}

impl Display for Streams {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let words: Vec<String> = self.0.iter().map(Stream::to_string).collect();
        f.write_str(&words.join(","))
    }
}

impl Display for Stream {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind.prefix(), self.path.display())?;
        let options = [
            self.parity.map(|parity| format!("parity={parity}")),
            self.wanted.exposure_us.map(|us| format!("exposure_us={us}")),
            self.wanted.gain.map(|gain| format!("gain={gain}")),
            self.wanted.trigger.map(|trigger| format!("trigger={}", trigger.name())),
        ];
        let options: Vec<String> = options.into_iter().flatten().collect();
        if options.is_empty() { Ok(()) } else { write!(f, "?{}", options.join("&")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_form_is_read_as_it_is_written() {
        let stream = |path: &str, parity| Stream {
            kind: StreamKind::Y4m,
            path: path.into(),
            parity,
            wanted: Wanted::default(),
        };
        let set = Wanted { exposure_us: Some(2000), gain: Some(-4), trigger: Some(Trigger::External) };
        let streams = |all: &[Stream]| Cameras::Streams(Streams(all.to_vec()));
        for (text, expected) in [
            ("virtual", Cameras::Virtual),
            ("./virtual", Cameras::Program("./virtual".into())),
            ("/opt/rig:1/driver", Cameras::Program("/opt/rig:1/driver".into())),
            ("y4m:a", streams(&[stream("a", None)])),
            ("mcap:a.mcap", streams(&[Stream { kind: StreamKind::Mcap, ..stream("a.mcap", None) }])),
            ("y4m:a,y4m:/b/c?parity=1,y4m:d?parity=0", {
                streams(&[stream("a", None), stream("/b/c", Some(1)), stream("d", Some(0))])
            }),
            ("v4l2:/dev/video0?parity=1&exposure_us=2000&gain=-4&trigger=external,y4m:a", {
                let device = Stream { kind: StreamKind::V4l2, wanted: set, ..stream("/dev/video0", Some(1)) };
                streams(&[device, stream("a", None)])
            }),
            ("genicam:Aravis-Fake-GV02?gain=-4,genicam:192.168.0.7", {
                let named = |name, gain| Stream {
                    kind: StreamKind::Genicam,
                    wanted: Wanted { gain, ..Wanted::default() },
                    ..stream(name, None)
                };
                streams(&[named("Aravis-Fake-GV02", Some(-4)), named("192.168.0.7", None)])
            }),
        ] {
            let read: Cameras = text.parse().unwrap();
            assert_eq!(read, expected);
            assert_eq!(read.to_string(), text);
        }
    }

    #[test]
    fn slips_are_named() {
        for (text, named) in [
            ("", "expected virtual, a program"),
            ("usb:3", "expected virtual, a program"),
            ("y4m:", "expected y4m:PATH"),
            ("y4m:a,b", "found \"b\""),
            ("y4m:a,", "found \"\""),
            ("y4m:a?parity=2", "?parity=0 or ?parity=1"),
            ("y4m:a?rate=50", "?parity=0 or ?parity=1"),
            ("y4m:?parity=1", "expected y4m:PATH"),
            ("y4m:a?gain=4", "expected no gain: a pipe or a file has no such setting"),
            ("v4l2:", "expected y4m:PATH, mcap:FILE, v4l2:/dev/videoN or genicam:NAME"),
            ("genicam:?gain=1", "expected y4m:PATH, mcap:FILE, v4l2:/dev/videoN or genicam:NAME"),
            ("mcap:a?parity=1", "expected nothing after the file"),
            ("mcap:a?gain=1", "expected"),
            ("genicam:a?speed=1", "expected parity, exposure_us, gain or trigger"),
            ("v4l2:/dev/video0?brightness=3", "expected parity, exposure_us, gain or trigger"),
            ("v4l2:/dev/video0?exposure_us=0", "exposure_us=1 to 1000000, found \"exposure_us=0\""),
            ("v4l2:/dev/video0?gain=much", "expected gain=NUMBER"),
            ("v4l2:/dev/video0?gain=1&gain=2", "expected gain once"),
            ("v4l2:/dev/video0?trigger=maybe", "trigger=internal or trigger=external"),
        ] {
            let told = text.parse::<Cameras>().unwrap_err();
            assert!(told.contains(named), "{text:?}: {told}");
        }
    }
}
