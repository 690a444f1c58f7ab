//! The process: once a field, as often as the rig's cameras give one, it reads inputs and publishes poses, handles
//! and pedal. The only module with transport and clock.

use crate::config::{Config, InputSource};
use crate::frame;
use crate::gamepad::Gamepad;
use crate::guidance::Guidance;
use crate::input_file::{Inputs, Player};
use anyhow::{Context, Result};
use bytemuck::Zeroable;
use ipc::clock::now;
use ipc::shell::{Served, Shell, Work};
use ipc::trace::About;
use ipc::{Instance, Queue, Receiver, Sender};
use protocol::control::Command;
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Process, STATE_FINISHED};
use protocol::inputs::{Hint, Input, InputEvent, Origin};
use protocol::message::text_bytes;
use protocol::phases::Phase;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};

/// The pedal is sent when it changes, and at least so often, ns.
const PEDAL_EVERY_NS: u64 = 100_000_000;

/// Runs until a request or a signal stops it.
///
/// # Errors
/// If rig, scene or file of inputs cannot be read, a gamepad asked for is missing, or a channel
/// fails.
pub fn run(config: &Config) -> Result<()> {
    ipc::shell::run(&mut DeskShell::open(config)?)
}

/// The process: channels, schedule, and the state between fields.
struct DeskShell {
    config: Config,
    rig: Rig,
    guidance: Guidance,
    player: Option<Player>,
    gamepad: Option<Gamepad>,
    shell: Shell,
    window_inputs: Receiver<InputEvent>,
    own_inputs: Sender<InputEvent>,
    hints: Sender<Hint>,
    poses: Sender<TrackerFrame>,
    handles: Sender<HandleState>,
    pedal: Sender<PedalState>,
    last_pedal: PedalState,
    next_pedal: u64,
    last_hint: String,
    field: u64,
    /// From one field to the next, as of the rig's cameras, ns.
    period_ns: u64,
    /// Exposure of the next field.
    next_ns: Nanos,
    paused: bool,
    finished: bool,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl DeskShell {
    fn open(config: &Config) -> Result<Self> {
        let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
        let guidance = Guidance::new(&SceneFile::load(config.scene.name(DEFAULT_SCENE))?, &rig);
        let player =
            config.desk.inputs.as_deref().map(Inputs::load).transpose().context("--inputs")?.map(Player::new);
        let gamepad = match (config.input(), &player) {
            (InputSource::Gamepad, None) => Some(Gamepad::require()?),
            (InputSource::Auto, None) => Gamepad::find(),
            _ => None,
        };
        let (instance, shell) = Shell::start(Process::Desk, &config.shell).context("cannot start")?;
        let period_ns = rig.field_period_ns();
        let mut process = DeskShell {
            config: config.clone(),
            rig,
            guidance,
            player,
            gamepad,
            shell,
            window_inputs: instance.receiver(Queue::InOrder)?,
            own_inputs: instance.sender()?,
            hints: instance.sender()?,
            poses: instance.sender()?,
            handles: instance.sender()?,
            pedal: instance.sender()?,
            last_pedal: PedalState::zeroed(),
            next_pedal: 0,
            last_hint: String::new(),
            field: 0,
            period_ns,
            next_ns: now() + period_ns,
            paused: false,
            finished: false,
            _instance: instance,
        };
        if let Some(pad) = &process.gamepad {
            process.shell.set_text(&format!("gamepad: {}", pad.name()));
        }
        Ok(process)
    }

    /// Applies the window's inputs; ignored while a file of inputs is played.
    fn read_window_inputs(&mut self) -> Result<()> {
        while let Some(event) = self.window_inputs.next_valid()? {
            let from_window = event.origin == Origin::Window as u32 && self.player.is_none();
            let moves = |i: &Input| matches!(i, Input::Move(_) | Input::Wheel(_));
            let wanted = |i: &Input| self.config.input() != InputSource::Gamepad || !moves(i);
            if let Some(input) = event.input().filter(|i| from_window && wanted(i)) {
                self.apply(input);
            }
        }
        Ok(())
    }

    /// Applies an input; while paused only released keys count.
    fn apply(&mut self, input: Input) {
        if !self.paused || matches!(input, Input::Release(_) | Input::LetGo) {
            self.guidance.apply(input);
        }
    }

    /// A field, s.
    fn field_s(&self) -> f64 {
        self.period_ns as f64 * 1e-9
    }

    /// One field. Fields that were missed are simulated too, so that no movement is lost.
    fn field(&mut self) -> Result<()> {
        let at = now();
        let late = at.saturating_sub(self.next_ns) / self.period_ns;
        self.next_ns += late * self.period_ns;
        for _ in 0..=late {
            self.read_own_inputs()?;
            if !self.paused {
                self.guidance.advance(self.field_s());
            }
        }
        if !self.paused {
            self.field += late;
            self.shell.report.lost += late;
            let about = About::field(self.field);
            let read = self.shell.trace.end(Phase::ReadInputs, about, at);
            self.publish()?;
            self.shell.trace.end(Phase::SendDesk, about, read);
            self.shell.trace.end(Phase::Desk, about, at);
            self.field += 1;
        }
        self.next_ns += self.period_ns;
        self.publish_status()
    }

    /// Applies and publishes the inputs of file and gamepad of this field.
    fn read_own_inputs(&mut self) -> Result<()> {
        let (mut done, field_s) = (Vec::new(), self.field_s());
        let origin = if let Some(player) = &mut self.player {
            player.advance(field_s, |input| done.push(input));
            Origin::File
        } else {
            if let Some(pad) = &mut self.gamepad
                && let Err(gone) = pad.read(|input| done.push(input))
            {
                tracing::warn!("{gone:#}; continuing without it");
                self.gamepad = None;
                done.push(Input::LetGo);
            }
            Origin::Gamepad
        };
        for input in done {
            self.own_inputs.send(&InputEvent::new(input, origin, now()))?;
            self.apply(input);
        }
        Ok(())
    }

    fn publish(&mut self) -> Result<()> {
        let exposed = self.next_ns;
        for handle in frame::handles(&self.guidance, self.field, exposed, self.handles.sent()) {
            self.handles.fill(|block| *block = handle)?;
        }
        let pedal = self.guidance.pedal();
        if pedal != self.last_pedal || self.field >= self.next_pedal {
            (self.last_pedal, self.next_pedal) =
                (pedal, self.field + PEDAL_EVERY_NS.div_ceil(self.period_ns));
            let seq = self.pedal.sent();
            self.pedal.fill(|block| *block = PedalState { seq, instant_ns: exposed, ..pedal })?;
        }
        let DeskShell { poses, guidance, field, shell, .. } = self;
        poses.fill(|block| {
            frame::write_poses(guidance, *field, exposed, block);
            shell.inject_delay();
            block.instants.tracked = now();
        })?;
        self.shell.report.received = self.window_inputs.counts().received;
        self.shell.report.sent = self.poses.sent() + self.handles.sent() + self.pedal.sent();
        Ok(())
    }

    /// Publishes the hint when it changes, and the end of a file of inputs.
    fn publish_status(&mut self) -> Result<()> {
        let hint = self.guidance.hint();
        if hint != self.last_hint {
            self.hints.send(&Hint { instant_ns: now(), text: text_bytes(&hint) })?;
            self.last_hint = hint;
        }
        if !self.finished && self.player.as_ref().is_some_and(Player::is_over) {
            self.finished = true;
            self.shell.report.state = STATE_FINISHED;
            self.shell.beat_now(now())?;
        }
        Ok(())
    }

    /// Starts again with the present contents of the scene file.
    fn reload(&mut self) -> Result<()> {
        self.guidance = Guidance::new(&SceneFile::load(self.config.scene.name(DEFAULT_SCENE))?, &self.rig);
        (self.field, self.next_pedal) = (0, 0);
        self.last_hint.clear();
        Ok(())
    }
}

impl Work<anyhow::Error> for DeskShell {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// Until the next field is due or the person does something.
    fn rest(&mut self) {
        self.shell.rest_to(&[&self.window_inputs], self.next_ns);
    }

    fn turn(&mut self, woken: Nanos) -> Result<()> {
        self.read_window_inputs()?;
        if woken >= self.next_ns { self.field() } else { Ok(()) }
    }

    fn execute(&mut self, command: Command, _argument: u64) -> Result<Served> {
        if let Some(player) = &mut self.player {
            player.served(command);
        }
        match command {
            Command::Pause | Command::Start => self.paused = command == Command::Pause,
            Command::Reset | Command::Load => return Ok(Served::of(self.reload())),
            _ => return Ok(Served::NothingToDo),
        }
        Ok(Served::Done)
    }
}
