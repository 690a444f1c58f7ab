//! The process of pedal and handles: devices, channels, heartbeat and figures.

pub(crate) mod device;
mod figures;
mod handles;
pub(crate) mod line;
pub(crate) mod pedal;

use crate::condition::in_words;
use anyhow::{Context, Result, ensure};
use figures::Figures;
use handles::HandlesFeed;
use ipc::clock::now;
use ipc::shell::{Served, Shell, Work};
use ipc::{Instance, Queue, Receiver, wait};
use pedal::PedalFeed;
use protocol::control::Command;
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use rig::Rig;
use scene::{DEFAULT_SCENE, SceneFile};
use std::os::fd::BorrowedFd;

/// Period of the figures, ns.
const FIGURES_NS: u64 = 1_000_000_000;

/// Runs pedal and handles until they are stopped.
///
/// # Errors
/// Where no device is named, the rig or a mapping is refused, or a channel fails.
pub fn run(config: &crate::config::Config) -> Result<()> {
    ensure!(config.controls.any(), "expected --pedal, --handles or both");
    let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
    let (instance, shell) = Shell::start(Process::Controls, &config.shell).context("cannot start")?;
    let (pedal, handles) = (&config.controls.pedal, &config.controls.handles);
    let scene = SceneFile::load(config.scene.name(DEFAULT_SCENE)).context("--scene")?;
    let tools = std::array::from_fn(|i| scene.instruments[i].tool);
    let handles = handles.as_ref().map(|spec| HandlesFeed::open(spec, &rig, tools, &instance)).transpose()?;
    let mut controls = Controls {
        pedal: pedal.as_ref().map(|spec| PedalFeed::open(spec, &instance)).transpose().context("--pedal")?,
        handles,
        poses: instance.receiver(Queue::Newest)?,
        field: 0,
        run_from: None,
        figures: Figures::in_directory(instance.directory()),
        figures_due_ns: 0,
        reported: String::new(),
        shell,
        _instance: instance,
    };
    let ended = ipc::shell::run(&mut controls);
    controls.keep_figures();
    ended
}

/// Devices and channels.
struct Controls {
    shell: Shell,
    pedal: Option<PedalFeed>,
    handles: Option<HandlesFeed>,
    /// Names the newest field.
    poses: Receiver<TrackerFrame>,
    field: u64,
    /// When the first poses came.
    run_from: Option<Nanos>,
    figures: Figures,
    figures_due_ns: Nanos,
    /// What the newest heartbeat says.
    reported: String,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl Controls {
    /// Takes in which field is the newest.
    fn follow(&mut self, now: Nanos) -> Result<()> {
        // Takes its notifications away, without waiting.
        wait(&[&self.poses], 0);
        while let Some(frame) = self.poses.next_sample()? {
            self.field = frame.field;
            self.run_from = self.run_from.or(Some(now));
        }
        Ok(())
    }

    /// Brings the state up to date, and reports what has changed.
    fn judge(&mut self, now: Nanos) -> Result<()> {
        let news = [
            self.pedal.as_mut().and_then(|pedal| pedal.judge(now)),
            self.handles.as_mut().and_then(|handles| handles.judge(now)),
        ];
        for news in news.into_iter().flatten() {
            match news.is_bad {
                true => tracing::warn!("{}", news.text),
                false => ipc::logging::message(tracing::Level::INFO, &news.text),
            }
        }
        let text = in_words([
            ("the pedal", self.pedal.as_ref().map(|pedal| &pedal.condition)),
            ("the handles", self.handles.as_ref().map(|handles| &handles.condition)),
        ]);
        let state = if text.is_empty() { STATE_RUNNING } else { STATE_DEGRADED };
        if text != self.reported {
            self.shell.report.state = state;
            self.shell.set_text(&text);
            self.reported = text;
            self.shell.beat_now(now)?;
        }
        Ok(())
    }

    fn count(&mut self) {
        let [samples, lines_refused] = self.handles.as_ref().map_or([0; 2], HandlesFeed::counts);
        let [taken, refused] = self.pedal.as_ref().map_or([0; 2], |p| [p.device.taken, p.device.bad]);
        let sent = self.pedal.as_ref().map_or(0, PedalFeed::sent);
        let report = &mut self.shell.report;
        (report.received, report.refused) = (samples + taken, lines_refused + refused);
        report.sent = sent + self.handles.as_ref().map_or(0, HandlesFeed::sent);
    }

    fn keep_figures(&mut self) {
        let pedal = self.pedal.as_ref().map(PedalFeed::figures);
        let handles = self.handles.as_ref().map(HandlesFeed::figures);
        self.figures.keep(&[pedal, handles].into_iter().flatten().collect::<Vec<_>>());
    }
}

impl Work<anyhow::Error> for Controls {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// Until a device has something to say.
    fn rest(&mut self) {
        let pedal = self.pedal.as_ref().and_then(|pedal| pedal.device.line().waits());
        let handles = self.handles.as_ref().and_then(|handles| handles.line().waits());
        let files: Vec<BorrowedFd<'_>> = [pedal, handles].into_iter().flatten().collect();
        self.shell.rest_beside(&files);
    }

    fn turn(&mut self, _woken: Nanos) -> Result<()> {
        let at = now();
        self.follow(at)?;
        if let Some(pedal) = &mut self.pedal {
            pedal.turn(at, self.run_from)?;
        }
        if let Some(handles) = &mut self.handles {
            handles.turn(self.field, at)?;
        }
        self.judge(at)?;
        self.count();
        if at >= self.figures_due_ns {
            self.figures_due_ns = at + FIGURES_NS;
            self.keep_figures();
        }
        Ok(())
    }

    /// Hands and feet do what they do: nothing is asked of them.
    fn execute(&mut self, _command: Command, _argument: u64) -> Result<Served> {
        Ok(Served::NothingToDo)
    }
}
