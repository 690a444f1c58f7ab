//! Specification of the faults: presets by name, or a TOML file.
//!
//! ```toml
//! format = "vitreo-faults-1"
//! [dropped]             # a section switches its fault on; a key that is left out has its default
//! rate = 0.02           # probability for each field of each camera
//! cameras = [0, 2]      # empty or left out: all
//! ```

use super::FaultEvent;
use anyhow::{Result, anyhow, ensure};
use protocol::file::{MAX_SETTINGS_BYTES, other_format, other_format_in, read_text};
use protocol::limits::MAX_CAMERAS;
use protocol::parse_error;
use rig::Rig;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::path::Path;

/// Format key of the files.
pub const FORMAT: &str = "vitreo-faults-1";
/// Longest delay of a field, ms.
pub const MAX_DELAY_MS: f64 = 500.0;
/// Longest episode, fields.
pub const MAX_RUN: u32 = 500;
/// Most hot pixels of a camera.
pub const MAX_HOT: u32 = 10_000;

/// A preset that there is not: wrong use, not a failure.
#[derive(Debug, thiserror::Error)]
#[error("--faults: expected a file name ending in .toml or one or more of {known}, found '{found}'")]
pub struct UnknownPreset {
    /// Every preset.
    known: String,
    /// What was asked for.
    found: String,
}

/// Presets of several faults: name and text.
const MIXTURES: [(&str, &str); 3] = [
    ("none", "format = \"vitreo-faults-1\""),
    ("mild", include_str!("../../../../assets/faults/mild.toml")),
    ("hard", include_str!("../../../../assets/faults/hard.toml")),
];

/// Declares the faults: of each its section of the file, its kind and its name, and every key with
/// its default, its range, and its unit in messages (with a space before it).
macro_rules! faults {
    ($($(#[$doc:meta])* $section:ident: $kind:ident = $name:literal {
        $($(#[$key_doc:meta])* $key:ident: $number:ty = $default:expr, $range:expr, $unit:literal;)*
    })*) => {
        /// Kind of fault.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum FaultKind {
            $($(#[$doc])* $kind,)*
        }

        impl FaultKind {
            /// Every kind, in the order of its number.
            pub const ALL: [FaultKind; [$($name),*].len()] = [$(FaultKind::$kind),*];

            /// Name in fault files, logs and on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(FaultKind::$kind => $name,)*
                }
            }
        }

        impl FaultEvent {
            /// Kind of the fault.
            pub fn kind(&self) -> FaultKind {
                match self {
                    $(FaultEvent::$kind { .. } => FaultKind::$kind,)*
                }
            }
        }

        $(
            $(#[$doc])*
            #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
            #[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
            pub struct $kind {
                $($(#[$key_doc])* pub $key: $number,)*
                /// Ids of the cameras that have the fault; empty: all.
                pub cameras: Vec<u32>,
            }

            impl Default for $kind {
                fn default() -> Self {
                    $kind { $($key: $default,)* cameras: Vec::new() }
                }
            }
        )*

        /// Faults with their parameters; a section that is `None` is off.
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, rename_all = "kebab-case")]
        pub struct FaultSpec {
            /// Format key.
            pub format: String,
            $($(#[$doc])* pub $section: Option<$kind>,)*
        }

        impl FaultSpec {
            /// One fault with the defaults of its keys.
            fn single(name: &str) -> Option<Self> {
                match name {
                    $($name => Some(FaultSpec { $section: Some($kind::default()), ..Self::empty() }),)*
                    _ => None,
                }
            }

            /// Replaces the sections that `other` has.
            fn merge(&mut self, other: FaultSpec) {
                $(self.$section = other.$section.or(self.$section.take());)*
            }

            /// Cameras that a fault is limited to; empty for all cameras and for a fault that is
            /// off.
            pub fn cameras(&self, kind: FaultKind) -> &[u32] {
                match kind {
                    $(FaultKind::$kind => self.$section.as_ref().map_or(&[], |s| &s.cameras),)*
                }
            }

            /// Refuses the first number that is out of its range.
            fn check_numbers(&self, file: &str) -> Result<()> {
                $(if let Some(section) = &self.$section {
                    $(check_number(file, $name, stringify!($key), section.$key.into(), $range, $unit)?;)*
                })*
                Ok(())
            }
        }
    };
}

faults! {
    /// A field is not sent.
    dropped: Dropped = "dropped" {
        /// Probability for each field.
        rate: f64 = 0.05, 0.0..=1.0, "";
    }

    /// A field is sent late.
    late: Late = "late" {
        /// Probability for each field.
        rate: f64 = 0.05, 0.0..=1.0, "";
        /// Longest delay, ms; delays are uniform from 0 to it.
        delay_ms: f64 = 15.0, 0.0..=MAX_DELAY_MS, " ms";
    }

    /// The lower lines of a field are those of the previous one, or lines are missing.
    torn: Torn = "torn" {
        /// Probability for each field.
        rate: f64 = 0.03, 0.0..=1.0, "";
    }

    /// Single pixels are bright in every field, at the same places.
    hot_pixels: HotPixels = "hot-pixels" {
        /// Number of hot pixels.
        count: u32 = 60, 0.0..=MAX_HOT.into(), "";
    }

    /// A mains lamp whose light beats against the exposure.
    flicker: Flicker = "flicker" {
        /// Amplitude of the light as a share of its mean.
        depth: f64 = 0.2, 0.0..=1.0, "";
        /// Frequency of the light, Hz: twice the mains'.
        hz: f64 = 100.7, 0.0..=1e4, " Hz";
    }

    /// A shiny surface shows a second image of a marker, which moves around it.
    reflections: Reflections = "reflections" {
        /// Probability, for each field, that an episode begins.
        rate: f64 = 0.01, 0.0..=1.0, "";
        /// Longest episode, fields.
        fields: u32 = 40, 1.0..=MAX_RUN.into(), "";
        /// Light of the ghost as a share of the marker's.
        brightness: f64 = 0.8, 0.0..=10.0, "";
        /// Size of the ghost as a share of the marker's.
        size: f64 = 0.7, 0.05..=5.0, "";
    }

    /// A marker is overexposed.
    saturated: Saturated = "saturated" {
        /// Probability, for each field, that an episode begins.
        rate: f64 = 0.01, 0.0..=1.0, "";
        /// Longest episode, fields.
        fields: u32 = 25, 1.0..=MAX_RUN.into(), "";
        /// Brightness of the marker as a multiple of the usual one.
        brightness: f64 = 3.0, 1.0..=100.0, "";
    }

    /// Hue and gain of chroma oscillate slowly.
    colour_drift: ColourDrift = "colour-drift" {
        /// Amplitude of the hue, degrees.
        hue_deg: f64 = 8.0, 0.0..=180.0, " degrees";
        /// Amplitude of the chroma gain.
        gain: f64 = 0.15, 0.0..=1.0, "";
        /// Period, s.
        period_s: f64 = 30.0, 0.1..=1e6, " s";
    }

    /// Markers of one body are hidden from a camera.
    occlusion: Occlusion = "occlusion" {
        /// Probability, for each field, that an episode begins.
        rate: f64 = 0.01, 0.0..=1.0, "";
        /// Longest episode, fields.
        fields: u32 = 20, 1.0..=MAX_RUN.into(), "";
    }

    /// Each camera runs on a clock of its own.
    clock_drift: ClockDrift = "clock-drift" {
        /// Largest error of a clock's period, parts per million.
        ppm: f64 = 100.0, 0.0..=10_000.0, "";
        /// Latest first exposure, ms.
        phase_ms: f64 = 20.0, 0.0..=1000.0, " ms";
    }
}

impl FaultSpec {
    /// A specification without faults.
    fn empty() -> Self {
        FaultSpec { format: FORMAT.into(), ..FaultSpec::default() }
    }

    /// Reads presets (comma-separated; a later one replaces sections of an earlier one) or a file
    /// whose name ends in `.toml`.
    ///
    /// # Errors
    /// An unknown preset, or a file that cannot be read; otherwise as [`FaultSpec::parse`].
    pub fn load(text: &str) -> Result<Self> {
        if text.ends_with(".toml") {
            let read = read_text(Path::new(text), MAX_SETTINGS_BYTES);
            let read = read.map_err(|e| anyhow!("fault file {text}: {e}"))?;
            return Self::parse(&read, text);
        }
        let mut all = Self::empty();
        for name in text.split(',').map(str::trim) {
            all.merge(Self::preset(name)?);
        }
        Ok(all)
    }

    /// Names of all presets.
    pub fn presets() -> impl Iterator<Item = &'static str> {
        MIXTURES.iter().map(|(name, _)| *name).chain(FaultKind::ALL.into_iter().map(FaultKind::name))
    }

    fn preset(name: &str) -> Result<Self> {
        if let Some((name, text)) = MIXTURES.iter().find(|(known, _)| *known == name) {
            return Self::parse(text, name);
        }
        let known = || Self::presets().collect::<Vec<_>>().join(", ");
        Ok(Self::single(name).ok_or_else(|| UnknownPreset { known: known(), found: name.into() })?)
    }

    /// Parses and checks the text of a fault file; `file` is its name in error messages.
    ///
    /// # Errors
    /// A text that is not TOML of this format, or a value out of range.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let refused = |found| anyhow!("fault file {file}: format: expected {FORMAT}, found {found}");
        let spec: FaultSpec = toml::from_str(text).map_err(|e| {
            other_format_in(text, FORMAT)
                .map_or_else(|| anyhow!("fault file {file}, {}", parse_error::toml(text, &e)), refused)
        })?;
        other_format(&spec.format, FORMAT).map_or(Ok(()), |found| Err(refused(found)))?;
        spec.check_numbers(file)?;
        let expected = format!("ids of 0 to {}", MAX_CAMERAS - 1);
        spec.check_cameras(file, &expected, |id| (id as usize) < MAX_CAMERAS)?;
        Ok(spec)
    }

    /// Checks that the rig has every camera named.
    ///
    /// # Errors
    /// The first id that the rig does not have.
    pub fn check_rig(&self, rig: &Rig) -> Result<()> {
        let ids = rig.cameras.iter().map(|c| c.id.to_string()).collect::<Vec<_>>();
        let known = |id: u32| rig.cameras.iter().any(|c| c.id == id);
        self.check_cameras("for this rig", &format!("some of {}", ids.join(", ")), known)
    }

    /// Refuses the first camera that is not `known`.
    fn check_cameras(&self, file: &str, expected: &str, known: impl Fn(u32) -> bool) -> Result<()> {
        for kind in FaultKind::ALL {
            for &id in self.cameras(kind) {
                let name = kind.name();
                ensure!(known(id), "fault file {file}: [{name}] cameras: expected {expected}, found {id}");
            }
        }
        Ok(())
    }
}

fn check_number(
    file: &str,
    section: &str,
    key: &str,
    value: f64,
    range: RangeInclusive<f64>,
    unit: &str,
) -> Result<()> {
    let (key, least, most) = (key.replace('_', "-"), range.start(), range.end());
    ensure!(
        range.contains(&value),
        "fault file {file}: [{section}] {key}: expected {least} to {most}{unit}, found {value}"
    );
    Ok(())
}
