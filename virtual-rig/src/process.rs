//! The virtual rig's process: channels, timeline, control requests and heartbeat.
//!
//! It either simulates the cameras (`simulation`) or plays a recorded stream of blobs (`playback`).

mod controls;
mod kept;
mod output;
mod perception;
mod playback;
mod simulation;
mod surgeon;
mod timeline;

use crate::config::Config;
use crate::playback::BlobPlayback;
use anyhow::{Context, Result, ensure};
use controls::Controls;
use ipc::awake::Awake;
use ipc::clock::{now, sleep_until};
use ipc::shell::Shell;
use ipc::{Instance, Sender, wait};
use kept::{Keeper, Standing};
use perception::PerceptionInput;
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::health::{Process, STATE_FINISHED, STATE_RUNNING};
use protocol::limits::MAX_WAIT_MS;
use protocol::rig::Rig;
use surgeon::ScriptedSurgeon;
use timeline::Timeline;

/// Time before a deadline from which on requests are not served, ns.
const FINE_NS: u64 = 1_000_000;
/// Runs the virtual rig until it is stopped.
///
/// # Errors
/// Where an input cannot be read or does not fit the rig, or a channel fails.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.as_deref()).context("--rig")?;
    let surgeon = ScriptedSurgeon::load(config, &rig)?;
    if let Some(late) = config.late_camera {
        let known = rig.cameras.iter().any(|c| c.id == late.camera);
        ensure!(known, "--late-camera: the rig has no camera {}", late.camera);
    }
    match &config.blobs {
        Some(path) => {
            let playback = BlobPlayback::load(path, &rig).context("--blobs")?;
            VirtualRigShell::open(config, &rig, surgeon)?.play(&playback)
        }
        None => simulation::run(config, &rig, surgeon),
    }
}

/// Cause of the end of a wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wake {
    /// The instant has come.
    Due,
    /// The schedule starts again.
    Restart,
    /// The process ends.
    Stop,
}

/// Channels and state of the process.
struct VirtualRigShell {
    shell: Shell,
    blobs: Sender<BlobField>,
    controls: Controls,
    surgeon: ScriptedSurgeon,
    perception: Option<PerceptionInput>,
    config: Config,
    rig: Rig,
    timeline: Timeline,
    /// Injected delay of fields and controls, for tests of the time budgets, ns.
    delay_ns: u64,
    duration_ns: u64,
    /// Keeps how the script stands, for a successor.
    keeper: Keeper,
    /// Time that had passed when the predecessor was killed, ns after the start.
    resumed_at: Option<u64>,
    awake: Awake,
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
            blobs: instance.sender()?,
            controls: Controls::open(&instance)?,
            perception: reacts.then(|| PerceptionInput::open(&instance, goals)).transpose()?,
            surgeon,
            config: config.clone(),
            rig: rig.clone(),
            timeline: Timeline::default(),
            delay_ns: (config.shell.inject_delay_ms.max(0.0) * 1e6) as u64,
            duration_ns: config.duration.map_or(u64::MAX, |s| (s * 1e9) as u64),
            keeper: Keeper::open(instance.directory()).context("the instance's directory")?,
            resumed_at: None,
            awake: Awake::default(),
            note: "",
            text: String::with_capacity(256),
            instance,
        };
        shell.enter(STATE_RUNNING, shell.surgeon.note)?;
        shell.timeline.restart(now());
        if let Some((time_ns, standing)) = resumed {
            shell.go_on(time_ns, standing);
        } else if config.resume {
            tracing::warn!("the script begins anew: its state was not kept");
        }
        shell.keep();
        Ok(shell)
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

    /// Sends blobs now.
    fn send(&mut self, field: &mut BlobField) -> Result<()> {
        field.blobs_out_ns = now();
        self.blobs.send(field)?;
        self.shell.report.sent = self.blobs.sent() + self.controls.sent();
        Ok(())
    }

    /// Puts the note and the faults into the next heartbeat.
    fn report_text(&mut self) {
        let between = if self.note.is_empty() || self.text.is_empty() { "" } else { "; " };
        self.shell.set_text(&format!("{}{between}{}", self.note, self.text));
    }

    /// Waits until `offset_ns` after the start and serves requests; a pause moves the start.
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

    /// Reports the end `offset_ns` after the start, then serves requests until a restart or a stop.
    fn finish(&mut self, offset_ns: u64) -> Result<Wake> {
        let wake = self.wait_for(offset_ns)?;
        if wake != Wake::Due {
            return Ok(wake);
        }
        self.enter(STATE_FINISHED, "finished")?;
        let wake = self.wait_for(u64::MAX)?;
        if wake == Wake::Restart {
            self.enter(STATE_RUNNING, self.surgeon.note)?;
        }
        Ok(wake)
    }

    /// Serves requests and the heartbeat; true if the schedule starts again.
    fn serve(&mut self) -> Result<bool> {
        let mut restart = false;
        if let Some(slept_ns) = self.awake.slept(now()) {
            // The hand stood still with the rig that moves it.
            self.timeline.shift(slept_ns);
            tracing::warn!("slept for {:.1} s", slept_ns as f64 * 1e-9);
        }
        while let Some((request, command)) = self.shell.serve(now())? {
            let done = self.execute(command, request.argument);
            restart |= done.is_ok() && matches!(command, Command::Reset | Command::Load);
            self.shell.answer(&request, done.as_ref().map_err(String::as_str).copied())?;
            self.keep();
            // What a command takes is no sleep.
            self.awake = Awake::default();
        }
        Ok(restart)
    }

    /// Executes a command; the error is the reason of a refusal.
    fn execute(&mut self, command: Command, argument: u64) -> Result<(), String> {
        match command {
            Command::Pause => self.timeline.pause(now()),
            Command::Start => self.timeline.resume(now()),
            Command::Reset => self.restart(),
            // The surgeon of the scene file is loaded again; a duration of 0 ms keeps the present
            // one.
            Command::Load => {
                let loaded = ScriptedSurgeon::load(&self.config, &self.rig);
                self.surgeon = loaded.map_err(|problem| format!("{problem:#}"))?;
                if argument > 0 {
                    self.duration_ns = argument * 1_000_000;
                }
                self.restart();
            }
            _ => return Err("the virtual rig knows start, pause, reset and load only".into()),
        }
        Ok(())
    }

    /// Starts the schedule and the surgeon again.
    fn restart(&mut self) {
        self.surgeon.motion = self.surgeon.fresh.clone();
        self.timeline.restart(now());
    }

    /// Enters a state and sends the heartbeat at once.
    fn enter(&mut self, state: u32, note: &'static str) -> Result<()> {
        self.shell.report.state = state;
        self.note = note;
        self.report_text();
        Ok(self.shell.beat_now(now())?)
    }
}
