//! The thread that reads one camera of this machine: opens it, brings its pictures with their instants, and
//! waits for it where it was unplugged.

use super::reader::{LOOK_MS, Pictured, ROUNDS_REFUSED, Told, pause};
use crate::device::{Absent, Buffer, Device, Open, Parts, Role, is_gone};
use crate::stamps::Stamps;
use crate::stream::is_black;
use anyhow::{Result, anyhow, bail};
use fpga_model::input::Picture;
use fpga_model::input::packed::Layout;
use ipc::BellRope;
use protocol::time::Nanos;
use rig::sensor::Sensor;
use std::io::ErrorKind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender};

/// Reads one camera.
pub(super) struct LiveReader {
    pub(super) opener: Box<dyn Open>,
    pub(super) role: Role,
    pub(super) sensor: Sensor,
    /// Of a field, ns.
    pub(super) period_ns: u64,
    /// The present instant, and by how much the wall clock is ahead of it.
    pub(super) clock: fn() -> (Nanos, u64),
    pub(super) outbox: SyncSender<Told>,
    /// Pictures that are done with, to be filled again.
    pub(super) spare: Receiver<Picture>,
    pub(super) rope: BellRope,
    pub(super) stop: Arc<AtomicBool>,
}

/// How reading ended.
enum End {
    Unplugged {
        /// It was opened before.
        was_open: bool,
    },
    /// The process ends.
    Stopped,
}

/// What is known of a camera since it was opened.
#[derive(Default)]
struct Course {
    stamps: Option<Stamps>,
    /// Damaged frames that were not told yet.
    damaged: u64,
    /// A picture was told.
    has_begun: bool,
}

impl LiveReader {
    /// Reads until the process ends.
    pub(super) fn run(mut self) {
        let mut is_away = false;
        loop {
            // A camera that stays away is told once.
            let (told, is_news) = match self.read() {
                Ok(End::Stopped) => return,
                Ok(End::Unplugged { was_open }) => (Told::Closed, was_open || !is_away),
                Err(problem) => (Told::Refused(format!("{problem:#}")), true),
            };
            is_away = matches!(told, Told::Closed);
            if is_news && self.tell(told).is_err() {
                return;
            }
            (0..ROUNDS_REFUSED).filter(|_| !self.stopping()).for_each(|_| pause());
            if self.stopping() {
                return;
            }
        }
    }

    fn stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Waits where the process is not ready for more; an error where it is gone.
    fn tell(&self, told: Told) -> Result<()> {
        self.outbox.send(told).map_err(|_| anyhow!("nobody listens"))?;
        self.rope.ring();
        Ok(())
    }

    /// Opens the camera and reads it until it is gone.
    fn read(&mut self) -> Result<End> {
        let mut device = match self.opener.open() {
            Err(problem) if problem.is::<Absent>() => return Ok(End::Unplugged { was_open: false }),
            opened => opened?,
        };
        let (settings, note) = device.notes();
        self.tell(Told::Opened { is_file: false, settings, note })?;
        let (layout, mut course) = (device.layout(), Course::default());
        while !self.stopping() {
            match self.next(&mut *device, &layout, &mut course) {
                Ok(None) => {}
                Ok(Some(told)) => self.tell(told)?,
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
            Ok(Some(buffer)) => self.told(&buffer, layout, course).map(Some),
            Err(e) if matches!(e.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => Ok(None),
            Err(e) if is_gone(&e) => Err(e.into()),
            Err(e) => bail!("fails: {e}"),
        }
    }

    fn told(&self, buffer: &Buffer<'_>, layout: &Layout, course: &mut Course) -> Result<Told> {
        let (arrived_ns, wall_ns) = (self.clock)();
        let parts = self.role.parts(layout, buffer.field)?;
        let stamps = course.stamps.get_or_insert_with(|| self.stamps(&parts));
        let mut taken = stamps.take(buffer.stamp, buffer.sequence, arrived_ns, wall_ns);
        let mut picture = self.spare.try_recv().unwrap_or_default();
        let unpacked = match buffer.is_damaged {
            true => Err(anyhow!("marks a picture as damaged")),
            false => layout.unpack(buffer.bytes, &mut picture),
        };
        course.damaged += taken.lost;
        if let Err(problem) = unpacked {
            course.damaged += 1;
            return Ok(Told::Refused(format!("brings a picture that is left out: {problem}")));
        }
        taken.lost = std::mem::take(&mut course.damaged);
        let is_first = !std::mem::replace(&mut course.has_begun, true);
        let is_black = is_black(&picture);
        let taken = Some(taken);
        Ok(Told::Picture(Box::new(Pictured { picture, parts, arrived_ns, is_black, is_first, taken })))
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
