//! Scanners of `vitreo blobs`: settings by the user, one scanner a camera, blobs found.

use crate::colours::CLASSES;
use crate::colours::file::ColourFile;
use crate::input::source::{Reading, Shot};
use crate::input::still::Levels;
use crate::input::{Interlace, bin_of_rank};
use crate::scan::background::Level;
use crate::scan::{Found, Scanner, Settings, limits};
use protocol::blobs::{BLOB_CLIPPED, BLOB_MERGED, Blob, Colour};
use protocol::fields::DARK;

/// Passes over a still image before the one that counts, so that a tracked background converges.
const SETTLING: u32 = 16;

/// Polarity of the blobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Polarity {
    /// Bright on dark.
    #[default]
    Bright,
    /// Dark on bright.
    Dark,
}

/// Source of the background level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ground {
    /// This luma everywhere.
    Fixed(u8),
    /// Tracked block by block from the median of the first picture.
    Tracked,
}

impl Ground {
    fn parse(text: &str) -> Result<Self, String> {
        match text.strip_prefix("fixed=").map(str::parse) {
            Some(Ok(level)) => Ok(Ground::Fixed(level)),
            None if text == "tracked" => Ok(Ground::Tracked),
            _ => Err(format!("expected tracked or fixed=LEVEL with a luma from 0 to 255, found {text:?}")),
        }
    }
}

/// Grey levels above the background.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Threshold {
    /// Of every pixel of a blob.
    low: u8,
    /// Of its brightest pixel.
    high: u8,
}

impl Threshold {
    fn parse(text: &str) -> Result<Self, String> {
        let (low, high) = text.split_once(':').unwrap_or((text, text));
        match (low.parse(), high.parse()) {
            (Ok(low @ 1..), Ok(high)) if low <= high => Ok(Threshold { low, high }),
            _ => Err(format!(
                "expected LOW or LOW:HIGH, 1 to 255 grey levels, the first not higher; found {text:?}"
            )),
        }
    }
}

/// Settings of the scanner; what is not given is as in the camera hardware.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Tuning {
    /// Brightness of blobs relative to their surroundings.
    #[arg(long, default_value = "bright", help_heading = "Detection")]
    pub polarity: Polarity,
    /// Background: fixed=LEVEL (luma; black is 16) or tracked [default: tracked in camera fields; the camera
    /// hardware's fixed level in other pictures, whose objects can be larger than the background's blocks].
    /// With tracked, a still image is scanned 16 times first, until the background has settled.
    #[arg(long, value_name = "fixed=LEVEL|tracked", value_parser = Ground::parse, help_heading = "Detection")]
    pub background: Option<Ground>,
    /// Minimum grey levels above the background: LOW for every pixel of a blob, HIGH for its brightest pixel.
    #[arg(long, value_name = "LOW[:HIGH]", value_parser = Threshold::parse, help_heading = "Detection")]
    pub threshold: Option<Threshold>,
    /// Minimum area of a blob, px.
    #[arg(long, alias = "least-area", value_name = "PX", help_heading = "Detection")]
    pub min_area: Option<u16>,
    /// Maximum number of blobs per picture; the first to be complete are kept, the others counted as lost.
    #[arg(long, value_name = "N", help_heading = "Detection")]
    pub max_blobs: Option<usize>,
    /// Detect spots of light, such as stars or particles: weight by brightness up to the peak, and accept
    /// blobs of one line.
    #[arg(long, help_heading = "Detection")]
    pub spots: bool,
    /// Treat pixels outside every colour class as black: for coloured objects on a bright background.
    #[arg(long, conflicts_with = "grey", help_heading = "Detection")]
    pub key: bool,
    /// Ignore colour: every blob is white.
    #[arg(long, conflicts_with = "colours", help_heading = "Detection")]
    pub grey: bool,
}

impl Tuning {
    /// Options of reading for these settings.
    pub fn reading(
        &self,
        levels: Option<Levels>,
        interlace: Option<Interlace>,
        colours: &ColourFile,
    ) -> Reading {
        let (dark, key) = (self.polarity == Polarity::Dark, self.key.then(|| colours.table()));
        Reading { levels, interlace, dark, grey: self.grey, key }
    }

    /// The scanner's settings for a picture.
    fn settings(&self, colours: &ColourFile, shot: &Shot<'_>) -> Settings {
        let mut settings = Settings { limits: limits::PICTURE, ..Settings::default() };
        colours.apply(&mut settings);
        settings.frame_lines = if shot.is_field { 2 } else { 1 };
        match self.background {
            None if !shot.is_field => {}
            Some(Ground::Fixed(level)) => settings.level = Level::Fixed(level),
            None | Some(Ground::Tracked) => settings.level = Level::Tracked(median(shot)),
        }
        if let Some(Threshold { low, high }) = self.threshold {
            settings.low = low;
            // Classes that are not in the file still never count.
            settings.high = settings.high.map(|h| if h == u8::MAX { h } else { high });
        }
        settings.spots = self.spots;
        if self.spots {
            settings.least_lines = 1;
        }
        if let Some(area) = self.min_area {
            settings.least_area = area;
        }
        if let Some(blobs) = self.max_blobs {
            settings.limits.blobs = blobs;
        }
        settings
    }
}

/// Median luma of a picture.
fn median(shot: &Shot<'_>) -> u8 {
    let mut counts = [0; 256];
    for y in 0..shot.view.height() {
        shot.view.line(y).0.iter().for_each(|&v| counts[usize::from(v)] += 1);
    }
    let half = u64::from(counts.iter().sum::<u32>()) / 2;
    bin_of_rank(&counts, half).map_or(DARK, |level| level as u8)
}

/// A scanner for each camera, and the blobs of the newest picture.
pub struct Extractor<'a> {
    colours: &'a ColourFile,
    tuning: &'a Tuning,
    /// By camera, with the size of its pictures.
    scanners: Vec<Option<([usize; 2], Scanner)>>,
    /// Blobs of the newest picture.
    pub blobs: Vec<Blob>,
    /// Bounding box of each blob (left, right, top, bottom), px and lines of the field.
    pub boxes: Vec<[f64; 4]>,
}

impl<'a> Extractor<'a> {
    /// Scanners with these settings.
    pub fn new(colours: &'a ColourFile, tuning: &'a Tuning) -> Self {
        Extractor { colours, tuning, scanners: Vec::new(), blobs: Vec::new(), boxes: Vec::new() }
    }

    /// Scans a still image until a tracked background has converged.
    pub fn settle(&mut self, shot: &Shot<'_>) {
        if self.tuning.background == Some(Ground::Tracked) && shot.is_still {
            for _ in 0..SETTLING {
                self.scan(shot);
            }
        }
    }

    /// Finds the blobs of a field; returns the number lost.
    pub fn scan(&mut self, shot: &Shot<'_>) -> u64 {
        let size = [shot.view.picture.width, shot.view.height()];
        let camera = shot.head.cam as usize;
        if self.scanners.len() <= camera {
            self.scanners.resize_with(camera + 1, || None);
        }
        let slot = &mut self.scanners[camera];
        if slot.as_ref().is_none_or(|(known, _)| *known != size) {
            let settings = self.tuning.settings(self.colours, shot);
            *slot = Some((size, Scanner::new(settings, size[0], size[1])));
        }
        let Some((_, scanner)) = slot else { return 0 };
        self.blobs.clear();
        self.boxes.clear();
        let mut keep = |found: Found| {
            let from = self.blobs.len();
            self.blobs.extend(found.blobs());
            let new = &self.blobs[from..];
            let whole = found.sums.half_box_px.map(f64::from);
            self.boxes.extend(new.iter().map(|b| if new.len() == 1 { whole } else { box_of(b) }));
        };
        scanner.field((0..size[1]).map(|y| shot.view.line(y)), &mut keep);
        u64::from(scanner.tally().lost())
    }
}

/// The box of one of several blobs in a component.
fn box_of(blob: &Blob) -> [f64; 4] {
    let side = |centre: f64, length: f64| [centre - (length - 1.0) / 2.0, centre + (length - 1.0) / 2.0];
    let ([left, right], [top, bottom]) =
        (side(blob.x_px, blob.width_px), side(blob.y_field_px, blob.height_px));
    [left, right, top, bottom]
}

/// Counts over all pictures.
#[derive(Debug, Clone, Default)]
pub struct Counts {
    /// Pictures, or fields.
    pub pictures: u64,
    pixels: u64,
    scanning_ns: u64,
    blobs: u64,
    by_class: [u64; CLASSES],
    merged: u64,
    clipped: u64,
    lost: u64,
}

impl Counts {
    /// Adds a picture.
    pub fn add(&mut self, shot: &Shot<'_>, blobs: &[Blob], lost: u64, scanning_ns: u64) {
        self.pictures += 1;
        self.pixels += (shot.view.picture.width * shot.view.height()) as u64;
        self.scanning_ns += scanning_ns;
        self.lost += lost;
        self.blobs += blobs.len() as u64;
        for blob in blobs {
            self.by_class[blob.colour as usize % CLASSES] += 1;
            self.merged += u64::from(blob.flags & BLOB_MERGED != 0);
            self.clipped += u64::from(blob.flags & BLOB_CLIPPED != 0);
        }
    }

    /// The counts as one line.
    pub fn summary(&self) -> String {
        let counted = Colour::ALL.map(|c| (c.name(), self.by_class[c as usize]));
        let colours: Vec<String> =
            counted.iter().filter(|(_, n)| *n > 0).map(|(name, n)| format!("{n} {name}")).collect();
        let colours = if colours.is_empty() { String::new() } else { format!(" ({})", colours.join(", ")) };
        let Counts { pictures, blobs, merged, clipped, lost, .. } = self;
        let rate = self.pixels as f64 * 1e3 / self.scanning_ns.max(1) as f64;
        format!(
            "{pictures} pictures, {blobs} blobs{colours}, {merged} merged, {clipped} clipped, {lost} lost; \
             {rate:.0} million px/s"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_thresholds_are_read_and_nonsense_refused() {
        assert_eq!(Ground::parse("tracked"), Ok(Ground::Tracked));
        assert_eq!(Ground::parse("fixed=16"), Ok(Ground::Fixed(16)));
        assert_eq!(Threshold::parse("8"), Ok(Threshold { low: 8, high: 8 }));
        assert_eq!(Threshold::parse("8:20"), Ok(Threshold { low: 8, high: 20 }));
        for text in ["fixed", "fixed=", "fixed=256", "16", "tracked=3"] {
            assert!(Ground::parse(text).is_err(), "{text}");
        }
        for text in ["0", "", "20:8", "8:", "256", "-1"] {
            assert!(Threshold::parse(text).is_err(), "{text}");
        }
    }
}
