//! The two processes of a replay, each in an instance of its own, and the messages to and from them.
//!
//! Tracker and simulation are not connected: the replay carries every message itself, so that
//! each gets exactly what the record says, when it says so.

use crate::children::{Child, end_all, wait_until_running};
use anyhow::{Context, bail};
use ipc::clock::now;
use ipc::{Instance, Queue, Receiver, Sender, Wakes, wait};
use protocol::blobs::BlobField;
use protocol::control::{Answer, Command, RecordedFrame, Request};
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Health, Process};
use protocol::limits::MAX_WAIT_MS;
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use recording::Provenance;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How long a process may take until it works, ns.
const START_NS: u64 = 20_000_000_000;
/// How long a process may take for one answer before it is taken for hung, ns.
const ANSWER_NS: u64 = 30_000_000_000;

/// How the tracker decides when a frame is complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackerMode {
    /// From the recorded frames.
    Recorded,
    /// From the stream.
    StreamClock,
}

/// The replay was asked to stop.
#[derive(Debug, thiserror::Error)]
#[error("stopped")]
pub struct Stopped;

/// One process and its instance. The children end before the instance is taken away.
struct Side {
    children: Vec<Child>,
    health: Receiver<Health>,
    requests: Sender<Request>,
    answers: Receiver<Answer>,
    seq: u64,
    /// Blocks that the process says it has taken in.
    received: u64,
    stop: Arc<AtomicBool>,
    instance: Instance,
}

impl Side {
    fn open(name: &str, stop: &Arc<AtomicBool>) -> anyhow::Result<Self> {
        let instance = Instance::own(name)?;
        Ok(Side {
            children: Vec::new(),
            health: instance.receiver(Queue::InOrder)?,
            requests: instance.sender()?,
            answers: instance.receiver(Queue::InOrder)?,
            seq: 0,
            received: 0,
            stop: Arc::clone(stop),
            instance,
        })
    }

    /// Writes a file for the process into its instance; returns the path.
    fn file(&self, name: &str, text: &str) -> anyhow::Result<String> {
        let path = self.instance.directory().join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())?;
        Ok(path.display().to_string())
    }

    fn start(&mut self, process: Process, args: &[String]) -> anyhow::Result<()> {
        self.children.push(Child::spawn(process, self.instance.name(), args)?);
        let stop = Arc::clone(&self.stop);
        let stopped = || stop.load(Ordering::Relaxed);
        wait_until_running(&mut self.health, &mut self.children, START_NS, &stopped)
    }

    fn hear_health(&mut self) -> anyhow::Result<()> {
        while let Some(beat) = self.health.next_valid()? {
            self.received = beat.received;
        }
        Ok(())
    }

    /// Called while nothing comes: fails if the process has ended, hangs, or the user stops.
    fn still_there(&mut self, waiting_since: u64, what: &str) -> anyhow::Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Stopped.into());
        }
        for child in &mut self.children {
            if child.exited().is_some() {
                bail!("{what}: {}", child.obituary());
            }
            if now() > waiting_since + ANSWER_NS {
                bail!("{what}: no answer for {} s; {}", ANSWER_NS / 1_000_000_000, child.obituary());
            }
        }
        Ok(())
    }

    fn request(&mut self, process: Process, command: Command) -> anyhow::Result<u64> {
        self.seq += 1;
        let (target, command) = (process as u32, command as u32);
        self.requests.send(&Request { seq: self.seq, argument: 0, target, command })?;
        Ok(self.seq)
    }

    /// The answer to a request, if it has come.
    fn answer(&mut self, seq: u64) -> anyhow::Result<Option<Answer>> {
        while let Some(answer) = self.answers.next_valid()? {
            if answer.seq == seq {
                return Ok(Some(answer));
            }
        }
        Ok(None)
    }

    /// Asks and waits until it is done.
    fn demand(&mut self, process: Process, command: Command) -> anyhow::Result<()> {
        let (seq, since) = (self.request(process, command)?, now());
        loop {
            if let Some(answer) = self.answer(seq)? {
                if answer.result != 0 {
                    bail!("{} cannot do {command:?}: {}", process.name(), answer.text());
                }
                return Ok(());
            }
            wait(&[&self.answers], MAX_WAIT_MS * 1_000_000);
            self.still_there(since, &format!("waiting for {command:?}"))?;
        }
    }
}

impl Drop for Side {
    fn drop(&mut self) {
        self.seq += 1;
        end_all(&mut self.children, Some(&mut self.requests), self.seq);
    }
}

/// Tracker and simulation, ready for work.
pub struct Stage {
    blobs: Sender<BlobField>,
    recorded: Sender<RecordedFrame>,
    tracked: Receiver<TrackerFrame>,
    handles: Sender<HandleState>,
    pedals: Sender<PedalState>,
    poses: Sender<TrackerFrame>,
    steps: Receiver<StepRecord>,
    tracker: Side,
    world: Side,
}

impl Stage {
    /// Starts both processes with the recording's rig and scene (`collision`: who looks for collisions), in instances `<name>-t` and `<name>-s`.
    pub fn start(
        name: &str,
        provenance: &Provenance,
        mode: TrackerMode,
        collision: Option<&str>,
        stop: &Arc<AtomicBool>,
    ) -> anyhow::Result<Self> {
        let tracker = Side::open(&format!("{name}-t"), stop)?;
        let world = Side::open(&format!("{name}-s"), stop)?;
        let mut stage = Stage {
            blobs: tracker.instance.sender()?,
            recorded: tracker.instance.sender()?,
            tracked: tracker.instance.receiver(Queue::InOrder)?,
            handles: world.instance.sender()?,
            pedals: world.instance.sender()?,
            poses: world.instance.sender()?,
            steps: world.instance.receiver(Queue::InOrder)?,
            tracker,
            world,
        };
        let rig = stage.tracker.file("rig.json", &provenance.rig_json)?;
        let scene = stage.world.file("scene.toml", &provenance.scene_toml)?;
        let how = match mode {
            TrackerMode::Recorded => "--replay",
            TrackerMode::StreamClock => "--stream-clock",
        };
        stage.tracker.start(Process::Tracker, &["--rig".into(), rig, how.into()])?;
        let mut of_world = vec!["--scene".to_owned(), scene];
        of_world.extend(collision.into_iter().flat_map(|who| ["--collision".to_owned(), who.to_owned()]));
        stage.world.start(Process::Simcore, &of_world)?;
        Ok(stage)
    }

    /// Sends a camera-field to the tracker.
    pub fn send_field(&mut self, field: &BlobField) -> anyhow::Result<()> {
        Ok(self.blobs.send(field)?)
    }

    /// Asks the tracker for a recorded frame.
    pub fn send_recorded(&mut self, recorded: &RecordedFrame) -> anyhow::Result<()> {
        Ok(self.recorded.send(recorded)?)
    }

    /// The tracker's next frame, if there is one.
    pub fn try_frame(&mut self) -> anyhow::Result<Option<TrackerFrame>> {
        let frame = self.tracked.next_valid()?;
        let counts = self.tracked.counts();
        if counts.lost + counts.refused > 0 {
            bail!("{} tracker frames lost and {} refused on the way", counts.lost, counts.refused);
        }
        Ok(frame)
    }

    /// The tracker's next frame; `field` is for messages.
    pub fn await_frame(&mut self, field: u64) -> anyhow::Result<TrackerFrame> {
        let since = now();
        loop {
            if let Some(frame) = self.try_frame()? {
                return Ok(frame);
            }
            self.wait_for_tracker(since, &format!("tracking field {field}"))?;
        }
    }

    /// Sleeps until the tracker may have something new.
    pub fn wait_for_tracker(&mut self, since: u64, what: &str) -> anyhow::Result<()> {
        let sources: [&dyn Wakes; 3] = [&self.tracked, &self.tracker.health, &self.tracker.answers];
        wait(&sources, MAX_WAIT_MS * 1_000_000);
        self.tracker.hear_health()?;
        self.tracker.still_there(since, what)
    }

    /// Camera-fields and recorded frames that the tracker has received.
    pub fn tracker_received(&self) -> u64 {
        self.tracker.received
    }

    /// Lets the simulation make a step and waits for it.
    pub fn step(
        &mut self,
        handles: &[HandleState],
        pedals: &[PedalState],
        frame: &TrackerFrame,
    ) -> anyhow::Result<StepRecord> {
        handles.iter().try_for_each(|h| self.handles.send(h))?;
        pedals.iter().try_for_each(|p| self.pedals.send(p))?;
        self.poses.send(frame)?;
        let since = now();
        loop {
            if let Some(step) = self.steps.next_valid()? {
                return Ok(step);
            }
            wait(&[&self.steps, &self.world.health], MAX_WAIT_MS * 1_000_000);
            self.world.hear_health()?;
            self.world.still_there(since, &format!("simulating field {}", frame.field))?;
        }
    }

    /// Asks the tracker to finish what is open; the answer shows in [`Stage::flushed`].
    pub fn request_flush(&mut self) -> anyhow::Result<u64> {
        self.tracker.request(Process::Tracker, Command::Flush)
    }

    /// True once the tracker has answered the request.
    pub fn flushed(&mut self, seq: u64) -> anyhow::Result<bool> {
        Ok(self.tracker.answer(seq)?.is_some())
    }

    /// The simulation begins anew.
    pub fn reset_world(&mut self) -> anyhow::Result<()> {
        self.world.demand(Process::Simcore, Command::Reset)
    }

    /// The tracker begins anew.
    pub fn reset_tracker(&mut self) -> anyhow::Result<()> {
        self.tracker.demand(Process::Tracker, Command::Reset)
    }
}
