//! A pedal's device: which mapping fits it, where it stands when it is opened, and what it brings.

use super::line::{Got, Kind, Line};
use crate::events::{Blocks, Event, EventReader, SYN, SYN_DROPPED};
use crate::inputs::{Input, Inputs, LONGEST_REPORT};
use crate::mapping::{Mapping, SHIPPED, shipped};
use evdev::Device;
use protocol::time::Nanos;
use settings::commands::controls::{PedalInterface, PedalSpec};
use std::collections::VecDeque;
use std::os::fd::OwnedFd;

/// Bytes read at a time.
const BUFFER: usize = 4096;
/// Longest recorded file: a million events.
const LONGEST_FILE: usize = 24 << 20;

/// How a device's bytes are read.
enum Reading {
    Events(EventReader),
    /// Reports that a pipe brings without a border between them.
    Reports(Blocks),
    /// Every read is a report.
    Whole,
}

/// A pedal's device.
pub(crate) struct PedalDevice {
    interface: PedalInterface,
    line: Line,
    reading: Reading,
    /// What its axes and buttons mean; `None` until it is known what it is.
    pub(crate) mapping: Option<Mapping>,
    /// Where they stand.
    pub(crate) inputs: Inputs,
    /// What a recorded file brings, and is to come.
    recorded: VecDeque<Event>,
    /// Instant of the first recorded event on the clock of the process less that of the file, ns.
    recorded_from: Option<Nanos>,
    first_us: i64,
    is_file: bool,
    is_pipe: bool,
    /// Events were lost: it must be asked again where everything stands.
    is_stale: bool,
    /// Keeps others from getting its events.
    grabbed: Option<Device>,
    /// Nothing is known of a device without a mapping but what it sends: for people who look at it.
    needs_mapping: bool,
    /// Events or reports taken in.
    pub(crate) taken: u64,
    /// Reports of another length, events that were torn or lost.
    pub(crate) bad: u64,
    /// It was opened, or something has moved, since this was last looked at.
    pub(crate) has_news: bool,
}

impl PedalDevice {
    /// Nothing is opened yet. Without `mapping` one is chosen where it is opened, if `needs_mapping`.
    pub(crate) fn new(spec: &PedalSpec, mapping: Option<Mapping>, needs_mapping: bool) -> Self {
        let reading = match spec.interface {
            PedalInterface::Evdev => Reading::Events(EventReader::default()),
            PedalInterface::Hidraw => Reading::Whole,
        };
        PedalDevice {
            interface: spec.interface,
            line: Line::new(&spec.path, None),
            reading,
            mapping,
            inputs: Inputs::default(),
            recorded: VecDeque::new(),
            recorded_from: None,
            first_us: 0,
            is_file: false,
            is_pipe: false,
            is_stale: false,
            grabbed: None,
            needs_mapping,
            taken: 0,
            bad: 0,
            has_news: false,
        }
    }

    pub(crate) fn interface(&self) -> PedalInterface {
        self.interface
    }

    pub(crate) fn line(&self) -> &Line {
        &self.line
    }

    /// Whether it is open, or a recorded file is not over.
    pub(crate) fn is_there(&self) -> bool {
        self.line.is_open() || !self.recorded.is_empty()
    }

    /// Whether it is a recorded file.
    pub(crate) fn is_file(&self) -> bool {
        self.is_file
    }

    /// Whether it is a pipe: its writer comes later, or never.
    pub(crate) fn is_pipe(&self) -> bool {
        self.is_pipe
    }

    /// Opens it where it is closed and it is time to try; returns whether it was opened.
    ///
    /// # Errors
    /// Why it cannot be used, in words that follow its name.
    pub(crate) fn open_if_due(&mut self, now: Nanos) -> Result<bool, String> {
        if !self.line.is_due(now) || self.is_file {
            return Ok(false);
        }
        let (kind, fd) = self.line.open(now)?;
        let opened = self.begin(kind, fd);
        if opened.is_err() {
            self.line.close();
        }
        // A pipe that is opened again says nothing until its next writer does.
        self.has_news |= opened.is_ok() && (!self.is_pipe || self.line.openings == 1);
        opened.map(|()| true)
    }

    fn begin(&mut self, kind: Kind, fd: OwnedFd) -> Result<(), String> {
        self.inputs.let_go();
        self.is_pipe = kind == Kind::Pipe;
        match (self.interface, kind) {
            (PedalInterface::Evdev, Kind::Device) => self.ask(fd)?,
            (PedalInterface::Evdev, _) => self.is_file = kind == Kind::File,
            (PedalInterface::Hidraw, Kind::File) => {
                return Err("is a file, and reports carry no times: write it into a pipe".into());
            }
            (PedalInterface::Hidraw, _) => {
                let bytes = self.mapping.as_ref().and_then(|m| m.report).map(|shape| shape.bytes);
                self.reading = match (kind, bytes) {
                    (Kind::Pipe, Some(bytes)) => Reading::Reports(Blocks::of(bytes)),
                    _ => Reading::Whole,
                };
            }
        }
        if let Reading::Events(reader) = &mut self.reading {
            self.bad += u64::from(reader.forget());
        }
        let Some(mapping) = &self.mapping else {
            let problem = "does not describe its axes: give a mapping, evdev:PATH,MAPPING";
            return if self.needs_mapping { Err(problem.into()) } else { Ok(()) };
        };
        match mapping.without_range(&self.inputs) {
            Some(input) => Err(format!(
                "reports no range of {input}: give one in the mapping (range = [RELEASED, PRESSED])"
            )),
            None => Ok(()),
        }
    }

    /// Asks the kernel for ranges and where everything stands, chooses a mapping where none is given, and
    /// keeps the events to itself where the mapping wants it.
    fn ask(&mut self, fd: OwnedFd) -> Result<(), String> {
        let refused = |e: std::io::Error| format!("is not an input device of the kernel: {e}");
        let mut device = Device::from_fd(fd).map_err(refused)?;
        for (axis, about) in device.get_absinfo().map_err(refused)? {
            let input = Input::Axis(axis.0);
            self.inputs.set(input, about.value().into());
            self.inputs.set_range(input, [about.minimum().into(), about.maximum().into()]);
        }
        for key in &device.get_key_state().map_err(refused)? {
            self.inputs.set(Input::Key(key.0), 1);
        }
        if self.mapping.is_none() && self.needs_mapping {
            self.mapping = Some(fitting(&device)?);
        }
        if self.mapping.as_ref().is_some_and(|mapping| mapping.grab) {
            device
                .grab()
                .map_err(|e| format!("cannot be grabbed, so that other programs do not receive it: {e}"))?;
            self.grabbed = Some(device);
        }
        Ok(())
    }

    /// Takes in what has come by `now`; returns whether it has gone away. A recorded file is played from
    /// `run_from` on, if that is known.
    pub(crate) fn take(&mut self, now: Nanos, run_from: Option<Nanos>) -> bool {
        let mut buffer = [0; BUFFER];
        let room = if self.interface == PedalInterface::Hidraw { LONGEST_REPORT } else { BUFFER };
        let mut gone = false;
        // At most the capacity of a pipe: an endless writer does not block this thread.
        for _ in 0..16 {
            match self.line.read(&mut buffer[..room]) {
                Got::Nothing => break,
                Got::Bytes(bytes) => self.take_bytes(&buffer[..bytes]),
                Got::Closed => {
                    (gone, self.grabbed) = (!self.is_file, None);
                    break;
                }
            }
        }
        if std::mem::take(&mut self.is_stale) {
            (_, self.grabbed) = (self.line.close(), None);
            self.line.retry_at_once();
        }
        self.play(now, run_from);
        gone
    }

    fn take_bytes(&mut self, bytes: &[u8]) {
        let PedalDevice { inputs, recorded, mapping, taken, bad, has_news, is_stale, .. } = self;
        let shape = mapping.as_ref().and_then(|m| m.report);
        let mut report = |report: &[u8]| match shape {
            Some(shape) if report.len() != shape.bytes => *bad += 1,
            // Another report of the same device.
            Some(shape) if shape.id.is_some_and(|id| report[0] != id) => {}
            _ => {
                inputs.note_report(report);
                (*taken, *has_news) = (*taken + 1, true);
            }
        };
        match &mut self.reading {
            Reading::Whole => report(bytes),
            Reading::Reports(blocks) => blocks.take(bytes, report),
            Reading::Events(reader) if self.is_file => reader.take(bytes, |event| {
                if recorded.len() * size_of::<Event>() < LONGEST_FILE {
                    recorded.push_back(event);
                }
            }),
            Reading::Events(reader) => reader.take(bytes, |event| {
                if event.kind == SYN && event.code == SYN_DROPPED {
                    (*bad, *is_stale) = (*bad + 1, true);
                }
                if inputs.note(event) {
                    (*taken, *has_news) = (*taken + 1, true);
                }
            }),
        }
    }

    /// Plays what is due of a recorded file, with the spacing of its instants.
    fn play(&mut self, now: Nanos, run_from: Option<Nanos>) {
        let Some(from) = self.recorded_from.or(run_from) else { return };
        if self.recorded_from.is_none() {
            let Some(first) = self.recorded.front() else { return };
            (self.recorded_from, self.first_us) = (Some(from), first.at_us);
        }
        let due_us = self.first_us.saturating_add((now.saturating_sub(from) / 1_000) as i64);
        while let Some(event) = self.recorded.pop_front_if(|event| event.at_us <= due_us) {
            if self.inputs.note(event) {
                (self.taken, self.has_news) = (self.taken + 1, true);
            }
        }
    }
}

/// The shipped mapping that names nothing which a device has not.
fn fitting(device: &Device) -> Result<Mapping, String> {
    let has = |input: Input| match input {
        Input::Axis(code) => {
            device.supported_absolute_axes().is_some_and(|all| all.contains(evdev::AbsoluteAxisCode(code)))
        }
        Input::Key(code) => device.supported_keys().is_some_and(|all| all.contains(evdev::KeyCode(code))),
        Input::Bits { .. } => false,
    };
    let all = SHIPPED.iter().filter_map(|(name, _)| shipped(name));
    // A real keyboard has every key of a foot switch and must not be grabbed from other programs.
    let mut fit = all.filter(|m| {
        m.interface == PedalInterface::Evdev && !m.grab && m.axes.iter().all(|map| has(map.input))
    });
    fit.next().ok_or_else(|| "fits none of the shipped mappings: give one, evdev:PATH,MAPPING".into())
}

#[cfg(test)]
mod tests;
