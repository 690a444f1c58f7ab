//! Streaming blob extraction, as the camera hardware does it: one line at a time, no frame buffer.
//!
//! Each line is cut into runs of one colour that stand out from the background (`background`,
//! `runs`). A run joins the components of the same colour that it touches in the line before (eight
//! neighbours), which may unite several of them (`labels`). Two lines later, when the lines below
//! are known too, the pixels of the runs and of the blurred edge around them (`owners`) get their
//! weights (`weight`) and are added up (`sums`). A component whose last line and the line below
//! have been weighed is complete and is output at once as one blob, or as two that touch (`disc`).
//!
//! Integers only. Overflows of a table (`limits`) are counted and change nothing else: runs beyond
//! the table of a line, components beyond the labels, blobs beyond those of a field.
//!
//! A component counts if its brightest pixel stands out by [`Settings::high`], though its pixels
//! need only [`Settings::low`] (a threshold with hysteresis), and if it is large enough.

pub mod background;
pub mod disc;
pub mod labels;
pub mod limits;
pub mod moments;
pub mod owners;
pub mod runs;
pub mod split;
pub mod sums;
pub mod weight;

use crate::colours::{CLASSES, ColourTable};
use background::{Background, Level};
use disc::{Discs, FieldShape};
use labels::Labels;
use limits::{CAMERA, DIVIDER_CLOCKS, FULL_WEIGHT, LEVEL_BITS, LINE_CLOCKS, Limits, PICTURE, SPLIT_CLOCKS};
use owners::Owners;
use protocol::blobs::{BlobField, Colour};
use protocol::fields::{DARK, FieldPicture};
use runs::{NO_LABEL, Run, Runs};
use std::ops::Deref;
use sums::Sums;
use weight::{Around, Weigher};

/// Lines held at a time: the window of the line being weighed, up to the newest line.
const HELD: usize = 2 * weight::LINES + 1;
/// Lines from a component's last line to its completion: the line below it is weighed as well.
pub const COMPLETE_AFTER: usize = weight::LINES + 1;

/// Grey levels above the background of a pixel that may belong to a marker: the darkest marker
/// (blue) has about 65, noise of 4 σ stays below 12.
const LOW: u8 = 16;
/// Grey levels that the brightest pixel of a coloured component has to have.
const HIGH: u8 = 24;
/// The same for white, which chroma does not distinguish from a reflection.
const HIGH_WHITE: u8 = 120;
/// Least area of a blob, px: an eighth of the smallest marker of the shipped rig.
const LEAST_AREA: u16 = 6;

/// Settings of the extractor.
#[derive(Clone)]
pub struct Settings {
    /// Sizes of the tables.
    pub limits: Limits,
    /// Colour class of each chroma.
    pub colours: ColourTable,
    /// Level of the background.
    pub level: Level,
    /// Grey levels above the background of every pixel of a component.
    pub low: u8,
    /// Grey levels above the background of the brightest pixel of a component, by class.
    pub high: [u8; CLASSES],
    /// Least sum of weights of a blob, px.
    pub least_area: u16,
    /// Least lines of a blob.
    pub least_lines: u16,
    /// Lines of the frame per line of the field: 2 where interlaced, 1 where progressive.
    pub frame_lines: u8,
    /// Blobs are spots of light without a lit surface; see [`weight::Weigher::for_spots`].
    pub spots: bool,
}

impl Default for Settings {
    /// Settings of the camera hardware in a rig.
    fn default() -> Self {
        let mut high = [HIGH; CLASSES];
        high[Colour::White as usize] = HIGH_WHITE;
        Settings {
            limits: CAMERA,
            colours: ColourTable::default(),
            level: Level::Fixed(DARK),
            low: LOW,
            high,
            least_area: LEAST_AREA,
            least_lines: 2,
            frame_lines: 2,
            spots: false,
        }
    }
}

impl Settings {
    /// The camera hardware, with larger tables where a sensor of `width` × `height` px needs them.
    pub fn for_sensor(width: usize, height: usize) -> Self {
        let fits = width <= CAMERA.width && height <= CAMERA.lines;
        let limits = if fits { CAMERA } else { Limits { blobs: CAMERA.blobs, ..PICTURE } };
        Settings { limits, ..Settings::default() }
    }
}

/// A complete component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    /// Its sums.
    pub sums: Sums,
    /// Output, pixel clocks after the first pixel of the field.
    pub out_clock: u64,
    /// Pixel clocks from its last pixel to its output.
    pub latency_clocks: u64,
    /// Lines from its last line to its output.
    pub latency_lines: u64,
    field: FieldShape,
}

impl Found {
    /// Its blob, or its two touching blobs.
    pub fn blobs(&self) -> Discs {
        disc::discs(&self.sums, &self.field)
    }
}

/// Counts of what was left out of a field.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Components too small or too faint to be blobs.
    pub specks: u32,
    /// Runs beyond the table of a line.
    pub runs_lost: u32,
    /// Runs whose component found no label.
    pub unlabelled: u32,
    /// Components beyond the blobs of a field.
    pub blobs_lost: u32,
}

impl Tally {
    /// Runs and components lost because a table was full.
    pub fn lost(&self) -> u32 {
        self.runs_lost.saturating_add(self.unlabelled).saturating_add(self.blobs_lost)
    }
}

/// A line of the window.
struct Held {
    luma: Vec<u8>,
    runs: Runs,
}

/// The extractor of one camera.
pub struct Scanner {
    settings: Settings,
    field: FieldShape,
    background: Background,
    /// Next line.
    y: u16,
    /// Line y is at y modulo [`HELD`].
    held: [Held; HELD],
    labels: Labels,
    owners: Owners,
    weigher: Weigher,
    /// No runs: of a line beyond the field.
    nothing: Runs,
    tally: Tally,
    found: usize,
    /// Pixel clock at which the divider is free.
    divider_free: u64,
}

impl Scanner {
    /// An extractor for fields of `width` × `height` px.
    ///
    /// # Panics
    /// Where a side exceeds `settings.limits` or [`PICTURE`]; rigs within these limits are valid.
    pub fn new(settings: Settings, width: usize, height: usize) -> Self {
        let limits = settings.limits;
        assert!((1..=limits.width.min(PICTURE.width)).contains(&width), "{width} px in a line");
        assert!((1..=limits.lines.min(PICTURE.lines)).contains(&height), "{height} lines");
        Scanner {
            field: FieldShape { size_px: [width as u16, height as u16], frame_lines: settings.frame_lines },
            background: Background::new(settings.level, settings.low, width, height),
            y: 0,
            held: std::array::from_fn(|_| Held { luma: vec![0; width], runs: Runs::new(limits.runs) }),
            labels: Labels::new(limits.labels),
            owners: Owners::new(limits.runs),
            weigher: if settings.spots { Weigher::for_spots(width) } else { Weigher::new(width) },
            nothing: Runs::new(0),
            tally: Tally::default(),
            found: 0,
            divider_free: 0,
            settings,
        }
    }

    /// Extracts a whole field; the losses are added to `blobs_left_out`.
    pub fn scan<B: Deref<Target = [u8]>>(&mut self, picture: &FieldPicture<B>, out: &mut BlobField) {
        let lines = (0..picture.height).map(|y| picture.line(y));
        self.field(lines, &mut |found: Found| found.blobs().for_each(|blob| out.push(blob)));
        out.blobs_left_out = out.blobs_left_out.saturating_add(self.tally.lost());
    }

    /// Processes the lines of a whole field: luma, Cb and Cr of each.
    pub fn field<'a>(
        &mut self,
        lines: impl Iterator<Item = (&'a [u8], &'a [u8], &'a [u8])>,
        out: &mut impl FnMut(Found),
    ) {
        self.begin();
        for (luma, blue, red) in lines {
            self.line(luma, blue, red, out);
        }
        self.end(out);
    }

    /// Begins a field.
    pub fn begin(&mut self) {
        self.y = 0;
        self.labels.clear();
        self.tally = Tally::default();
        (self.found, self.divider_free) = (0, 0);
        for held in &mut self.held {
            held.runs.clear();
            held.runs.lost = 0;
        }
    }

    /// Counts since the beginning of the field.
    pub fn tally(&self) -> Tally {
        let runs_lost = self.held.iter().fold(0u32, |sum, held| sum.saturating_add(held.runs.lost));
        Tally { runs_lost, ..self.tally }
    }

    /// Processes the next line: luma, and Cb and Cr of every second pixel. Components that it
    /// completes go to `out`. Lines and pixels beyond the field are ignored.
    pub fn line(&mut self, luma: &[u8], blue: &[u8], red: &[u8], out: &mut impl FnMut(Found)) {
        let chroma = blue.len().min(red.len());
        let width = luma.len().min(2 * chroma).min(usize::from(self.field.size_px[0]));
        if self.y >= self.field.size_px[1] {
            return;
        }
        let (luma, y) = (&luma[..width], usize::from(self.y));
        self.background.begin_line(y);
        let held = &mut self.held[y % HELD];
        held.luma[..width].copy_from_slice(luma);
        held.luma[width..].fill(0);
        held.runs.find(&self.settings.colours, self.background.foreground(), luma, [blue, red]);
        // Completed components free their labels before this line needs some.
        self.complete(y, y, out);
        self.label_runs(y);
        self.background.watch(y, luma);
        self.y += 1;
    }

    /// Ends a field: completes the open components.
    pub fn end(&mut self, out: &mut impl FnMut(Found)) {
        let lines = usize::from(self.y);
        if let Some(newest) = lines.checked_sub(1) {
            for y in lines..lines + COMPLETE_AFTER {
                self.complete(y, newest, out);
            }
        }
        self.tally = self.tally();
    }

    /// Weighs the line that line `y` completes the window of, and outputs completed components;
    /// `newest` is the last line of the field so far.
    fn complete(&mut self, y: usize, newest: usize, out: &mut impl FnMut(Found)) {
        if let Some(weighed) = y.checked_sub(weight::LINES).filter(|&weighed| weighed <= newest) {
            self.weigh_line(weighed, newest);
        }
        self.emit(y, out);
    }

    /// Labels every run of line `y`.
    fn label_runs(&mut self, y: usize) {
        let mut first = 0;
        for r in 0..self.held[y % HELD].runs.all().len() {
            let run = self.held[y % HELD].runs.all()[r];
            let mut label = NO_LABEL;
            if let Some(above) = y.checked_sub(1) {
                // Runs that end more than a pixel before this one touch no later run either.
                let runs = self.held[above % HELD].runs.all();
                while runs.get(first).is_some_and(|p| p.end < run.start) {
                    first += 1;
                }
                label = self.join_above(&run, above, first);
            }
            if label == NO_LABEL {
                label = self.labels.open().unwrap_or(NO_LABEL);
            }
            let held = &mut self.held[y % HELD];
            held.runs.set_label(r, label);
            if label == NO_LABEL {
                self.tally.unlabelled = self.tally.unlabelled.saturating_add(1);
                continue;
            }
            let columns = usize::from(run.start)..usize::from(run.end);
            let level = self.background.at(columns.start.midpoint(columns.end)) >> LEVEL_BITS;
            let part = Sums::of_run(&held.luma[columns], run.start, y as u16, run.class, level as u8);
            self.labels.add(label, &part);
        }
    }

    /// Label of the runs of line `above` that `run` touches, united if there are several.
    fn join_above(&mut self, run: &Run, above: usize, first: usize) -> u16 {
        let mut label = NO_LABEL;
        for p in first..self.held[above % HELD].runs.all().len() {
            let runs = &self.held[above % HELD].runs;
            let (touched, other) = (runs.all()[p], runs.labels()[p]);
            if touched.start > run.end {
                break;
            }
            if touched.class != run.class || other == NO_LABEL || other == label {
                continue;
            }
            if label == NO_LABEL {
                label = other;
                continue;
            }
            let (kept, freed) = (label.min(other), label.max(other));
            self.labels.unite(kept, freed);
            self.held.iter_mut().for_each(|held| held.runs.relabel(freed, kept));
            label = kept;
        }
        label
    }

    /// Adds the weights of line `y` to its owners' sums; `newest` is the last line known.
    fn weigh_line(&mut self, y: usize, newest: usize) {
        let Scanner { held, labels, owners, weigher, background, nothing, field, .. } = self;
        let line = |y: usize| &held[y % HELD];
        let around: Around = std::array::from_fn(|i| {
            let held = line((y + i).saturating_sub(weight::LINES).min(newest));
            weight::Line { luma: &held.luma, runs: held.runs.all() }
        });
        let above = y.checked_sub(1).map_or(&*nothing, |y| &line(y).runs);
        let below = if y < newest { &line(y + 1).runs } else { &*nothing };
        owners.each(field.size_px[0], &line(y).runs, above, below, |claim| {
            let columns = usize::from(claim.columns.start)..usize::from(claim.columns.end);
            let level = background.at(columns.start.midpoint(columns.end));
            let sums = labels.sums_mut(claim.label);
            weigher.weigh(&around, columns.clone(), sums.class, level);
            let slope = claim.run.then(|| weight::slope(&line(y).luma[columns.clone()], level));
            let luma = &line(y).luma[columns];
            sums.weigh(luma, &weigher.weights, claim.columns.start, y as u16, slope);
        });
    }

    /// Outputs the components whose last line is [`COMPLETE_AFTER`] lines before `y`. Once line `y`
    /// has been read, one label is searched a clock; each component then waits for the divider.
    fn emit(&mut self, y: usize, out: &mut impl FnMut(Found)) {
        let read = (y as u64 + 1) * LINE_CLOCKS;
        let complete = |sums: &Sums| usize::from(sums.last_line()) + COMPLETE_AFTER <= y;
        while let Some((label, sums)) = self.labels.take(complete) {
            if !self.counts(&sums) {
                self.tally.specks = self.tally.specks.saturating_add(1);
            } else if self.found == self.settings.limits.blobs {
                self.tally.blobs_lost = self.tally.blobs_lost.saturating_add(1);
            } else {
                self.found += 1;
                out(self.found_at(read + u64::from(label) + 1, sums));
            }
        }
    }

    /// The component whose completion is found at `clock`.
    fn found_at(&mut self, clock: u64, sums: Sums) -> Found {
        let split = if disc::is_pair(&sums, &self.field) { SPLIT_CLOCKS } else { 0 };
        let out_clock = clock.max(self.divider_free) + DIVIDER_CLOCKS + split;
        self.divider_free = out_clock;
        let last = u64::from(sums.last_line());
        Found {
            sums,
            out_clock,
            latency_clocks: out_clock - (last * LINE_CLOCKS + u64::from(sums.last_x)),
            latency_lines: out_clock / LINE_CLOCKS - last,
            field: self.field,
        }
    }

    /// True if a component is large and bright enough for a blob.
    fn counts(&self, sums: &Sums) -> bool {
        let [left, right, top, bottom] = sums.half_box_px;
        let high = self.settings.high[usize::from(sums.class) % CLASSES];
        sums.contrast >= high
            && sums.w >= u64::from(self.settings.least_area) * u64::from(FULL_WEIGHT)
            && left <= right
            && bottom - top + 1 >= self.settings.least_lines
    }
}

#[cfg(test)]
mod tests;
