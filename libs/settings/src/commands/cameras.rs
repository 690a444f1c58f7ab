//! Where a run's pictures come from: what `--cameras` says.

use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

/// The word for the cameras that vitreo invents.
const VIRTUAL: &str = "virtual";
/// What a stream of pictures begins with.
const Y4M: &str = "y4m:";
/// The option of a stream.
const PARITY: &str = "?parity=";

/// What `--cameras` asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cameras {
    /// The virtual rig, as without the option.
    Virtual,
    /// A program of the rig's maker.
    Program(PathBuf),
    /// Streams of pictures, one for each camera of the rig in its order.
    Streams(Streams),
}

/// Streams of pictures, in the order of the rig's cameras.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Streams(pub Vec<Stream>);

/// One stream of pictures (YUV4MPEG2).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stream {
    /// A pipe or a file.
    pub path: PathBuf,
    /// Parity of the field with number 0, where it is given.
    pub parity: Option<u32>,
}

impl FromStr for Cameras {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == VIRTUAL {
            return Ok(Cameras::Virtual);
        }
        if text.starts_with(Y4M) {
            return text.parse().map(Cameras::Streams);
        }
        let kind = text.split_once(':').map_or("", |(kind, _)| kind);
        let is_kind = kind.len() > 1 && kind.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
        if text.is_empty() || is_kind {
            let expected = "virtual, a program, or y4m:PATH for each camera of the rig, separated by commas";
            return Err(format!("expected {expected}, found {text:?} (a program of that name: ./{text})"));
        }
        Ok(Cameras::Program(text.into()))
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
        let expected = "y4m:PATH or y4m:PATH?parity=1";
        let refused = || format!("expected {expected} for each camera, found {text:?}");
        let place = text.strip_prefix(Y4M).ok_or_else(refused)?;
        let (path, parity) = match place.split_once('?') {
            None => (place, None),
            Some((path, _)) => {
                let parity = match &place[path.len()..].strip_prefix(PARITY) {
                    Some("0") => 0,
                    Some("1") => 1,
                    _ => {
                        return Err(format!(
                            "expected ?parity=0 or ?parity=1 after the path, found {text:?}"
                        ));
                    }
                };
                (path, Some(parity))
            }
        };
        if path.is_empty() { Err(refused()) } else { Ok(Stream { path: path.into(), parity }) }
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
        write!(f, "{Y4M}{}", self.path.display())?;
        self.parity.map_or(Ok(()), |parity| write!(f, "{PARITY}{parity}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_form_is_read_as_it_is_written() {
        let stream = |path: &str, parity| Stream { path: path.into(), parity };
        let streams = |all: &[Stream]| Cameras::Streams(Streams(all.to_vec()));
        for (text, expected) in [
            ("virtual", Cameras::Virtual),
            ("./virtual", Cameras::Program("./virtual".into())),
            ("/opt/rig:1/driver", Cameras::Program("/opt/rig:1/driver".into())),
            ("y4m:a", streams(&[stream("a", None)])),
            ("y4m:a,y4m:/b/c?parity=1,y4m:d?parity=0", {
                streams(&[stream("a", None), stream("/b/c", Some(1)), stream("d", Some(0))])
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
        ] {
            let told = text.parse::<Cameras>().unwrap_err();
            assert!(told.contains(named), "{text:?}: {told}");
        }
    }
}
