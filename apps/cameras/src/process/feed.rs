//! One camera: what its reader has brought, which numbers its fields have, and how it stands.

mod field;

pub(crate) use field::Field;

use super::line::Line;
use super::live::LiveReader;
use super::reader::{Pictured, Reader, Told};
use super::recorded::RecordedReader;
use crate::condition::{Condition, Kind, Trouble};
use crate::device::v4l2::Opener;
use crate::device::{Open, Role};
use crate::stream::Expected;
use crate::tally::Tally;
use crate::timing::{Clock, Numbering, Place};
use anyhow::{Context, Result, ensure};
use fpga_model::input::Picture;
use ipc::BellRope;
use protocol::condition::ProblemKind;
use protocol::deliveries::Delivery;
use protocol::fields::{FORMAT_YCBCR_422, FieldHeader};
use protocol::time::Nanos;
use rig::Rig;
use rig::camera::Camera;
use rig::region;
use rig::sensor::{Scan, Sensor as OfRig};
use settings::commands::cameras::{Stream, StreamKind, Trigger};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};

/// A source that has brought nothing for so many periods is silent.
const SILENT_PERIODS: u64 = 10;
/// Time before a source that has delivered nothing yet is reported, ns.
const AWAITED_NS: u64 = 500_000_000;
/// Time of nothing but black pictures after which a camera counts as black, ns.
const BLACK_NS: u64 = 1_000_000_000;
/// Time for which a camera with an impossible timestamp is reported, ns.
const ODD_NS: u64 = 1_000_000_000;
/// Late fields in a row after which a camera is slow, and fields in time after which it is not.
const SLOW_AFTER: u32 = 3;
const IN_TIME_AFTER: u32 = 25;

/// Error for GenICam cameras in a build without them.
#[cfg(not(feature = "genicam"))]
pub(crate) const NO_GENICAM: &str = "this vitreo was built without support for GenICam cameras. With aravis installed (Debian: \
    libaravis-dev, libusb-1.0-0-dev), build it by: cargo build --release --features cameras/genicam (docs/cameras.md)";

/// A picture whose fields are not all published.
struct Held {
    pictured: Box<Pictured>,
    /// Fields that were taken.
    taken: usize,
}

/// What the rig says of a camera's fields.
struct Sensor {
    of_rig: OfRig,
    /// Pixels a line; even.
    width: u32,
    /// Lines in which markers can appear.
    lines: u32,
}

impl Sensor {
    fn header(&self, read_out_ns: Nanos, number: u64, parity: u32) -> FieldHeader {
        FieldHeader {
            field: number,
            exposed_ns: read_out_ns.saturating_sub(self.of_rig.read_out_ns()),
            first_line_ns: read_out_ns.saturating_sub(self.of_rig.lines_ns()),
            line_period_ns: self.of_rig.line_ns,
            camera: self.of_rig.camera,
            parity,
            format: FORMAT_YCBCR_422,
            width: self.width,
            height: self.of_rig.lines(),
            lines: self.lines,
        }
    }
}

/// What a reader must know.
struct Reading<'a> {
    camera: &'a Camera,
    of_rig: OfRig,
    stream: &'a Stream,
}

impl Reading<'_> {
    /// What the thread of the reader does.
    fn reader(&self, line: Line) -> Result<Box<dyn FnOnce() + Send>> {
        let Reading { camera, of_rig, stream } = self;
        let (frame_px, scan, path) = (camera.size_px, of_rig.scan, stream.path.clone());
        let has_parity = stream.parity.is_some();
        let expected = Expected { frame_px, scan, field_hz: 1e9 / of_rig.period_ns as f64, has_parity };
        if stream.kind == StreamKind::Y4m {
            let reader = Reader { path, expected, line };
            return Ok(Box::new(move || reader.run()));
        }
        if stream.kind == StreamKind::Mcap {
            let reader = RecordedReader { path, camera: camera.id, expected, line };
            return Ok(Box::new(move || reader.run()));
        }
        let whole = scan == Scan::Progressive;
        ensure!(!(whole && has_parity), "{stream}: whole frames have all lines: omit ?parity");
        let believed_us = of_rig.exposure_ns / 1_000;
        if let Some(us) = stream.wanted.exposure_us.filter(|us| u64::from(*us) != believed_us) {
            tracing::warn!(
                "{stream}: exposure {us} µs; the tracker uses the rig's exposure_ns, {believed_us} µs: \
                 correct one of them"
            );
        }
        let opener = self.opener()?;
        let clock = || (ipc::clock::now(), ipc::clock::realtime_offset_ns());
        let (role, period_ns) = (Role { frame_px, scan }, of_rig.period_ns);
        let is_triggered = stream.wanted.trigger == Some(Trigger::External);
        let reader = LiveReader { opener, role, sensor: *of_rig, period_ns, clock, is_triggered, line };
        Ok(Box::new(move || reader.run()))
    }
}

impl Reading<'_> {
    /// How the camera is opened.
    fn opener(&self) -> Result<Box<dyn Open>> {
        let Reading { camera, of_rig, stream } = self;
        let (frame_px, format, hz) = (camera.size_px, of_rig.format, 1e9 / of_rig.period_ns as f64);
        let (interlaced, wanted) = (of_rig.scan == Scan::Interlaced, stream.wanted);
        if stream.kind == StreamKind::V4l2 {
            let path = stream.path.clone();
            return Ok(Box::new(Opener { path, frame_px, format, hz, interlaced, wanted }));
        }
        #[cfg(feature = "genicam")]
        {
            let name = stream.path.display().to_string();
            Ok(Box::new(crate::device::genicam::Opener { name, frame_px, format, hz, interlaced, wanted }))
        }
        #[cfg(not(feature = "genicam"))]
        anyhow::bail!("{stream}: {NO_GENICAM}")
    }
}

/// One camera.
pub(crate) struct Feed {
    sensor: Sensor,
    pub(crate) source: String,
    is_device: bool,
    period_ns: u64,
    first_parity: u32,
    inbox: Receiver<Told>,
    spare: Sender<Picture>,
    held: Option<Held>,
    numbering: Numbering,
    pub(crate) tally: Tally,
    pub(crate) condition: Condition,
    /// What its camera was set to, in words.
    settings: String,
    /// When its camera's stamp could not be true last.
    odd_ns: Nanos,
    /// `None` while nothing is known of it.
    is_file: Option<bool>,
    /// A file is over, or defective for this reason.
    over: Option<Option<String>>,
    refusal: Option<String>,
    is_closed: bool,
    begun_ns: Nanos,
    /// When the newest picture was taken in.
    newest_ns: Nanos,
    black_since: Option<Nanos>,
    late_in_a_row: u32,
    in_time_in_a_row: u32,
    is_slow: bool,
}

impl Feed {
    /// Starts to read the source of a camera.
    pub(crate) fn start(
        rig: &Rig,
        camera: &Camera,
        stream: &Stream,
        rope: BellRope,
        stop: &Arc<AtomicBool>,
        begun_ns: Nanos,
    ) -> Result<Self> {
        let of_rig = rig.sensor(camera.id);
        let [width, height] = of_rig.field_size()?;
        let (outbox, inbox) = sync_channel(1);
        let (spare, spares) = channel();
        let reading = Reading { camera, of_rig, stream };
        let reader = reading.reader(Line { outbox, spare: spares, rope, stop: Arc::clone(stop) })?;
        let thread = std::thread::Builder::new().name(format!("camera-{}", camera.id));
        thread.spawn(reader).context("a thread for a camera")?;
        let source = stream.to_string();
        let lines = region::lines(rig, camera).min(height) as u32;
        Ok(Feed {
            sensor: Sensor { of_rig, width: width as u32, lines },
            condition: Condition::new(format!("camera {} ({source})", camera.id)),
            source,
            period_ns: of_rig.period_ns,
            is_device: stream.kind.is_camera(),
            first_parity: stream.parity.unwrap_or(0),
            inbox,
            spare,
            held: None,
            numbering: Numbering::default(),
            tally: Tally::default(),
            is_file: None,
            over: None,
            refusal: None,
            is_closed: false,
            begun_ns,
            newest_ns: 0,
            black_since: None,
            late_in_a_row: 0,
            in_time_in_a_row: 0,
            is_slow: false,
            settings: String::new(),
            odd_ns: 0,
        })
    }

    /// A clock for this camera alone, which begins at `start_ns`.
    pub(crate) fn own_clock(&self, start_ns: Nanos) -> Clock {
        Clock { start_ns, period_ns: self.period_ns, lines_ns: self.sensor.of_rig.lines_ns(), patience_ns: 0 }
    }

    /// Its id in the rig.
    pub(crate) fn camera(&self) -> u32 {
        self.sensor.of_rig.camera
    }

    /// What its camera was set to, in words; empty where nothing was asked for.
    pub(crate) fn settings(&self) -> &str {
        &self.settings
    }

    /// Takes in what the reader has brought, up to a picture that waits for its instant.
    pub(crate) fn listen(&mut self, now: Nanos) {
        while self.held.is_none() {
            let Ok(report) = self.inbox.try_recv() else { return };
            match report {
                Told::Opened { is_file, settings, note } => {
                    (self.is_file, self.settings) = (Some(is_file), settings);
                    if let Some(note) = note {
                        tracing::warn!("camera {} ({}) {note}", self.sensor.of_rig.camera, self.source);
                    }
                }
                Told::Picture(pictured) => self.hold(pictured, now),
                Told::Closed => (self.is_closed, self.black_since) = (true, None),
                Told::Refused(why) => self.refusal = Some(why),
                Told::Over(why) => self.over = Some(why),
            }
        }
    }

    fn hold(&mut self, pictured: Box<Pictured>, now: Nanos) {
        (self.refusal, self.is_closed, self.newest_ns) = (None, false, now);
        if pictured.is_first {
            self.numbering.opened();
            self.tally.openings += 1;
        }
        if let Some(taken) = pictured.taken {
            self.tally.lost += taken.lost;
            taken.jitter_ns.into_iter().for_each(|ns| self.tally.jitter.note(ns));
            self.odd_ns = if taken.is_odd { now } else { self.odd_ns };
        }
        self.black_since = pictured.is_black.then(|| self.black_since.unwrap_or(now));
        self.held = Some(Held { pictured, taken: 0 });
    }

    /// Instant of the first picture, while it waits for those of the others: as its camera has stamped it, else `now`.
    /// A picture of a pipe that came while the process was busy is not late.
    pub(crate) fn first_ready(&self, now: Nanos) -> Option<Nanos> {
        self.held.as_ref().map(|held| held.pictured.taken.map_or(now, |t| t.read_out_ns))
    }

    /// Before the start, a camera shows its newest picture: those before it are of no use.
    pub(crate) fn renew(&mut self, now: Nanos) {
        let is_live = |held: &mut Held| held.pictured.taken.is_some();
        while let Some(held) = self.held.take_if(is_live) {
            self.listen(now);
            if self.held.is_none() {
                self.held = Some(held);
                return;
            }
            // A reader that is gone needs none.
            let _ = self.spare.send(held.pictured.picture);
        }
    }

    /// The clock of all cameras at the rate of this one.
    fn own(&self, clock: &Clock) -> Clock {
        Clock { period_ns: self.period_ns, ..*clock }
    }

    /// When the field is read out that is still to come, of a camera from which one is expected.
    pub(crate) fn awaited(&self, clock: &Clock) -> Option<Nanos> {
        let expected = self.held.is_none() && self.over.is_none() && self.condition.trouble().is_none();
        expected.then(|| self.next(clock))
    }

    /// When there is a field to be published; `awaited` is the read-out of the first one that is still to come.
    pub(crate) fn due(&self, clock: &Clock, awaited: Nanos) -> Option<Nanos> {
        let (held, clock) = (self.held.as_ref()?, &self.own(clock));
        Some(match held.read_out(clock.period_ns) {
            Some(read_out) => self.numbering.stamped_due(clock, read_out, awaited),
            None => self.numbering.due(clock, clock.read_out(self.numbering.next()) < awaited),
        })
    }

    /// When the camera's next field is read out.
    pub(crate) fn next(&self, clock: &Clock) -> Nanos {
        self.own(clock).read_out(self.numbering.next())
    }

    /// Publishes by `send` every field that is due; `awaited` is the read-out of the first one that is still to come
    /// from another camera.
    pub(crate) fn publish(
        &mut self,
        clock: &Clock,
        awaited: Nanos,
        now: Nanos,
        mut send: impl FnMut(&Field<'_>) -> Result<()>,
    ) -> Result<()> {
        let clock = &self.own(clock);
        while self.due(clock, awaited).is_some_and(|due| due <= now) {
            let Some(held) = &mut self.held else { return Ok(()) };
            let (pictured, i) = (&held.pictured, held.taken);
            // The second field of a frame comes a period after the first, as the camera took it.
            let arrived = pictured.arrived_ns + i as u64 * clock.period_ns;
            let stamped = held.read_out(clock.period_ns);
            let place = match stamped {
                Some(at) => self.numbering.place_stamped(clock, at, pictured.arrived_ns, now),
                None => self.numbering.place(clock, arrived, now),
            };
            let (part, parts) = (pictured.parts.all()[i], pictured.parts.all().len());
            if let Place::Taken { number, delay_ns } = place {
                // Whoever opens a pipe anew begins with the first field of a frame, whatever its number is here.
                let before = pictured.before.unwrap_or(number);
                let by_count = || self.sensor.of_rig.parity(before, self.first_parity);
                let parity = part.parity.unwrap_or_else(by_count);
                let read_out_ns = stamped.unwrap_or_else(|| clock.read_out(number));
                let header = self.sensor.header(read_out_ns, number, parity);
                send(&Field { header, picture: &pictured.picture, lines: part.lines })?;
                self.tally.put_out(number, delay_ns);
            }
            held.taken += 1;
            let is_done = held.taken == parts;
            self.note_pace(place);
            if is_done && let Some(held) = self.held.take() {
                // A reader that is gone needs none.
                let _ = self.spare.send(held.pictured.picture);
                self.listen(now);
            }
        }
        Ok(())
    }

    fn note_pace(&mut self, place: Place) {
        if matches!(place, Place::Before | Place::Surplus) {
            self.tally.surplus += u64::from(place == Place::Surplus);
            return;
        }
        if place == Place::Late {
            (self.late_in_a_row, self.in_time_in_a_row) = (self.late_in_a_row + 1, 0);
            self.tally.late += 1;
        } else {
            (self.late_in_a_row, self.in_time_in_a_row) = (0, self.in_time_in_a_row.saturating_add(1));
        }
        self.is_slow |= self.late_in_a_row >= SLOW_AFTER;
        self.is_slow &= self.in_time_in_a_row < IN_TIME_AFTER;
    }

    /// True if nothing more will come and nothing waits.
    pub(crate) fn is_over(&self) -> bool {
        self.over.is_some() && self.held.is_none()
    }

    /// True of a pipe that its writer has closed, with nothing left of it.
    pub(crate) fn is_closed_pipe(&self) -> bool {
        self.is_closed && self.held.is_none() && !self.is_device
    }

    /// Why a file cannot be used, if that is so.
    pub(crate) fn defect(&self) -> Option<&str> {
        self.over.as_ref()?.as_deref()
    }

    /// True for a file, from which nothing comes by itself.
    pub(crate) fn is_file(&self) -> bool {
        self.is_file == Some(true)
    }

    /// What is wrong with it at `now`.
    pub(crate) fn trouble(&self, started: bool, now: Nanos) -> Option<Trouble> {
        let trouble = |kind, text: &str| Some(Trouble::new(kind, text));
        let since = |instant: Nanos| now.saturating_sub(instant);
        let never = self.newest_ns == 0;
        match (&self.over, &self.refusal) {
            (Some(Some(why)), _) => return trouble(Kind::Refused, why),
            (Some(None), _) if self.held.is_none() => {
                return trouble(Kind::Over, "has reached the end of its file");
            }
            (None, Some(why)) => return trouble(Kind::Refused, why),
            _ => {}
        }
        if never {
            let what = match self.is_device {
                true if self.is_closed => "is not ready: there is no such device; waiting for it",
                true => "is not ready: its device has delivered no picture yet",
                false => "is not ready: no program has written a picture into its pipe yet",
            };
            return (since(self.begun_ns) >= AWAITED_NS).then(|| trouble(Kind::Awaited, what)).flatten();
        }
        if self.is_closed && self.held.is_none() && self.is_device {
            return trouble(Kind::Unplugged, "is unplugged; waiting for it");
        }
        if self.is_closed && self.held.is_none() {
            return trouble(Kind::Closed, "was closed by its writer; waiting for the next");
        }
        if started && self.held.is_none() && since(self.newest_ns) >= SILENT_PERIODS * self.period_ns {
            let what = match self.is_device {
                true => "delivers nothing although it is connected: check its cable and trigger",
                false => "delivers nothing although its pipe is open",
            };
            return trouble(Kind::Silent, what);
        }
        if self.is_slow {
            return trouble(Kind::Slow, "delivers pictures too late; late ones are dropped");
        }
        if self.odd_ns > 0 && since(self.odd_ns) < ODD_NS {
            return trouble(
                Kind::Stamps,
                "delivers implausible timestamps; the arrival times of its pictures are used",
            );
        }
        let black = self.black_since.is_some_and(|black| since(black) >= BLACK_NS);
        black
            .then(|| trouble(Kind::Black, "delivers only black pictures: check cap, light and gain"))
            .flatten()
    }

    /// Its figures so far; `reached` is the read-out that all cameras have reached.
    pub(crate) fn delivery(&self, clock: &Clock, reached: Nanos) -> Delivery {
        let reached = self.own(clock).first_from(reached);
        let counts = self.condition.counts().filter(|(k, _)| !matches!(k, Kind::Awaited | Kind::Over));
        Delivery {
            camera: self.sensor.of_rig.camera,
            source: self.source.clone(),
            fields: self.tally.fields,
            late: self.tally.late,
            missing: self.tally.missing(reached),
            openings: self.tally.openings,
            delay_ms: self.tally.delays.delays(),
            surplus: self.tally.surplus,
            lost: self.tally.lost,
            jitter_ms: self.tally.jitter.delays(),
            settings: self.settings.clone(),
            troubles: counts.map(|(kind, n)| (kind.name().into(), n)).collect(),
            trouble: self.condition.text().into(),
        }
    }
}

impl Held {
    /// When its next field was read out, where its camera says it.
    fn read_out(&self, period_ns: u64) -> Option<Nanos> {
        let further = (self.pictured.parts.all().len() - 1 - self.taken) as u64;
        self.pictured.taken.map(|taken| taken.read_out_ns.saturating_sub(further * period_ns))
    }
}

#[cfg(test)]
mod tests;
