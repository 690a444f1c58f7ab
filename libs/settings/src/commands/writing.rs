//! Compression and split of recordings.

use std::fmt;
use std::str::FromStr;

/// Options of every command that writes a recording.
#[derive(Debug, Clone, Default, PartialEq, clap::Args)]
pub struct WritingArgs {
    /// Compression: zstd (small), lz4 (larger, faster to read) or none.
    #[arg(long, value_name = "FORMAT", value_parser = PACKINGS, default_value = PACKINGS[0])]
    pub compress: String,
    /// Split the recording into FILE.0001.mcap, FILE.0002.mcap and so on, by length (90s, 10m, 1h) or size
    /// (500MB, 2GB). Each part is a recording; FILE.mcap stands for all of them.
    #[arg(long, value_name = "LENGTH|SIZE")]
    pub split: Option<Split>,
}

/// Names of the compressions, the default first.
pub const PACKINGS: [&str; 3] = ["zstd", "lz4", "none"];

/// Maximum length or size of each part of a split recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Split {
    /// Length, s.
    Seconds(f64),
    /// Size, bytes.
    Bytes(u64),
}

/// Units of lengths, with their value in s, and of sizes, in bytes.
const LENGTHS: [(&str, f64); 3] = [("h", 3600.0), ("m", 60.0), ("s", 1.0)];
const SIZES: [(&str, f64); 3] = [("GB", 1e9), ("MB", 1e6), ("kB", 1e3)];
/// Minimum length, s, and size, bytes, of a part: shorter parts would contain little but their headers.
const SHORTEST_S: f64 = 1.0;
const SMALLEST_BYTES: f64 = 1e5;

impl FromStr for Split {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let with_unit = |units: [(&str, f64); 3]| {
            let found = units.iter().find_map(|(unit, worth)| Some((text.strip_suffix(unit)?, worth)));
            let (number, worth) = found?;
            number.parse::<f64>().ok().filter(|n| n.is_finite() && *n >= 0.0).map(|n| n * worth)
        };
        if let Some(bytes) = with_unit(SIZES) {
            return match bytes >= SMALLEST_BYTES {
                true => Ok(Split::Bytes(bytes as u64)),
                false => Err("expected parts of 100kB or more".into()),
            };
        }
        let plain = || text.parse::<f64>().ok().filter(|n| n.is_finite() && *n >= 0.0);
        match with_unit(LENGTHS).or_else(plain) {
            Some(seconds) if seconds >= SHORTEST_S => Ok(Split::Seconds(seconds)),
            Some(_) => Err("expected parts of 1s or more".into()),
            None => Err("expected a length such as 90s, 10m or 1h, or a size such as 500MB or 2GB".into()),
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Split::Seconds(seconds) => write!(to, "{seconds}s"),
            Split::Bytes(bytes) => write!(to, "{}kB", *bytes as f64 / 1e3),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_sizes_have_units() {
        let of = |text: &str| text.parse::<Split>();
        let seconds = ["45", "45s", "10m", "1.5h", "1"].map(|text| of(text).unwrap());
        assert_eq!(seconds, [45.0, 45.0, 600.0, 5400.0, 1.0].map(Split::Seconds));
        let bytes = ["500MB", "100kB", "1.5GB"].map(|text| of(text).unwrap());
        assert_eq!(bytes, [500_000_000, 100_000, 1_500_000_000].map(Split::Bytes));
        for wrong in ["", "m", "0.5s", "10 m", "-1h", "nanm", "infs", "5MiB", "10min", "9kB", "1e400h"] {
            assert!(of(wrong).is_err(), "{wrong:?} was taken");
        }
        for split in seconds.into_iter().chain(bytes) {
            assert_eq!(of(&split.to_string()), Ok(split), "{split} is read as it is written");
        }
    }
}
