//! The virtual rig's process: channels, timeline, control requests and heartbeat.
//!
//! Its fields come from simulated cameras (`simulation`), from a recorded stream of blobs (`playback`), or
//! from one that is read while it is made (`live`).

mod controls;
mod kept;
mod live;
mod output;
mod perception;
mod playback;
mod simulation;
mod surgeon;
mod timeline;

use crate::config::Config;
use crate::playback::BlobPlayback;
use anyhow::{Context, Result, ensure};
use controls::ControlSample;
use ipc::clock::now;
use ipc::outbox::Outbox;
use ipc::shell::{Served, Shell, Work};
use ipc::trace::About;
use ipc::{ControlSender, Instance, Lease, Sender};
use kept::{Keeper, Standing};
use perception::PerceptionInput;
use playback::Playback;
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::health::{Process, STATE_FINISHED, STATE_RUNNING};
use protocol::phases::Phase;
use protocol::time::Nanos;
use rig::Rig;
use settings::blob_source::BlobSource;
use surgeon::ScriptedSurgeon;
use timeline::Timeline;

/// Runs the virtual rig until it is stopped.
///
/// # Errors
/// Where an input cannot be read or does not fit the rig, or a channel fails.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
    let surgeon = ScriptedSurgeon::load(config, &rig)?;
    if let Some(late) = config.late_camera {
        let known = rig.cameras.iter().any(|c| c.id == late.camera);
        ensure!(known, "--late-camera: the rig has no camera {}", late.camera);
    }
    match &config.cameras.blobs {
        Some(path) => {
            let source = BlobSource::of(path).map_err(anyhow::Error::msg).context("--blobs")?;
            if source.is_live() {
                return live::run(&source, config, &rig, surgeon);
            }
            let stream = BlobPlayback::load(path, &rig).context("--blobs")?;
            let playback = Playback { stream, next: 0, beats: 0 };
            VirtualRigShell::open(config, &rig, surgeon)?.run(playback).map(drop)
        }
        None => simulation::run(config, &rig, surgeon),
    }
}

/// Where the fields come from.
trait Source {
    /// Whether it is asked for nothing before the instant that it named, nor during a pause.
    const WAITS: bool = true;

    /// Rests until there may be something to put out, `due` where nothing else brings it.
    fn rest(&self, shell: &Shell, due: Nanos) {
        shell.rest_to(&[], due);
    }

    /// Puts out what is due; returns when to go on, ns after the start.
    fn advance(&mut self, rig: &mut VirtualRigShell) -> Result<u64>;

    /// Starts again with the first field.
    fn restart(&mut self);
}

/// Channels and state of the process.
struct VirtualRigShell {
    shell: Shell,
    blobs: Sender<BlobField>,
    controls: ControlSender,
    surgeon: ScriptedSurgeon,
    perception: Option<PerceptionInput>,
    config: Config,
    rig: Rig,
    timeline: Timeline,
    duration_ns: u64,
    /// Keeps how the script stands, for a successor.
    keeper: Keeper,
    /// Time that had passed when the predecessor was killed, ns after the start.
    resumed_at: Option<u64>,
    /// Note on the state.
    note: &'static str,
    /// Summary of the faults.
    text: String,
    /// Keeps the node alive; dropped last.
    instance: Instance,
}

impl VirtualRigShell {
    fn open(config: &Config, rig: &Rig, surgeon: ScriptedSurgeon) -> Result<Self> {
        let (instance, shell) = Shell::start(Process::VirtualRig, &config.shell).context("cannot start")?;
        let resumed = config.resume.then(|| kept::predecessor(instance.directory())).flatten();
        let goals = resumed.as_ref().map_or(0, |(_, standing)| standing.reached) | config.goals_reached;
        let reacts = surgeon.motion.is_reactive();
        let mut shell = VirtualRigShell {
            shell,
            blobs: Outbox::sender(&instance)?,
            controls: ControlSender::open(&instance, config.leave.unwrap_or_default())?,
            perception: reacts.then(|| PerceptionInput::open(&instance, goals)).transpose()?,
            note: surgeon.note,
            surgeon,
            config: config.clone(),
            rig: rig.clone(),
            timeline: Timeline::default(),
            duration_ns: config.duration.map_or(u64::MAX, |s| (s * 1e9) as u64),
            keeper: Keeper::open(instance.directory()).context("the instance's directory")?,
            resumed_at: None,
            text: String::with_capacity(256),
            instance,
        };
        shell.report_text();
        shell.timeline.restart(now());
        if let Some((time_ns, standing)) = resumed {
            shell.go_on(time_ns, standing);
        } else if config.resume {
            tracing::warn!("the script starts over: its state was not saved");
        }
        shell.keep();
        Ok(shell)
    }

    /// Puts out what a source gives until the process is stopped; returns the source.
    fn run<S: Source>(self, source: S) -> Result<S> {
        let mut process = VirtualRig { rig: self, source, until_ns: None };
        ipc::shell::run(&mut process)?;
        Ok(process.source)
    }

    /// Sends handles and pedal.
    fn send_controls(&mut self, sample: &ControlSample) -> Result<()> {
        self.controls.send_handles(sample.field, sample.tool, sample.jaw_rad)?;
        Ok(self.controls.send_pedal(&sample.pedal)?)
    }

    /// Goes on where the predecessor stood. The time without a rig is one in which nothing went on.
    fn go_on(&mut self, time_ns: u64, standing: Standing) {
        self.surgeon.motion.go_on(standing.script, time_ns);
        self.duration_ns = standing.duration_ns;
        self.timeline.go_on(now(), time_ns, standing.paused);
        self.resumed_at = Some(time_ns);
    }

    /// Keeps how the script stands; to be called when it has changed.
    fn keep(&mut self) {
        self.keeper.keep(&Standing {
            script: self.surgeon.motion.script().clone(),
            reached: self.perception.as_ref().map_or(0, PerceptionInput::goals_reached),
            duration_ns: self.duration_ns,
            paused: self.timeline.is_paused(),
        });
    }

    /// Builds blobs where they are sent from, and sends them now.
    fn send(&mut self, build: impl FnOnce(&mut BlobField)) -> Result<()> {
        let mut lease = self.blobs.lend()?;
        build(lease.block());
        self.send_lease(lease)
    }

    /// Sends blobs that were lent, now.
    fn send_lease(&mut self, mut lease: Lease<BlobField>) -> Result<()> {
        let field = lease.block();
        let at = now();
        field.blobs_out_ns = at;
        let about = About::camera(field.field, field.camera);
        self.blobs.send_lease(lease)?;
        self.shell.trace.end(Phase::SendBlobs, about, at);
        self.shell.report.sent = self.blobs.sent() + self.controls.sent();
        Ok(())
    }

    /// Puts the note and the faults into the next heartbeat.
    fn report_text(&mut self) {
        let between = if self.note.is_empty() || self.text.is_empty() { "" } else { "; " };
        self.shell.set_text(&format!("{}{between}{}", self.note, self.text));
    }

    /// Loads the surgeon of the scene file again; a duration of 0 ms keeps the present one.
    fn load(&mut self, duration_ms: u64) -> Result<()> {
        self.surgeon = ScriptedSurgeon::load(&self.config, &self.rig)?;
        if duration_ms > 0 {
            self.duration_ns = duration_ms * 1_000_000;
        }
        Ok(())
    }

    /// Announces the end of the data `offset_ns` after the start; returns when to go on.
    fn finish(&mut self, offset_ns: u64) -> Result<u64> {
        if now() < self.timeline.instant(offset_ns) {
            return Ok(offset_ns);
        }
        self.enter(STATE_FINISHED, "finished")?;
        Ok(u64::MAX)
    }

    /// Enters a state and sends the heartbeat at once.
    fn enter(&mut self, state: u32, note: &'static str) -> Result<()> {
        self.shell.report.state = state;
        self.note = note;
        self.report_text();
        Ok(self.shell.beat_now(now())?)
    }
}

/// The process: a source of fields and the shell around it.
struct VirtualRig<S> {
    rig: VirtualRigShell,
    source: S,
    /// Until when the source waits, ns after the start; `None` to go on at once.
    until_ns: Option<u64>,
}

impl<S: Source> VirtualRig<S> {
    /// Until when the source waits; a pause has no end.
    fn due(&self) -> Nanos {
        if !S::WAITS {
            return 0;
        }
        self.until_ns.map_or(0, |offset_ns| self.rig.timeline.instant(offset_ns))
    }

    /// Starts schedule and surgeon again. The source goes on at once, ahead of its first field.
    fn restart(&mut self) -> Result<()> {
        let VirtualRig { rig, source, until_ns } = self;
        rig.surgeon.motion = rig.surgeon.fresh.clone();
        rig.timeline.restart(now());
        source.restart();
        *until_ns = None;
        if rig.shell.report.state == STATE_FINISHED {
            rig.enter(STATE_RUNNING, rig.surgeon.note)
        } else {
            Ok(())
        }
    }
}

impl<S: Source> Work<anyhow::Error> for VirtualRig<S> {
    fn shell(&mut self) -> &mut Shell {
        &mut self.rig.shell
    }

    fn rest(&mut self) {
        self.source.rest(&self.rig.shell, self.due());
    }

    /// The hand stood still with the rig that moves it.
    fn slept(&mut self, slept_ns: u64) -> Result<u64> {
        self.rig.timeline.shift(slept_ns);
        tracing::warn!("the machine was suspended for {:.1} s", slept_ns as f64 * 1e-9);
        Ok(0)
    }

    fn turn(&mut self, woken: Nanos) -> Result<()> {
        if woken >= self.due() {
            self.until_ns = Some(self.source.advance(&mut self.rig)?);
        }
        Ok(())
    }

    fn execute(&mut self, command: Command, argument: u64) -> Result<Served> {
        match command {
            Command::Pause => self.rig.timeline.pause(now()),
            Command::Start => self.rig.timeline.resume(now()),
            Command::Reset => self.restart()?,
            Command::Load => match self.rig.load(argument) {
                Ok(()) => self.restart()?,
                refused => return Ok(Served::of(refused)),
            },
            _ => return Ok(Served::NothingToDo),
        }
        self.rig.keep();
        Ok(Served::Done)
    }
}
