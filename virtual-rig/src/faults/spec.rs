//! What shall go wrong: presets by name, or a TOML file.
//!
//! ```toml
//! format = "vitreo-faults-1"
//! [dropped]             # a section switches its fault on; a key that is left out has its default
//! rate = 0.02           # chance for each field of each camera
//! cameras = [0, 2]      # empty or left out: all
//! ```

use super::Kind;
use protocol::limits::MAX_CAMERAS;
use protocol::rig::Rig;
use serde::{Deserialize, Serialize};

/// The one format this build reads.
pub const FORMAT: &str = "vitreo-faults-1";
/// Longest delay of a field, ms.
pub const MAX_DELAY_MS: f64 = 500.0;
/// Most fields that one event lasts.
pub const MAX_RUN: u32 = 500;
/// Most hot pixels of a camera.
pub const MAX_HOT: u32 = 10_000;

/// Several faults under one name.
const MIXTURES: [(&str, &str); 3] = [
    ("none", "format = \"vitreo-faults-1\""),
    ("mild", include_str!("../../../assets/faults/mild.toml")),
    ("hard", include_str!("../../../assets/faults/hard.toml")),
];

/// Why faults were refused.
#[derive(Debug, thiserror::Error)]
pub enum FaultError {
    /// No preset of this name.
    #[error("--faults: expected a file name ending in .toml or some of {known}, found '{found}'")]
    Unknown {
        /// What there is.
        known: String,
        /// What was asked for.
        found: String,
    },
    /// The file cannot be read.
    #[error("fault file {file}: {source}")]
    Read {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// Not in this form; the message has the line.
    #[error("fault file {file}: {source}")]
    Parse {
        /// The file.
        file: String,
        /// Why, with the line.
        source: Box<toml::de::Error>,
    },
    /// A value makes no sense.
    #[error("fault file {file}: {key}: expected {expected}, found {found}")]
    Value {
        /// The file.
        file: String,
        /// Section and key.
        key: String,
        /// What would be right.
        expected: String,
        /// What is there.
        found: String,
    },
}

/// A section that can be left out, with its defaults.
macro_rules! section {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:ty = $default:expr,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind,)*
            /// Cameras it may happen to; empty: all.
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
    /// A field that never comes.
    Dropped {
        /// Chance for each field.
        rate: f64 = 0.05,
    }
}

section! {
    /// A field whose blobs come late.
    Late {
        /// Chance for each field.
        rate: f64 = 0.05,
        /// Longest delay, ms; delays are spread evenly from 0 on.
        delay_ms: f64 = 15.0,
    }
}

section! {
    /// A field whose lower lines are those of the field before, or in which lines are missing.
    Torn {
        /// Chance for each field.
        rate: f64 = 0.03,
    }
}

section! {
    /// Single pixels that are always bright, at the same places as long as the camera lives.
    HotPixels {
        /// So many in each field.
        count: u32 = 60,
    }
}

section! {
    /// A mains lamp whose light beats against the exposure.
    Flicker {
        /// Swing of the light as a share of its mean.
        depth: f64 = 0.2,
        /// Frequency of the light, Hz: twice the mains'.
        hz: f64 = 100.7,
    }
}

section! {
    /// A shiny surface shows a marker twice; the twin moves about.
    Reflections {
        /// Chance for each field that one begins.
        rate: f64 = 0.01,
        /// Most fields that one lasts.
        fields: u32 = 40,
        /// Light of the twin as a share of the marker's.
        brightness: f64 = 0.8,
        /// Size of the twin as a share of the marker's.
        size: f64 = 0.7,
    }
}

section! {
    /// A marker that glares.
    Saturated {
        /// Chance for each field that it begins.
        rate: f64 = 0.01,
        /// Most fields that it lasts.
        fields: u32 = 25,
        /// Light on the marker as a multiple of what it should be.
        brightness: f64 = 3.0,
    }
}

section! {
    /// Colours that slowly turn and fade, and come back.
    ColourDrift {
        /// Largest turn of the hue, degrees.
        hue_deg: f64 = 8.0,
        /// Largest change of chroma's gain.
        gain: f64 = 0.15,
        /// Time of a round, s.
        period_s: f64 = 30.0,
    }
}

section! {
    /// Something gets between a camera and markers of one body.
    Occlusion {
        /// Chance for each field that it begins.
        rate: f64 = 0.01,
        /// Most fields that it lasts.
        fields: u32 = 20,
    }
}

section! {
    /// Cameras that run on clocks of their own.
    ClockDrift {
        /// Largest error of a clock, parts per million.
        ppm: f64 = 100.0,
        /// Latest first exposure, ms.
        phase_ms: f64 = 20.0,
    }
}

/// What shall go wrong.
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
    /// Presets (comma-separated; a later one replaces sections of an earlier one) or a file that ends
    /// in `.toml`.
    pub fn load(text: &str) -> Result<Self, FaultError> {
        if text.ends_with(".toml") {
            let read = std::fs::read_to_string(text);
            let read = read.map_err(|source| FaultError::Read { file: text.into(), source })?;
            return Self::parse(&read, text);
        }
        let mut all = FaultSpec { format: FORMAT.into(), ..FaultSpec::default() };
        for name in text.split(',').map(str::trim) {
            all.take(Self::preset(name)?);
        }
        Ok(all)
    }

    /// Names of all presets.
    pub fn presets() -> impl Iterator<Item = &'static str> {
        MIXTURES.iter().map(|(name, _)| *name).chain(Kind::ALL.into_iter().map(Kind::name))
    }

    fn preset(name: &str) -> Result<Self, FaultError> {
        if let Some((name, text)) = MIXTURES.iter().find(|(known, _)| *known == name) {
            return Self::parse(text, name);
        }
        let known = || Self::presets().collect::<Vec<_>>().join(", ");
        let kind = Kind::ALL.into_iter().find(|k| k.name() == name);
        let kind = kind.ok_or_else(|| FaultError::Unknown { known: known(), found: name.into() })?;
        let mut spec = FaultSpec { format: FORMAT.into(), ..FaultSpec::default() };
        match kind {
            Kind::Dropped => spec.dropped = Some(Dropped::default()),
            Kind::Late => spec.late = Some(Late::default()),
            Kind::Torn => spec.torn = Some(Torn::default()),
            Kind::HotPixels => spec.hot_pixels = Some(HotPixels::default()),
            Kind::Flicker => spec.flicker = Some(Flicker::default()),
            Kind::Reflections => spec.reflections = Some(Reflections::default()),
            Kind::Saturated => spec.saturated = Some(Saturated::default()),
            Kind::ColourDrift => spec.colour_drift = Some(ColourDrift::default()),
            Kind::Occlusion => spec.occlusion = Some(Occlusion::default()),
            Kind::ClockDrift => spec.clock_drift = Some(ClockDrift::default()),
        }
        Ok(spec)
    }

    /// Takes the sections of another one.
    fn take(&mut self, other: FaultSpec) {
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

    /// Parses and checks the text of a fault file; `file` is for error messages.
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
        for (kind, key, value, range, unit) in self.numbers() {
            if !range.contains(&value) {
                return Err(FaultError::Value {
                    file: file.into(),
                    key: format!("[{}] {key}", kind.name()),
                    expected: format!("{} to {}{unit}", range.start(), range.end()),
                    found: value.to_string(),
                });
            }
        }
        for kind in Kind::ALL {
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

    /// Refuses cameras that the rig has not.
    pub fn check_rig(&self, rig: &Rig) -> Result<(), FaultError> {
        for kind in Kind::ALL {
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

    /// Cameras a fault is limited to; empty for all and for a fault that is not there.
    pub fn cameras(&self, kind: Kind) -> &[u32] {
        macro_rules! list {
            ($section:ident) => {
                self.$section.as_ref().map_or(&[][..], |s| &s.cameras)
            };
        }
        match kind {
            Kind::Dropped => list!(dropped),
            Kind::Late => list!(late),
            Kind::Torn => list!(torn),
            Kind::HotPixels => list!(hot_pixels),
            Kind::Flicker => list!(flicker),
            Kind::Reflections => list!(reflections),
            Kind::Saturated => list!(saturated),
            Kind::ColourDrift => list!(colour_drift),
            Kind::Occlusion => list!(occlusion),
            Kind::ClockDrift => list!(clock_drift),
        }
    }

    /// Every number with what it may be.
    fn numbers(&self) -> Vec<Number> {
        let mut all = Vec::new();
        let mut add = |kind, key, value: f64, least: f64, most: f64, unit| {
            all.push((kind, key, value, least..=most, unit));
        };
        let run = f64::from(MAX_RUN);
        if let Some(s) = &self.dropped {
            add(Kind::Dropped, "rate", s.rate, 0.0, 1.0, "");
        }
        if let Some(s) = &self.late {
            add(Kind::Late, "rate", s.rate, 0.0, 1.0, "");
            add(Kind::Late, "delay-ms", s.delay_ms, 0.0, MAX_DELAY_MS, " ms");
        }
        if let Some(s) = &self.torn {
            add(Kind::Torn, "rate", s.rate, 0.0, 1.0, "");
        }
        if let Some(s) = &self.hot_pixels {
            add(Kind::HotPixels, "count", s.count.into(), 0.0, MAX_HOT.into(), "");
        }
        if let Some(s) = &self.flicker {
            add(Kind::Flicker, "depth", s.depth, 0.0, 1.0, "");
            add(Kind::Flicker, "hz", s.hz, 0.0, 1e4, " Hz");
        }
        if let Some(s) = &self.reflections {
            add(Kind::Reflections, "rate", s.rate, 0.0, 1.0, "");
            add(Kind::Reflections, "fields", s.fields.into(), 1.0, run, "");
            add(Kind::Reflections, "brightness", s.brightness, 0.0, 10.0, "");
            add(Kind::Reflections, "size", s.size, 0.05, 5.0, "");
        }
        if let Some(s) = &self.saturated {
            add(Kind::Saturated, "rate", s.rate, 0.0, 1.0, "");
            add(Kind::Saturated, "fields", s.fields.into(), 1.0, run, "");
            add(Kind::Saturated, "brightness", s.brightness, 1.0, 100.0, "");
        }
        if let Some(s) = &self.colour_drift {
            add(Kind::ColourDrift, "hue-deg", s.hue_deg, 0.0, 180.0, " degrees");
            add(Kind::ColourDrift, "gain", s.gain, 0.0, 1.0, "");
            add(Kind::ColourDrift, "period-s", s.period_s, 0.1, 1e6, " s");
        }
        if let Some(s) = &self.occlusion {
            add(Kind::Occlusion, "rate", s.rate, 0.0, 1.0, "");
            add(Kind::Occlusion, "fields", s.fields.into(), 1.0, run, "");
        }
        if let Some(s) = &self.clock_drift {
            add(Kind::ClockDrift, "ppm", s.ppm, 0.0, 10_000.0, "");
            add(Kind::ClockDrift, "phase-ms", s.phase_ms, 0.0, 1000.0, " ms");
        }
        all
    }
}

/// Fault, key, value, what it may be, unit.
type Number = (Kind, &'static str, f64, std::ops::RangeInclusive<f64>, &'static str);

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
