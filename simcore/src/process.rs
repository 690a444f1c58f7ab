//! The loop: poses, handles and pedal in; steps, scene, events and checkpoints out. The only module
//! that knows the transport and the clock.

use crate::config::Args;
use crate::resume::{InputHistory, ResumeOutcome};
use crate::scene_block::{SceneWriter, bytes_needed};
use crate::world::World;
use anyhow::Context;
use collision::backend::Backend;
use ipc::clock::now;
use ipc::shell::Shell;
use ipc::{BlockSender, Instance, IpcError, Queue, Receiver, Sender, wait};
use protocol::control::Command;
use protocol::events::{Event, EventKind, NO_INSTRUMENT};
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Process, STATE_RUNNING};
use protocol::journal::{JournalError, Reader};
use protocol::limits::{CHECKPOINT_NS, MAX_CHECKPOINT_BYTES, MAX_WAIT_MS};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::steps::{CheckpointHeader, StepInput, StepRecord};
use protocol::time::Nanos;
use scene::SceneFile;
use std::io::BufReader;
use std::path::Path;

/// Runs the simulation until a stop is requested.
///
/// # Errors
/// For a scene that cannot be simulated, a journal that cannot be read, or a failing channel.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let scene = SceneFile::load(&args.scene)?;
    let mut world = World::new(&scene).context("scene")?;
    choose_collision(&mut world, args.collision);
    let (instance, mut shell) = Shell::start(Process::Simcore, &args.shell)?;
    let mut simcore = SimcoreShell::open(&instance, &world)?;
    if let Some(file) = &args.resume {
        simcore.resume(&mut world, file)?;
    }
    shell.report.state = STATE_RUNNING;
    shell.beat_now(now())?;
    let mut paused = false;
    while !shell.stopping() {
        // Handles and pedal are taken with the next pose: they need not wake this process.
        wait(&[&simcore.poses, shell.control()], MAX_WAIT_MS * 1_000_000);
        if let Some((request, command)) = shell.serve(now())? {
            let mut result = Ok(());
            match command {
                Command::Start => paused = false,
                Command::Pause => paused = true,
                Command::Reset => simcore.reset(&mut world)?,
                Command::Load => result = simcore.load(&mut world, args).map_err(|e| format!("{e:#}")),
                Command::Snapshot => result = Err("the simulation takes no pictures".into()),
                _ => {}
            }
            shell.answer(&request, result.as_ref().map(|_| ()).map_err(String::as_str))?;
        }
        while let Some(frame) = simcore.poses.next_valid()? {
            if !paused {
                simcore.step(&mut world, &frame, &shell)?;
            }
        }
        simcore.report(&mut shell, &world);
    }
    Ok(())
}

/// Chooses the back end for collisions, and logs it.
fn choose_collision(world: &mut World, wanted: Backend) {
    let Some(choice) = world.choose_collision(wanted, &mut now) else { return };
    if wanted == Backend::Gpu && !choice.on_gpu {
        tracing::warn!("{choice}");
    } else {
        tracing::info!("{choice}");
    }
}

/// The channels, and what is kept between steps.
struct SimcoreShell {
    poses: Receiver<TrackerFrame>,
    handles: Receiver<HandleState>,
    pedals: Receiver<PedalState>,
    scenes: BlockSender<SceneHeader>,
    steps: Sender<StepRecord>,
    events: Sender<Event>,
    checkpoints: BlockSender<CheckpointHeader>,
    writer: SceneWriter,
    handle_queue: Vec<HandleState>,
    pedal_queue: Vec<PedalState>,
    saved: Vec<u8>,
    scene_bytes: usize,
    next_checkpoint_ns: Nanos,
    /// Events raised by this shell, which the world's own numbers leave room for.
    own_events: u64,
    refused: u64,
}

impl SimcoreShell {
    fn open(instance: &Instance, world: &World) -> Result<Self, IpcError> {
        let scene_bytes = Self::bytes(world);
        Ok(SimcoreShell {
            poses: instance.receiver(Queue::InOrder)?,
            handles: instance.receiver(Queue::InOrder)?,
            pedals: instance.receiver(Queue::InOrder)?,
            scenes: instance.block_sender(scene_bytes)?,
            steps: instance.sender()?,
            events: instance.sender()?,
            checkpoints: instance.block_sender(MAX_CHECKPOINT_BYTES)?,
            writer: SceneWriter::new(world),
            handle_queue: Vec::with_capacity(2 * HandleState::QUEUE),
            pedal_queue: Vec::with_capacity(2 * PedalState::QUEUE),
            saved: Vec::with_capacity(1 << 16),
            scene_bytes,
            next_checkpoint_ns: 0,
            own_events: 0,
            refused: 0,
        })
    }

    /// One tracker frame: everything the handles and the pedal said until now goes with it.
    fn step(&mut self, world: &mut World, frame: &TrackerFrame, shell: &Shell) -> anyhow::Result<()> {
        self.drain()?;
        let (handles, pedals) = (&self.handle_queue[..], &self.pedal_queue[..]);
        let report = world.step(&StepInput { frame, handles, pedals }, &mut now);
        shell.inject_delay();
        let mut instants = frame.instants;
        let transfer_begin = now();
        instants.stepped = transfer_begin;
        let (writer, hash) = (&mut self.writer, report.state_hash);
        self.scenes.send(self.scene_bytes, |payload| writer.write(world, instants, hash, payload))?;
        let mut profile = report.profile;
        profile.transfer_ns = now() - transfer_begin;
        let (state, removed) = (world.state(), world.removed());
        self.steps.send(&StepRecord {
            step: state.step,
            field: frame.field,
            frame: frame.frame,
            instants,
            handles_below: state.handles_below,
            pedals_below: state.pedals_below,
            advanced_ns: report.advanced_ns,
            state_hash: hash,
            profile,
            inputs_refused: state.refused + self.refused_by_channels(),
            frames_lost: self.poses.counts().lost,
            membrane_cut_um2: removed.membrane_um2,
            retina_cut_um2: removed.retina_um2,
            vitreous_removed_um3: removed.vitreous_um3,
            vitreous_left_um3: removed.vitreous_left_um3,
        })?;
        self.send_events(world, frame)?;
        self.save_if_due(world, hash)
    }

    fn drain(&mut self) -> Result<(), IpcError> {
        // Takes their notifications away, without waiting.
        wait(&[&self.handles, &self.pedals], 0);
        self.handle_queue.clear();
        self.pedal_queue.clear();
        while self.handle_queue.len() < self.handle_queue.capacity() {
            let Some(handle) = self.handles.next_valid()? else { break };
            self.handle_queue.push(handle);
        }
        while self.pedal_queue.len() < self.pedal_queue.capacity() {
            let Some(pedal) = self.pedals.next_valid()? else { break };
            self.pedal_queue.push(pedal);
        }
        Ok(())
    }

    fn refused_by_channels(&self) -> u64 {
        self.poses.counts().refused + self.handles.counts().refused + self.pedals.counts().refused
    }

    /// Sends the step's events, and one of its own if the channels refused anything since.
    fn send_events(&mut self, world: &World, frame: &TrackerFrame) -> Result<(), IpcError> {
        for event in world.events() {
            self.events.send(&Event { seq: event.seq + self.own_events, ..*event })?;
        }
        let refused = self.refused_by_channels();
        if refused > self.refused {
            self.refused = refused;
            self.send_own_event(world, frame.instants.exposed, EventKind::InputRefused, refused as f64)?;
        }
        Ok(())
    }

    /// Sends an event of the shell itself.
    fn send_own_event(
        &mut self,
        world: &World,
        at: Nanos,
        kind: EventKind,
        value: f64,
    ) -> Result<(), IpcError> {
        let state = world.state();
        let mut event: Event = bytemuck::Zeroable::zeroed();
        event.seq = state.next_event + self.own_events;
        (event.field, event.exposed_ns) = (state.field, at);
        (event.kind, event.severity) = (kind as u32, kind.info().severity as u32);
        (event.instrument, event.value) = (NO_INSTRUMENT, value);
        self.own_events += 1;
        self.events.send(&event)
    }

    /// A checkpoint at the first step and every five seconds.
    fn save_if_due(&mut self, world: &World, state_hash: u64) -> anyhow::Result<()> {
        let at = now();
        if at < self.next_checkpoint_ns {
            return Ok(());
        }
        self.next_checkpoint_ns = at + CHECKPOINT_NS;
        world.save(&mut self.saved).context("checkpoint")?;
        let state = world.state();
        let header = CheckpointHeader {
            step: state.step,
            field: state.field,
            handles_below: state.handles_below,
            pedals_below: state.pedals_below,
            state_hash,
            bytes: self.saved.len() as u64,
        };
        let saved = &self.saved;
        self.checkpoints.send(saved.len(), |payload| {
            payload[..saved.len()].copy_from_slice(saved);
            header
        })?;
        Ok(())
    }

    /// Replays the journal to its end, and sends an event.
    fn resume(&mut self, world: &mut World, file: &Path) -> anyhow::Result<()> {
        let journal =
            std::fs::File::open(file).map_err(JournalError::Io).and_then(|f| Reader::new(BufReader::new(f)));
        let mut journal = journal.with_context(|| format!("--resume {}", file.display()))?;
        let mut past = InputHistory::default();
        loop {
            match journal.next_entry() {
                Ok(Some(entry)) => past.note(entry),
                Ok(None) => break,
                Err(error) => {
                    tracing::warn!("--resume: {error}; going on with what comes before");
                    break;
                }
            }
        }
        let resumed = past.replay(world).with_context(|| format!("--resume {}", file.display()))?;
        if !resumed.agrees || resumed.missing > 0 {
            let ResumeOutcome { steps, missing, agrees } = resumed;
            tracing::warn!("resumed with {steps} steps; missing: {missing}; state as recorded: {agrees}");
        }
        self.writer.forget();
        let exposed = world.state().exposed_ns;
        self.send_own_event(world, exposed, EventKind::Resumed, resumed.steps as f64)?;
        Ok(())
    }

    fn reset(&mut self, world: &mut World) -> Result<(), IpcError> {
        // What hands and foot did before belongs to the past that is forgotten.
        self.drain()?;
        world.reset();
        self.writer.forget();
        self.next_checkpoint_ns = 0;
        Ok(())
    }

    /// Takes the scene that its file holds now in place of the old one; on an error nothing
    /// changes.
    fn load(&mut self, world: &mut World, args: &Args) -> anyhow::Result<()> {
        let mut fresh = World::new(&SceneFile::load(&args.scene)?).context("scene")?;
        let needed = Self::bytes(&fresh);
        anyhow::ensure!(
            needed <= self.scene_bytes,
            "the new scene takes {needed} bytes, there is room for the {} of the first one",
            self.scene_bytes
        );
        choose_collision(&mut fresh, args.collision);
        *world = fresh;
        self.writer = self.writer.successor(world);
        Ok(self.reset(world)?)
    }

    /// Room that the scene of a world takes, bytes.
    fn bytes(world: &World) -> usize {
        let (vitreous, retina) = (world.vitreous().map(|(v, _)| v), world.retina().map(|r| &r.body.mesh));
        bytes_needed(world.sheet(), world.adhesion().is_some(), vitreous, retina)
    }

    fn report(&self, shell: &mut Shell, world: &World) {
        let counts = [self.poses.counts(), self.handles.counts(), self.pedals.counts()];
        shell.report.received = counts.iter().map(|c| c.received).sum();
        shell.report.lost = counts.iter().map(|c| c.lost).sum::<u64>() + world.events_left_out();
        shell.report.refused = counts.iter().map(|c| c.refused).sum();
        shell.report.sent = self.scenes.sent() + self.steps.sent() + self.events.sent();
    }
}
