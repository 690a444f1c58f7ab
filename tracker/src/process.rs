//! The process: fields in, frames and checkpoints out. The only module that knows the clock and the
//! transport.

mod saving;

use crate::assembler::{ClosedFrame, FrameAssembler};
use crate::config::Config;
use crate::report::Report;
use crate::rig_check;
use crate::tracker::{Tracker, close, stamp};
use anyhow::Context;
use ipc::awake::Awake;
use ipc::clock::now;
use ipc::shell::Shell;
use ipc::{Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::limits::{FIELD_PERIOD_NS, MAX_FIELDS_USED, MAX_WAIT_MS};
use protocol::message::Message;
use protocol::poses::{ClosedBy, TrackerFrame};
use protocol::rig::Rig;
use saving::Saving;
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
        process.report();
        process.serve_control()?;
    }
    Ok(())
}

struct TrackerProcess {
    blobs: Receiver<BlobField>,
    poses: Sender<TrackerFrame>,
    saving: Saving,
    shell: Shell,
    assembler: FrameAssembler,
    tracker: Tracker,
    told: Report,
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
        let tracker = Tracker::with(&rig, !config.fixed_rig);
        let mut process = TrackerProcess {
            blobs: instance.receiver(Queue::InOrder)?,
            poses: instance.sender()?,
            saving: Saving::open(&instance, &tracker)?,
            shell,
            assembler: FrameAssembler::new(&rig),
            tracker,
            told: Report::default(),
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
        let (longest, at) = (MAX_WAIT_MS * 1_000_000, now());
        // A poll rounds up to whole milliseconds of its own accord.
        let timeout_ns = self.assembler.deadline(at).map_or(longest, |d| d.saturating_sub(at).min(longest));
        wait(&[&self.blobs, self.shell.control()], timeout_ns);
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
        self.wake()?;
        while let Some(field) = self.blobs.next_valid()? {
            let at = now();
            // The assembler counts refusals; the count is published with every frame.
            if let Err(refusal) = self.assembler.push(&field, at) {
                tracing::debug!(field = field.field, camera = field.camera, "field refused: {refusal}");
            }
            while let Some(closed) = self.assembler.complete(at) {
                self.publish(&closed)?;
            }
        }
        let at = now();
        while let Some(closed) = self.assembler.expired(at) {
            self.publish(&closed)?;
        }
        Ok(())
    }

    fn publish(&mut self, closed: &ClosedFrame) -> anyhow::Result<()> {
        let mut frame = self.tracker.track(self.assembler.used(), &closed.reference);
        close(&mut frame, closed.closed_by);
        frame.waited_ns = closed.waited_ns;
        stamp(&mut frame, self.assembler.used(), closed.taken_ns);
        self.send(frame)
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
        self.poses.send(&frame)?;
        self.saving.save_if_due(&self.tracker, &frame)
    }

    /// Tells what is new, and updates the figures of the next heartbeat.
    fn report(&mut self) {
        self.told.tell(&mut self.tracker);
        let (blobs, report) = (self.blobs.counts(), &mut self.shell.report);
        report.received = blobs.received;
        report.sent = self.poses.sent();
        report.lost = blobs.lost + self.passed_over;
        let fields = u64::from(self.assembler.refused());
        report.refused = blobs.refused + fields + self.tracker.blobs_refused() + self.withheld;
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
            }
            Command::Start | Command::Pause | Command::Ping | Command::Flush | Command::Shutdown => {}
            Command::Snapshot | Command::Next | Command::Help => {
                return Ok(Err("the tracker has neither picture nor levels".to_owned()));
            }
        }
        Ok(Ok(()))
    }

    fn reset_tracker(&mut self) {
        self.tracker.reset();
        self.told.reset();
        self.saving.now();
    }
}

const _: () = assert!(ClosedBy::Inputs as u32 == 0, "a zeroed frame is closed by its inputs");
