//! The two processes of a replay, each in an instance of its own, and the messages to and from
//! them.
//!
//! Tracker and simulation are not connected: the replay carries every message itself, so that
//! each gets exactly what was recorded, in the recorded order.

use super::turns::Checkpoint;
use crate::children::{Child, Surroundings, end_all, wait_until_running};
use crate::runtime::{StopSignal, Wakeups};
use anyhow::{Context, bail};
use ipc::logging::warn;
use ipc::{Instance, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::{Answer, Command, RecordedFrame, Request};
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Health, Process};
use protocol::journal::{self, Entry};
use protocol::limits::MAX_WAIT_MS;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use recording::Provenance;
use std::fmt::Debug;
use std::fs::File;
use std::io::BufWriter;
use std::time::Duration;
use tokio::time::Instant;

/// How long a process may take until it works.
const START: Duration = Duration::from_secs(20);
/// How long a process may take for one answer before it is taken for hung.
const ANSWER: Duration = Duration::from_secs(30);

/// How the tracker decides when a frame is complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackerMode {
    /// From the recorded frames.
    Recorded,
    /// From the time of the stream.
    StreamClock,
}

/// The user stopped the replay.
#[derive(Debug, thiserror::Error)]
#[error("stopped")]
pub struct Stopped;

/// One process, its instance, and the channel of what it makes.
pub struct ProcessLink<M: Message + Debug> {
    process: Process,
    /// Of the one process; empty before it is started.
    children: Vec<Child>,
    surroundings: Surroundings,
    output: Receiver<M>,
    health: Receiver<Health>,
    requests: Sender<Request>,
    answers: Receiver<Answer>,
    wakeups: Wakeups,
    seq: u64,
    /// Blocks that the process has taken in, by its newest heartbeat.
    pub received: u64,
    stop: StopSignal,
    // Last, so that the directory goes after the ports.
    instance: Instance,
}

impl<M: Message + Debug> ProcessLink<M> {
    fn open(process: Process, name: &str, stop: &StopSignal) -> anyhow::Result<Self> {
        let instance = Instance::own(name)?;
        let (output, health) = (instance.receiver(Queue::InOrder)?, instance.receiver(Queue::InOrder)?);
        let answers = instance.receiver(Queue::InOrder)?;
        Ok(ProcessLink {
            process,
            children: Vec::new(),
            surroundings: Surroundings::default(),
            wakeups: Wakeups::of(&[&output, &health, &answers])?,
            output,
            health,
            requests: instance.sender()?,
            answers,
            seq: 0,
            received: 0,
            stop: stop.clone(),
            instance,
        })
    }

    /// Writes a file for the process into its instance; returns the path.
    fn file(&self, name: &str, text: &str) -> anyhow::Result<String> {
        let path = self.instance.directory().join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())?;
        Ok(path.display().to_string())
    }

    async fn start(&mut self, args: &[String]) -> anyhow::Result<()> {
        self.children.push(Child::spawn(self.process, self.instance.name(), args, &self.surroundings)?);
        let ended = &self.surroundings.ended;
        wait_until_running(&mut self.health, &self.children, ended, START, &self.stop).await
    }

    /// Waits until the process may have something new. `since` is the beginning of the wait for
    /// `what`.
    ///
    /// # Errors
    /// Where the process has ended or hangs, or the user stops.
    pub async fn wait(&mut self, since: Instant, what: &str) -> anyhow::Result<()> {
        tokio::select! {
            () = self.wakeups.wait(Duration::from_millis(MAX_WAIT_MS)) => {}
            () = self.surroundings.ended.notified() => {}
            () = self.stop.raised() => return Err(Stopped.into()),
        }
        wait(&[&self.output, &self.health, &self.answers], 0);
        while let Some(beat) = self.health.next_valid()? {
            self.received = beat.received;
        }
        for child in &self.children {
            if child.exited().is_some() {
                bail!("{what}: {}", child.exit_report());
            }
            if since.elapsed() > ANSWER {
                bail!("{what}: no answer for {} s; {}", ANSWER.as_secs(), child.exit_report());
            }
        }
        Ok(())
    }

    /// Sends a command; returns the number that its answer carries.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn request(&mut self, command: Command) -> anyhow::Result<u64> {
        self.seq += 1;
        let (target, command) = (self.process as u32, command as u32);
        self.requests.send(&Request { seq: self.seq, argument: 0, target, command })?;
        Ok(self.seq)
    }

    /// The answer to a request, if it has come.
    ///
    /// # Errors
    /// Where the channel fails.
    pub fn answer(&mut self, seq: u64) -> anyhow::Result<Option<Answer>> {
        while let Some(answer) = self.answers.next_valid()? {
            if answer.seq == seq {
                return Ok(Some(answer));
            }
        }
        Ok(None)
    }

    /// Sends a command and waits until it is done.
    ///
    /// # Errors
    /// Where the process cannot do it, has ended or hangs, or the user stops.
    pub async fn command(&mut self, command: Command) -> anyhow::Result<()> {
        let (seq, since) = (self.request(command)?, Instant::now());
        loop {
            if let Some(answer) = self.answer(seq)? {
                if answer.result != 0 {
                    bail!("{} cannot do {command:?}: {}", self.process.name(), answer.text());
                }
                return Ok(());
            }
            self.wait(since, &format!("waiting for {command:?}")).await?;
        }
    }

    async fn end(&mut self) {
        self.seq += 1;
        end_all(&self.children, &mut self.requests, self.seq).await;
        self.children.clear();
        self.instance.clean_up_after_the_dead();
    }
}

/// Tracker and simulation of a replay.
pub struct ReplayProcesses {
    /// Camera fields for the tracker.
    pub blobs: Sender<BlobField>,
    /// Frames that the tracker is asked for.
    pub recorded: Sender<RecordedFrame>,
    handles: Sender<HandleState>,
    pedals: Sender<PedalState>,
    poses: Sender<TrackerFrame>,
    /// The tracker.
    pub tracker: ProcessLink<TrackerFrame>,
    /// The simulation.
    pub world: ProcessLink<StepRecord>,
    /// Its arguments.
    of_world: Vec<String>,
}

impl ReplayProcesses {
    /// Opens the instances `<name>-t` and `<name>-s`. Nothing runs yet.
    ///
    /// # Errors
    /// Where an instance is in use or a channel cannot be opened.
    pub fn open(name: &str, stop: &StopSignal) -> anyhow::Result<Self> {
        let tracker = ProcessLink::open(Process::Tracker, &format!("{name}-t"), stop)?;
        let world = ProcessLink::open(Process::Simcore, &format!("{name}-s"), stop)?;
        Ok(ReplayProcesses {
            blobs: tracker.instance.sender()?,
            recorded: tracker.instance.sender()?,
            handles: world.instance.sender()?,
            pedals: world.instance.sender()?,
            poses: world.instance.sender()?,
            tracker,
            world,
            of_world: Vec::new(),
        })
    }

    /// Starts both processes with the recording's rig and scene, and waits until they work.
    /// `collision` is the simulation's option of this name.
    ///
    /// # Errors
    /// Where a process does not start, or the user stops.
    pub async fn start(
        &mut self,
        provenance: &Provenance,
        mode: TrackerMode,
        collision: Option<&str>,
    ) -> anyhow::Result<()> {
        let rig = self.tracker.file("rig.json", &provenance.rig_json)?;
        let scene = self.world.file("scene.toml", &provenance.scene_toml)?;
        let how = match mode {
            TrackerMode::Recorded => "--replay",
            TrackerMode::StreamClock => "--stream-clock",
        };
        self.tracker.start(&["--rig".into(), rig, how.into()]).await?;
        let mut of_world = vec!["--scene".to_owned(), scene];
        of_world.extend(collision.into_iter().flat_map(|c| ["--collision".to_owned(), c.to_owned()]));
        self.of_world = of_world;
        self.world.start(&self.of_world).await
    }

    /// Starts the simulation again at a recorded state; false where it refuses that (of another
    /// version, say), and stands at its start.
    ///
    /// # Errors
    /// Where it does not start at all, or the user stops.
    pub async fn restore(&mut self, checkpoint: &Checkpoint) -> anyhow::Result<bool> {
        let file = self.world.instance.directory().join("resume.journal");
        let entry = Entry::Checkpoint(checkpoint.0, checkpoint.1.clone());
        let written = File::create(&file)
            .and_then(|out| journal::write(&mut BufWriter::new(out), [&entry].into_iter()));
        written.with_context(|| file.display().to_string())?;
        self.world.end().await;
        let resume = ["--resume".to_owned(), file.display().to_string()];
        match self.world.start(&[&self.of_world[..], &resume].concat()).await {
            Ok(()) => Ok(true),
            Err(error) if error.is::<Stopped>() => Err(error),
            Err(error) => {
                warn(&format!("step {}: its checkpoint is of no use: {error:#}", checkpoint.0.step));
                self.world.end().await;
                self.world.start(&self.of_world).await?;
                Ok(false)
            }
        }
    }

    /// Ends both processes.
    pub async fn end(&mut self) {
        self.world.end().await;
        self.tracker.end().await;
    }

    /// The tracker's next frame, if there is one.
    ///
    /// # Errors
    /// Where a frame was lost or refused on the way.
    pub fn try_frame(&mut self) -> anyhow::Result<Option<TrackerFrame>> {
        let frame = self.tracker.output.next_valid()?;
        let counts = self.tracker.output.counts();
        if counts.lost + counts.refused > 0 {
            bail!("{} tracker frames lost and {} refused on the way", counts.lost, counts.refused);
        }
        Ok(frame)
    }

    /// The tracker's next frame; `field` is for messages.
    ///
    /// # Errors
    /// Where a frame was lost, the tracker fails, or the user stops.
    pub async fn await_frame(&mut self, field: u64) -> anyhow::Result<TrackerFrame> {
        let since = Instant::now();
        loop {
            if let Some(frame) = self.try_frame()? {
                return Ok(frame);
            }
            self.tracker.wait(since, &format!("tracking field {field}")).await?;
        }
    }

    /// Lets the simulation make a step and waits for it.
    ///
    /// # Errors
    /// Where the simulation has ended or hangs, or the user stops.
    pub async fn step(
        &mut self,
        handles: &[HandleState],
        pedals: &[PedalState],
        frame: &TrackerFrame,
    ) -> anyhow::Result<StepRecord> {
        handles.iter().try_for_each(|h| self.handles.send(h))?;
        pedals.iter().try_for_each(|p| self.pedals.send(p))?;
        self.poses.send(frame)?;
        let since = Instant::now();
        loop {
            if let Some(step) = self.world.output.next_valid()? {
                return Ok(step);
            }
            self.world.wait(since, &format!("simulating field {}", frame.field)).await?;
        }
    }
}
