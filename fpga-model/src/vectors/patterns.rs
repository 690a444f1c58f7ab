//! Small fields that are hard for an extractor, with their settings.

use crate::colours::CLASSES;
use crate::scan::Settings;
use crate::scan::background::Level;
use crate::scan::limits::{CAMERA, Limits};
use protocol::blobs::Colour;
use protocol::fields::{DARK, FieldPicture};

/// A field with its settings.
pub struct Pattern {
    /// Short name; also of the file.
    pub name: &'static str,
    /// The difficulty and the expected result.
    pub about: &'static str,
    /// Settings of the extractor.
    pub settings: Settings,
    /// The pixels.
    pub picture: FieldPicture,
}

/// A field painted pixel by pixel.
struct Canvas(FieldPicture);

impl Canvas {
    fn dark(width: usize, height: usize) -> Self {
        Canvas(FieldPicture::new([width as u32, 2 * height as u32]))
    }

    /// Paints the pixels for which `inside` holds.
    fn paint(mut self, colour: Colour, inside: impl Fn(usize, usize) -> bool) -> Self {
        let [light, blue, red] = colour.reference();
        let (width, height) = (self.0.width, self.0.height);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).filter(|&(x, y)| inside(x, y))
        {
            self.0.luma[y * width + x] = light;
            self.0.blue[(y * width + x) / 2] = blue;
            self.0.red[(y * width + x) / 2] = red;
        }
        self
    }

    /// Paints a disc with a soft edge; axes in px of the field, chroma a little larger than luma.
    fn disc(mut self, colour: Colour, [cx, cy]: [f64; 2], [rx, ry]: [f64; 2]) -> Self {
        let [light, blue, red] = colour.reference();
        let (width, height) = (self.0.width, self.0.height);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let rho = libm::hypot((x as f64 - cx) / rx, (y as f64 - cy) / ry);
            let cover = (0.5 - (rho - 1.0) * rx / 2.5).clamp(0.0, 1.0);
            let i = y * width + x;
            let ground = f64::from(self.0.luma[i]);
            self.0.luma[i] = (ground + (f64::from(light) - ground) * cover + 0.5) as u8;
            if rho < 1.4 {
                (self.0.blue[i / 2], self.0.red[i / 2]) = (blue, red);
            }
        }
        self
    }

    fn named(self, name: &'static str, about: &'static str, settings: Settings) -> Pattern {
        Pattern { name, about, settings, picture: self.0 }
    }
}

/// Settings in which every component counts, however small or faint.
fn unfiltered() -> Settings {
    Settings { high: [0; CLASSES], least_area: 1, least_lines: 1, ..Settings::default() }
}

/// As [`unfiltered`], with small tables.
fn with_tables(runs: usize, labels: usize, blobs: usize) -> Settings {
    Settings { limits: Limits { runs, labels, blobs, ..CAMERA }, ..unfiltered() }
}

/// True on a square spiral of lines one pixel wide, two apart, that starts at the corner.
fn on_spiral(x: usize, y: usize, side: usize) -> bool {
    let ring = x.min(y).min(side - 1 - x).min(side - 1 - y);
    let on_ring = ring.is_multiple_of(2);
    // The gap that opens each ring to the next lies below its left upper corner.
    let gate = x == ring && y == ring + 1 && ring > 0;
    let bridge = ring % 2 == 1 && x == ring && y == ring + 1;
    (on_ring && !gate) || bridge
}

/// All patterns.
pub fn all() -> Vec<Pattern> {
    let mut all = shapes();
    all.extend(markers());
    all.extend(overflows());
    all
}

/// Difficult shapes within the tables.
fn shapes() -> Vec<Pattern> {
    use Colour::*;
    let tooth = |x: usize| x % 4 < 2;
    vec![
        Canvas::dark(32, 8).named("all-off", "nothing: no blob", unfiltered()),
        Canvas::dark(32, 8).paint(Red, |_, _| true).named(
            "all-on",
            "one component fills the field: one blob, flagged as clipped",
            unfiltered(),
        ),
        Canvas::dark(64, 8).paint(Red, |x, y| y == 7 || tooth(x)).named(
            "comb",
            "16 teeth, open at the top, meet in the last line: 15 unions in one line, one blob",
            unfiltered(),
        ),
        Canvas::dark(64, 8).paint(Red, |x, y| y == 0 || tooth(x)).named(
            "comb-upside-down",
            "16 teeth hang from one line: one blob, and no label is wasted",
            unfiltered(),
        ),
        Canvas::dark(34, 33).paint(Red, |x, y| x < 33 && on_spiral(x, y, 33)).named(
            "spiral",
            "one arm winds inwards and is cut by every line: one blob from many unions",
            unfiltered(),
        ),
        Canvas::dark(32, 16).paint(Red, |x, y| (x / 2 + y) % 2 == 0).named(
            "chequerboard",
            "cells touch by their corners only: eight neighbours make one component of them",
            unfiltered(),
        ),
        Canvas::dark(32, 12)
            .paint(Red, |x, y| x + 2 * y < 30 && y < 11)
            .paint(Green, |x, y| x + 2 * y >= 30 && y < 11)
            .named("two-colours", "two colours with a common border: two blobs", unfiltered()),
    ]
}

/// Images of markers.
fn markers() -> Vec<Pattern> {
    use Colour::*;
    let usual = Settings::default;
    vec![
        Canvas::dark(96, 24)
            .disc(Yellow, [20.3, 11.7], [11.0, 6.0])
            .disc(Cyan, [67.6, 12.1], [11.0, 6.0])
            .named("markers", "two markers as the cameras see them: two blobs", usual()),
        Canvas::dark(64, 24)
            .disc(Green, [20.4, 11.2], [10.5, 5.5])
            .disc(Green, [41.1, 12.3], [10.5, 5.5])
            .named("touching", "two markers of one colour that touch: flagged as merged", usual()),
        Canvas::dark(48, 16)
            .disc(Magenta, [1.5, 7.0], [10.0, 5.0])
            .disc(Blue, [36.0, 14.0], [9.0, 5.0])
            .named("border", "two markers cut by the border: flagged as clipped", usual()),
        Canvas::dark(32, 16)
            .disc(White, [15.0, 8.0], [9.0, 5.0])
            .paint(White, |x, y| (26..28).contains(&x) && (2..4).contains(&y))
            .named("speck", "a white marker and a speck of 4 px: one blob, the speck is counted", usual()),
        Canvas(FieldPicture::new([64, 64])).disc(Red, [30.0, 14.0], [11.0, 6.0]).named(
            "tracked-background",
            "the level of the background starts 20 grey levels too low: the first lines stand out as a whole, \
             are no blob, and then the marker is found",
            Settings { level: Level::Tracked(DARK - 20), ..usual() },
        ),
    ]
}

/// Fields that exceed a table.
fn overflows() -> Vec<Pattern> {
    use Colour::Red;
    let dot = |x: usize| x % 4 < 2;
    vec![
        Canvas::dark(64, 4).paint(Red, |x, y| dot(x) && y < 3).named(
            "too-many-runs",
            "16 runs a line where 10 fit: 10 blobs, 6 runs lost in each of 3 lines",
            with_tables(10, 32, 64),
        ),
        Canvas::dark(64, 4).paint(Red, |x, y| dot(x) && y < 3).named(
            "too-many-labels",
            "16 components where 12 have a label: 12 blobs, 4 runs without a label in each of 3 lines",
            with_tables(32, 12, 64),
        ),
        Canvas::dark(64, 16).paint(Red, |x, y| dot(x) && y % 4 < 2).named(
            "labels-again",
            "4 rows of 16 dots with 16 labels: each row uses the labels of the row before",
            with_tables(32, 16, 64),
        ),
        Canvas::dark(66 * 4, 4).paint(Red, |x, y| dot(x) && y < 2).named(
            "too-many-blobs",
            "66 dots where a field has 64 blobs: the first 64, and 2 are counted",
            with_tables(128, 128, 64),
        ),
    ]
}
