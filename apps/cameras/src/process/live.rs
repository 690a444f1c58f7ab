//! The thread that reads one camera of this machine: opens it, brings its pictures with their instants, and
//! waits for it where it was unplugged.

use super::line::{LOOK_MS, Line};
use super::reader::{Pictured, Told};
use crate::device::{Absent, Buffer, Device, Open, Parts, Role, is_gone};
use crate::stamps::Stamps;
use crate::stream::is_black;
use anyhow::{Result, bail};
use fpga_model::input::packed::Layout;
use protocol::time::Nanos;
use rig::sensor::Sensor;
use std::io::ErrorKind;

/// Rounds of [`LOOK_MS`] without a picture after which a camera is closed and opened again, 10 s: one that answers and
/// brings nothing may have been left in a state by the program before, which a new start ends.
const ROUNDS_SILENT: u32 = 200;

/// Reads one camera.
pub(super) struct LiveReader {
    pub(super) opener: Box<dyn Open>,
    pub(super) role: Role,
    pub(super) sensor: Sensor,
    /// Of a field, ns.
    pub(super) period_ns: u64,
    /// The present instant, and by how much the wall clock is ahead of it.
    pub(super) clock: fn() -> (Nanos, u64),
    /// Its pictures begin when somebody triggers them: it may bring nothing for any time.
    pub(super) is_triggered: bool,
    pub(super) line: Line,
}

/// How reading ended.
enum End {
    Unplugged {
        /// It was opened before.
        was_open: bool,
    },
    /// It is open and brings nothing.
    Silent,
    /// The process ends.
    Stopped,
}

/// What is known of a camera since it was opened.
#[derive(Default)]
struct Course {
    stamps: Option<Stamps>,
    /// Damaged frames that were not reported yet.
    damaged: u64,
    /// A picture was reported.
    has_begun: bool,
}

impl LiveReader {
    /// Reads until the process ends.
    pub(super) fn run(mut self) {
        let mut is_away = false;
        loop {
            // A camera that stays away is reported once.
            let (report, is_news) = match self.read() {
                Ok(End::Stopped) => return,
                // Where pictures are awaited, the silence has been reported.
                Ok(End::Silent) => continue,
                Ok(End::Unplugged { was_open }) => (Told::Closed, was_open || !is_away),
                Err(problem) => (Told::Refused(format!("{problem:#}")), true),
            };
            is_away = matches!(report, Told::Closed);
            if is_news && self.line.tell(report).is_err() {
                return;
            }
            self.line.pause();
            if self.line.stopping() {
                return;
            }
        }
    }

    /// Opens the camera and reads it until it is gone.
    fn read(&mut self) -> Result<End> {
        let mut device = match self.opener.open() {
            Err(problem) if problem.is::<Absent>() => return Ok(End::Unplugged { was_open: false }),
            opened => opened?,
        };
        let (settings, note) = device.notes();
        self.line.tell(Told::Opened { is_file: false, settings, note })?;
        let (layout, mut course, mut silent) = (device.layout(), Course::default(), 0);
        while !self.line.stopping() {
            match self.next(&mut *device, &layout, &mut course) {
                Ok(None) if silent == ROUNDS_SILENT && !self.is_triggered => return Ok(End::Silent),
                Ok(None) => silent = ROUNDS_SILENT.min(silent + 1),
                Ok(Some(report)) => {
                    silent = 0;
                    self.line.tell(report)?;
                }
                Err(problem) if problem.downcast_ref().is_some_and(is_gone) => {
                    return Ok(End::Unplugged { was_open: true });
                }
                Err(problem) => return Err(problem),
            }
        }
        Ok(End::Stopped)
    }

    /// What the next buffer brings.
    fn next(&self, device: &mut dyn Device, layout: &Layout, course: &mut Course) -> Result<Option<Told>> {
        match device.next(LOOK_MS) {
            Ok(None) => Ok(None),
            Ok(Some(buffer)) => self.report(&buffer, layout, course).map(Some),
            Err(e) if matches!(e.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => Ok(None),
            Err(e) if is_gone(&e) => Err(e.into()),
            Err(e) => bail!("fails: {e}"),
        }
    }

    fn report(&self, buffer: &Buffer<'_>, layout: &Layout, course: &mut Course) -> Result<Told> {
        let (arrived_ns, wall_ns) = (self.clock)();
        let parts = self.role.parts(layout, buffer.field)?;
        let stamps = course.stamps.get_or_insert_with(|| self.stamps(&parts));
        if let Some(damage) = buffer.damage {
            course.damaged += stamps.pass_over(buffer.sequence) + 1;
            return Ok(Told::Refused(format!("delivered a picture that {damage}; it is dropped")));
        }
        let mut taken = stamps.take(buffer.stamp, buffer.sequence, arrived_ns, wall_ns);
        let mut picture = self.line.picture();
        course.damaged += taken.lost;
        if let Err(problem) = layout.unpack(buffer.bytes, &mut picture) {
            course.damaged += 1;
            return Ok(Told::Refused(format!("delivered a picture that is dropped: {problem}")));
        }
        taken.lost = std::mem::take(&mut course.damaged);
        let is_first = !std::mem::replace(&mut course.has_begun, true);
        let is_black = is_black(&picture);
        let taken = Some(taken);
        Ok(Told::Picture(Box::new(Pictured {
            picture,
            parts,
            arrived_ns,
            is_black,
            is_first,
            before: None,
            taken,
        })))
    }

    /// Instants of pictures with these fields.
    fn stamps(&self, parts: &Parts) -> Stamps {
        let fields = parts.all().len() as u64;
        let before_last_ns = (fields - 1) * self.period_ns;
        let after_start_ns = self.sensor.exposure_ns + self.sensor.lines_ns() + before_last_ns;
        Stamps::new(fields * self.period_ns, after_start_ns)
    }
}

#[cfg(test)]
mod tests;
