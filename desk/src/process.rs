//! The loop: 50 times a second inputs in, a pose, handles and pedal out. The only module that knows the transport and the clock.

use crate::config::{Config, Listen};
use crate::frame;
use crate::gamepad::Gamepad;
use crate::hands::Desk;
use crate::script::{Inputs, Player};
use anyhow::{Context, Result};
use bytemuck::Zeroable;
use ipc::clock::{now, sleep_until};
use ipc::shell::Shell;
use ipc::{Instance, Queue, Receiver, Sender, wait};
use protocol::control::{Command, Request};
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Process, STATE_FINISHED, STATE_RUNNING};
use protocol::inputs::{Hint, Input, InputEvent, Origin};
use protocol::limits::{FIELD_PERIOD_NS, MAX_WAIT_MS};
use protocol::message::text_bytes;
use protocol::poses::TrackerFrame;
use protocol::rig::Rig;
use protocol::time::Nanos;
use scene::SceneFile;

/// The last stretch before a field is slept through without looking at requests, ns.
const FINE_NS: u64 = 1_000_000;
/// The pedal is sent when it changes, and with every fifth field: 10 times a second.
const PEDAL_EVERY: u64 = 5;
/// A field, s.
const FIELD_S: f64 = FIELD_PERIOD_NS as f64 * 1e-9;

/// Runs until it is told to stop.
pub fn run(config: &Config) -> Result<()> {
    let mut station = Station::open(config)?;
    while !station.shell.stopping() {
        station.wait_for_field()?;
        if now() >= station.next_ns {
            station.field()?;
        }
    }
    Ok(())
}

/// Channels and schedule.
struct Station {
    config: Config,
    rig: Rig,
    desk: Desk,
    player: Option<Player>,
    gamepad: Option<Gamepad>,
    shell: Shell,
    heard: Receiver<InputEvent>,
    told: Sender<InputEvent>,
    hints: Sender<Hint>,
    poses: Sender<TrackerFrame>,
    handles: Sender<HandleState>,
    pedal: Sender<PedalState>,
    last_pedal: PedalState,
    next_pedal: u64,
    last_hint: String,
    field: u64,
    /// Exposure of the next field.
    next_ns: Nanos,
    paused: bool,
    finished: bool,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl Station {
    fn open(config: &Config) -> Result<Self> {
        let rig = Rig::load_or_shipped(config.rig.as_deref())?;
        let desk = Desk::new(&SceneFile::load(&config.scene)?, &rig);
        let player = config.inputs.as_deref().map(Inputs::load).transpose()?.map(Player::new);
        let gamepad = match (config.input, &player) {
            (Listen::Gamepad, None) => Some(Gamepad::demand()?),
            (Listen::Auto, None) => Gamepad::find(),
            _ => None,
        };
        let (instance, shell) = Shell::start(Process::Desk, &config.shell).context("cannot start")?;
        let mut station = Station {
            config: config.clone(),
            rig,
            desk,
            player,
            gamepad,
            shell,
            heard: instance.receiver(Queue::InOrder)?,
            told: instance.sender()?,
            hints: instance.sender()?,
            poses: instance.sender()?,
            handles: instance.sender()?,
            pedal: instance.sender()?,
            last_pedal: PedalState::zeroed(),
            next_pedal: 0,
            last_hint: String::new(),
            field: 0,
            next_ns: now() + FIELD_PERIOD_NS,
            paused: false,
            finished: false,
            _instance: instance,
        };
        if let Some(pad) = &station.gamepad {
            station.shell.say(&format!("gamepad: {}", pad.name()));
        }
        station.shell.report.state = STATE_RUNNING;
        station.shell.beat_now(now())?;
        Ok(station)
    }

    /// Sleeps until the next field is due or something comes.
    fn wait_for_field(&mut self) -> Result<()> {
        self.serve()?;
        self.listen()?;
        let left = self.next_ns.saturating_sub(now());
        if left <= FINE_NS {
            sleep_until(self.next_ns);
        } else {
            wait(&[&self.heard, self.shell.control()], (left - FINE_NS / 2).min(MAX_WAIT_MS * 1_000_000));
        }
        Ok(())
    }

    /// What the window sent. A file of inputs is all that counts while it is played.
    fn listen(&mut self) -> Result<()> {
        while let Some(event) = self.heard.next_valid()? {
            let from_window = event.origin == Origin::Window as u32 && self.player.is_none();
            let moves = |i: &Input| matches!(i, Input::Move(_) | Input::Wheel(_));
            let wanted = |i: &Input| self.config.input != Listen::Gamepad || !moves(i);
            if let Some(input) = event.input().filter(|i| from_window && wanted(i)) {
                self.do_it(input);
            }
        }
        Ok(())
    }

    /// Nothing moves while everything stands still, but keys that go up go up.
    fn do_it(&mut self, input: Input) {
        if !self.paused || matches!(input, Input::Release(_) | Input::LetGo) {
            self.desk.take(input);
        }
    }

    /// One field; those for which the machine was too slow are made up for, so that nothing is lost of a movement.
    fn field(&mut self) -> Result<()> {
        let late = now().saturating_sub(self.next_ns) / FIELD_PERIOD_NS;
        self.next_ns += late * FIELD_PERIOD_NS;
        for _ in 0..=late {
            self.take_own()?;
            if !self.paused {
                self.desk.advance(FIELD_S);
            }
        }
        if !self.paused {
            self.field += late;
            self.shell.report.lost += late;
            self.publish()?;
            self.field += 1;
        }
        self.next_ns += FIELD_PERIOD_NS;
        self.say()
    }

    /// What file and gamepad do in this field; the launcher hears of it too.
    fn take_own(&mut self) -> Result<()> {
        let mut done = Vec::new();
        let origin = if let Some(player) = &mut self.player {
            player.advance(FIELD_S, |input| done.push(input));
            Origin::File
        } else {
            if let Some(pad) = &mut self.gamepad
                && let Err(gone) = pad.read(|input| done.push(input))
            {
                tracing::warn!("{gone:#}; going on without it");
                self.gamepad = None;
                done.push(Input::LetGo);
            }
            Origin::Gamepad
        };
        for input in done {
            self.told.send(&InputEvent::new(input, origin, now()))?;
            self.do_it(input);
        }
        Ok(())
    }

    fn publish(&mut self) -> Result<()> {
        let exposed = self.next_ns;
        for handle in frame::handles(&self.desk, self.field, exposed, self.handles.sent()) {
            self.handles.send(&handle)?;
        }
        let pedal = self.desk.pedal();
        if pedal != self.last_pedal || self.field >= self.next_pedal {
            (self.last_pedal, self.next_pedal) = (pedal, self.field + PEDAL_EVERY);
            self.pedal.send(&PedalState { seq: self.pedal.sent(), instant_ns: exposed, ..pedal })?;
        }
        let mut poses = frame::poses(&self.desk, self.field, exposed);
        self.shell.inject_delay();
        poses.instants.tracked = now();
        self.poses.send(&poses)?;
        self.shell.report.received = self.heard.counts().received;
        self.shell.report.sent = self.poses.sent() + self.handles.sent() + self.pedal.sent();
        Ok(())
    }

    /// Tells the picture what is in the hand when that changes, and the launcher when a file is over.
    fn say(&mut self) -> Result<()> {
        let hint = self.desk.hint();
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

    fn serve(&mut self) -> Result<()> {
        while let Some((request, command)) = self.shell.serve(now())? {
            let done = self.obey(command);
            if let Some(player) = &mut self.player {
                player.served(command);
            }
            self.answer(&request, done)?;
        }
        Ok(())
    }

    fn answer(&mut self, request: &Request, done: Result<()>) -> Result<()> {
        let text = done.err().map(|e| format!("{e:#}"));
        Ok(self.shell.answer(request, text.as_deref().map_or(Ok(()), Err))?)
    }

    fn obey(&mut self, command: Command) -> Result<()> {
        match command {
            Command::Pause => self.paused = true,
            Command::Start => self.paused = false,
            Command::Reset | Command::Load => {
                self.desk = Desk::new(&SceneFile::load(&self.config.scene)?, &self.rig);
                (self.field, self.next_pedal) = (0, 0);
                self.last_hint.clear();
            }
            Command::Ping | Command::Flush | Command::Shutdown => {}
            Command::Snapshot | Command::Next => {
                anyhow::bail!("the desk knows start, pause, reset and load only")
            }
        }
        Ok(())
    }
}
