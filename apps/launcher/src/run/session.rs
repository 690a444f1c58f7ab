//! A run from its first process to its last: the main loop, which receives, supervises, records and shows the
//! status.

mod attempts;
mod closing;
mod drivers;
mod restarts;
mod status;

use super::attempt_control::AttemptControl;
use super::channel_tap::ChannelTap;
use super::field_trace::Traced;
use super::latency_stats::{LatencyStats, WARM_UP_NS};
use super::load::LoadAccount;
use super::monitor::Monitor;
use super::options::{RunArgs, View};
use super::policy::CpuAccount;
use super::recorder::Recorder;
use super::recorder::files::RecordingFiles;
use super::report::Incident;
use super::resume::Resume;
use super::screen::Screen;
use super::silence::SilenceWatch;
use super::supervisor::{ProcessEvent, Supervisor};
use crate::machine::has_display;
use crate::modules::Composed;
use crate::runtime::StopSignal;
use anyhow::bail;
pub use closing::Closed;
use diagnosis::{Tracking, Watch};
use ipc::clock::now;
use ipc::{Instance, Sender};
use outputs::Outputs;
use protocol::budget::Budgets;
use protocol::control::{Answer, Command, Notice};
use protocol::health::Process;
use protocol::time::Nanos;
use recording::{Item, Note, Provenance};
use restarts::GoalsReached;
use rig::Rig;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout_at};
use training::score::recording::LiveScore;

/// Time after the end of the stream in which the last fields can reach the picture.
const LINGER: Duration = Duration::from_millis(300);
/// Time after the end of the duration at which the launcher ends the run itself, ns. Usually the cameras end
/// it.
const OVERTIME_NS: u64 = 3_000_000_000;
/// Period of the messages during start-up.
const START_MESSAGE_PERIOD: Duration = Duration::from_secs(5);
/// Capacity of the queue of lines from the processes.
const LINES_QUEUE: usize = 1024;

/// A run in progress.
pub struct Session<'a> {
    /// Arguments, with level and recording of the current attempt.
    args: RunArgs,
    view: View,
    budgets: &'a Budgets,
    provenance: Provenance,
    /// Composed scene of the module, if there is a module.
    composed: Option<&'a mut Composed>,
    control: AttemptControl,
    answers: Sender<Answer>,
    notices: Sender<Notice>,
    /// Answers to the newest command.
    command: CommandProgress,
    /// Start of the current pause, ns; `None` if not paused.
    paused_ns: Option<Nanos>,
    help: attempts::HelpState,
    /// The completed attempts.
    attempts: Vec<Attempt>,
    /// Requested recording file, whose name is numbered for later attempts.
    first_record: Option<PathBuf>,
    stop: StopSignal,
    tap: ChannelTap,
    consumers: Consumers,
    supervisor: Supervisor,
    screen: Screen,
    /// Receives the lines of the processes' standard error.
    lines: mpsc::Receiver<String>,
    incidents: Vec<Incident>,
    /// Number of times the simulation could not resume.
    states_lost: u64,
    /// Start of the wait for the source, and time of the next message about it, ns; 0 before.
    awaited_ns: Nanos,
    report_waiting_ns: Nanos,
    /// Time at which the cameras became ready, ns; 0 before.
    started_ns: Nanos,
    /// Start of the attempt, shifted by every pause, ns; 0 before.
    attempt_ns: Nanos,
    /// Time of the last check for warnings, ns.
    watched_ns: Nanos,
    own_cpu: CpuAccount,
    load: LoadAccount,
    traced: Traced,
    // Dropped last, so that the instance's directory is removed after the channels are closed.
    instance: Instance,
}

/// Progress of a command sent to the processes.
#[derive(Debug, Default)]
struct CommandProgress {
    /// Sequence number of the request.
    seq: u64,
    /// Processes that have not answered yet.
    waiting: Vec<u32>,
    /// Reasons of processes that could not execute the command.
    problems: Vec<String>,
}

/// Results of an attempt.
#[derive(Debug, Clone)]
pub struct Attempt {
    /// Level of the module.
    pub level: u32,
    /// File of the recording, if there is one.
    pub record: Option<PathBuf>,
    /// The score that the simulation published.
    pub live: LiveScore,
}

/// Consumers of the received items.
struct Consumers {
    latencies: LatencyStats,
    monitor: Monitor,
    tracking: Tracking,
    watch: Watch,
    silence: SilenceWatch,
    resume: Resume,
    recorder: Option<Recorder>,
    score: LiveScore,
    goals: GoalsReached,
    lost_before: u64,
}

impl Consumers {
    /// Creates empty consumers for a run; reads the rig.
    fn new(args: &RunArgs, recorder: Option<Recorder>) -> anyhow::Result<Self> {
        Ok(Consumers {
            latencies: LatencyStats::default(),
            monitor: Monitor::default(),
            tracking: Tracking::new(&Rig::load_or_shipped(args.rig.rig.as_deref())?),
            watch: Watch::default(),
            silence: SilenceWatch::new(args.source(), args.takes_live_blobs()),
            resume: Resume::default(),
            recorder,
            score: LiveScore::default(),
            goals: GoalsReached::default(),
            lost_before: 0,
        })
    }

    fn take(&mut self, at: Nanos, item: Item) {
        match &item {
            Item::Blobs(field) => self.tracking.note_field(field),
            Item::Poses(pose) => {
                self.latencies.note_pose(pose);
                self.tracking.note_frame(pose);
            }
            Item::Matches(matches) => self.tracking.note_matches(matches),
            Item::Step(step) => self.latencies.note_step(step),
            Item::Frame(frame) => self.latencies.note_frame(frame),
            Item::Event(event) => {
                self.score.note(event);
                self.goals.note(event);
            }
            _ => {}
        }
        self.monitor.note(&item);
        self.resume.note(&item);
        if let Some(recorder) = &mut self.recorder {
            recorder.offer(at, item);
        }
    }

    fn record_note(&mut self, note: Note) {
        if let Some(recorder) = &mut self.recorder {
            recorder.offer(note.instant_ns, Item::Note(note));
        }
    }
}

impl<'a> Session<'a> {
    /// Opens the instance, its channels and the recording, without starting a process.
    ///
    /// # Errors
    /// If rig or scene are invalid, the instance is in use, there is no display for a desk, or the recording
    /// cannot be created.
    pub fn open(
        args: &RunArgs,
        composed: Option<&'a mut Composed>,
        view: View,
        budgets: &'a Budgets,
        outputs: &mut Outputs,
        stop: StopSignal,
    ) -> anyhow::Result<Self> {
        let provenance = super::provenance(args)?;
        args.check_display(has_display())?;
        let instance = Instance::own(&args.instance)?;
        let files = args.outputs.record.as_deref();
        let files =
            files.map(|file| RecordingFiles::begin(file, &args.outputs.writing, outputs)).transpose()?;
        let recorder = files.map(|files| Recorder::start(files, &provenance)).transpose()?;
        let consumers = Consumers::new(args, recorder)?;
        let (line_sender, lines) = mpsc::channel(LINES_QUEUE);
        Ok(Session {
            args: args.clone(),
            view,
            budgets,
            provenance,
            composed,
            control: AttemptControl::default(),
            answers: instance.sender()?,
            notices: instance.sender()?,
            command: CommandProgress::default(),
            paused_ns: None,
            help: attempts::HelpState::default(),
            attempts: Vec::new(),
            first_record: args.outputs.record.clone(),
            stop,
            tap: ChannelTap::open(&instance)?,
            consumers,
            supervisor: Supervisor::new(&instance, args, view, line_sender)?,
            screen: Screen::new(),
            lines,
            incidents: Vec::new(),
            states_lost: 0,
            awaited_ns: 0,
            report_waiting_ns: 0,
            started_ns: 0,
            attempt_ns: 0,
            watched_ns: 0,
            own_cpu: CpuAccount::default(),
            load: LoadAccount::default(),
            traced: Traced::default(),
            instance,
        })
    }

    /// Starts all processes and runs to the end. Returns why the run ended.
    ///
    /// # Errors
    /// If a process does not start or dies too often, or a channel fails.
    pub async fn run(&mut self) -> anyhow::Result<&'static str> {
        self.start_receivers().await?;
        self.invite_drivers()?;
        if !self.args.has_outside_source() {
            self.supervisor.start(self.args.source(), self.args.duration, now())?;
        }
        self.begin_to_wait(now());
        let why = self.work().await?;
        self.linger().await?;
        Ok(why)
    }

    /// Starts the processes that receive and waits until they are ready, so that none of them misses the
    /// first field.
    async fn start_receivers(&mut self) -> anyhow::Result<()> {
        let picture = (self.view != View::None).then_some(Process::Renderer);
        let controls = self.args.controls.any().then_some(Process::Controls);
        let trackers = self.args.trackers().iter().copied();
        for process in picture.into_iter().chain([Process::Simcore]).chain(controls).chain(trackers) {
            self.supervisor.start(process, None, now())?;
        }
        self.screen.print(&format!("starting {}", self.supervisor.awaited().join(", ")));
        let mut message_at = Instant::now() + START_MESSAGE_PERIOD;
        while !self.supervisor.all_prepared(now()) {
            self.turn().await?;
            if self.stop.is_raised() {
                bail!("stopped while the processes were starting");
            }
            if Instant::now() > message_at {
                message_at += START_MESSAGE_PERIOD;
                self.screen.print(&format!("waiting for {}", self.supervisor.awaited().join(", ")));
            }
        }
        Ok(())
    }

    /// The main loop.
    async fn work(&mut self) -> anyhow::Result<&'static str> {
        loop {
            let events = self.turn().await?;
            if self.stop.is_raised() {
                return Ok("signal");
            }
            if events.contains(&ProcessEvent::WindowClosed) {
                return Ok("window closed");
            }
            if events.contains(&ProcessEvent::StreamEnded) {
                return Ok(if self.args.duration.is_some() { "duration" } else { "end of the stream" });
            }
            if self.args.source().drives().is_some() && self.remaining_ns().is_some_and(|left| left <= 0) {
                return Ok("duration");
            }
            if self.remaining_ns().is_some_and(|left| left < -(OVERTIME_NS as i64)) {
                return Ok("duration (no end reported by the cameras)");
            }
            if self.has_waited_enough(now()) {
                return Ok("duration (its source never connected)");
            }
            if let Some(why) = self.serve_requests().await? {
                return Ok(why);
            }
            self.watch();
            self.watch_silence();
            self.show();
        }
    }

    /// Ends the cameras first and lets the last fields arrive.
    async fn linger(&mut self) -> anyhow::Result<()> {
        self.supervisor.ask(self.args.source() as u32, Command::Shutdown, 0);
        // No more scenes will come, so the last picture must not be marked as held.
        self.supervisor.ask(Process::Renderer as u32, Command::Flush, 0);
        let end = Instant::now() + LINGER;
        while timeout_at(end, self.tap.wait()).await.is_ok() {
            self.receive()?;
        }
        Ok(())
    }

    /// Waits until there is something to do, receives everything, and restarts dead processes.
    async fn turn(&mut self) -> anyhow::Result<Vec<ProcessEvent>> {
        let child_ended = self.supervisor.child_ended();
        tokio::select! {
            () = self.tap.wait() => {}
            () = child_ended.notified() => {}
            () = self.stop.raised() => {}
        }
        let mut events = self.receive()?;
        self.supervise(&mut events).await?;
        for event in &events {
            self.note_event(event)?;
        }
        Ok(events)
    }

    /// Drains every channel.
    fn receive(&mut self) -> anyhow::Result<Vec<ProcessEvent>> {
        let at = now();
        let (consumers, control) = (&mut self.consumers, &mut self.control);
        self.tap.drain(at, |filed_at, item| {
            if let Item::Pedal(pedal) = &item {
                control.note_pedal(pedal);
            }
            consumers.take(filed_at, item);
        })?;
        let mut events = Vec::new();
        while let Some(beat) = self.tap.health.next_valid()? {
            self.traced.note(&beat, at);
            events.extend(self.supervisor.note(&beat, at));
        }
        self.receive_requests()?;
        self.note_losses(at);
        while let Ok(line) = self.lines.try_recv() {
            self.screen.pass_on(&line);
        }
        Ok(events)
    }

    /// Records a note about blocks that were overwritten before the launcher could read them.
    fn note_losses(&mut self, at: Nanos) {
        let lost = self.tap.lost();
        let total: u64 = lost.values().sum();
        let count = total - self.consumers.lost_before;
        if count == 0 {
            return;
        }
        self.consumers.lost_before = total;
        let text = format!("{count} blocks were overwritten before they were recorded (so far: {lost:?})");
        self.consumers.record_note(Note::loss(at, count, text));
    }

    fn note_event(&mut self, event: &ProcessEvent) -> anyhow::Result<()> {
        let at = now();
        match event {
            ProcessEvent::Gone(driver) => self.report_driver(at, *driver, false),
            ProcessEvent::Ready(process) => {
                if self.args.real.drivers().contains(process) {
                    self.report_driver(at, *process, true);
                }
                if *process == self.args.source() && self.started_ns == 0 {
                    (self.started_ns, self.attempt_ns) = (at, at);
                    self.consumers.recorder.as_mut().map_or(Ok(()), Recorder::appear)?;
                    self.note_own_cpu(at);
                    self.load.start();
                    self.consumers.monitor.measure(at);
                }
                if self.supervisor.all_ready() && self.started_ns > 0 {
                    self.consumers.latencies.warm_from(at + WARM_UP_NS);
                }
            }
            ProcessEvent::Restarting(process, how) => self.report_restart(at, *process, how),
            ProcessEvent::Joined(_) | ProcessEvent::StreamEnded | ProcessEvent::WindowClosed => {}
        }
        Ok(())
    }

    fn elapsed_s(&self, at: Nanos) -> f64 {
        if self.started_ns == 0 { 0.0 } else { at.saturating_sub(self.started_ns) as f64 * 1e-9 }
    }

    /// Remaining duration, ns; negative in overtime; `None` for a run without a duration.
    fn remaining_ns(&self) -> Option<i64> {
        let duration_ns = (self.args.duration? * 1e9) as i64;
        let until = self.paused_ns.unwrap_or_else(now);
        let begun = if self.attempt_ns == 0 { 0 } else { until as i64 - self.attempt_ns as i64 };
        Some(duration_ns - begun)
    }
}
