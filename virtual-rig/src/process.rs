//! The virtual rig's loop: when fields are exposed, when they and the controls are sent.
//!
//! Field `k` is exposed at `t0 + k·period` (or by its camera's own clock). Its pixels are synthesised and
//! published ahead, with the instants at which a real camera would send them; the camera hardware keeps
//! to those. Blobs that are made without pixels are held back here. A machine that falls behind by a
//! field leaves fields out and counts them; nothing queues up.

mod controls;
mod perception;
mod timeline;

use crate::cameras::{Cameras, Path};
use crate::config::{Config, LateCamera};
use crate::faults::FaultInjector;
use crate::faults::spec::FaultSpec;
use crate::faults::tally::{FaultLog, FaultTally};
use crate::playback::BlobPlayback;
use crate::schedule::{Action, Schedule};
use anyhow::{Context, Result, ensure};
use bytemuck::Zeroable;
use controls::{ControlSample, Controls};
use ipc::clock::{now, sleep_until};
use ipc::logging::message;
use ipc::outbox::Outbox;
use ipc::shell::Shell;
use ipc::{BlockSender, Instance, Sender, wait};
use perception::PerceptionInput;
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::fields::FieldHeader;
use protocol::health::{Process, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING};
use protocol::limits::MAX_WAIT_MS;
use protocol::rig::Rig;
use scene::SceneFile;
use surgeon::motion::recorded::RecordedMotion;
use surgeon::motion::{MotionSource, MotionUse};
use timeline::Timeline;

/// The last stretch before a deadline is slept through without looking at requests, ns.
const FINE_NS: u64 = 1_000_000;
/// Fields in a row that must be in time before the machine counts as fast enough again.
const RECOVERED_AFTER: u64 = 50;
/// Time that the camera hardware has after the last field is due before the end is reported, ns.
const DRAIN_NS: u64 = 5_000_000;
/// Note of a scene without a script.
const NO_SCRIPT: &str = "the scene has no script: instruments rest";

/// Runs until told to stop.
///
/// # Errors
/// Where an input cannot be read or does not fit the rig, or a channel fails.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.as_deref())?;
    let surgeon = ScriptedSurgeon::load(config, &rig)?;
    if let Some(late) = config.late_camera {
        let known = rig.cameras.iter().any(|c| c.id == late.camera);
        ensure!(known, "--late-camera: the rig has no camera {}", late.camera);
    }
    if let Some(path) = &config.blobs {
        let playback = BlobPlayback::load(path, &rig)?;
        return VirtualRigShell::open(config, &rig, surgeon)?.play(&playback);
    }
    let path = if config.direct { Path::Direct } else { Path::Pixels };
    let faults = match &config.faults.faults {
        Some(text) => FaultInjector::new(FaultSpec::load(text)?, &rig, config.seed)?,
        None => FaultInjector::none(&rig),
    };
    let log = config
        .faults
        .fault_log
        .as_deref()
        .map(|path| FaultLog::create(path).with_context(|| format!("cannot write {}", path.display())));
    let mut cameras = Cameras::with_faults(&rig, path, config.seed, faults)?;
    let mut shell = VirtualRigShell::open(config, &rig, surgeon)?;
    shell.late = config.late_camera;
    shell.fault_log = log.transpose()?;
    let mut output = Output::open(&shell.instance, path, cameras.payload_bytes())?;
    shell.simulate(&mut cameras, &mut output)?;
    let mut summary = String::new();
    cameras.tally.summary(&mut summary);
    if !summary.is_empty() {
        message(tracing::Level::INFO, &summary);
    }
    Ok(())
}

/// The surgeon of the scene, with the recorded motion that was asked for.
struct ScriptedSurgeon {
    motion: MotionSource,
    /// The surgeon before the first field, who has seen nothing.
    fresh: MotionSource,
    /// What is worth knowing while nothing is wrong.
    note: &'static str,
}

impl ScriptedSurgeon {
    fn load(config: &Config, rig: &Rig) -> Result<Self> {
        let scene = SceneFile::load(&config.scene)?;
        let recorded = config.motion.as_deref().map(RecordedMotion::load).transpose()?;
        let recorded = recorded.map(if config.motion_full { MotionUse::Full } else { MotionUse::Tremor });
        let motion = MotionSource::new(&scene, rig, recorded, config.seed);
        let scripted = scene.script.is_some() || config.motion_full;
        Ok(ScriptedSurgeon { fresh: motion.clone(), motion, note: if scripted { "" } else { NO_SCRIPT } })
    }
}

/// Where fields go.
enum Output {
    /// Pixels to the camera hardware.
    Fields(BlockSender<FieldHeader>),
    /// Blobs to the tracker, when they are due.
    Blobs(Outbox),
}

impl Output {
    fn open(instance: &Instance, path: Path, payload_bytes: usize) -> Result<Self> {
        Ok(match path {
            Path::Pixels => Output::Fields(instance.block_sender(payload_bytes)?),
            Path::Direct => Output::Blobs(Outbox::default()),
        })
    }

    /// When the next blobs are due, ns after the start.
    fn due_ns(&self) -> Option<u64> {
        match self {
            Output::Fields(_) => None,
            Output::Blobs(outbox) => outbox.due_ns(),
        }
    }

    fn sent(&self) -> u64 {
        match self {
            Output::Fields(fields) => fields.sent(),
            Output::Blobs(_) => 0,
        }
    }
}

/// Why a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wake {
    /// The instant has come.
    Due,
    /// Begin anew.
    Restart,
    /// End.
    Stop,
}

/// Channels and schedule of the process.
struct VirtualRigShell {
    shell: Shell,
    blobs: Sender<BlobField>,
    controls: Controls,
    surgeon: ScriptedSurgeon,
    perception: Option<PerceptionInput>,
    config: Config,
    rig: Rig,
    timeline: Timeline,
    /// Added to the instant at which blobs leave, to prove that budgets notice.
    delay_ns: u64,
    late: Option<LateCamera>,
    duration_ns: u64,
    in_time: u64,
    fault_log: Option<FaultLog>,
    /// Note on the state, and the health text made from it and the faults.
    note: &'static str,
    text: String,
    /// Keeps the node alive; dropped last.
    instance: Instance,
}

impl VirtualRigShell {
    fn open(config: &Config, rig: &Rig, surgeon: ScriptedSurgeon) -> Result<Self> {
        let (instance, shell) = Shell::start(Process::VirtualRig, &config.shell).context("cannot start")?;
        let reacts = surgeon.motion.is_reactive();
        let mut shell = VirtualRigShell {
            shell,
            blobs: instance.sender()?,
            controls: Controls::open(&instance)?,
            perception: reacts.then(|| PerceptionInput::open(&instance)).transpose()?,
            surgeon,
            config: config.clone(),
            rig: rig.clone(),
            timeline: Timeline::default(),
            delay_ns: (config.shell.inject_delay_ms.max(0.0) * 1e6) as u64,
            late: None,
            duration_ns: config.duration.map_or(u64::MAX, |s| (s * 1e9) as u64),
            in_time: 0,
            fault_log: None,
            note: "",
            text: String::with_capacity(256),
            instance,
        };
        shell.enter(STATE_RUNNING, shell.surgeon.note)?;
        shell.timeline.restart(now());
        Ok(shell)
    }

    /// Simulates the cameras, field by field.
    fn simulate(&mut self, cameras: &mut Cameras, output: &mut Output) -> Result<()> {
        let mut schedule = Schedule::of(cameras);
        let mut controls: Option<ControlSample> = None;
        let mut last_due_ns = 0;
        loop {
            let elapsed = self.timeline.elapsed(now());
            let send = output.due_ns().into_iter().chain(controls.map(|c| c.due_ns)).min();
            let wake = match schedule.next(elapsed, send, self.end_ns()) {
                // A published field has its instants: none is made while the schedule stands still.
                Action::Expose(_) if self.timeline.is_paused() => self.wait_for(0)?,
                Action::Expose(i) => {
                    let missed = schedule.leave_out_missed(i, elapsed);
                    self.judge(missed, schedule.0[i].cameras.len() as u64)?;
                    let number = schedule.exposed(i);
                    for &camera in &schedule.0[i].cameras {
                        last_due_ns = self.expose(cameras, camera, number, output)?.max(last_due_ns);
                    }
                    if i == 0 {
                        let exposed = schedule.0[i].clock.exposed_ns(number);
                        let due = exposed + schedule.0[i].out_after_ns + self.delay_ns;
                        controls = Some(ControlSample::at(&mut self.surgeon.motion, exposed, number, due));
                        if let Some(perception) = &mut self.perception {
                            perception.show(&mut self.surgeon.motion, exposed)?;
                        }
                    }
                    self.report_faults(&mut cameras.tally)?;
                    continue;
                }
                Action::Wait(until) => self.wait_for(until)?,
                Action::Over => self.finish(last_due_ns + DRAIN_NS)?,
            };
            match wake {
                Wake::Stop => return Ok(()),
                Wake::Restart => {
                    if let Output::Blobs(outbox) = output {
                        outbox.clear();
                    }
                    schedule.reset();
                    (controls, last_due_ns) = (None, 0);
                }
                Wake::Due => {
                    let elapsed = self.timeline.elapsed(now());
                    if let Some(due) = controls.take_if(|c| c.due_ns <= elapsed) {
                        self.controls.send(&due)?;
                    }
                    self.send_due(output, elapsed)?;
                }
            }
        }
    }

    /// When the last field has been exposed, ns after the start.
    fn end_ns(&self) -> u64 {
        let after = |s: f64| ((self.surgeon.motion.period_s() + s) * 1e9) as u64;
        self.config.after_round.map_or(u64::MAX, after).min(self.duration_ns)
    }

    /// Exposes field `number` of camera `i` and publishes its pixels, or holds its blobs until they are
    /// due. Returns when they are due at the earliest, ns after the start.
    fn expose(&mut self, cameras: &mut Cameras, i: usize, number: u64, output: &mut Output) -> Result<u64> {
        let late_ns = self.late.filter(|l| l.camera == cameras.id(i)).map_or(0, |l| l.delay_ns);
        let delivery = cameras.delivery(i, number);
        let late_ns = late_ns + delivery.delay_ns;
        let due_ns = cameras.clock(i).exposed_ns(number) + cameras.out_after_ns(i) + late_ns + self.delay_ns;
        let mut exposure = cameras.expose(i, &mut self.surgeon.motion, number);
        if delivery.dropped {
            return Ok(due_ns);
        }
        match output {
            Output::Fields(fields) => {
                let mut header = exposure.header();
                header.exposed_ns += self.timeline.start();
                header.first_line_ns += self.timeline.start() + late_ns;
                fields.send(header.bytes(), |payload| {
                    exposure.paint(payload);
                    header
                })?;
            }
            Output::Blobs(outbox) => {
                let mut field = BlobField::zeroed();
                exposure.blobs(&mut field);
                if !outbox.put(due_ns, &field) {
                    self.shell.report.lost += 1;
                }
            }
        }
        self.shell.report.sent = self.blobs.sent() + self.controls.sent() + output.sent();
        Ok(due_ns)
    }

    /// Sends the blobs that are due. Their instants count from the start until here, because a pause may
    /// move that.
    fn send_due(&mut self, output: &mut Output, elapsed: u64) -> Result<()> {
        let Output::Blobs(outbox) = output else { return Ok(()) };
        while let Some(mut field) = outbox.take(elapsed) {
            field.exposed_ns += self.timeline.start();
            field.read_out_ns += self.timeline.start();
            self.send(&mut field)?;
        }
        Ok(())
    }

    fn send(&mut self, field: &mut BlobField) -> Result<()> {
        field.blobs_out_ns = now();
        self.blobs.send(field)?;
        self.shell.report.sent = self.blobs.sent() + self.controls.sent();
        Ok(())
    }

    /// Writes down what the faults did and puts it into the next heartbeat.
    fn report_faults(&mut self, tally: &mut FaultTally) -> Result<()> {
        if tally.waiting().is_empty() {
            return Ok(());
        }
        if let Some(log) = &mut self.fault_log {
            log.write(tally.waiting()).context("cannot write the fault log")?;
        }
        tally.clear_waiting();
        self.text.clear();
        tally.summary(&mut self.text);
        self.say();
        Ok(())
    }

    /// Puts the note on the state and the faults into the next heartbeat.
    fn say(&mut self) {
        if self.note.is_empty() || self.text.is_empty() {
            let text = if self.note.is_empty() { self.text.as_str() } else { self.note };
            self.shell.say(text);
        } else {
            let length = self.text.len();
            self.text.insert_str(0, "; ");
            self.text.insert_str(0, self.note);
            self.shell.say(&self.text);
            self.text.drain(..self.text.len() - length);
        }
    }

    /// Plays a recorded stream of blobs; then finishes.
    fn play(&mut self, playback: &BlobPlayback) -> Result<()> {
        let mut field = BlobField::zeroed();
        let (mut i, mut beats) = (0, 0);
        let period_ns = self.rig.field_period_ns();
        loop {
            let over = i == playback.len() || playback.due_ns(i) >= self.duration_ns;
            let wake = if over { self.finish(0)? } else { self.wait_for(playback.due_ns(i))? };
            match wake {
                Wake::Stop => return Ok(()),
                Wake::Restart => {
                    (i, beats) = (0, 0);
                    continue;
                }
                Wake::Due => {}
            }
            // The stream holds no controls: those of the script go with it, once a field period.
            let elapsed = playback.due_ns(i);
            if elapsed >= beats * period_ns {
                let sample = ControlSample::at(&mut self.surgeon.motion, elapsed, beats, elapsed);
                self.controls.send(&sample)?;
                beats = elapsed / period_ns + 1;
            }
            playback.field(i, self.timeline.start(), &mut field);
            self.shell.inject_delay();
            self.send(&mut field)?;
            i += 1;
        }
    }

    /// Counts fields that the machine was too slow for.
    fn judge(&mut self, missed: u64, cameras: u64) -> Result<()> {
        if missed > 0 {
            self.shell.report.lost += missed * cameras;
            self.in_time = 0;
            if self.shell.report.state == STATE_RUNNING {
                self.enter(STATE_DEGRADED, "machine too slow: fields are left out")?;
            }
        } else {
            self.in_time += 1;
            if self.in_time == RECOVERED_AFTER && self.shell.report.state == STATE_DEGRADED {
                self.enter(STATE_RUNNING, self.surgeon.note)?;
            }
        }
        Ok(())
    }

    /// Waits until `offset_ns` after the start of the schedule, serving requests; a pause moves the
    /// schedule.
    fn wait_for(&mut self, offset_ns: u64) -> Result<Wake> {
        loop {
            if self.serve()? {
                return Ok(Wake::Restart);
            }
            if self.shell.stopping() {
                return Ok(Wake::Stop);
            }
            let due = self.timeline.instant(offset_ns);
            let left = due.saturating_sub(now());
            if left <= FINE_NS {
                sleep_until(due);
                return Ok(Wake::Due);
            }
            wait(&[self.shell.control()], (left - FINE_NS / 2).min(MAX_WAIT_MS * 1_000_000));
        }
    }

    /// Reports the end `offset_ns` after the start and goes on breathing until told otherwise.
    fn finish(&mut self, offset_ns: u64) -> Result<Wake> {
        match self.wait_for(offset_ns)? {
            Wake::Due => {}
            other => return Ok(other),
        }
        self.enter(STATE_FINISHED, "finished")?;
        let wake = self.wait_for(u64::MAX)?;
        if wake == Wake::Restart {
            self.enter(STATE_RUNNING, self.surgeon.note)?;
        }
        Ok(wake)
    }

    /// Serves requests and the heartbeat; true if everything shall begin anew.
    fn serve(&mut self) -> Result<bool> {
        let mut restart = false;
        while let Some((request, command)) = self.shell.serve(now())? {
            let answer = match command {
                Command::Pause => Ok(self.timeline.pause(now())),
                Command::Start => Ok(self.timeline.resume(now())),
                Command::Reset | Command::Load => {
                    if command == Command::Load
                        && let Err(problem) = self.load(request.argument)
                    {
                        self.shell.answer(&request, Err(&format!("{problem:#}")))?;
                        continue;
                    }
                    self.surgeon.motion = self.surgeon.fresh.clone();
                    self.timeline.restart(now());
                    restart = true;
                    Ok(())
                }
                _ => Err("the virtual rig knows start, pause, reset and load only"),
            };
            self.shell.answer(&request, answer)?;
        }
        Ok(restart)
    }

    /// Takes the surgeon of the scene that the file holds now; `duration_ms` 0 leaves the duration.
    fn load(&mut self, duration_ms: u64) -> Result<()> {
        self.surgeon = ScriptedSurgeon::load(&self.config, &self.rig)?;
        if duration_ms > 0 {
            self.duration_ns = duration_ms * 1_000_000;
        }
        Ok(())
    }

    fn enter(&mut self, state: u32, note: &'static str) -> Result<()> {
        self.shell.report.state = state;
        self.note = note;
        self.say();
        Ok(self.shell.beat_now(now())?)
    }
}
