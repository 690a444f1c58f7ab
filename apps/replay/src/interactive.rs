//! A replay that is watched and stepped: in a window, in a terminal, or both.

use crate::film::StepShown;
use crate::resimulate::scene_of;
use crate::stop::StopSignal;
use crate::terminal::{Pressed, Terminal};
use crate::timeline::player::Player;
use crate::timeline::{self, Moment, index};
use crate::transport::{Order, RATES, Target, Transport};
use crate::viewer::Viewer;
use anyhow::{Context, bail};
use outputs::exit::INTERRUPTED;
use protocol::inputs::Key;
use protocol::time::Nanos;
use protocol::transport::help;
use recording::Recording;
use rig::Rig;
use settings::commands::ReplayArgs;
use simcore::world::World;
use std::ops::ControlFlow;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Between two looks at keys, while nothing is due.
const LOOK: Duration = Duration::from_millis(10);
/// Between two pictures at most, however fast the replay is.
const PICTURE: Duration = Duration::from_millis(15);

/// Shows a recording until the person ends it.
///
/// # Errors
/// Where it holds no steps or cannot be simulated, or window or terminal fail.
pub fn run(args: &ReplayArgs, recording: &Recording, stop: &StopSignal) -> anyhow::Result<ExitCode> {
    let scene = scene_of(recording)?;
    let world = World::new(&scene).context("scene")?;
    let rig = Rig::parse(&recording.provenance().rig_json, "of the recording")?;
    let timeline = index::open(recording, stop)?;
    let name = recording.path().display();
    let Some(ends) = timeline.ends() else { bail!("{name}: contains no steps to be shown") };
    let viewer = if args.window {
        let instance = args.instance.as_deref().unwrap_or("replay");
        let options = window_options(args);
        Some(Viewer::start(instance, (&scene, &world), &rig, &options, || stop.is_raised())?)
    } else {
        None
    };
    let player =
        if args.as_recorded { Player::as_recorded(timeline, world)? } else { Player::new(timeline, world)? };
    let terminal = args.interactive.then(Terminal::open).transpose()?;
    let at_s = |s: f64| ends[0].exposed_ns.saturating_add((s * 1e9) as Nanos);
    let rate = if args.lockstep { RATES[1] } else { args.rate.clamp(RATES[0], RATES[1]) };
    let mut show = Show {
        player,
        transport: Transport::new(true, rate, args.endless),
        viewer,
        terminal,
        ends: [at_s(args.span.from), args.span.until.map_or(ends[1].exposed_ns, at_s)],
        origin_ns: ends[0].exposed_ns,
        tied: None,
        shown: Instant::now(),
        event: String::new(),
        line: String::new(),
    };
    let ended = show.play(stop);
    let closed = show.viewer.take().map_or(Ok(()), Viewer::finish);
    drop(show.terminal.take());
    ended?;
    closed?;
    Ok(if stop.is_raised() { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

/// The renderer's options for window and picture.
fn window_options(args: &ReplayArgs) -> Vec<String> {
    let mut options = vec!["--window".to_owned(), "--arrange".into(), args.drawing.arrange.to_string()];
    options.extend(args.drawing.fundus.arguments());
    if let Some(tier) = args.drawing.tier {
        options.extend(["--tier".into(), tier.to_string()]);
    }
    options
}

/// A replay that is shown.
struct Show {
    player: Player,
    transport: Transport,
    viewer: Option<Viewer>,
    terminal: Option<Terminal>,
    /// First and last exposure that are shown.
    ends: [Nanos; 2],
    /// Exposure from which time is counted.
    origin_ns: Nanos,
    /// Instants of recording and clock that belong together, and the rate since.
    tied: Option<(Nanos, Instant, f64)>,
    /// When the last picture was shown.
    shown: Instant,
    /// The event to which the replay went last.
    event: String,
    line: String,
}

impl Show {
    /// Plays until the end is asked for.
    fn play(&mut self, stop: &StopSignal) -> anyhow::Result<()> {
        self.seek(timeline::Target::Exposed(self.ends[0]))?;
        while !stop.is_raised() {
            let wait = self.until_due().min(LOOK);
            if self.serve_keys(wait, stop)?.is_break() {
                return Ok(());
            }
            if self.transport.playing && self.until_due().is_zero() && self.advance()?.is_break() {
                return Ok(());
            }
        }
        Ok(())
    }

    /// The exposure behind which the replay stands, ns.
    fn now_ns(&self) -> Nanos {
        self.player.at().map_or(self.ends[0], |at| at.exposed_ns)
    }

    /// How long it is until the next step is due.
    fn until_due(&self) -> Duration {
        if !self.transport.playing {
            return LOOK;
        }
        let Some((recorded, clock, rate)) = self.tied else { return Duration::ZERO };
        let since_s = self.now_ns().saturating_sub(recorded) as f64 * 1e-9 / rate;
        let due = clock + Duration::from_secs_f64(since_s.min(1e6));
        due.saturating_duration_since(Instant::now())
    }

    /// Takes what was pressed; breaks where the person ends the replay.
    fn serve_keys(&mut self, wait: Duration, stop: &StopSignal) -> anyhow::Result<ControlFlow<()>> {
        let pressed = match &mut self.terminal {
            Some(terminal) => terminal.next(wait)?,
            None => {
                stop.wait_until(Instant::now() + wait);
                None
            }
        };
        let mut keys: Vec<Key> = Vec::new();
        match pressed {
            Some(Pressed::Interrupt) => stop.raise(),
            Some(Pressed::Key(key)) => keys.push(key),
            None => {}
        }
        if let Some(viewer) = &mut self.viewer {
            if viewer.has_ended() {
                return Ok(ControlFlow::Break(()));
            }
            while let Some(key) = viewer.next_key()? {
                keys.push(key);
            }
        }
        for key in keys {
            if self.press(key)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        self.say()?;
        Ok(ControlFlow::Continue(()))
    }

    fn press(&mut self, key: Key) -> anyhow::Result<ControlFlow<()>> {
        let (playing, rate) = (self.transport.playing, self.transport.rate);
        let order = self.transport.press(key, self.now_ns());
        if (playing, rate) != (self.transport.playing, self.transport.rate) {
            self.tied = None;
        }
        match order {
            Some(order) => self.carry_out(order),
            None => Ok(ControlFlow::Continue(())),
        }
    }

    fn carry_out(&mut self, order: Order) -> anyhow::Result<ControlFlow<()>> {
        self.event.clear();
        match order {
            Order::Quit => return Ok(ControlFlow::Break(())),
            Order::Help => return self.show_help(),
            Order::Steps(by) => self.step(by, |_, _| true)?,
            Order::Fields(by) => self.step(by, |from, to| from.field != to.field)?,
            Order::Event { forward } => self.go_to_event(forward)?,
            Order::Start => self.seek(timeline::Target::Exposed(self.ends[0]))?,
            Order::End => self.seek(timeline::Target::Exposed(self.ends[1]))?,
            Order::SeekTo(at) => self.seek(timeline::Target::Exposed(at))?,
            Order::Seek(Target::Time(s)) => {
                self.seek(timeline::Target::Exposed(self.origin_ns.saturating_add((s * 1e9) as Nanos)))?;
            }
            Order::Seek(Target::Field(field)) => self.seek(timeline::Target::Field(field))?,
            Order::Seek(Target::Step(step)) => self.seek(timeline::Target::Step(step))?,
        }
        self.tied = None;
        self.draw(true)
    }

    /// Goes to a place; to the last step where that lies behind it.
    fn seek(&mut self, target: timeline::Target) -> anyhow::Result<()> {
        let arrival = self.player.seek(target)?;
        if arrival.at.is_none() {
            let Some([_, last]) = self.player.timeline().ends() else { return Ok(()) };
            self.player.seek(timeline::Target::Exposed(last.exposed_ns))?;
            self.event = "the recording ends here".into();
        }
        if let Some(lost) = arrival.lost.filter(|_| arrival.left_out > 0) {
            self.event = lost;
        }
        Ok(())
    }

    /// By steps, one after the other, until `enough` of them.
    fn step(&mut self, by: i64, enough: impl Fn(&Moment, &Moment) -> bool) -> anyhow::Result<()> {
        let Some(from) = self.player.at() else { return Ok(()) };
        loop {
            let to = if by < 0 { self.player.step_back()? } else { self.player.step_forward()? };
            match to {
                Some(to) if !enough(&from, &to) => {}
                Some(_) => return Ok(()),
                // Before the first step there is nothing to be seen, and behind the last nothing new.
                None => return self.seek(timeline::Target::Exposed(from.exposed_ns)),
            }
        }
    }

    fn go_to_event(&mut self, forward: bool) -> anyhow::Result<()> {
        let event = if forward { self.player.next_event()? } else { self.player.previous_event()? };
        self.event = match event {
            Some(event) => event.describe(),
            None => format!("no event {}", if forward { "behind this one" } else { "before this one" }),
        };
        Ok(())
    }

    fn show_help(&mut self) -> anyhow::Result<ControlFlow<()>> {
        let shown = self.transport.help;
        if let Some(viewer) = &mut self.viewer {
            viewer.show_help(shown)?;
        }
        if let Some(terminal) = self.terminal.as_mut().filter(|_| shown) {
            terminal.print(&help())?;
        }
        self.draw(true)
    }

    /// Does the next step, or stops at the end.
    fn advance(&mut self) -> anyhow::Result<ControlFlow<()>> {
        let before = self.now_ns();
        let stepped = self.player.step_forward()?;
        let at = self.now_ns();
        let end = stepped.is_none() || at >= self.ends[1];
        if let Some(order) = self.transport.wrap(before, at, end) {
            return self.carry_out(order);
        }
        if end {
            self.transport.playing = false;
            return self.draw(true);
        }
        if self.tied.is_none_or(|(_, _, rate)| rate != self.transport.rate) {
            self.tied = Some((before, Instant::now(), self.transport.rate));
        }
        self.event.clear();
        self.draw(false)
    }

    /// Shows the step behind which the replay stands; `surely`, or if the last picture is old enough.
    fn draw(&mut self, surely: bool) -> anyhow::Result<ControlFlow<()>> {
        let due = surely || self.shown.elapsed() >= PICTURE;
        let (Some(viewer), true) = (&mut self.viewer, due) else { return Ok(ControlFlow::Continue(())) };
        let Some(last) = self.player.last() else { return Ok(ControlFlow::Continue(())) };
        self.shown = Instant::now();
        let (instants, step) = (last.record.instants, last.record.step);
        let (state_hash, world) = (last.record.state_hash, self.player.world());
        viewer.show(&StepShown { world, step, instants, state_hash, poses: &last.poses })
    }

    /// Says where the replay stands, in window and terminal.
    fn say(&mut self) -> anyhow::Result<()> {
        let line = match self.player.at() {
            Some(Moment { exposed_ns, field, step }) => {
                let at_s = exposed_ns.saturating_sub(self.origin_ns) as f64 * 1e-9;
                let event = if self.event.is_empty() { String::new() } else { format!("  {}", self.event) };
                format!("{at_s:.2} s  field {field}  step {step}  {}{event}", self.transport.text())
            }
            None => self.transport.text(),
        };
        if line != self.line {
            if let Some(viewer) = &mut self.viewer {
                viewer.say(&line)?;
            }
            if let Some(terminal) = &mut self.terminal {
                terminal.show(&format!("{line}   (h: keys)"))?;
            }
            self.line = line;
        }
        Ok(())
    }
}
