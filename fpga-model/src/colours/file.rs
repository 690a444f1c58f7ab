//! Files of colour classes (`vitreo-colours-1`): references, tolerances and thresholds.

use super::{CLASSES, Class, ColourTable};
use crate::scan::Settings;
use crate::scan::background::Level;
use protocol::blobs::Colour;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Format key of a file.
const FORMAT: &str = "vitreo-colours-1";
/// Longest file, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// The shipped classes.
pub const SHIPPED: &str = include_str!("../../../assets/colours.toml");

/// A file was refused.
#[derive(Debug, thiserror::Error)]
pub enum ColourFileError {
    /// It cannot be read.
    #[error("{file}: {source}")]
    Read {
        /// The file.
        file: String,
        /// Cause.
        source: std::io::Error,
    },
    /// It is not TOML, has an unknown key, or lacks one.
    #[error("{file}: {source}")]
    Toml {
        /// The file.
        file: String,
        /// Cause, with the line.
        source: Box<toml::de::Error>,
    },
    /// A value is out of range.
    #[error("{file}: {key}: {problem}")]
    Value {
        /// The file.
        file: String,
        /// The key.
        key: String,
        /// Expected and found values.
        problem: String,
    },
}

/// Content of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColourFile {
    format: String,
    /// Luma of black.
    pub black: u8,
    /// Grey levels above the background of every pixel of a blob.
    pub low: u8,
    /// Grey levels above the background of the brightest pixel of a coloured blob.
    pub high: u8,
    /// The same for white.
    pub high_white: u8,
    #[serde(rename = "class")]
    classes: Vec<ClassEntry>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClassEntry {
    colour: Colour,
    reference: [u8; 3],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    least_chroma: Option<u8>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tolerance_deg: Option<f64>,
}

impl ColourFile {
    /// Classes with the levels of the shipped file.
    pub fn of_classes(classes: &[Class]) -> Self {
        let entry = |class: &Class| {
            let coloured = class.colour != Colour::White;
            ClassEntry {
                colour: class.colour,
                reference: class.reference,
                least_chroma: coloured.then_some(class.least_chroma),
                tolerance_deg: coloured.then_some(class.tolerance_deg),
            }
        };
        let shipped = Self::parse(SHIPPED, "shipped colours").expect("checked by a test");
        ColourFile { classes: classes.iter().map(entry).collect(), ..shipped }
    }

    /// Reads a file, or the shipped classes where none is named.
    ///
    /// # Errors
    /// [`ColourFileError::Read`] where the file cannot be read or is too long; otherwise as
    /// [`ColourFile::parse`].
    pub fn load_or_shipped(path: Option<&Path>) -> Result<Self, ColourFileError> {
        let Some(path) = path else { return Self::parse(SHIPPED, "shipped colours") };
        let file = path.display().to_string();
        let read = || {
            let length = std::fs::metadata(path)?.len();
            if length > MAX_BYTES {
                let problem = format!("expected at most {MAX_BYTES} bytes, found {length}");
                return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, problem));
            }
            std::fs::read_to_string(path)
        };
        let text = read().map_err(|source| ColourFileError::Read { file: file.clone(), source })?;
        Self::parse(&text, &file)
    }

    /// Parses a text; `file` is its name in messages.
    ///
    /// # Errors
    /// [`ColourFileError::Toml`] where the text is not TOML of this format,
    /// [`ColourFileError::Value`] where a value is out of range.
    pub fn parse(text: &str, file: &str) -> Result<Self, ColourFileError> {
        let parsed: ColourFile = toml::from_str(text)
            .map_err(|e| ColourFileError::Toml { file: file.into(), source: Box::new(e) })?;
        match parsed.defect() {
            None => Ok(parsed),
            Some((key, problem)) => Err(ColourFileError::Value { file: file.into(), key, problem }),
        }
    }

    fn defect(&self) -> Option<(String, String)> {
        let refuse = |key: &str, problem: String| Some((key.to_owned(), problem));
        if self.format != FORMAT {
            return refuse("format", format!("expected {FORMAT:?}, found {:?}", self.format));
        }
        if self.low == 0 {
            return refuse("low", "expected at least 1, found 0".into());
        }
        if self.high < self.low || self.high_white < self.low {
            let found = self.high.min(self.high_white);
            return refuse(
                "high, high_white",
                format!("expected at least low = {}, found {found}", self.low),
            );
        }
        if self.classes.is_empty() {
            return refuse("class", "expected at least one class, found none".into());
        }
        for (i, entry) in self.classes.iter().enumerate() {
            let name = entry.colour.name();
            if self.classes[..i].iter().any(|other| other.colour == entry.colour) {
                return refuse("class", format!("expected each colour once, found {name} twice"));
            }
            if let Some((key, problem)) = entry.defect(self.black) {
                return refuse(&format!("class {name}, {key}"), problem);
            }
        }
        None
    }

    /// The classes.
    pub fn classes(&self) -> Vec<Class> {
        self.classes.iter().map(ClassEntry::class).collect()
    }

    /// The look-up table.
    pub fn table(&self) -> ColourTable {
        ColourTable::of_classes(&self.classes())
    }

    /// Puts classes and thresholds into the settings of a scanner. Other classes never count.
    pub fn apply(&self, settings: &mut Settings) {
        settings.colours = self.table();
        settings.level = Level::Fixed(self.black);
        settings.low = self.low;
        settings.high = [u8::MAX; CLASSES];
        for entry in &self.classes {
            let white = entry.colour == Colour::White;
            settings.high[entry.colour as usize] = if white { self.high_white } else { self.high };
        }
    }

    /// The text that [`ColourFile::parse`] reads.
    pub fn text(&self) -> String {
        toml::to_string(self).expect("numbers and names only")
    }
}

impl ClassEntry {
    fn class(&self) -> Class {
        Class {
            colour: self.colour,
            reference: self.reference,
            least_chroma: self.least_chroma.unwrap_or(0),
            tolerance_deg: self.tolerance_deg.unwrap_or(0.0),
        }
    }

    fn defect(&self, black: u8) -> Option<(&'static str, String)> {
        let [y, cb, cr] = self.reference;
        if y <= black {
            return Some(("reference", format!("expected a luma above black = {black}, found {y}")));
        }
        if self.colour == Colour::White {
            let key = match (self.least_chroma, self.tolerance_deg) {
                (None, None) => return None,
                (Some(_), _) => "least_chroma",
                _ => "tolerance_deg",
            };
            return Some((key, "expected none, because white has no hue".into()));
        }
        if [cb, cr] == [128; 2] {
            return Some(("reference", "expected chroma other than 128, 128, found grey".into()));
        }
        match (self.least_chroma, self.tolerance_deg) {
            (None | Some(0), _) => Some(("least_chroma", "expected a number from 1 to 255".into())),
            (_, Some(t)) if t > 0.0 && t <= 180.0 => None,
            (_, found) => {
                let found = found.map_or("none".into(), |t| t.to_string());
                Some(("tolerance_deg", format!("expected more than 0 and at most 180, found {found}")))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn shipped_file_is_what_the_hardware_begins_with() {
        let file = ColourFile::load_or_shipped(None).unwrap();
        let (table, built_in) = (file.table(), ColourTable::default());
        for cb in 0..=255 {
            for cr in 0..=255 {
                assert_eq!(table.class(cb, cr), built_in.class(cb, cr), "{cb}, {cr}");
            }
        }
        let (mut settings, usual) = (Settings::default(), Settings::default());
        file.apply(&mut settings);
        assert_eq!((settings.level, settings.low), (usual.level, usual.low));
        assert_eq!(settings.high[1..], usual.high[1..]);
        assert_eq!(ColourFile::parse(&file.text(), "again").unwrap(), file);
    }

    #[test]
    fn defects_are_named_with_file_and_key() {
        let cases = [
            ("vitreo-colours-1", "vitreo-colours-9", "format: expected \"vitreo-colours-1\""),
            ("black =", "blak =", "unknown field `blak`"),
            ("black = 30", "black = 300", "300"),
            ("black = 30", "black = 190", "class red, reference: expected a luma above black = 190"),
            ("low = 16", "low = 0", "low: expected at least 1"),
            ("high = 24", "high = 4", "high, high_white: expected at least low = 16, found 4"),
            ("\"yellow\"", "\"red\"", "class: expected each colour once, found red twice"),
            ("\"yellow\"", "\"pink\"", "unknown variant `pink`"),
            ("[114, 100, 194]", "[114, 128, 128]", "class red, reference: expected chroma other than"),
            ("[114, 100, 194]", "[114, 100]", "invalid length 2"),
            ("tolerance_deg = 180", "tolerance_deg = nan", "class red, tolerance_deg"),
            (
                "tolerance_deg = 180",
                "",
                "class red, tolerance_deg: expected more than 0 and at most 180, found none",
            ),
            ("least_chroma = 24", "least_chroma = 0", "class red, least_chroma"),
            ("[200, 128, 128]", "[200, 128, 128]\nleast_chroma = 3", "class white, least_chroma"),
        ];
        for (from, to, named) in cases {
            let broken = SHIPPED.replacen(from, to, 1);
            assert_ne!(broken, SHIPPED, "{from} is not in the file");
            let error = ColourFile::parse(&broken, "c.toml").unwrap_err().to_string();
            assert!(error.starts_with("c.toml: ") && error.contains(named), "{named}: {error}");
        }
        let none = "format = \"vitreo-colours-1\"\nblack = 1\nlow = 1\nhigh = 1\nhigh_white = 1\nclass = []";
        assert!(ColourFile::parse(none, "c").unwrap_err().to_string().contains("at least one class"));
    }

    proptest! {
        #[test]
        fn damaged_files_are_read_or_refused(cut in 0..SHIPPED.len(), with in any::<char>()) {
            let mut text: String = SHIPPED.chars().take(cut).collect();
            text.push(with);
            text.extend(SHIPPED.chars().skip(cut + 1));
            if let Ok(file) = ColourFile::parse(&text, "f") {
                prop_assert!(!file.classes().is_empty());
                let _ = file.table();
            }
        }
    }
}
