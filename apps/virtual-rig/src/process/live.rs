//! A live stream of blobs: every line is put out as soon as it was read, on this machine's clock.
//!
//! Reading never waits, so heartbeat and commands go on whatever a writer does. Handles and pedal do not
//! come with the stream: jaws are open, and the pedal is up.

mod inlet;

use super::controls::ControlSample;
use super::surgeon::ScriptedSurgeon;
use super::{Source, VirtualRigShell};
use crate::config::Config;
use anyhow::{Context, Result};
use blob_stream::live::{Complaints, Heard, LiveFigures, LiveStream, Silence};
use inlet::{Got, Inlet};
use ipc::clock::now;
use ipc::logging::message;
use ipc::shell::Shell;
use protocol::blobs::BlobField;
use protocol::health::{STATE_DEGRADED, STATE_RUNNING};
use protocol::time::Nanos;
use rig::Rig;
use settings::blob_source::BlobSource;
use std::path::PathBuf;
use tracing::Level;

/// Readings a turn at most: a writer that floods does not stop the heart.
const READINGS: usize = 4;
/// Period of the figures, ns.
const FIGURES_NS: u64 = 1_000_000_000;
/// Time of silence after which a connected writer is replaced by another, ns.
const DEAF_NS: u64 = 5_000_000_000;

/// Notes on the state.
const WAITING: &str = "waiting for a writer";
const SILENT: &str = "no camera-field arrives";

/// The stream, and the reports on it.
pub(super) struct Live {
    inlet: Inlet,
    stream: LiveStream,
    ears: Ears,
    /// When the writer was heard last.
    heard_ns: Nanos,
    /// When the figures were left last.
    left_ns: Nanos,
    /// Where they are left.
    figures: PathBuf,
    begun: bool,
    finished: bool,
}

/// What becomes of each line.
#[derive(Default)]
struct Ears {
    bad: Complaints,
    clock: Complaints,
    silence: Silence,
    in_pauses: u64,
    /// Exposure with which the controls were sent last.
    controls_ns: Nanos,
}

/// Takes a live stream until the process is stopped.
pub(super) fn run(source: &BlobSource, config: &Config, rig: &Rig, surgeon: ScriptedSurgeon) -> Result<()> {
    let inlet = Inlet::open(source).context("--blobs")?;
    let shell = VirtualRigShell::open(config, rig, surgeon)?;
    let live = Live {
        stream: LiveStream::new(inlet.name(), rig.cameras.iter().map(|c| c.id)),
        inlet,
        ears: Ears::default(),
        heard_ns: 0,
        left_ns: 0,
        figures: LiveFigures::file(shell.instance.directory()),
        begun: false,
        finished: false,
    };
    let mut live = shell.run(live)?;
    let at = now();
    let rest = [live.ears.bad.rest(at), live.ears.clock.rest(at)];
    rest.into_iter().flatten().for_each(|text| message(Level::WARN, &text));
    live.leave();
    Ok(())
}

impl Live {
    /// Takes in what has come; false where nothing can come any more.
    fn listen(&mut self, rig: &mut VirtualRigShell) -> Result<bool> {
        for _ in 0..READINGS {
            let at = now();
            let deaf = at.saturating_sub(self.heard_ns) > DEAF_NS;
            match self.inlet.next(deaf)? {
                Got::Nothing => break,
                Got::Came => {
                    self.heard_ns = at;
                    self.stream.writer_came();
                    message(Level::INFO, &format!("a writer is connected on {}", self.inlet.name()));
                }
                Got::Bytes(bytes) => {
                    self.heard_ns = at;
                    self.stream.take(bytes, at, |heard| self.ears.hear(rig, heard, at))?;
                }
                Got::TurnedAway(who) => {
                    self.stream.counts().turned_away += 1;
                    let text = format!("{}: {who} was rejected: one writer at a time", self.inlet.name());
                    self.ears.complain(text, at);
                }
                Got::Gone => {
                    self.stream.writer_gone(at, |heard| self.ears.hear(rig, heard, at))?;
                    message(Level::WARN, &format!("the writer on {} has disconnected", self.inlet.name()));
                    self.wait(rig)?;
                }
                Got::Ended => {
                    self.stream.writer_gone(at, |heard| self.ears.hear(rig, heard, at))?;
                    message(Level::INFO, &format!("{} has ended", self.inlet.name()));
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }

    /// Reports that it waits for a writer.
    fn wait(&self, rig: &mut VirtualRigShell) -> Result<()> {
        message(Level::INFO, &format!("{WAITING} on {}", self.inlet.name()));
        rig.enter(STATE_DEGRADED, WAITING)
    }

    /// Reports a silence, lines that were not reported yet, and the figures.
    fn tell(&mut self, rig: &mut VirtualRigShell, at: Nanos) -> Result<()> {
        if rig.timeline.is_paused() {
            self.ears.silence.excuse(at);
        } else if self.ears.silence.begins(at) {
            message(Level::WARN, &format!("{SILENT} on {}", self.inlet.name()));
            rig.enter(STATE_DEGRADED, if self.inlet.has_writer() { SILENT } else { WAITING })?;
        }
        let due = [self.ears.bad.due(at), self.ears.clock.due(at)];
        due.into_iter().flatten().for_each(|text| message(Level::WARN, &text));
        if at >= self.left_ns + FIGURES_NS {
            self.left_ns = at;
            let figures = self.leave();
            let report = &mut rig.shell.report;
            report.received = figures.lines;
            report.refused = figures.bad + figures.doubtful + figures.out_of_order;
            rig.text = figures.short();
            rig.report_text();
        }
        Ok(())
    }

    /// Leaves the figures so far for the launcher, and returns them.
    fn leave(&self) -> LiveFigures {
        let silence = &self.ears.silence;
        let figures = LiveFigures {
            in_pauses: self.ears.in_pauses,
            silences: silence.count(),
            longest_silence_s: silence.longest_ns() as f64 * 1e-9,
            ..self.stream.figures()
        };
        // The stream goes on without; the launcher then says less at the end.
        if let Err(problem) = ipc::write_whole_json(&self.figures, &figures) {
            tracing::debug!("the statistics of the stream cannot be written: {problem}");
        }
        figures
    }
}

impl Ears {
    fn hear(&mut self, rig: &mut VirtualRigShell, heard: Heard<'_>, at: Nanos) -> Result<()> {
        match heard {
            Heard::Field(field) => return self.put_out(rig, field, at),
            Heard::Bad(problem) => {
                if let Some(text) = self.bad.note(problem, at) {
                    message(Level::WARN, &text);
                }
            }
            Heard::Begun(why) => self.complain(format!("clock offset to the stream estimated: {why}"), at),
        }
        Ok(())
    }

    fn complain(&mut self, text: String, at: Nanos) {
        if let Some(text) = self.clock.note(text, at) {
            message(Level::INFO, &text);
        }
    }

    /// Puts a field out, and with one of each period the controls.
    fn put_out(&mut self, rig: &mut VirtualRigShell, field: &mut BlobField, at: Nanos) -> Result<()> {
        if let Some(silent_ns) = self.silence.note(at) {
            let seconds = silent_ns as f64 * 1e-9;
            message(Level::INFO, &format!("camera-fields arrive again after {seconds:.1} s"));
        }
        if rig.timeline.is_paused() {
            self.in_pauses += 1;
            return Ok(());
        }
        if rig.shell.report.state == STATE_DEGRADED {
            rig.enter(STATE_RUNNING, "")?;
        }
        if field.exposed_ns >= self.controls_ns + rig.rig.field_period_ns() / 2 {
            self.controls_ns = field.exposed_ns;
            let at_rest = ControlSample::at_rest(&mut rig.surgeon.motion, field.field);
            rig.send_controls(&at_rest)?;
        }
        field.read_out_ns =
            field.exposed_ns.saturating_add(rig.rig.sensor(field.camera).read_out_ns()).min(at);
        rig.shell.inject_delay();
        // The line was read and judged before it was known that it is to be sent.
        rig.send(|block| *block = *field)
    }
}

impl Source for Live {
    /// Lines do not wait for the end of a pause.
    const WAITS: bool = false;

    fn rest(&self, shell: &Shell, _due: Nanos) {
        self.inlet.rest(|files| shell.rest_beside(if self.finished { &[] } else { files }));
    }

    fn advance(&mut self, rig: &mut VirtualRigShell) -> Result<u64> {
        if self.finished {
            return Ok(u64::MAX);
        }
        if !std::mem::replace(&mut self.begun, true) {
            self.wait(rig)?;
        }
        let goes_on = self.listen(rig)?;
        let at = now();
        self.tell(rig, at)?;
        let in_time = rig.timeline.is_paused() || rig.timeline.elapsed(at) < rig.duration_ns;
        if !(goes_on && in_time) {
            self.finished = true;
            rig.finish(0)?;
        }
        Ok(u64::MAX)
    }

    /// What has been read is gone: a live stream goes on.
    fn restart(&mut self) {}
}
