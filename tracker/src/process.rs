//! The process: fields in, frames and checkpoints out. The only module that knows the clock and the
//! transport.

mod readiness;
mod saving;

use crate::assembler::{ClosedFrame, FrameAssembler};
use crate::config::Config;
use crate::refusals::Refusals;
use crate::report::Report;
use crate::rig_check::{self, RigDefect};
use crate::tracker::{Tracker, close, stamp};
use anyhow::Context;
use ipc::clock::now;
use ipc::shell::{Served, Shell, Work};
use ipc::trace::About;
use ipc::{Queue, Receiver, Sender};
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::limits::MAX_FIELDS_USED;
use protocol::matches::MatchFrame;
use protocol::message::{Invalid, Message};
use protocol::phases::{Phase, Unmarked};
use protocol::poses::{ClosedBy, TrackerFrame};
use protocol::time::Nanos;
use readiness::Readiness;
use rig::Rig;
use saving::Saving;
use std::collections::VecDeque;
use std::path::Path;

/// Fields taken in a turn. Where they come as fast as they are tracked there is no last one, and a turn without an end
/// would count as a sleep, after which fields are passed over. Requests wait for the end of a turn, so that they find tracked
/// what was sent before them.
const FIELDS_A_TURN: usize = 8 * MAX_FIELDS_USED;

/// Runs the tracker until it is asked to stop.
///
/// # Errors
/// A rig that cannot be read or cannot work; a channel that cannot be opened or fails.
pub fn run(config: &Config) -> anyhow::Result<()> {
    ipc::shell::run(&mut TrackerProcess::start(config)?)
}

/// The refusal of a rig, with the command that says more, such as which rotations look transposed. A rig out of a recording
/// is a file in memory, which no other command can read.
fn unusable(path: Option<&Path>, defect: &RigDefect) -> anyhow::Error {
    match path.filter(|path| !path.starts_with("/proc")) {
        Some(path) => {
            let name = path.display().to_string();
            let word = if name.contains(char::is_whitespace) { format!("'{name}'") } else { name.clone() };
            anyhow::anyhow!("the rig {name} cannot work: {defect}; for details: vitreo rig check {word}")
        }
        None => anyhow::anyhow!("this rig cannot work: {defect}"),
    }
}

struct TrackerProcess {
    blobs: Receiver<BlobField>,
    poses: Sender<TrackerFrame>,
    matches: Sender<MatchFrame>,
    saving: Saving,
    readiness: Readiness,
    shell: Shell,
    assembler: FrameAssembler,
    tracker: Tracker,
    report: Report,
    refusals: Refusals,
    /// Frames that were not valid and were not sent.
    withheld: u64,
    /// The newest fields that came during a sleep.
    newest: VecDeque<BlobField>,
    /// Fields passed over after a sleep.
    passed_over: u64,
    /// The turn before ended with its fields, and more may lie ready.
    more: bool,
    /// Field of the newest frame.
    newest_field: u64,
    /// From field to field of a camera, ns.
    period_ns: u64,
}

impl TrackerProcess {
    fn start(config: &Config) -> anyhow::Result<Self> {
        let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
        rig_check::check(&rig).map_err(|defect| unusable(config.rig.rig.as_deref(), &defect))?;
        let (instance, shell) = Shell::start(Process::Tracker, &config.shell).context("cannot start")?;
        let tracker = Tracker::with(&rig, !config.fixed_rig);
        Ok(TrackerProcess {
            blobs: instance.receiver(Queue::InOrder)?,
            poses: instance.sender()?,
            matches: instance.sender()?,
            saving: Saving::open(&instance, &tracker)?,
            readiness: Readiness::new(&tracker, rig.field_period_ns(), config.ready_ahead_us * 1000),
            shell,
            assembler: FrameAssembler::new(&rig),
            tracker,
            report: Report::default(),
            refusals: Refusals::default(),
            withheld: 0,
            newest: VecDeque::with_capacity(MAX_FIELDS_USED),
            passed_over: 0,
            more: false,
            newest_field: 0,
            period_ns: rig.field_period_ns(),
        })
    }

    /// Takes in the fields that have arrived, and closes frames.
    fn receive_fields(&mut self) -> anyhow::Result<()> {
        self.more = true;
        for _ in 0..FIELDS_A_TURN {
            let Some(field) = self.blobs.next_sample()? else {
                self.more = false;
                break;
            };
            let at = now();
            let about = About::camera(field.field, field.camera);
            // The assembler counts refusals; the count is published with every frame.
            let (number, camera) = (field.field, field.camera);
            let pushed = self.assembler.push(&field, at);
            drop(field);
            let (news, ended) = match &pushed {
                Err(refusal) => (self.refusals.note(camera, refusal), false),
                Ok(()) => (None, self.refusals.taken(camera)),
            };
            if let Err(refusal) = &pushed {
                tracing::debug!(field = number, camera, "field refused: {refusal}");
            }
            if let Some(news) = &news {
                tracing::warn!(field = number, "{news}");
            }
            if news.is_some() || ended {
                self.say_how_it_is();
            }
            self.shell.trace.end(Phase::Assemble, about, at);
            while let Some(closed) = self.assembler.complete(at) {
                self.publish(&closed)?;
            }
        }
        if self.more {
            // What a frame waits for may lie ready.
            return Ok(());
        }
        let at = now();
        while let Some(closed) = self.assembler.expired(at) {
            self.publish(&closed)?;
        }
        Ok(())
    }

    /// Tracks a frame in the memory where its receivers will read it, and sends it.
    fn publish(&mut self, closed: &ClosedFrame) -> anyhow::Result<()> {
        self.newest_field = closed.reference.field;
        let about = About::field(self.newest_field);
        let begun = self.shell.trace.begin();
        let TrackerProcess { poses, tracker, assembler, shell, .. } = self;
        let (used, reference) = (assembler.used(), &closed.reference);
        let refused = assembler.refused().saturating_add(self.blobs.counts().refused as u32);
        let (mut checked, mut built) = (Ok(()), 0);
        poses.send_in_place(|frame| {
            match shell.trace.laps(about) {
                Some(mut laps) => tracker.track_into(frame, used, reference, &mut laps),
                None => tracker.track_into(frame, used, reference, &mut Unmarked),
            }
            close(frame, closed.closed_by);
            (frame.waited_ns, frame.fields_refused) = (closed.waited_ns, refused);
            stamp(frame, used, closed.taken_ns);
            shell.inject_delay();
            frame.instants.tracked = now();
            checked = frame.validate();
            built = shell.trace.begin();
            checked.is_ok()
        })?;
        self.shell.trace.end(Phase::SendPoses, about, built);
        let tracked = self.shell.trace.end(Phase::Track, about, begun);
        self.tracker.follow_up(self.assembler.used());
        let taken_ns = closed.taken_ns;
        self.readiness.note(
            self.assembler.used(),
            &closed.reference,
            taken_ns,
            now().saturating_sub(taken_ns),
        );
        match checked {
            Ok(()) => self.send_matches(about, tracked)?,
            Err(invalid) => self.withhold(&invalid),
        }
        Ok(())
    }

    /// The tracker's own chokepoint: an invalid frame is not sent.
    fn withhold(&mut self, invalid: &Invalid) {
        let (field, frame) = (self.newest_field, self.tracker.matches().frame);
        tracing::error!(field, frame, "frame withheld: {invalid}");
        self.withheld += 1;
        self.say_how_it_is();
    }

    /// Puts what is wrong into the next heartbeat.
    fn say_how_it_is(&mut self) {
        let text = match self.withheld {
            0 => self.refusals.text().to_owned(),
            frames => format!("{frames} frames withheld"),
        };
        self.shell.report.state = if text.is_empty() { STATE_RUNNING } else { STATE_DEGRADED };
        self.shell.set_text(&text);
    }

    /// Sends what no receiver waits for, after the poses.
    fn send_matches(&mut self, about: About, tracked: Nanos) -> anyhow::Result<()> {
        self.matches.send(self.tracker.matches())?;
        let begun = self.shell.trace.end(Phase::FollowUp, about, tracked);
        if self.saving.save_if_due(&self.tracker)? {
            self.shell.trace.end(Phase::SaveTracker, about, begun);
        }
        Ok(())
    }

    /// Logs what has changed, and updates the figures of the next heartbeat.
    fn report(&mut self) {
        self.report.log(&mut self.tracker, self.newest_field);
        let (blobs, report) = (self.blobs.counts(), &mut self.shell.report);
        report.received = blobs.received;
        report.sent = self.poses.sent();
        report.lost = blobs.lost + self.passed_over;
        let fields = u64::from(self.assembler.refused());
        report.refused = blobs.refused + fields + self.tracker.blobs_refused() + self.withheld;
    }
}

impl Work<anyhow::Error> for TrackerProcess {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// Until a field comes, at most until the assembler's next deadline. A field that comes just
    /// before it is in time.
    fn rest(&mut self) {
        let until = if self.more { 0 } else { self.assembler.deadline(now()).unwrap_or(Nanos::MAX) };
        let until = self.readiness.wake_ns().map_or(until, |wake_ns| until.min(wake_ns));
        self.shell.rest(&[&self.blobs], until);
    }

    /// No pose of the past goes out as the present.
    fn slept(&mut self, _slept_ns: u64) -> anyhow::Result<u64> {
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
            if field.exposed_ns + self.period_ns <= newest_ns {
                passed_over += 1;
            } else {
                let _ = self.assembler.push(&field, at);
            }
        }
        while let Some(closed) = self.assembler.complete(at) {
            self.publish(&closed)?;
        }
        self.passed_over += passed_over;
        Ok(passed_over)
    }

    fn turn(&mut self, _woken: Nanos) -> anyhow::Result<()> {
        self.receive_fields()?;
        while self.readiness.prepare(now()) {
            std::hint::spin_loop();
            self.receive_fields()?;
        }
        self.report();
        Ok(())
    }

    fn execute(&mut self, command: Command, _argument: u64) -> anyhow::Result<Served> {
        let (Command::Reset | Command::Load) = command else { return Ok(Served::NothingToDo) };
        self.tracker.reset();
        self.report.reset();
        self.saving.now();
        self.assembler.reset();
        Ok(Served::Done)
    }
}

const _: () = assert!(ClosedBy::Inputs as u32 == 0, "a zeroed frame is closed by its inputs");
