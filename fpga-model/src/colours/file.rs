//! Files of colour classes (`vitreo-colours-1`): references, tolerances and thresholds.

use super::{CLASSES, Class, ColourTable};
use crate::scan::Settings;
use crate::scan::background::Level;
use anyhow::{Result, anyhow, bail, ensure};
use protocol::blobs::Colour;
use protocol::file::{MAX_SETTINGS_BYTES, other_format, other_format_in, read_text};
use protocol::parse_error;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Format key of a file.
const FORMAT: &str = "vitreo-colours-1";
/// The shipped classes.
pub const SHIPPED: &str = include_str!("../../../assets/colours.toml");

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
    /// A file that cannot be read or is too long; otherwise as [`ColourFile::parse`].
    pub fn load_or_shipped(path: Option<&Path>) -> Result<Self> {
        let Some(path) = path else { return Self::parse(SHIPPED, "shipped colours") };
        let file = path.display().to_string();
        let failed = |e: std::io::Error| anyhow!("{file}: {e}");
        Self::parse(&read_text(path, MAX_SETTINGS_BYTES).map_err(failed)?, &file)
    }

    /// Parses a text; `file` is its name in messages.
    ///
    /// # Errors
    /// A text that is not TOML of this format, or a value out of range.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let parsed: ColourFile = toml::from_str(text).map_err(|e| match other_format_in(text, FORMAT) {
            Some(found) => anyhow!("{file}: format: expected {FORMAT:?}, found {found}"),
            None => anyhow!("{file}, {}", parse_error::toml(text, &e)),
        })?;
        parsed.check().map_err(|problem| anyhow!("{file}: {problem}"))?;
        Ok(parsed)
    }

    /// Refuses the first value that is out of range.
    fn check(&self) -> Result<()> {
        if let Some(found) = other_format(&self.format, FORMAT) {
            bail!("format: expected {FORMAT:?}, found {found}");
        }
        ensure!(self.low > 0, "low: expected at least 1, found 0");
        let (low, found) = (self.low, self.high.min(self.high_white));
        ensure!(found >= low, "high, high_white: expected at least low = {low}, found {found}");
        ensure!(!self.classes.is_empty(), "class: expected at least one class, found none");
        for (i, entry) in self.classes.iter().enumerate() {
            let name = entry.colour.name();
            let first = self.classes[..i].iter().all(|other| other.colour != entry.colour);
            ensure!(first, "class: expected each colour once, found {name} twice");
            entry.check(self.black).map_err(|problem| anyhow!("class {name}, {problem}"))?;
        }
        Ok(())
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

    /// Refuses the first value that is out of range.
    fn check(&self, black: u8) -> Result<()> {
        let [y, cb, cr] = self.reference;
        ensure!(y > black, "reference: expected a luma above black = {black}, found {y}");
        if self.colour == Colour::White {
            ensure!(self.least_chroma.is_none(), "least_chroma: expected none, because white has no hue");
            ensure!(self.tolerance_deg.is_none(), "tolerance_deg: expected none, because white has no hue");
            return Ok(());
        }
        ensure!([cb, cr] != [128; 2], "reference: expected chroma other than 128, 128, found grey");
        ensure!(self.least_chroma.is_some_and(|c| c > 0), "least_chroma: expected a number from 1 to 255");
        let found = self.tolerance_deg.map_or("none".into(), |t| t.to_string());
        ensure!(
            self.tolerance_deg.is_some_and(|t| t > 0.0 && t <= 180.0),
            "tolerance_deg: expected more than 0 and at most 180, found {found}"
        );
        Ok(())
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
            ("black =", "blak =", "unknown key blak"),
            ("black = 30", "black = 300", "300"),
            ("black = 30", "black = 190", "class red, reference: expected a luma above black = 190"),
            ("low = 16", "low = 0", "low: expected at least 1"),
            ("high = 24", "high = 4", "high, high_white: expected at least low = 16, found 4"),
            ("\"yellow\"", "\"red\"", "class: expected each colour once, found red twice"),
            ("\"yellow\"", "\"pink\"", "found pink"),
            ("[114, 100, 194]", "[114, 128, 128]", "class red, reference: expected chroma other than"),
            ("[114, 100, 194]", "[114, 100]", "found 2 values"),
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
            assert!(error.starts_with("c.toml") && error.contains(named), "{named}: {error}");
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
