//! Specification of the faults: presets by name, or a TOML file.
//!
//! ```toml
//! format = "vitreo-faults-1"
//! [dropped]             # a section switches its fault on; a key that is left out has its default
//! rate = 0.02           # probability for each field of each camera
//! cameras = [0, 2]      # empty or left out: all
//! ```

use super::FaultKind;
use protocol::limits::MAX_CAMERAS;
use protocol::rig::Rig;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Format key of the files.
pub const FORMAT: &str = "vitreo-faults-1";
/// Longest delay of a field, ms.
pub const MAX_DELAY_MS: f64 = 500.0;
/// Longest episode, fields.
pub const MAX_RUN: u32 = 500;
/// Most hot pixels of a camera.
pub const MAX_HOT: u32 = 10_000;

/// Presets of several faults: name and text.
const MIXTURES: [(&str, &str); 3] = [
    ("none", "format = \"vitreo-faults-1\""),
    ("mild", include_str!("../../../assets/faults/mild.toml")),
    ("hard", include_str!("../../../assets/faults/hard.toml")),
];

/// A specification was refused.
#[derive(Debug, thiserror::Error)]
pub enum FaultError {
    /// No preset of this name.
    #[error("--faults: expected a file name ending in .toml or some of {known}, found '{found}'")]
    Unknown {
        /// Names of the presets.
        known: String,
        /// The name given.
        found: String,
    },
    /// The file cannot be read.
    #[error("fault file {file}: {source}")]
    Read {
        /// The file.
        file: String,
        /// Cause.
        source: std::io::Error,
    },
    /// The file is not TOML of this format.
    #[error("fault file {file}: {source}")]
    Parse {
        /// The file.
        file: String,
        /// Cause, with the line.
        source: Box<toml::de::Error>,
    },
    /// A value is out of range.
    #[error("fault file {file}: {key}: expected {expected}, found {found}")]
    Value {
        /// The file.
        file: String,
        /// Section and key.
        key: String,
        /// Expected values.
        expected: String,
        /// Value found.
        found: String,
    },
}

/// Declares a section of the file with the defaults of its keys.
macro_rules! section {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty = $default:expr,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind,)*
            /// Ids of the cameras that have the fault; empty: all.
            pub cameras: Vec<u32>,
        }

        impl Default for $name {
            fn default() -> Self {
                $name { $($field: $default,)* cameras: Vec::new() }
            }
        }
    };
}

section! {
    /// A field is not sent.
    Dropped {
        /// Probability for each field.
        rate: f64 = 0.05,
    }
}

section! {
    /// A field is sent late.
    Late {
        /// Probability for each field.
        rate: f64 = 0.05,
        /// Longest delay, ms; delays are uniform from 0 to it.
        delay_ms: f64 = 15.0,
    }
}

section! {
    /// The lower lines of a field are those of the previous one, or lines are missing.
    Torn {
        /// Probability for each field.
        rate: f64 = 0.03,
    }
}

section! {
    /// Single pixels are bright in every field, at the same places.
    HotPixels {
        /// Number of hot pixels.
        count: u32 = 60,
    }
}

section! {
    /// A mains lamp whose light beats against the exposure.
    Flicker {
        /// Amplitude of the light as a share of its mean.
        depth: f64 = 0.2,
        /// Frequency of the light, Hz: twice the mains'.
        hz: f64 = 100.7,
    }
}

section! {
    /// A shiny surface shows a second image of a marker, which moves around it.
    Reflections {
        /// Probability, for each field, that an episode begins.
        rate: f64 = 0.01,
        /// Longest episode, fields.
        fields: u32 = 40,
        /// Light of the ghost as a share of the marker's.
        brightness: f64 = 0.8,
        /// Size of the ghost as a share of the marker's.
        size: f64 = 0.7,
    }
}

section! {
    /// A marker is overexposed.
    Saturated {
        /// Probability, for each field, that an episode begins.
        rate: f64 = 0.01,
        /// Longest episode, fields.
        fields: u32 = 25,
        /// Brightness of the marker as a multiple of the usual one.
        brightness: f64 = 3.0,
    }
}

section! {
    /// Hue and gain of chroma oscillate slowly.
    ColourDrift {
        /// Amplitude of the hue, degrees.
        hue_deg: f64 = 8.0,
        /// Amplitude of the chroma gain.
        gain: f64 = 0.15,
        /// Period, s.
        period_s: f64 = 30.0,
    }
}

section! {
    /// Markers of one body are hidden from a camera.
    Occlusion {
        /// Probability, for each field, that an episode begins.
        rate: f64 = 0.01,
        /// Longest episode, fields.
        fields: u32 = 20,
    }
}

section! {
    /// Each camera runs on a clock of its own.
    ClockDrift {
        /// Largest error of a clock's period, parts per million.
        ppm: f64 = 100.0,
        /// Latest first exposure, ms.
        phase_ms: f64 = 20.0,
    }
}

/// Faults with their parameters; a section that is `None` is off.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
#[allow(missing_docs)]
pub struct FaultSpec {
    pub format: String,
    pub dropped: Option<Dropped>,
    pub late: Option<Late>,
    pub torn: Option<Torn>,
    pub hot_pixels: Option<HotPixels>,
    pub flicker: Option<Flicker>,
    pub reflections: Option<Reflections>,
    pub saturated: Option<Saturated>,
    pub colour_drift: Option<ColourDrift>,
    pub occlusion: Option<Occlusion>,
    pub clock_drift: Option<ClockDrift>,
}

impl FaultSpec {
    /// Reads presets (comma-separated; a later one replaces sections of an earlier one) or a file
    /// whose name ends in `.toml`.
    ///
    /// # Errors
    /// [`FaultError::Unknown`] for an unknown preset, [`FaultError::Read`] where the file cannot be
    /// read; otherwise as [`FaultSpec::parse`].
    pub fn load(text: &str) -> Result<Self, FaultError> {
        if text.ends_with(".toml") {
            let read = std::fs::read_to_string(text);
            let read = read.map_err(|source| FaultError::Read { file: text.into(), source })?;
            return Self::parse(&read, text);
        }
        let mut all = FaultSpec { format: FORMAT.into(), ..FaultSpec::default() };
        for name in text.split(',').map(str::trim) {
            all.merge(Self::preset(name)?);
        }
        Ok(all)
    }

    /// Names of all presets.
    pub fn presets() -> impl Iterator<Item = &'static str> {
        MIXTURES.iter().map(|(name, _)| *name).chain(FaultKind::ALL.into_iter().map(FaultKind::name))
    }

    fn preset(name: &str) -> Result<Self, FaultError> {
        if let Some((name, text)) = MIXTURES.iter().find(|(known, _)| *known == name) {
            return Self::parse(text, name);
        }
        let known = || Self::presets().collect::<Vec<_>>().join(", ");
        let kind = FaultKind::ALL.into_iter().find(|k| k.name() == name);
        let kind = kind.ok_or_else(|| FaultError::Unknown { known: known(), found: name.into() })?;
        let mut spec = FaultSpec { format: FORMAT.into(), ..FaultSpec::default() };
        match kind {
            FaultKind::Dropped => spec.dropped = Some(Dropped::default()),
            FaultKind::Late => spec.late = Some(Late::default()),
            FaultKind::Torn => spec.torn = Some(Torn::default()),
            FaultKind::HotPixels => spec.hot_pixels = Some(HotPixels::default()),
            FaultKind::Flicker => spec.flicker = Some(Flicker::default()),
            FaultKind::Reflections => spec.reflections = Some(Reflections::default()),
            FaultKind::Saturated => spec.saturated = Some(Saturated::default()),
            FaultKind::ColourDrift => spec.colour_drift = Some(ColourDrift::default()),
            FaultKind::Occlusion => spec.occlusion = Some(Occlusion::default()),
            FaultKind::ClockDrift => spec.clock_drift = Some(ClockDrift::default()),
        }
        Ok(spec)
    }

    /// Replaces the sections that `other` has.
    fn merge(&mut self, other: FaultSpec) {
        macro_rules! each {
            ($($section:ident),*) => { $(self.$section = other.$section.or(self.$section.take());)* };
        }
        each!(
            dropped,
            late,
            torn,
            hot_pixels,
            flicker,
            reflections,
            saturated,
            colour_drift,
            occlusion,
            clock_drift
        );
    }

    /// Parses and checks the text of a fault file; `file` is its name in error messages.
    ///
    /// # Errors
    /// [`FaultError::Parse`] where the text is not TOML of this format, [`FaultError::Value`] where
    /// a value is out of range.
    pub fn parse(text: &str, file: &str) -> Result<Self, FaultError> {
        let spec: FaultSpec = toml::from_str(text)
            .map_err(|source| FaultError::Parse { file: file.into(), source: Box::new(source) })?;
        if spec.format != FORMAT {
            let (key, expected) = ("format".into(), FORMAT.into());
            return Err(FaultError::Value { file: file.into(), key, expected, found: spec.format });
        }
        spec.check(file)?;
        Ok(spec)
    }

    fn check(&self, file: &str) -> Result<(), FaultError> {
        for Number { kind, key, value, range, unit } in self.numbers() {
            if !range.contains(&value) {
                return Err(FaultError::Value {
                    file: file.into(),
                    key: format!("[{}] {key}", kind.name()),
                    expected: format!("{} to {}{unit}", range.start(), range.end()),
                    found: value.to_string(),
                });
            }
        }
        for kind in FaultKind::ALL {
            if let Some(id) = self.cameras(kind).iter().find(|&&id| id as usize >= MAX_CAMERAS) {
                return Err(FaultError::Value {
                    file: file.into(),
                    key: format!("[{}] cameras", kind.name()),
                    expected: format!("ids of 0 to {}", MAX_CAMERAS - 1),
                    found: id.to_string(),
                });
            }
        }
        Ok(())
    }

    /// Checks that the rig has every camera named.
    ///
    /// # Errors
    /// [`FaultError::Value`] with the first id that the rig does not have.
    pub fn check_rig(&self, rig: &Rig) -> Result<(), FaultError> {
        for kind in FaultKind::ALL {
            let unknown = |id: &&u32| !rig.cameras.iter().any(|c| c.id == **id);
            if let Some(id) = self.cameras(kind).iter().find(unknown) {
                let ids = rig.cameras.iter().map(|c| c.id.to_string()).collect::<Vec<_>>();
                return Err(FaultError::Value {
                    file: "for this rig".into(),
                    key: format!("[{}] cameras", kind.name()),
                    expected: format!("some of {}", ids.join(", ")),
                    found: id.to_string(),
                });
            }
        }
        Ok(())
    }

    /// Cameras that a fault is limited to; empty for all cameras and for a fault that is off.
    pub fn cameras(&self, kind: FaultKind) -> &[u32] {
        macro_rules! list {
            ($section:ident) => {
                self.$section.as_ref().map_or(&[][..], |s| &s.cameras)
            };
        }
        match kind {
            FaultKind::Dropped => list!(dropped),
            FaultKind::Late => list!(late),
            FaultKind::Torn => list!(torn),
            FaultKind::HotPixels => list!(hot_pixels),
            FaultKind::Flicker => list!(flicker),
            FaultKind::Reflections => list!(reflections),
            FaultKind::Saturated => list!(saturated),
            FaultKind::ColourDrift => list!(colour_drift),
            FaultKind::Occlusion => list!(occlusion),
            FaultKind::ClockDrift => list!(clock_drift),
        }
    }

    /// Every number with its range.
    fn numbers(&self) -> Vec<Number> {
        let mut all = Vec::new();
        let mut add = |kind, key, value: f64, range, unit| all.push(Number { kind, key, value, range, unit });
        let run = f64::from(MAX_RUN);
        if let Some(s) = &self.dropped {
            add(FaultKind::Dropped, "rate", s.rate, 0.0..=1.0, "");
        }
        if let Some(s) = &self.late {
            add(FaultKind::Late, "rate", s.rate, 0.0..=1.0, "");
            add(FaultKind::Late, "delay-ms", s.delay_ms, 0.0..=MAX_DELAY_MS, " ms");
        }
        if let Some(s) = &self.torn {
            add(FaultKind::Torn, "rate", s.rate, 0.0..=1.0, "");
        }
        if let Some(s) = &self.hot_pixels {
            add(FaultKind::HotPixels, "count", s.count.into(), 0.0..=MAX_HOT.into(), "");
        }
        if let Some(s) = &self.flicker {
            add(FaultKind::Flicker, "depth", s.depth, 0.0..=1.0, "");
            add(FaultKind::Flicker, "hz", s.hz, 0.0..=1e4, " Hz");
        }
        if let Some(s) = &self.reflections {
            add(FaultKind::Reflections, "rate", s.rate, 0.0..=1.0, "");
            add(FaultKind::Reflections, "fields", s.fields.into(), 1.0..=run, "");
            add(FaultKind::Reflections, "brightness", s.brightness, 0.0..=10.0, "");
            add(FaultKind::Reflections, "size", s.size, 0.05..=5.0, "");
        }
        if let Some(s) = &self.saturated {
            add(FaultKind::Saturated, "rate", s.rate, 0.0..=1.0, "");
            add(FaultKind::Saturated, "fields", s.fields.into(), 1.0..=run, "");
            add(FaultKind::Saturated, "brightness", s.brightness, 1.0..=100.0, "");
        }
        if let Some(s) = &self.colour_drift {
            add(FaultKind::ColourDrift, "hue-deg", s.hue_deg, 0.0..=180.0, " degrees");
            add(FaultKind::ColourDrift, "gain", s.gain, 0.0..=1.0, "");
            add(FaultKind::ColourDrift, "period-s", s.period_s, 0.1..=1e6, " s");
        }
        if let Some(s) = &self.occlusion {
            add(FaultKind::Occlusion, "rate", s.rate, 0.0..=1.0, "");
            add(FaultKind::Occlusion, "fields", s.fields.into(), 1.0..=run, "");
        }
        if let Some(s) = &self.clock_drift {
            add(FaultKind::ClockDrift, "ppm", s.ppm, 0.0..=10_000.0, "");
            add(FaultKind::ClockDrift, "phase-ms", s.phase_ms, 0.0..=1000.0, " ms");
        }
        all
    }
}

/// A number of the file.
struct Number {
    kind: FaultKind,
    key: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    /// Unit in messages, with a space before it.
    unit: &'static str,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        FaultSpec::parse(&format!("format = \"{FORMAT}\"\n{text}"), "f.toml").unwrap_err().to_string()
    }

    #[test]
    fn every_preset_is_in_order_and_says_what_its_name_says() {
        let rig = Rig::load_or_shipped(None).unwrap();
        for name in FaultSpec::presets() {
            let spec = FaultSpec::load(name).unwrap();
            spec.check(name).unwrap();
            spec.check_rig(&rig).unwrap();
            let back = FaultSpec::parse(&toml::to_string(&spec).unwrap(), name).unwrap();
            assert_eq!(back, spec);
        }
        assert_eq!(
            FaultSpec::load("none").unwrap(),
            FaultSpec { format: FORMAT.into(), ..FaultSpec::default() }
        );
        let hard = FaultSpec::load("hard").unwrap();
        assert!(hard.dropped.is_some() && hard.clock_drift.is_some() && hard.hot_pixels.is_some());
    }

    #[test]
    fn presets_add_up_and_the_later_one_wins() {
        let both = FaultSpec::load("late, mild,dropped").unwrap();
        assert_eq!(both.dropped, Some(Dropped::default()));
        let mild = FaultSpec::load("mild").unwrap();
        assert_eq!(both.late, mild.late.clone().or(Some(Late::default())));
        assert_eq!(both.flicker, mild.flicker);
    }

    #[test]
    fn left_out_keys_have_defaults_and_cameras_are_kept() {
        let text = format!("format = \"{FORMAT}\"\n[late]\ndelay-ms = 3.5\ncameras = [1]\n[torn]\n");
        let spec = FaultSpec::parse(&text, "f").unwrap();
        assert_eq!(spec.late, Some(Late { delay_ms: 3.5, cameras: vec![1], ..Late::default() }));
        assert_eq!((spec.torn, spec.dropped), (Some(Torn::default()), None));
    }

    #[test]
    fn nonsense_is_refused_with_what_was_expected() {
        for (text, parts) in [
            ("[dropt]", &["dropt", "line 2"][..]),
            ("[late]\ndelay = 3", &["delay", "line 3", "delay-ms"]),
            ("[late]\ndelay-ms = 900", &["[late] delay-ms", "0 to 500 ms", "900"]),
            ("[dropped]\nrate = nan", &["[dropped] rate", "0 to 1", "NaN"]),
            ("[dropped]\nrate = -0.1", &["[dropped] rate", "-0.1"]),
            ("[occlusion]\nfields = 0", &["[occlusion] fields", "1 to 500"]),
            ("[torn]\ncameras = [9]", &["[torn] cameras", "0 to 7", "9"]),
            ("[hot-pixels]\ncount = -3", &["line 3"]),
        ] {
            let message = refused(text);
            assert!(message.contains("f.toml") && parts.iter().all(|p| message.contains(p)), "{message}");
        }
        let old = FaultSpec::parse("format = \"vitreo-faults-0\"", "f").unwrap_err().to_string();
        assert!(old.contains(FORMAT) && old.contains("vitreo-faults-0"), "{old}");
        let name = FaultSpec::load("dropped,lost").unwrap_err().to_string();
        assert!(name.contains("'lost'") && name.contains("clock-drift"), "{name}");
        let file = FaultSpec::load("/nowhere/f.toml").unwrap_err().to_string();
        assert!(file.contains("/nowhere/f.toml"), "{file}");
        let rig = Rig::load_or_shipped(None).unwrap();
        let text = format!("format = \"{FORMAT}\"\n[late]\ncameras = [5]");
        let other = FaultSpec::parse(&text, "f").unwrap().check_rig(&rig).unwrap_err().to_string();
        assert!(
            other.contains("[late] cameras") && other.contains("0, 1, 2") && other.contains('5'),
            "{other}"
        );
    }
}
