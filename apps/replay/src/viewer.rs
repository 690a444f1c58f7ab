//! The ordinary renderer in a process of its own, which shows what a replay publishes: poses and scenes
//! over the same channels as in a run.

use crate::blocks::Blocks;
use crate::film::StepShown;
use crate::pace::Stopped;
use anyhow::{Context, bail};
use ipc::clock::now;
use ipc::logging::arguments;
use ipc::{BlockSender, Instance, Queue, Receiver, Sender, programs, wait};
use outputs::Outputs;
use protocol::control::{Command, Request};
use protocol::health::{Health, Process, STATE_STARTING};
use protocol::inputs::{Hint, Input, InputEvent, Key};
use protocol::message::text_bytes;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use rig::Rig;
use scene::SceneFile;
use simcore::world::World;
use std::ops::ControlFlow;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// How long the renderer may take until it can draw: a software driver compiles for seconds.
const START: Duration = Duration::from_secs(60);
/// How long it may take to end.
const END: Duration = Duration::from_secs(3);
/// Between two looks at whether it has ended.
const LOOK: Duration = Duration::from_millis(10);

/// A renderer that shows a replay.
pub struct Viewer {
    renderer: Child,
    requests: Sender<Request>,
    asked: u64,
    hints: Sender<Hint>,
    inputs: Receiver<InputEvent>,
    poses: Sender<TrackerFrame>,
    scenes: BlockSender<SceneHeader>,
    blocks: Blocks,
    /// Number of the step that was shown last.
    last: Option<u64>,
    /// Keeps the channels; dropped last.
    _instance: Instance,
}

impl Viewer {
    /// Starts the renderer in an instance of the name `instance`, with `options` of its own, for a scene at
    /// its start, and waits until it can draw; `stopped` ends that early.
    ///
    /// # Errors
    /// Where the name is in use, or the renderer cannot be started or ends: without a display, for instance.
    pub fn start(
        instance: &str,
        (scene, world): (&SceneFile, &World),
        rig: &Rig,
        options: &[String],
        stopped: impl Fn() -> bool,
    ) -> anyhow::Result<Self> {
        let instance = Instance::own(instance)?;
        let file = |name: &str, text: String| {
            let path = instance.directory().join(name);
            Outputs::new(true).write(&path, text).map(|()| path)
        };
        let (rig, scene) = (file("rig.json", rig.to_json())?, file("scene.toml", scene.to_toml())?);
        let blocks = Blocks::new(world);
        let mut health: Receiver<Health> = instance.receiver(Queue::InOrder)?;
        let channels = (instance.sender()?, instance.sender()?, instance.receiver(Queue::InOrder)?);
        let (poses, scenes) = (instance.sender()?, instance.block_sender(blocks.capacity())?);
        let mut command = programs::command(Process::Renderer.binary())?;
        command.args(["--instance", instance.name(), "--supervised", "--replay"]).args(arguments());
        command.arg("--rig").arg(rig).arg("--scene").arg(scene).args(options);
        let renderer = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn().context("the renderer")?;
        let (requests, hints, inputs) = channels;
        let mut viewer = Viewer {
            renderer,
            requests,
            asked: 0,
            hints,
            inputs,
            poses,
            scenes,
            blocks,
            last: None,
            _instance: instance,
        };
        viewer.await_start(&mut health, stopped)?;
        Ok(viewer)
    }

    fn await_start(
        &mut self,
        health: &mut Receiver<Health>,
        stopped: impl Fn() -> bool,
    ) -> anyhow::Result<()> {
        let begun = Instant::now();
        loop {
            wait(&[&*health], LOOK.as_nanos() as u64);
            while let Some(beat) = health.next_valid()? {
                if beat.process == Process::Renderer as u32 && beat.state != STATE_STARTING {
                    return Ok(());
                }
            }
            if let Some(status) = self.renderer.try_wait()? {
                bail!("the renderer ended ({status})");
            }
            if stopped() {
                bail!(Stopped);
            }
            if begun.elapsed() > START {
                bail!("the renderer has not started after {} s", START.as_secs());
            }
        }
    }

    /// Shows a step: its poses and its scene. Breaks where the user has closed the window.
    ///
    /// # Errors
    /// Where a channel fails, or the renderer has ended with an error.
    pub fn show(&mut self, step: &StepShown<'_>) -> anyhow::Result<ControlFlow<()>> {
        if let Some(status) = self.renderer.try_wait()? {
            return if status.success() {
                Ok(ControlFlow::Break(()))
            } else {
                bail!("the renderer ended ({status})")
            };
        }
        let last = self.last.replace(step.step);
        if last.is_none_or(|last| step.step != last + 1) {
            self.blocks.forget();
        }
        self.poses.send(step.poses)?;
        let (header, payload) = self.blocks.make(step.world, step.instants, step.state_hash);
        self.scenes.send(payload.len(), |room| {
            room.copy_from_slice(payload);
            header
        })?;
        Ok(ControlFlow::Continue(()))
    }

    /// Shows a line at the lower left.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn say(&mut self, text: &str) -> anyhow::Result<()> {
        Ok(self.hints.send(&Hint { instant_ns: now(), text: text_bytes(text) })?)
    }

    /// Shows the keys over the picture, or hides them.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn show_help(&mut self, shown: bool) -> anyhow::Result<()> {
        self.ask(Command::Help, u64::from(shown))
    }

    fn ask(&mut self, command: Command, argument: u64) -> anyhow::Result<()> {
        self.asked += 1;
        let (target, command) = (Process::Renderer as u32, command as u32);
        Ok(self.requests.send(&Request { seq: self.asked, argument, target, command })?)
    }

    /// The next key that was pressed in the window.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn next_key(&mut self) -> anyhow::Result<Option<Key>> {
        while let Some(event) = self.inputs.next_valid()? {
            if let Some(Input::Press(key)) = event.input() {
                return Ok(Some(key));
            }
        }
        Ok(None)
    }

    /// Whether the renderer has ended.
    pub fn has_ended(&mut self) -> bool {
        !matches!(self.renderer.try_wait(), Ok(None))
    }

    /// Ends the renderer.
    ///
    /// # Errors
    /// Where it ends with an error.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.ask(Command::Shutdown, 0)?;
        let begun = Instant::now();
        while begun.elapsed() < END {
            if let Some(status) = self.renderer.try_wait()? {
                return if status.success() { Ok(()) } else { bail!("the renderer ended ({status})") };
            }
            std::thread::sleep(LOOK);
        }
        bail!("the renderer did not end")
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        if !self.has_ended() {
            let _ = self.renderer.kill();
            let _ = self.renderer.wait();
        }
    }
}
