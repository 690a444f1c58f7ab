//! Streaming blob extraction, as the camera hardware does it: one line at a time, no frame buffer.
//!
//! Each line is cut into runs of one colour that stand out from the background (`background`, `runs`),
//! whose pixels get weights (`weight`). A run joins the components of the same colour that it touches in
//! the line before (eight neighbours), which may unite several of them; a component that no run of the
//! line touched is complete (`labels`, `sums`) and leaves at once as one blob, or two that touch (`disc`).
//! Integers only. What a table has no room for (`limits`) is counted, never wrapped and never wrong: runs
//! beyond the table of a line, components beyond the labels, blobs beyond those of a field.
//!
//! A component counts if its brightest pixel stands out by [`Settings::high`], though its pixels need only
//! [`Settings::low`] (a threshold with hysteresis), and if it is large enough.

pub mod background;
pub mod disc;
pub mod labels;
pub mod limits;
pub mod runs;
pub mod sums;
pub mod weight;

use crate::colours::{CLASSES, ColourTable, DARK};
use crate::picture::FieldPicture;
use background::{Background, Level};
use disc::{Discs, FieldShape};
use labels::Labels;
use limits::{
    CAMERA, DIVIDER_CLOCKS, FULL_WEIGHT, LEVEL_BITS, LINE_CLOCKS, Limits, PICTURE, RUN_CLOCKS, UNION_CLOCKS,
};
use protocol::blobs::{BlobField, Colour};
use runs::{NO_LABEL, Run, Runs};
use sums::Sums;

/// Grey levels above the background of a pixel that may belong to a marker: the darkest marker (blue) has
/// about 65, noise of 4 σ stays below 12.
const LOW: u8 = 16;
/// Grey levels that the brightest pixel of a coloured component has to have.
const HIGH: u8 = 24;
/// The same for white, which no chroma tells from a reflection.
const HIGH_WHITE: u8 = 120;
/// Least area of a blob, px: an eighth of the smallest marker of the shipped rig.
const LEAST_AREA: u16 = 6;

/// How a camera extracts.
#[derive(Clone)]
pub struct Settings {
    /// Sizes of the tables.
    pub limits: Limits,
    /// Which chroma is which class.
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
}

impl Default for Settings {
    /// The camera hardware before the mechanical eye.
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
    /// When it leaves, pixel clocks after the first pixel of the field.
    pub out_clock: u64,
    /// Pixel clocks since its last pixel was read.
    pub latency_clocks: u64,
    /// Lines begun since its last line.
    pub latency_lines: u64,
    field: FieldShape,
}

impl Found {
    /// The blob, or the two touching ones, that it is.
    pub fn blobs(&self) -> Discs {
        disc::discs(&self.sums, &self.field)
    }
}

/// What was left out of a field.
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
    /// Everything that may be missing from the blobs because a table was full.
    pub fn lost(&self) -> u32 {
        self.runs_lost.saturating_add(self.unlabelled).saturating_add(self.blobs_lost)
    }
}

/// The extractor of one camera.
pub struct Scanner {
    settings: Settings,
    field: FieldShape,
    background: Background,
    /// Next line.
    y: u16,
    previous: Runs,
    current: Runs,
    labels: Labels,
    weights: Vec<u8>,
    tally: Tally,
    found: usize,
    /// Clock at which the divider is free.
    divider_free: u64,
    /// Clock at which the newest line is labelled.
    labelled: u64,
}

impl Scanner {
    /// An extractor for fields of `width` × `height` px.
    ///
    /// # Panics
    /// Beyond the sides in `settings.limits` or [`PICTURE`], which no rig may ask for.
    pub fn new(settings: Settings, width: usize, height: usize) -> Self {
        let limits = settings.limits;
        assert!((1..=limits.width.min(PICTURE.width)).contains(&width), "{width} px in a line");
        assert!((1..=limits.lines.min(PICTURE.lines)).contains(&height), "{height} lines");
        Scanner {
            field: FieldShape { size_px: [width as u16, height as u16], frame_lines: settings.frame_lines },
            background: Background::new(settings.level, settings.low, width, height),
            y: 0,
            previous: Runs::new(limits.runs),
            current: Runs::new(limits.runs),
            labels: Labels::new(limits.labels),
            weights: Vec::with_capacity(width),
            tally: Tally::default(),
            found: 0,
            divider_free: 0,
            labelled: 0,
            settings,
        }
    }

    /// Extracts a whole field; what no table had room for is added to `blobs_left_out`.
    pub fn scan(&mut self, picture: &FieldPicture, out: &mut BlobField) {
        self.begin();
        let mut push = |found: Found| found.blobs().for_each(|blob| out.push(blob));
        for y in 0..picture.height {
            let (luma, blue, red) = picture.line(y);
            self.line(luma, blue, red, &mut push);
        }
        self.end(&mut push);
        out.blobs_left_out = out.blobs_left_out.saturating_add(self.tally.lost());
    }

    /// Begins a field.
    pub fn begin(&mut self) {
        self.y = 0;
        self.labels.clear();
        self.tally = Tally::default();
        (self.found, self.divider_free, self.labelled) = (0, 0, 0);
        for runs in [&mut self.previous, &mut self.current] {
            runs.clear();
            runs.lost = 0;
        }
    }

    /// What was left out since the field began.
    pub fn tally(&self) -> Tally {
        let runs_lost = self.previous.lost.saturating_add(self.current.lost);
        Tally { runs_lost, ..self.tally }
    }

    /// Takes the next line: luma, and Cb and Cr of every second pixel. Components that ended with the
    /// line before go to `out`. Lines and pixels beyond the field are passed over.
    pub fn line(&mut self, luma: &[u8], blue: &[u8], red: &[u8], out: &mut impl FnMut(Found)) {
        let chroma = blue.len().min(red.len());
        let width = luma.len().min(2 * chroma).min(usize::from(self.field.size_px[0]));
        if self.y >= self.field.size_px[1] {
            return;
        }
        let (luma, y) = (&luma[..width], usize::from(self.y));
        self.background.begin_line(y);
        self.current.find(&self.settings.colours, self.background.foreground(), luma, [blue, red]);
        let unions = self.label_runs(luma);
        self.background.watch(y, luma);
        let work = self.current.all().len() as u64 * RUN_CLOCKS + unions * UNION_CLOCKS;
        self.labelled = (u64::from(self.y) + 1) * LINE_CLOCKS + work;
        self.emit(|sums, y| sums.last_line() < y, out);
        self.labelled += self.settings.limits.labels as u64;
        std::mem::swap(&mut self.previous, &mut self.current);
        self.y += 1;
    }

    /// Ends a field: what is open is complete.
    pub fn end(&mut self, out: &mut impl FnMut(Found)) {
        self.emit(|_, _| true, out);
        self.tally = self.tally();
    }

    /// Gives every run of this line its component; returns how many were united.
    fn label_runs(&mut self, luma: &[u8]) -> u64 {
        let (mut first, mut unions) = (0, 0);
        for r in 0..self.current.all().len() {
            let run = self.current.all()[r];
            let above = self.previous.all();
            // Runs that end more than a pixel before this one touch no later run either.
            while above.get(first).is_some_and(|p| p.end < run.start) {
                first += 1;
            }
            let mut label = self.join_above(&run, first, &mut unions);
            if label == NO_LABEL {
                label = self.labels.open().unwrap_or(NO_LABEL);
            }
            self.current.set_label(r, label);
            if label == NO_LABEL {
                self.tally.unlabelled = self.tally.unlabelled.saturating_add(1);
            } else {
                let part = self.sums_of(&run, luma);
                self.labels.add(label, &part);
            }
        }
        unions
    }

    /// The component of the runs above that `run` touches, united if there are several.
    fn join_above(&mut self, run: &Run, first: usize, unions: &mut u64) -> u16 {
        let mut label = NO_LABEL;
        for p in first..self.previous.all().len() {
            let above = self.previous.all()[p];
            if above.start > run.end {
                break;
            }
            let other = self.previous.labels()[p];
            if above.class != run.class || other == NO_LABEL || other == label {
                continue;
            }
            if label == NO_LABEL {
                label = other;
                continue;
            }
            let (kept, freed) = (label.min(other), label.max(other));
            self.labels.unite(kept, freed);
            self.previous.relabel(freed, kept);
            self.current.relabel(freed, kept);
            label = kept;
            *unions += 1;
        }
        label
    }

    fn sums_of(&mut self, run: &Run, luma: &[u8]) -> Sums {
        let range = usize::from(run.start)..usize::from(run.end);
        let level = self.background.at(range.start.midpoint(range.end));
        let (table, weights) = (&self.settings.colours, &mut self.weights);
        weight::weights(table, luma, range.clone(), run.class, level, weights);
        Sums::of_run(&luma[range], weights, run.start, self.y, run.class, (level >> LEVEL_BITS) as u8)
    }

    /// Hands complete components out. The labels are looked at one a clock; each component then waits for
    /// the divider.
    fn emit(&mut self, complete: impl Fn(&Sums, u16) -> bool, out: &mut impl FnMut(Found)) {
        let y = self.y;
        while let Some((label, sums)) = self.labels.take(|sums| complete(sums, y)) {
            if !self.counts(&sums) {
                self.tally.specks = self.tally.specks.saturating_add(1);
            } else if self.found == self.settings.limits.blobs {
                self.tally.blobs_lost = self.tally.blobs_lost.saturating_add(1);
            } else {
                self.found += 1;
                out(self.found_at(self.labelled + u64::from(label) + 1, sums));
            }
        }
    }

    /// A component that is known to be complete at `clock`.
    fn found_at(&mut self, clock: u64, sums: Sums) -> Found {
        let out_clock = clock.max(self.divider_free) + DIVIDER_CLOCKS;
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

    /// True if a component is a blob.
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
