//! Streaming blob extraction, as the camera hardware does it: one line at a time, no frame buffer.
//!
//! Each line is cut into runs of one colour (`runs`); a run joins the components of the same colour that
//! it touches in the line before (eight neighbours), which may unite two of them; a component that no run
//! of the line touched is complete and becomes a blob at once (`parts`). Integers only. What a table has
//! no room for is counted, never wrong: runs beyond [`runs::MAX_RUNS`] a line and components beyond
//! [`LABELS`] at a time are left out.

pub mod parts;
pub mod runs;

use crate::colours::ColourTable;
use crate::picture::FieldPicture;
use parts::{MAX_LINES, MAX_WIDTH, Part};
use protocol::blobs::BlobField;
use runs::{Run, Runs};

/// Components that may be open at a time.
pub const LABELS: usize = 128;
const NO_LABEL: u8 = u8::MAX;

const _: () = assert!(LABELS < NO_LABEL as usize && LABELS <= u128::BITS as usize);
const _: () = assert!(MAX_LINES <= MAX_WIDTH && MAX_WIDTH <= u16::MAX as usize);

/// The extractor of one camera.
pub struct Scanner {
    table: ColourTable,
    size_px: [u16; 2],
    /// Next line.
    y: u16,
    previous: Runs,
    current: Runs,
    parts: [Part; LABELS],
    /// One bit for each open component.
    open: u128,
    /// Runs of which a component found no label in this field.
    unlabelled: u32,
}

impl Scanner {
    /// An extractor for fields of `width` × `height` px.
    ///
    /// # Panics
    /// Beyond [`MAX_WIDTH`] × [`MAX_LINES`], which no rig may ask for.
    pub fn new(table: ColourTable, width: usize, height: usize) -> Self {
        assert!((1..=MAX_WIDTH).contains(&width) && (1..=MAX_LINES).contains(&height), "{width} × {height}");
        Scanner {
            table,
            size_px: [width as u16, height as u16],
            y: 0,
            previous: Runs::default(),
            current: Runs::default(),
            parts: [Part::default(); LABELS],
            open: 0,
            unlabelled: 0,
        }
    }

    /// Extracts a whole field; what could not be followed is added to `blobs_left_out`.
    pub fn scan(&mut self, picture: &FieldPicture, out: &mut BlobField) {
        self.begin();
        for y in 0..picture.height {
            let (luma, blue, red) = picture.line(y);
            self.line(luma, blue, red, out);
        }
        self.end(out);
    }

    /// Begins a field.
    pub fn begin(&mut self) {
        self.y = 0;
        self.open = 0;
        self.unlabelled = 0;
        self.previous = Runs::default();
        self.current = Runs::default();
    }

    /// Takes the next line: luma, and Cb and Cr of every second pixel. Blobs that ended with the line
    /// before go to `out`. Lines beyond the field are passed over.
    pub fn line(&mut self, luma: &[u8], blue: &[u8], red: &[u8], out: &mut BlobField) {
        let width = luma.len().min(2 * blue.len().min(red.len())).min(usize::from(self.size_px[0]));
        if self.y >= self.size_px[1] {
            return;
        }
        self.current.find(&self.table, &luma[..width], blue, red);
        self.label_runs(luma);
        self.emit(|part, y| part.last_line < y, out);
        std::mem::swap(&mut self.previous, &mut self.current);
        self.y += 1;
    }

    /// Ends a field: what is open is complete.
    pub fn end(&mut self, out: &mut BlobField) {
        self.emit(|_, _| true, out);
        let lost = self.unlabelled.saturating_add(self.previous.lost).saturating_add(self.current.lost);
        out.blobs_left_out = out.blobs_left_out.saturating_add(lost);
    }

    /// Gives every run of this line its component.
    fn label_runs(&mut self, luma: &[u8]) {
        let mut first = 0;
        for r in 0..self.current.all().len() {
            let run = self.current.all()[r];
            let above = self.previous.all();
            // Runs that end more than a pixel before this one touch no later run either.
            while above.get(first).is_some_and(|p| p.end < run.start) {
                first += 1;
            }
            let label = self.join_above(&run, first);
            let label = if label == NO_LABEL { self.new_label() } else { label };
            self.current.all_mut()[r].label = label;
            if label == NO_LABEL {
                self.unlabelled = self.unlabelled.saturating_add(1);
                continue;
            }
            let pixels = &luma[usize::from(run.start)..usize::from(run.end)];
            let part = Part::of_run(&self.table, pixels, run.start, self.y, run.class);
            self.add(label, &part);
        }
    }

    /// The component of the runs above that `run` touches, united if there are several.
    fn join_above(&mut self, run: &Run, first: usize) -> u8 {
        let mut label = NO_LABEL;
        for p in first..self.previous.all().len() {
            let above = self.previous.all()[p];
            if above.start > run.end {
                break;
            }
            if above.class != run.class || above.label == NO_LABEL || above.label == label {
                continue;
            }
            label = if label == NO_LABEL { above.label } else { self.unite(label, above.label) };
        }
        label
    }

    fn new_label(&mut self) -> u8 {
        let free = self.open.trailing_ones() as usize;
        if free >= LABELS {
            return NO_LABEL;
        }
        self.open |= 1 << free;
        self.parts[free] = Part::default();
        free as u8
    }

    /// Adds a run's sums to a component.
    fn add(&mut self, label: u8, part: &Part) {
        let own = &mut self.parts[usize::from(label)];
        if own.w == 0 && own.class == 0 {
            *own = *part;
        } else {
            own.add(part);
        }
    }

    /// Makes two components one; the lower label stays.
    fn unite(&mut self, a: u8, b: u8) -> u8 {
        let (kept, freed) = (a.min(b), a.max(b));
        let part = self.parts[usize::from(freed)];
        self.parts[usize::from(kept)].add(&part);
        self.open &= !(1 << freed);
        for run in self.previous.all_mut().iter_mut().chain(self.current.all_mut()) {
            if run.label == freed {
                run.label = kept;
            }
        }
        kept
    }

    /// Turns open components into blobs where `complete` says so.
    fn emit(&mut self, complete: impl Fn(&Part, u16) -> bool, out: &mut BlobField) {
        let mut waiting = self.open;
        while waiting != 0 {
            let label = waiting.trailing_zeros() as usize;
            waiting &= waiting - 1;
            if complete(&self.parts[label], self.y) {
                self.open &= !(1 << label);
                if let Some(blob) = self.parts[label].blob(self.size_px) {
                    out.push(blob);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
