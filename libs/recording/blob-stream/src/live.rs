//! Blob streams that are read while they are made: bytes as they arrive become fields on this machine's
//! clock. Pure: the instant of arrival is an argument.
//!
//! A line that makes no sense is named and left out; the next one counts again. What a tracker is given is
//! in order: of each camera, exposures come later and field numbers are higher from one to the next.

mod clock;
mod complaints;
mod figures;
mod lines;
mod numbers;
mod silence;

pub use clock::{Begun, ClockMap, Mapped};
pub use complaints::Complaints;
pub use figures::LiveFigures;
use figures::{at_ms, delays};
use hdrhistogram::Histogram;
pub use lines::{LineSplitter, MAX_LINE_BYTES, TooLong};
pub use numbers::FieldNumbers;
pub use silence::{SILENT_NS, Silence};

use crate::{BlobStreamError, parse_line};
use protocol::blobs::BlobField;
use protocol::limits::MAX_CAMERAS;
use protocol::time::Nanos;

/// Longest time between exposure and reception that a stream may claim, ns.
pub const MAX_DELAY_NS: u64 = 10_000_000_000;

/// What a line was.
#[derive(Debug)]
pub enum Heard<'a> {
    /// A field on this machine's clock; read-out and sending are the receiver's to stamp.
    Field(&'a mut BlobField),
    /// Nothing that can be used: which line, what was expected.
    Bad(String),
    /// The stream's clock was tied to this machine's again, for this reason.
    Begun(&'static str),
}

/// A stream that is read while it is made.
#[derive(Debug)]
pub struct LiveStream {
    name: String,
    cameras: [Option<Nanos>; MAX_CAMERAS],
    splitter: LineSplitter,
    clock: ClockMap,
    numbers: FieldNumbers,
    /// Delays of arrival after the stamp, ns.
    jitter: Histogram<u64>,
    /// What has come so far.
    figures: LiveFigures,
}

impl LiveStream {
    /// A stream of these cameras; `name` is for messages.
    pub fn new(name: &str, cameras: impl IntoIterator<Item = u32>) -> Self {
        let mut known = [None; MAX_CAMERAS];
        cameras.into_iter().filter_map(|id| known.get_mut(id as usize).map(|k| *k = Some(0))).for_each(drop);
        LiveStream {
            name: name.into(),
            cameras: known,
            splitter: LineSplitter::default(),
            clock: ClockMap::default(),
            numbers: FieldNumbers::default(),
            jitter: delays(),
            figures: LiveFigures { source: name.into(), ..LiveFigures::default() },
        }
    }

    /// A writer is there.
    pub fn writer_came(&mut self) {
        self.figures.writers += 1;
        self.clock.expect_another();
    }

    /// The writer has gone: what it left of a line counts as one.
    ///
    /// # Errors
    /// Those of `hear`.
    pub fn writer_gone<E>(
        &mut self,
        at: Nanos,
        mut hear: impl FnMut(Heard<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut splitter = std::mem::take(&mut self.splitter);
        let heard = splitter.end(|number, line| self.line(number, line, at, &mut hear));
        self.splitter = splitter;
        heard
    }

    /// Takes what arrived at an instant of this machine's clock; `hear` is given every line.
    ///
    /// # Errors
    /// Those of `hear`.
    pub fn take<E>(
        &mut self,
        bytes: &[u8],
        at: Nanos,
        mut hear: impl FnMut(Heard<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut splitter = std::mem::take(&mut self.splitter);
        let heard = splitter.feed(bytes, |number, line| self.line(number, line, at, &mut hear));
        self.splitter = splitter;
        heard
    }

    /// What has come so far.
    pub fn figures(&self) -> LiveFigures {
        let (jitter_p50_ms, jitter_p99_ms) = (at_ms(&self.jitter, 0.5), at_ms(&self.jitter, 0.99));
        LiveFigures { jitter_p50_ms, jitter_p99_ms, ..self.figures.clone() }
    }

    /// The same without those of the jitter, for who counts along.
    pub fn counts(&mut self) -> &mut LiveFigures {
        &mut self.figures
    }

    fn line<E>(
        &mut self,
        number: u64,
        line: Result<&[u8], TooLong>,
        at: Nanos,
        hear: &mut impl FnMut(Heard<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        if line.is_ok_and(|line| line.trim_ascii().is_empty()) {
            return Ok(());
        }
        self.figures.lines += 1;
        match self.read(number, line) {
            Ok(field) => self.place(number, field, at, hear),
            Err(problem) => {
                self.figures.bad += 1;
                hear(Heard::Bad(problem))
            }
        }
    }

    /// The field of a line, as far as the line alone determines it.
    fn read(&self, number: u64, line: Result<&[u8], TooLong>) -> Result<BlobField, String> {
        let refuse = |problem: String| {
            BlobStreamError::Line { file: self.name.clone(), line: number, problem }.to_string()
        };
        let line = line
            .map_err(|_| refuse(format!("expected at most {MAX_LINE_BYTES} bytes in a line, found more")))?;
        let text = std::str::from_utf8(line.trim_ascii()).map_err(|e| {
            refuse(format!("expected text in UTF-8, found another byte at {}", e.valid_up_to()))
        })?;
        let field = parse_line(text, &self.name, number).map_err(|e| e.to_string())?;
        if !self.cameras.get(field.camera as usize).is_some_and(Option::is_some) {
            return Err(refuse(format!("cam: expected a camera of the rig, found {}", field.camera)));
        }
        delay_defect(&field).map_or(Ok(field), |problem| Err(refuse(problem)))
    }

    /// Puts a field on this machine's clock and in its order.
    fn place<E>(
        &mut self,
        number: u64,
        mut field: BlobField,
        at: Nanos,
        hear: &mut impl FnMut(Heard<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let shift = match self.clock.map(field.blobs_out_ns, at) {
            Mapped::By { shift_ns, late_ns, begun } => {
                self.jitter.saturating_record(late_ns);
                if let Some(begun) = begun {
                    self.figures.time_bases += 1;
                    hear(Heard::Begun(begun.text()))?;
                }
                shift_ns
            }
            Mapped::Doubtful { off_ms } => {
                self.figures.doubtful += 1;
                let (name, lead) = (&self.name, if off_ms > 0 { "ahead" } else { "back" });
                return hear(Heard::Bad(format!(
                    "blob stream {name}, line {number}: t_rx_ns: expected the clock of the lines before, found \
                     {} ms {lead}",
                    off_ms.unsigned_abs()
                )));
            }
        };
        let on_ours = |stamp: u64| (i128::from(stamp) + shift).clamp(1, i128::from(u64::MAX)) as u64;
        (field.exposed_ns, field.blobs_out_ns) = (on_ours(field.exposed_ns), on_ours(field.blobs_out_ns));
        let last = self.cameras[field.camera as usize].get_or_insert(0);
        if field.exposed_ns <= *last {
            self.figures.out_of_order += 1;
            return Ok(());
        }
        *last = field.exposed_ns;
        field.field = self.numbers.next(field.camera as usize, field.field);
        self.figures.fields += 1;
        self.figures.blobs_left_out += u64::from(field.blobs_left_out);
        hear(Heard::Field(&mut field))
    }
}

/// What is wrong with the instants of a field, if anything is.
pub fn delay_defect(field: &BlobField) -> Option<String> {
    let (exposed, received) = (field.exposed_ns, field.blobs_out_ns);
    let in_time = received >= exposed && received - exposed <= MAX_DELAY_NS;
    (!in_time).then(|| {
        format!("expected t_rx_ns at most 10 s after t_ns, found t_ns {exposed}, t_rx_ns {received}")
    })
}

#[cfg(test)]
mod tests;
