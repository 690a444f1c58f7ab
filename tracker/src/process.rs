//! The process: fields in, frames out. The only module that knows the clock and the transport.

use crate::assembler::{ClosedFrame, FrameAssembler};
use crate::config::Config;
use crate::replay::FieldStore;
use crate::rig_check;
use crate::tracker::{Reference, Tracker, close};
use anyhow::Context;
use ipc::awake::Awake;
use ipc::clock::now;
use ipc::shell::Shell;
use ipc::{Queue, Receiver, Sender, Wakes, wait};
use protocol::blobs::BlobField;
use protocol::control::{Command, RecordedFrame};
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::limits::{FIELD_PERIOD_NS, MAX_FIELDS_USED, MAX_WAIT_MS};
use protocol::message::Message;
use protocol::poses::{ClosedBy, TrackerFrame};
use protocol::rig::Rig;
use protocol::time::Nanos;
use std::collections::VecDeque;

/// Runs the tracker until it is asked to stop.
///
/// # Errors
/// A rig that cannot be read or cannot work; a channel that cannot be opened or fails.
pub fn run(config: &Config) -> anyhow::Result<()> {
    let mut process = TrackerProcess::start(config)?;
    while !process.shell.stopping() {
        process.wait();
        process.receive_fields()?;
        process.replay_frames()?;
        process.report();
        process.serve_control()?;
    }
    Ok(())
}

/// The clock that time-outs are measured by.
#[derive(Debug, Clone, Copy)]
enum Clock {
    /// The system's monotonic clock.
    System,
    /// The newest instant at which a field of the stream was received.
    Stream(Nanos),
}

struct TrackerProcess {
    blobs: Receiver<BlobField>,
    recorded: Receiver<RecordedFrame>,
    poses: Sender<TrackerFrame>,
    shell: Shell,
    assembler: FrameAssembler,
    tracker: Tracker,
    store: FieldStore,
    /// A recorded frame whose fields have not all arrived.
    waiting: Option<RecordedFrame>,
    clock: Clock,
    replay: bool,
    drift_reported: bool,
    restarts_reported: u64,
    /// Frames that were not valid and were not sent.
    withheld: u64,
    awake: Awake,
    /// The newest fields that came during a sleep.
    newest: VecDeque<BlobField>,
    /// Fields passed over after a sleep.
    passed_over: u64,
}

impl TrackerProcess {
    fn start(config: &Config) -> anyhow::Result<Self> {
        let rig = Rig::load_or_shipped(config.rig.as_deref()).context("--rig")?;
        rig_check::check(&rig).context("this rig cannot work")?;
        let (instance, shell) = Shell::start(Process::Tracker, &config.shell).context("cannot start")?;
        let mut process = TrackerProcess {
            blobs: instance.receiver(Queue::InOrder)?,
            recorded: instance.receiver(Queue::InOrder)?,
            poses: instance.sender()?,
            shell,
            assembler: FrameAssembler::new(&rig),
            tracker: Tracker::with(&rig, !config.fixed_rig),
            store: FieldStore::default(),
            waiting: None,
            clock: if config.stream_clock { Clock::Stream(0) } else { Clock::System },
            replay: config.replay,
            drift_reported: false,
            restarts_reported: 0,
            withheld: 0,
            awake: Awake::default(),
            newest: VecDeque::with_capacity(MAX_FIELDS_USED),
            passed_over: 0,
        };
        process.shell.report.state = STATE_RUNNING;
        process.shell.beat_now(now())?;
        Ok(process)
    }

    /// Waits for a message, at most until the assembler's next deadline.
    fn wait(&self) {
        let longest = MAX_WAIT_MS * 1_000_000;
        // A poll rounds up to whole milliseconds of its own accord.
        let timeout_ns = match (self.clock, self.replay) {
            (Clock::System, false) => {
                let at = now();
                self.assembler.deadline(at).map_or(longest, |d| d.saturating_sub(at).min(longest))
            }
            _ => longest,
        };
        let sources: [&dyn Wakes; 3] = [&self.blobs, &self.recorded, self.shell.control()];
        wait(&sources, timeout_ns);
    }

    /// After a sleep: passes over the fields of the past, so that no pose of it goes out as the
    /// present. They count as lost, and are told.
    fn wake(&mut self) -> anyhow::Result<()> {
        let Some(slept_ns) = self.awake.slept(now()) else { return Ok(()) };
        let mut passed_over = self.assembler.pass_over();
        while let Some(field) = self.blobs.next_valid()? {
            if self.newest.len() == MAX_FIELDS_USED {
                self.newest.pop_front();
                passed_over += 1;
            }
            self.newest.push_back(field);
        }
        let newest_ns = self.newest.iter().map(|f| f.exposed_ns).max().unwrap_or(0);
        let at = now();
        for field in self.newest.drain(..) {
            // Those of the newest frame; their cameras expose within a period.
            if field.exposed_ns + FIELD_PERIOD_NS <= newest_ns {
                passed_over += 1;
            } else {
                let _ = self.assembler.push(&field, at);
            }
        }
        while let Some(closed) = self.assembler.complete(at) {
            self.publish(&closed)?;
        }
        self.passed_over += passed_over;
        if passed_over > 0 {
            tracing::warn!("slept for {:.1} s: {passed_over} fields passed over", slept_ns as f64 * 1e-9);
        }
        Ok(())
    }

    /// Takes in all fields that have arrived, and closes frames.
    fn receive_fields(&mut self) -> anyhow::Result<()> {
        if matches!(self.clock, Clock::System) && !self.replay {
            self.wake()?;
        }
        while let Some(field) = self.blobs.next_valid()? {
            if self.replay {
                self.store.push(&field);
                continue;
            }
            let at = self.advance_clock(&field)?;
            // The assembler counts refusals; the count is published with every frame.
            if let Err(refusal) = self.assembler.push(&field, at) {
                tracing::debug!(field = field.field, camera = field.camera, "field refused: {refusal}");
            }
            while let Some(closed) = self.assembler.complete(at) {
                self.publish(&closed)?;
            }
        }
        if matches!(self.clock, Clock::System) && !self.replay {
            self.expire(now())?;
        }
        Ok(())
    }

    /// The instant at which a field arrives. On a stream's clock, frames whose wait ended before
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

    /// Tracks the recorded frames again, as far as their fields have arrived. Where nothing is
    /// replayed nobody has frames to send: what comes is counted as refused.
    fn replay_frames(&mut self) -> anyhow::Result<()> {
        while !self.replay {
            if self.recorded.next_valid()?.is_none() {
                return Ok(());
            }
        }
        loop {
            if self.waiting.is_none() {
                self.waiting = self.recorded.next_valid()?;
            }
            let Some(recorded) = self.waiting else { return Ok(()) };
            if recorded.frame == 0 {
                self.reset_tracker();
            }
            let Some(used) = self.store.take(&recorded) else { return Ok(()) };
            let taken = now();
            let reference =
                Reference { camera: recorded.camera, field: recorded.field, exposed_ns: recorded.exposed_ns };
            let mut frame = self.tracker.track(used, &reference);
            close(&mut frame, ClosedBy::from_wire(recorded.closed_by));
            stamp(&mut frame, used, taken);
            self.waiting = None;
            self.send(frame)?;
        }
    }

    fn send(&mut self, mut frame: TrackerFrame) -> anyhow::Result<()> {
        let refused = self.assembler.refused().saturating_add(self.blobs.counts().refused as u32);
        frame.fields_refused = refused;
        self.shell.inject_delay();
        frame.instants.tracked = now();
        if let Err(invalid) = frame.validate() {
            // The tracker's own chokepoint: an invalid frame is not sent.
            tracing::error!(field = frame.field, frame = frame.frame, "frame withheld: {invalid}");
            self.withheld += 1;
            self.shell.report.state = STATE_DEGRADED;
            self.shell.set_text(&format!("{} frames withheld", self.withheld));
            return Ok(());
        }
        Ok(self.poses.send(&frame)?)
    }

    /// Updates the figures of the next heartbeat, and warns once of a rig that has drifted by more
    /// than the corrections of every calibration.
    fn report(&mut self) {
        let drift = self.tracker.drift().filter(|r| r.detected && r.is_large());
        if let Some(report) = drift.filter(|_| !self.drift_reported) {
            tracing::warn!("{report}");
            self.drift_reported = true;
        }
        while let Some(notice) = self.tracker.take_notice() {
            tracing::warn!("{notice}");
        }
        let restarts = self.tracker.restarts();
        if restarts > self.restarts_reported {
            tracing::error!(restarts, "a filter or predictor was not finite and began anew");
        }
        self.restarts_reported = restarts;
        let (blobs, recorded) = (self.blobs.counts(), self.recorded.counts());
        let report = &mut self.shell.report;
        let strange = if self.replay { 0 } else { recorded.received - recorded.refused };
        report.received = blobs.received + recorded.received - strange;
        report.sent = self.poses.sent();
        report.lost = blobs.lost + recorded.lost + self.store.dropped() + self.passed_over;
        let fields = u64::from(self.assembler.refused());
        report.refused = blobs.refused + recorded.refused + strange + fields;
        report.refused += self.tracker.blobs_refused() + self.withheld;
    }

    fn serve_control(&mut self) -> anyhow::Result<()> {
        let Some((request, command)) = self.shell.serve(now())? else { return Ok(()) };
        let result = self.execute(command)?;
        Ok(self.shell.answer(&request, result.as_ref().map_err(String::as_str).copied())?)
    }

    /// Executes a command; the inner `Err` is the reason for a refusal.
    fn execute(&mut self, command: Command) -> anyhow::Result<Result<(), String>> {
        match command {
            Command::Reset | Command::Load => {
                self.reset_tracker();
                self.assembler.reset();
                self.store.clear();
                self.waiting = None;
                if let Clock::Stream(newest) = &mut self.clock {
                    *newest = 0;
                }
            }
            Command::Flush => return self.flush(),
            Command::Start | Command::Pause | Command::Ping | Command::Shutdown => {}
            Command::Snapshot | Command::Next | Command::Help => {
                return Ok(Err("the tracker has neither picture nor levels".to_owned()));
            }
        }
        Ok(Ok(()))
    }

    fn reset_tracker(&mut self) {
        self.tracker.reset();
        self.drift_reported = false;
    }

    /// Finishes what is open: everything sent before the request is in the queues by now.
    fn flush(&mut self) -> anyhow::Result<Result<(), String>> {
        self.receive_fields()?;
        self.replay_frames()?;
        let at = if let Clock::Stream(newest) = self.clock { newest } else { now() };
        while let Some(closed) = self.assembler.flush(at) {
            self.publish(&closed)?;
        }
        let Some(recorded) = self.waiting else { return Ok(Ok(())) };
        Ok(Err(self.store.missing(&recorded).map_or_else(String::new, |m| {
            format!("frame {} waits for field {} of camera {}", recorded.frame, m.field, m.camera)
        })))
    }
}

/// Copies the instants of the fields into the frame.
fn stamp(frame: &mut TrackerFrame, used: &[BlobField], taken: Nanos) {
    frame.instants.read_out = used.iter().map(|f| f.read_out_ns).max().unwrap_or(0);
    frame.instants.blobs_out = used.iter().map(|f| f.blobs_out_ns).max().unwrap_or(0);
    frame.instants.taken = taken;
}

const _: () = assert!(ClosedBy::Inputs as u32 == 0, "a zeroed frame is closed by its inputs");
