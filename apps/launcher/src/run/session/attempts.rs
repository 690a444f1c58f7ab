//! Pause, restart and next level. Each attempt has its own recording.

use super::{Attempt, CommandProgress, Session};
use crate::run::OutputArgs;
use crate::run::attempt_control::{ControlRequest, PendingRequest};
use crate::run::latency_stats::WARM_UP_NS;
use crate::run::provenance;
use crate::run::recorder::Recorder;
use crate::run::recorder::files::RecordingFiles;
use crate::run::report::{Incident, RecordingFigures};
use anyhow::bail;
use ipc::clock::now;
use ipc::logging::with_causes;
use outputs::Outputs;
use protocol::control::{Answer, Command, EVERY_PROCESS, LAUNCHER};
use protocol::health::Process;
use protocol::message::text_bytes;
use protocol::time::Nanos;
use std::time::Duration;
use tokio::time::Instant;

/// Timeout for the processes to execute a command, after which the launcher continues without them. Creating
/// the tissue of a new scene takes a second on a slow machine.
const OBEY: Duration = Duration::from_secs(15);

/// State of the help over the picture. This is the only copy of the state: the renderer shows what it is
/// sent.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HelpState {
    open: bool,
    /// True if the session is paused because of the help.
    pauses: bool,
}

impl Session<'_> {
    /// Receives requests, and answers of processes.
    pub(super) fn receive_requests(&mut self) -> anyhow::Result<()> {
        while let Some(event) = self.tap.inputs.next_valid()? {
            self.control.note_input(&event);
        }
        while let Some(request) = self.tap.requests.next_valid()? {
            if let Some(seq) = self.control.note_request(&request) {
                self.answer(
                    seq,
                    Err("the launcher knows start, pause, reset, next and shutdown only".into()),
                )?;
            }
        }
        let CommandProgress { seq, waiting, problems } = &mut self.command;
        while let Some(answer) = self.tap.answers.next_valid()? {
            if answer.seq == *seq && waiting.contains(&answer.process) {
                waiting.retain(|p| *p != answer.process);
                if answer.result != 0 {
                    problems.push(answer.text());
                }
            }
        }
        Ok(())
    }

    fn answer(&mut self, seq: u64, done: Result<(), String>) -> anyhow::Result<()> {
        let text = text_bytes(done.as_ref().err().map_or("", String::as_str));
        Ok(self.answers.send(&Answer { seq, process: LAUNCHER, result: u32::from(done.is_err()), text })?)
    }

    /// Serves the queued requests. Returns why the run must end, if it must.
    pub(super) async fn serve_requests(&mut self) -> anyhow::Result<Option<&'static str>> {
        while let Some(PendingRequest { request, seq }) = self.control.take() {
            let done = match (request, self.paused_ns) {
                (ControlRequest::Help, _) => self.help().await,
                // A pause that is requested while the help is open continues after the help is closed.
                (ControlRequest::Pause | ControlRequest::PauseOrResume, Some(_)) if self.help.pauses => {
                    self.help.pauses = false;
                    Ok(())
                }
                (ControlRequest::Pause | ControlRequest::PauseOrResume, None) => self.pause().await,
                (ControlRequest::Resume | ControlRequest::PauseOrResume, Some(since)) => {
                    self.resume(since).await
                }
                (ControlRequest::Pause, Some(_)) | (ControlRequest::Resume, None) => Ok(()),
                (ControlRequest::Restart, _) => {
                    self.begin_again(Command::Reset, self.args.training.level).await
                }
                (ControlRequest::Next, _) => self.next_level().await,
                (ControlRequest::Quit, _) => Ok(()),
            };
            if let Err(problem) = &done {
                self.screen.print(&with_causes(problem.as_ref()));
            }
            if let Some(seq) = seq {
                self.answer(seq, done.map_err(|e| with_causes(e.as_ref())))?;
            }
            if request == ControlRequest::Quit {
                return Ok(Some("asked to end"));
            }
        }
        Ok(None)
    }

    async fn pause(&mut self) -> anyhow::Result<()> {
        self.paused_ns = Some(now());
        // Pictures drawn during a pause are as old as the pause, so their latencies are not counted.
        self.consumers.latencies.cool();
        self.command_all(Command::Pause, 0).await
    }

    async fn resume(&mut self, since: Nanos) -> anyhow::Result<()> {
        self.command_all(Command::Start, 0).await?;
        let at = now();
        (self.paused_ns, self.help.pauses) = (None, false);
        self.attempt_ns += at.saturating_sub(since);
        self.consumers.latencies.warm_from(at + WARM_UP_NS);
        Ok(())
    }

    /// Opens the help and pauses, or closes the help and resumes.
    async fn help(&mut self) -> anyhow::Result<()> {
        self.help.open = !self.help.open;
        self.send_help_state();
        match (self.help.open, self.paused_ns) {
            (true, None) => {
                self.help.pauses = true;
                self.pause().await
            }
            (false, Some(since)) if std::mem::take(&mut self.help.pauses) => self.resume(since).await,
            _ => Ok(()),
        }
    }

    /// Sends the state of the help to the renderer.
    fn send_help_state(&mut self) {
        self.supervisor.ask(Process::Renderer as u32, Command::Help, u64::from(self.help.open));
    }

    /// Sends the current state (help, pause) to a renderer that has just started.
    pub(super) fn send_state_to_renderer(&mut self) {
        self.send_help_state();
        if self.paused_ns.is_some() {
            self.supervisor.ask(Process::Renderer as u32, Command::Pause, 0);
        }
    }

    async fn next_level(&mut self) -> anyhow::Result<()> {
        let Some(composed) = &mut self.composed else {
            bail!("there is no next level: no module is trained (--module)");
        };
        // A duration given on the command line remains unchanged.
        let scripted = self.args.duration == Some(self.args.attempt_s(composed));
        let level = composed.next_level()?;
        if scripted {
            self.args.duration = Some(self.args.attempt_s(composed));
        }
        self.begin_again(Command::Load, level).await
    }

    /// Ends the attempt and begins the next one, at level `level`. Everything is paused meanwhile, so that no
    /// message belongs to both attempts.
    async fn begin_again(&mut self, command: Command, level: u32) -> anyhow::Result<()> {
        self.consumers.latencies.cool();
        (self.paused_ns, self.help) = (Some(now()), HelpState::default());
        self.send_help_state();
        self.command_all(Command::Pause, 0).await?;
        self.end_attempt().await;
        let number = self.attempts.len() as u32;
        self.args.training.level = level;
        self.args.outputs.record = self.first_record.as_deref().map(|file| self.args.numbered(file, number));
        self.provenance = provenance(&self.args)?;
        let duration_ms = self.args.duration.map_or(0, |s| (s * 1e3) as u64);
        self.command_all(command, duration_ms).await?;
        self.consumers.recorder = self.recorder_of_attempt()?;
        self.command_all(Command::Start, 0).await?;
        let at = now();
        (self.paused_ns, self.attempt_ns) = (None, at);
        self.consumers.latencies.warm_from(at + WARM_UP_NS);
        let at_s = self.elapsed_s(at);
        self.incidents.push(Incident { at_s, what: format!("attempt {}, level {level}", number + 1) });
        Ok(())
    }

    /// Creates the recorder of the attempt that begins.
    fn recorder_of_attempt(&self) -> anyhow::Result<Option<Recorder>> {
        let Some(file) = &self.args.outputs.record else { return Ok(None) };
        let OutputArgs { writing, force, .. } = &self.args.outputs;
        let files = RecordingFiles::begin(file, writing, &mut Outputs::new(force.force))?;
        let mut recorder = Recorder::start(files, &self.provenance)?;
        recorder.appear()?;
        Ok(Some(recorder))
    }

    /// Ends the recording of the attempt and stores the attempt's results.
    pub(super) async fn end_attempt(&mut self) -> Option<RecordingFigures> {
        let recording = match self.consumers.recorder.take() {
            Some(recorder) => Some(recorder.finish().await),
            None => None,
        };
        let (level, record) = (self.args.training.level, self.args.outputs.record.clone());
        let live = std::mem::take(&mut self.consumers.score);
        self.attempts.push(Attempt { level, record, live });
        self.consumers.resume.clear();
        recording
    }

    /// Sends a command to every process and waits until source, trackers and simulation have executed it.
    async fn command_all(&mut self, command: Command, argument: u64) -> anyhow::Result<()> {
        let seq = self.supervisor.ask(EVERY_PROCESS, command, argument);
        let trackers = self.args.trackers().iter().copied();
        // Real cameras continue to deliver pictures and execute no commands.
        let real = self.args.real.given().is_some() || self.args.real.driver().is_some();
        let source = (!real).then(|| self.args.source());
        let obeying = source.into_iter().chain([Process::Simcore]).chain(trackers);
        let waiting = obeying.map(|p| p as u32).collect();
        self.command = CommandProgress { seq, waiting, problems: Vec::new() };
        let deadline = Instant::now() + OBEY;
        while !self.command.waiting.is_empty() && Instant::now() < deadline && !self.stop.is_raised() {
            self.turn().await?;
        }
        // Receives the messages that were sent before the last answer.
        self.receive()?;
        if let Some(problem) = self.command.problems.first() {
            bail!("{command:?}: {problem}");
        }
        Ok(())
    }
}
