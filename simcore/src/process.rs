//! The process: poses, handles and pedal in; steps, scene, events and checkpoints out. The only module
//! that knows the transport and the clock.

mod resuming;
mod saving;

use crate::config::Args;
use crate::scene_block::{SceneWriter, bytes_needed};
use crate::world::{StepReport, World};
use anyhow::Context;
use collision::backend::Backend;
use ipc::awake::Awake;
use ipc::clock::now;
use ipc::shell::{Served, Shell, Work};
use ipc::trace::About;
use ipc::{BlockSender, Instance, IpcError, Queue, Receiver, Sample, Sender, wait};
use protocol::control::Command;
use protocol::events::{Event, EventKind, NO_INSTRUMENT};
use protocol::handles::{HandleState, PedalState};
use protocol::health::Process;
use protocol::message::Message;
use protocol::phases::Phase;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::steps::{StepInput, StepProfile, StepRecord};
use protocol::time::{Instants, Nanos};
use saving::Saving;
use scene::{DEFAULT_SCENE, SceneFile};

/// Runs the simulation until a stop is requested.
///
/// # Errors
/// For a scene that cannot be simulated, a journal that cannot be read, or a failing channel.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let scene = SceneFile::load(args.scene.name(DEFAULT_SCENE))?;
    let mut world = World::new(&scene).context("scene")?;
    choose_collision(&mut world, args.backend());
    let (instance, mut shell) = Shell::start(Process::Simcore, &args.shell)?;
    let mut simcore = SimcoreShell::open(&instance, &world)?;
    if let Some(file) = &args.resume {
        // The launcher knows by this heartbeat that the channels are open.
        shell.beat_now(now())?;
        resuming::await_journal(file, &shell)?;
        simcore.resume(&mut world, file)?;
    }
    ipc::shell::run(&mut Simulation { shell, simcore, world, args, paused: false, awake: Awake::default() })
}

/// The process: the world, and its shell.
struct Simulation<'a> {
    shell: Shell,
    simcore: SimcoreShell,
    world: World,
    args: &'a Args,
    paused: bool,
    /// Watches the poses of a turn one by one: those that come while this process sleeps over one of them,
    /// or loads a scene, are past for the next.
    awake: Awake,
}

impl Work<anyhow::Error> for Simulation<'_> {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// Until a pose comes. Handles and pedal are taken with it: they need not wake this process.
    fn rest(&mut self) {
        self.shell.rest(&[&self.simcore.poses], Nanos::MAX);
    }

    fn turn(&mut self, _woken: Nanos) -> anyhow::Result<()> {
        let Simulation { shell, simcore, world, awake, .. } = self;
        while let Some(frame) = simcore.next_pose(world, awake.slept(now()))? {
            if !self.paused {
                simcore.step(world, &frame, shell)?;
            }
        }
        simcore.report(shell, world);
        Ok(())
    }

    fn execute(&mut self, command: Command, _argument: u64) -> anyhow::Result<Served> {
        match command {
            Command::Start | Command::Pause => self.paused = command == Command::Pause,
            Command::Reset => self.simcore.reset(&mut self.world)?,
            Command::Load => return Ok(Served::of(self.simcore.load(&mut self.world, self.args))),
            _ => return Ok(Served::NothingToDo),
        }
        Ok(Served::Done)
    }
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
    writer: SceneWriter,
    handle_queue: Vec<HandleState>,
    pedal_queue: Vec<PedalState>,
    saving: Saving,
    scene_bytes: usize,
    /// Events raised by this shell, which the world's own numbers leave room for.
    own_events: u64,
    refused: u64,
    /// Handles and pedal hold inputs of before this process, which the next step takes.
    inherited: bool,
    /// Poses that were passed over because this process slept or was not there.
    passed_over: u64,
}

impl SimcoreShell {
    fn open(instance: &Instance, world: &World) -> anyhow::Result<Self> {
        let scene_bytes = Self::bytes(world);
        Ok(SimcoreShell {
            poses: instance.receiver(Queue::InOrder)?,
            handles: instance.receiver(Queue::InOrder)?,
            pedals: instance.receiver(Queue::InOrder)?,
            scenes: instance.block_sender(scene_bytes)?,
            steps: instance.sender()?,
            events: instance.sender()?,
            writer: SceneWriter::new(world),
            handle_queue: Vec::with_capacity(2 * HandleState::QUEUE),
            pedal_queue: Vec::with_capacity(2 * PedalState::QUEUE),
            saving: Saving::open(instance, world)?,
            scene_bytes,
            own_events: 0,
            refused: 0,
            inherited: false,
            passed_over: 0,
        })
    }

    /// One tracker frame: everything the handles and the pedal said until now goes with it.
    fn step(&mut self, world: &mut World, frame: &TrackerFrame, shell: &mut Shell) -> anyhow::Result<()> {
        let about = About::field(frame.field);
        let taken = shell.trace.begin();
        self.drain()?;
        shell.trace.end(Phase::Inputs, about, taken);
        let begun = now();
        let (handles, pedals) = (&self.handle_queue[..], &self.pedal_queue[..]);
        let input = StepInput { frame, handles, pedals };
        let report = match shell.trace.laps(about) {
            Some(mut laps) => world.step_in_phases(&input, &mut laps),
            None => world.step(&input, &mut now),
        };
        shell.inject_delay();
        let mut instants = frame.instants;
        let transfer_begin = now();
        let (writer, hash) = (&mut self.writer, report.state_hash);
        self.scenes.send(self.scene_bytes, |payload| {
            let mut header = writer.write(world, instants, hash, payload);
            // The step is done when its scene is written.
            instants.stepped = now();
            header.instants.stepped = instants.stepped;
            header
        })?;
        let transferred = now();
        shell.trace.note(Phase::Scene, about, [transfer_begin, transferred]);
        let mut profile = report.profile;
        profile.transfer_ns = transferred - transfer_begin;
        self.send_step(world, frame, &report, instants, profile)?;
        let sent = shell.trace.end(Phase::SendStep, about, transferred);
        if self.saving.save_if_due(world, hash, [begun, now()])? {
            shell.trace.end(Phase::SaveState, about, sent);
        }
        shell.trace.end(Phase::Step, about, taken);
        Ok(())
    }

    /// Sends the figures of a step, and its events.
    fn send_step(
        &mut self,
        world: &World,
        frame: &TrackerFrame,
        report: &StepReport,
        instants: Instants,
        profile: StepProfile,
    ) -> Result<(), IpcError> {
        let (state, removed) = (world.state(), world.removed());
        let inputs_refused = state.refused + self.refused_by_channels();
        let frames_lost = self.poses.counts().lost + self.passed_over;
        let built = |block: &mut StepRecord| {
            *block = StepRecord {
                step: state.step,
                field: frame.field,
                frame: frame.frame,
                instants,
                handles_below: state.handles_below,
                pedals_below: state.pedals_below,
                advanced_ns: report.advanced_ns,
                state_hash: report.state_hash,
                profile,
                inputs_refused,
                frames_lost,
                membrane_cut_um2: removed.membrane_um2,
                retina_cut_um2: removed.retina_um2,
                vitreous_removed_um3: removed.vitreous_um3,
                vitreous_left_um3: removed.vitreous_left_um3,
                contacts: world.contacts(),
                inputs_hash: report.inputs.hash,
                handles_taken: report.inputs.handles,
                pedals_taken: report.inputs.pedals,
            }
        };
        self.steps.fill(built)?;
        self.send_events(world, frame)
    }

    /// The next pose to step to; after a sleep the newest one. What lies before it is past: the
    /// hands went on, and the eye was not there. Such poses count as lost, and are reported.
    fn next_pose(
        &mut self,
        world: &World,
        slept_ns: Option<u64>,
    ) -> Result<Option<Sample<TrackerFrame>>, IpcError> {
        let Some(mut next) = self.poses.next_sample()? else { return Ok(None) };
        if let Some(slept_ns) = slept_ns {
            let before = self.passed_over;
            while let Some(newer) = self.poses.next_sample()? {
                next = newer;
                self.passed_over += 1;
            }
            if self.passed_over > before {
                let poses = self.passed_over - before;
                tracing::debug!(field = next.field, poses, "poses before this field are skipped");
                let slept_ms = slept_ns as f64 * 1e-6;
                self.send_own_event(world, next.instants.exposed, EventKind::Slept, slept_ms)?;
            }
        }
        Ok(Some(next))
    }

    /// Takes what handles and pedal said since the last step: copied, because a step consumes all of it
    /// together, and a receiver holds two samples at most.
    fn drain(&mut self) -> Result<(), IpcError> {
        // Takes their notifications away, without waiting.
        wait(&[&self.handles, &self.pedals], 0);
        if !std::mem::take(&mut self.inherited) {
            self.handle_queue.clear();
            self.pedal_queue.clear();
        }
        while self.handle_queue.len() < self.handle_queue.capacity() {
            let Some(handle) = self.handles.next_sample()? else { break };
            self.handle_queue.push(*handle);
        }
        while self.pedal_queue.len() < self.pedal_queue.capacity() {
            let Some(pedal) = self.pedals.next_sample()? else { break };
            self.pedal_queue.push(*pedal);
        }
        Ok(())
    }

    fn refused_by_channels(&self) -> u64 {
        self.poses.counts().refused + self.handles.counts().refused + self.pedals.counts().refused
    }

    /// Sends the step's events, and one of its own if the channels refused anything since.
    fn send_events(&mut self, world: &World, frame: &TrackerFrame) -> Result<(), IpcError> {
        for event in world.events() {
            // Copied from the step's log, which replay and tests read too: the world knows no channel.
            let seq = event.seq + self.own_events;
            self.events.fill(|block| *block = Event { seq, ..*event })?;
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
        let seq = state.next_event + self.own_events;
        self.own_events += 1;
        self.events.fill(|event| {
            *event = bytemuck::Zeroable::zeroed();
            (event.seq, event.field, event.exposed_ns) = (seq, state.field, at);
            (event.kind, event.severity) = (kind as u32, kind.info().severity as u32);
            (event.instrument, event.value) = (NO_INSTRUMENT, value);
        })
    }

    fn reset(&mut self, world: &mut World) -> Result<(), IpcError> {
        // What hands and foot did before belongs to the past that is forgotten.
        self.drain()?;
        world.reset();
        self.writer.forget();
        self.saving.now();
        Ok(())
    }

    /// Takes the scene that its file holds now in place of the old one; on an error nothing
    /// changes.
    fn load(&mut self, world: &mut World, args: &Args) -> anyhow::Result<()> {
        let mut fresh = World::new(&SceneFile::load(args.scene.name(DEFAULT_SCENE))?).context("scene")?;
        let needed = Self::bytes(&fresh);
        anyhow::ensure!(
            needed <= self.scene_bytes,
            "the new scene needs {needed} bytes, more than the {} reserved for the first one",
            self.scene_bytes
        );
        choose_collision(&mut fresh, args.backend());
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
        let lost: u64 = counts.iter().map(|c| c.lost).sum();
        shell.report.lost = lost + self.passed_over + world.events_left_out();
        shell.report.refused = counts.iter().map(|c| c.refused).sum();
        shell.report.sent = self.scenes.sent() + self.steps.sent() + self.events.sent();
    }
}
