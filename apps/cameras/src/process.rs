//! The process of the cameras: channels, the common start, heartbeat and figures.

pub mod capture;
mod controls;
pub(crate) mod feed;
mod figures;
mod line;
mod live;
mod reader;
mod recorded;

use crate::config::Config;
use crate::timing::{Clock, patience_ns};
use anyhow::{Context, Result, bail, ensure};
use controls::Controls;
use feed::Feed;
use figures::Figures;
use ipc::clock::now;
use ipc::shell::{Served, Shell, Work};
use ipc::{Bell, BlockSender, Instance};
use protocol::budget::{Budgets, Stage};
use protocol::control::Command;
use protocol::deliveries::Deliveries;
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::health::{Process, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING, STATE_STARTING};
use protocol::time::Nanos;
use rig::Rig;
use rig::sensor::Sensor;
use std::fmt::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Period of the figures, ns.
const FIGURES_NS: u64 = 1_000_000_000;
/// Time that the camera hardware has after the last field before the end is announced, ns.
const DRAIN_NS: u64 = 5_000_000;

/// Runs the cameras until they are stopped.
///
/// # Errors
/// Where the rig cannot be read or has another number of cameras, a file is defective from the
/// beginning, or a channel fails.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
    let streams =
        config.cameras.as_ref().context("--cameras: expected a source for each camera of the rig")?;
    let cameras = rig.cameras();
    let sources = streams.spread(cameras.len());
    ensure!(
        cameras.len() == sources.len(),
        "--cameras: expected {} sources, one for each camera of the rig, found {}",
        cameras.len(),
        sources.len()
    );
    let (instance, shell) = Shell::start(Process::VirtualRig, &config.shell).context("cannot start")?;
    let (bell, stop) = (Bell::new().context("a bell")?, Arc::<AtomicBool>::default());
    let feed = |(camera, source)| Feed::start(&rig, camera, source, bell.rope(), &stop, now());
    let feeds = cameras.iter().zip(&sources).map(feed).collect::<Result<_>>()?;
    let mut live = LiveCameras::open(config, &rig, (instance, shell), feeds, bell)?;
    live.duration_ns = config.duration.map(|s| (s * 1e9) as u64);
    let ended = ipc::shell::run(&mut live);
    // The readers end by themselves; none is waited for.
    stop.store(true, Ordering::Relaxed);
    live.keep_figures();
    ended
}

/// Longest time from mid-exposure until the blobs are out, ns.
fn camera_budget_ns(rig: &Rig) -> u64 {
    let budgets = Budgets::of_rig(rig.field_period_ns(), rig.read_out_ns());
    (budgets.of(Stage::Camera).limit_ms * 1e6) as u64
}

/// Channels and cameras.
struct LiveCameras {
    shell: Shell,
    fields: BlockSender<FieldHeader>,
    controls: Controls,
    feeds: Vec<Feed>,
    bell: Bell,
    timing: Clock,
    /// All sources have brought their first picture: `timing` has its start.
    has_begun: bool,
    /// Length of the run from its start, where it has one.
    duration_ns: Option<u64>,
    /// When nothing more came.
    over_ns: Option<Nanos>,
    figures: Figures,
    figures_due_ns: Nanos,
    /// Text of the next heartbeat.
    text: String,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl LiveCameras {
    /// Opens the channels. A predecessor in this instance has left the start of its numbers.
    fn open(
        config: &Config,
        rig: &Rig,
        joined: (Instance, Shell),
        feeds: Vec<Feed>,
        bell: Bell,
    ) -> Result<Self> {
        let (instance, shell) = joined;
        let figures = Figures::in_directory(instance.directory());
        let period_ns = rig.field_period_ns();
        let begun = figures.predecessor().map(|left| left.start_ns);
        let sensors = rig.sensors();
        let bytes = |s: &Sensor| FieldPicture::bytes(s.size_px[0] as usize, s.lines() as usize);
        let bytes = sensors.iter().map(bytes).max().unwrap_or(0);
        Ok(LiveCameras {
            shell,
            fields: instance.block_sender(bytes)?,
            controls: Controls::open(&instance, config)?,
            feeds,
            bell,
            timing: Clock {
                start_ns: begun.unwrap_or(0),
                period_ns,
                lines_ns: sensors.iter().map(Sensor::lines_ns).max().unwrap_or(0),
                patience_ns: patience_ns(period_ns, rig.read_out_ns(), camera_budget_ns(rig)),
            },
            has_begun: begun.is_some(),
            duration_ns: None,
            over_ns: None,
            figures,
            figures_due_ns: 0,
            text: String::with_capacity(256),
            _instance: instance,
        })
    }

    /// Begins where every source has brought its first picture.
    fn begin(&mut self, now: Nanos) -> Result<()> {
        if let Some((feed, why)) = self.feeds.iter().find_map(|f| Some((f, f.defect()?))) {
            bail!("{} {why}", feed.source);
        }
        if let Some(feed) = self.feeds.iter().find(|f| f.is_over()) {
            bail!("{} has no picture", feed.source);
        }
        let arrived: Option<Vec<Nanos>> = self.feeds.iter().map(|f| f.first_ready(now)).collect();
        if let Some(start_ns) = arrived.and_then(|all| all.into_iter().max()) {
            (self.timing.start_ns, self.has_begun) = (start_ns, true);
        }
        Ok(())
    }

    /// Publishes the fields that are due.
    fn publish(&mut self, now: Nanos) -> Result<()> {
        let awaited = self.awaited();
        let LiveCameras { feeds, fields, timing, .. } = self;
        for feed in feeds {
            feed.publish(timing, awaited, now, |field| {
                fields.send(field.header.bytes(), |payload| {
                    field.write(payload);
                    field.header
                })?;
                Ok(())
            })?;
        }
        Ok(())
    }

    /// The read-out of the first field that is still to come from a camera without trouble.
    fn awaited(&self) -> Nanos {
        self.feeds.iter().filter_map(|f| f.awaited(&self.timing)).min().unwrap_or(Nanos::MAX)
    }

    /// When the next field is read out of the camera that is ahead.
    fn reached(&self) -> Nanos {
        self.feeds.iter().map(|f| f.next(&self.timing)).max().unwrap_or(0)
    }

    /// True once nothing more will come, or the time is up.
    fn is_over(&self, now: Nanos) -> bool {
        let end_ns = self.duration_ns.map(|ns| self.timing.start_ns.saturating_add(ns));
        end_ns.is_some_and(|end| now >= end) || self.feeds.iter().all(Feed::is_over)
    }

    /// Brings the state up to date, and reports what has changed.
    fn judge(&mut self, now: Nanos) -> Result<()> {
        let mut changed = false;
        for feed in &mut self.feeds {
            let trouble = feed.trouble(self.has_begun, now);
            changed |= trouble.as_ref() != feed.condition.trouble();
            match feed.condition.note(trouble, now) {
                Some(news) if news.is_bad => tracing::warn!("{}", news.text),
                Some(news) => ipc::logging::message(tracing::Level::INFO, &news.text),
                None => {}
            }
        }
        let is_sound = self.feeds.iter().all(|f| f.condition.trouble().is_none());
        let state = match (self.has_begun, self.over_ns, is_sound) {
            (false, ..) => STATE_STARTING,
            (_, Some(over_ns), _) if now >= over_ns + DRAIN_NS => STATE_FINISHED,
            (_, _, false) => STATE_DEGRADED,
            _ => STATE_RUNNING,
        };
        changed |= state != self.shell.report.state;
        self.shell.report.state = state;
        self.shell.report.sent = self.fields.sent() + self.controls.sent();
        self.shell.report.lost = self.feeds.iter().map(|f| f.tally.late).sum();
        if changed {
            self.tell_state(now)?;
        }
        Ok(())
    }

    /// Puts what is wrong into the heartbeat and sends it.
    fn tell_state(&mut self, now: Nanos) -> Result<()> {
        self.text.clear();
        for feed in &self.feeds {
            if let Some(trouble) = feed.condition.trouble() {
                let between = if self.text.is_empty() { "" } else { "; " };
                // Writing to a string cannot fail.
                let _ = write!(self.text, "{between}camera {} {}", feed.camera(), trouble.text);
            }
        }
        let text = std::mem::take(&mut self.text);
        self.shell.set_text(&text);
        self.text = text;
        Ok(self.shell.beat_now(now)?)
    }

    fn keep_figures(&mut self) {
        let reached = self.reached();
        let cameras = self.feeds.iter().map(|feed| feed.delivery(&self.timing, reached)).collect();
        let start_ns = if self.has_begun { self.timing.start_ns } else { 0 };
        self.figures.keep(&Deliveries { start_ns, cameras });
    }
}

impl Work<anyhow::Error> for LiveCameras {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// At work once every source has brought its first picture.
    fn first_state(&self) -> u32 {
        if self.has_begun { STATE_RUNNING } else { STATE_STARTING }
    }

    /// Until a picture comes or a field is due.
    fn rest(&mut self) {
        let (begun, awaited) = (self.has_begun && self.over_ns.is_none(), self.awaited());
        let due = self.feeds.iter().filter(|_| begun).filter_map(|feed| feed.due(&self.timing, awaited));
        self.shell.rest_to(&[&self.bell], due.min().unwrap_or(Nanos::MAX));
    }

    /// Files stood still with the machine; what comes through a pipe is late and is left out.
    fn slept(&mut self, slept_ns: u64) -> Result<u64> {
        if self.has_begun && self.feeds.iter().all(Feed::is_file) {
            self.timing.start_ns += slept_ns;
        }
        Ok(0)
    }

    fn turn(&mut self, _woken: Nanos) -> Result<()> {
        let at = now();
        self.feeds.iter_mut().for_each(|feed| feed.listen(at));
        if !self.has_begun {
            self.feeds.iter_mut().for_each(|feed| feed.renew(at));
            self.begin(at)?;
        }
        if self.has_begun && self.over_ns.is_none() {
            self.publish(at)?;
            let newest = self.timing.first_from(self.reached()).saturating_sub(1);
            self.controls.send_due(newest, self.timing.period_ns, at)?;
            self.over_ns = self.is_over(at).then_some(at);
        }
        self.judge(at)?;
        if at >= self.figures_due_ns {
            self.figures_due_ns = at + FIGURES_NS;
            self.keep_figures();
        }
        Ok(())
    }

    /// Real cameras see what there is: nothing is asked of them.
    fn execute(&mut self, _command: Command, _argument: u64) -> Result<Served> {
        Ok(Served::NothingToDo)
    }
}
