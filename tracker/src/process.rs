//! The process: fields in, frames out. The only module that knows the clock and the transport.

use crate::assembler::{ClosedFrame, FrameAssembler};
use crate::config::Config;
use crate::rig_check;
use crate::script::FieldStore;
use crate::tracker::{Reference, Tracker, close};
use anyhow::Context;
use ipc::clock::now;
use ipc::shell::Shell;
use ipc::{Queue, Receiver, Sender, Wakes, wait};
use protocol::blobs::BlobField;
use protocol::control::{Command, FrameScript, Request};
use protocol::health::{Process, STATE_RUNNING};
use protocol::limits::MAX_WAIT_MS;
use protocol::message::Message;
use protocol::poses::{ClosedBy, TrackerFrame};
use protocol::rig::Rig;
use protocol::time::Nanos;

/// Runs until it is told to end.
pub fn run(config: &Config) -> anyhow::Result<()> {
    let rig = Rig::load_or_shipped(config.rig.as_deref())?;
    rig_check::check(&rig).context("this rig cannot work")?;
    let (instance, shell) = Shell::start(Process::Tracker, &config.shell).context("cannot start")?;
    let mut tracking = Tracking {
        blobs: instance.receiver(Queue::InOrder)?,
        scripts: instance.receiver(Queue::InOrder)?,
        poses: instance.sender()?,
        shell,
        assembler: FrameAssembler::new(&rig),
        tracker: Tracker::with(&rig, !config.fixed_rig),
        store: FieldStore::default(),
        script: None,
        clock: if config.stream_clock { Clock::Stream(0) } else { Clock::System },
        scripted: config.script,
        drift_told: false,
    };
    tracking.shell.report.state = STATE_RUNNING;
    tracking.shell.beat_now(now())?;
    while !tracking.shell.stopping() {
        let sources: [&dyn Wakes; 3] = [&tracking.blobs, &tracking.scripts, tracking.shell.control()];
        wait(&sources, tracking.time_to_wait());
        tracking.take_fields()?;
        tracking.follow_scripts()?;
        tracking.report();
        if let Some((request, command)) = tracking.shell.serve(now())? {
            tracking.obey(&request, command)?;
        }
    }
    Ok(())
}

/// Whose time decides about time-outs.
#[derive(Debug, Clone, Copy)]
enum Clock {
    /// The system's.
    System,
    /// The newest instant at which a field of the stream was received.
    Stream(Nanos),
}

struct Tracking {
    blobs: Receiver<BlobField>,
    scripts: Receiver<FrameScript>,
    poses: Sender<TrackerFrame>,
    shell: Shell,
    assembler: FrameAssembler,
    tracker: Tracker,
    store: FieldStore,
    /// A script whose fields have not all come.
    script: Option<FrameScript>,
    clock: Clock,
    scripted: bool,
    drift_told: bool,
}

impl Tracking {
    /// Until the next deadline, ns; a poll rounds up to whole milliseconds of its own accord.
    fn time_to_wait(&self) -> u64 {
        let longest = MAX_WAIT_MS * 1_000_000;
        match (self.clock, self.scripted) {
            (Clock::System, false) => {
                let at = now();
                self.assembler.deadline(at).map_or(longest, |d| d.saturating_sub(at).min(longest))
            }
            _ => longest,
        }
    }

    /// Takes in all fields that have come, and closes frames.
    fn take_fields(&mut self) -> anyhow::Result<()> {
        while let Some(field) = self.blobs.next_valid()? {
            if self.scripted {
                self.store.push(&field);
                continue;
            }
            let at = self.advance_clock(&field)?;
            // A refusal is counted in the assembler and told with every frame.
            if let Err(refusal) = self.assembler.push(&field, at) {
                tracing::debug!(field = field.field, camera = field.camera, "field refused: {refusal}");
            }
            while let Some(closed) = self.assembler.complete(at) {
                self.publish(&closed)?;
            }
        }
        if matches!(self.clock, Clock::System) && !self.scripted {
            self.expire(now())?;
        }
        Ok(())
    }

    /// The instant at which a field comes in. On a stream's clock, frames whose wait ended before
    /// that are closed first.
    fn advance_clock(&mut self, field: &BlobField) -> anyhow::Result<Nanos> {
        let Clock::Stream(newest) = self.clock else { return Ok(now()) };
        let at = newest.max(field.blobs_out_ns);
        self.clock = Clock::Stream(at);
        self.expire(at)?;
        Ok(at)
    }

    fn expire(&mut self, at: Nanos) -> anyhow::Result<()> {
        while let Some(closed) = self.assembler.expired(at) {
            self.publish(&closed)?;
        }
        Ok(())
    }

    fn publish(&mut self, closed: &ClosedFrame) -> anyhow::Result<()> {
        let taken = if matches!(self.clock, Clock::System) { closed.taken_ns } else { now() };
        let mut frame = self.tracker.track(self.assembler.used(), &closed.reference);
        close(&mut frame, closed.closed_by);
        frame.waited_ns = closed.waited_ns;
        stamp(&mut frame, self.assembler.used(), taken);
        self.send(frame)
    }

    /// Produces the frames that the record names, as far as their fields have come.
    fn follow_scripts(&mut self) -> anyhow::Result<()> {
        loop {
            if self.script.is_none() {
                self.script = self.scripts.next_valid()?;
            }
            let Some(script) = self.script else { return Ok(()) };
            if script.frame == 0 {
                self.tracker.reset();
                self.drift_told = false;
            }
            let Some(used) = self.store.take(&script) else { return Ok(()) };
            let taken = now();
            let reference =
                Reference { camera: script.camera, field: script.field, exposed_ns: script.exposed_ns };
            let mut frame = self.tracker.track(used, &reference);
            close(&mut frame, ClosedBy::from_wire(script.closed_by));
            stamp(&mut frame, used, taken);
            self.script = None;
            self.send(frame)?;
        }
    }

    fn send(&mut self, mut frame: TrackerFrame) -> anyhow::Result<()> {
        let refused = self.assembler.refused().saturating_add(self.blobs.counts().refused as u32);
        frame.fields_refused = refused;
        self.shell.inject_delay();
        frame.instants.tracked = now();
        if let Err(invalid) = frame.validate() {
            // The tracker's own chokepoint: a frame that no one may use is not sent.
            tracing::error!(field = frame.field, frame = frame.frame, "frame withheld: {invalid}");
            self.shell.report.refused += 1;
            return Ok(());
        }
        Ok(self.poses.send(&frame)?)
    }

    /// Says once that the rig has drifted. Seldom enough to be formatted.
    fn tell_drift(&mut self) {
        if let Some(report) = self.tracker.drift().filter(|r| r.detected && !self.drift_told) {
            tracing::warn!("{report}");
            self.drift_told = true;
        }
    }

    fn report(&mut self) {
        self.tell_drift();
        let (blobs, scripts) = (self.blobs.counts(), self.scripts.counts());
        let report = &mut self.shell.report;
        report.received = blobs.received + scripts.received;
        report.sent = self.poses.sent();
        report.lost = blobs.lost + scripts.lost + self.store.dropped();
        let fields = u64::from(self.assembler.refused());
        report.refused = blobs.refused + scripts.refused + fields + self.tracker.blobs_refused();
    }

    fn obey(&mut self, request: &Request, command: Command) -> anyhow::Result<()> {
        let mut result = Ok(());
        match command {
            Command::Reset | Command::Load => {
                self.tracker.reset();
                self.drift_told = false;
                self.assembler.reset();
                self.store.clear();
                self.script = None;
                if let Clock::Stream(newest) = &mut self.clock {
                    *newest = 0;
                }
            }
            Command::Flush => result = self.flush()?,
            Command::Start | Command::Pause | Command::Ping | Command::Shutdown => {}
            Command::Snapshot | Command::Next => {
                result = Err("the tracker has neither picture nor levels".to_owned())
            }
        }
        let answer = match &result {
            Ok(()) => Ok(()),
            Err(reason) => Err(reason.as_str()),
        };
        Ok(self.shell.answer(request, answer)?)
    }

    /// Finishes what is open: everything sent before the request is in the queues by now.
    fn flush(&mut self) -> anyhow::Result<Result<(), String>> {
        self.take_fields()?;
        self.follow_scripts()?;
        let at = if let Clock::Stream(newest) = self.clock { newest } else { now() };
        while let Some(closed) = self.assembler.flush(at) {
            self.publish(&closed)?;
        }
        let Some(script) = self.script else { return Ok(Ok(())) };
        Ok(Err(self.store.missing(&script).map_or_else(String::new, |m| {
            format!("frame {} waits for field {} of camera {}", script.frame, m.field, m.camera)
        })))
    }
}

/// The instants that the fields carry.
fn stamp(frame: &mut TrackerFrame, used: &[BlobField], taken: Nanos) {
    frame.instants.read_out = used.iter().map(|f| f.read_out_ns).max().unwrap_or(0);
    frame.instants.blobs_out = used.iter().map(|f| f.blobs_out_ns).max().unwrap_or(0);
    frame.instants.taken = taken;
}

const _: () = assert!(ClosedBy::Inputs as u32 == 0, "a zeroed frame is closed by its inputs");
