//! Stereo layout: how the two channels share one picture or display.

use clap::ValueEnum;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::fmt;

/// An arrangement of the two channels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
#[repr(u32)]
pub enum Arrangement {
    /// Left channel left, right channel right.
    #[default]
    SideBySide = 0,
    /// For red–cyan glasses: the left channel's luminance in red, the right one's in green and
    /// blue.
    Anaglyph = 1,
    /// Lines from the top: even ones left, odd ones right, for line-interleaved fields of 85 Hz.
    Interleaved = 2,
    /// Left and right in turn, one refresh each, for two shuttered displays; a window only.
    Sequential = 3,
    /// Left channel alone.
    Left = 4,
    /// Right channel alone.
    Right = 5,
}

impl Arrangement {
    /// Size of the arranged picture for channels of this size, px.
    pub fn size_px(self, width_px: u32, height_px: u32) -> [u32; 2] {
        match self {
            Arrangement::SideBySide => [2 * width_px, height_px],
            _ => [width_px, height_px],
        }
    }

    /// Size of a text pixel over the picture, in pixels of the picture. In interleaved pictures each eye sees
    /// every second line, so every line of the text is drawn twice to be complete for both.
    pub fn text_scale(self) -> u32 {
        if self == Arrangement::Interleaved { 2 } else { 1 }
    }

    /// The arrangement for files, which cannot alternate channels in time: side by side replaces sequential.
    pub fn for_files(self) -> Self {
        if self == Arrangement::Sequential { Arrangement::SideBySide } else { self }
    }
}

/// Formats the arrangement as it is typed on the command line.
impl fmt::Display for Arrangement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.to_possible_value();
        f.write_str(value.as_ref().map_or("", PossibleValue::get_name))
    }
}

/// Parser for arrangements of a film, which cannot alternate channels in time.
pub fn of_films() -> impl TypedValueParser<Value = Arrangement> {
    let all = Arrangement::value_variants().iter().filter(|how| **how == how.for_files());
    PossibleValuesParser::new(all.filter_map(ValueEnum::to_possible_value))
        .map(|name| Arrangement::from_str(&name, false).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_written_as_it_is_read() {
        for how in Arrangement::value_variants() {
            assert_eq!(Arrangement::from_str(&how.to_string(), false), Ok(*how));
        }
        let command = clap::Command::new("film").arg(clap::Arg::new("how").value_parser(of_films()));
        let film = |word: &str| {
            let found = command.clone().try_get_matches_from(["film", word]).ok()?;
            found.get_one::<Arrangement>("how").copied()
        };
        assert_eq!(film("left"), Some(Arrangement::Left));
        assert_eq!((film("sequential"), film("cross-eyed")), (None, None));
    }
}
