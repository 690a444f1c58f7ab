//! The renderer's process: when a new scene or the display wakes it up, it draws a stereo frame with the
//! newest pose, and publishes the frame's timestamps.

mod channels;
mod drawing;
mod held;
mod pictures;
mod standby;
mod unanswered;
mod user;

use crate::assets::Assets;
use crate::compose::Composer;
use crate::config::{Config, IDLE_REDRAW_NS, STATUS_NS};
use crate::costs::Costs;
use crate::frame::Renderer;
use crate::governor::{FIRST_LEAN, FLOOR, Governor, TIERS};
use crate::gpu::Gpu;
use crate::gpu_clock::GpuClock;
use crate::latch::{Latched, latch, latch_scene};
use crate::pacing::Pacing;
use crate::present::{Handed, Present, Ready};
use crate::readback::ReadBack;
use crate::start::{self, Hurry};
use anyhow::{Context, Result};
use bytemuck::Zeroable;
use channels::Channels;
use drawing::Drawn;
use held::Held;
use ipc::clock::{now, sleep_until};
use ipc::shell::{Served, Shell, Work};
use ipc::trace::About;
use ipc::{Instance, instance_directory};
use pictures::PictureFiles;
use protocol::bindings::next_steps;
use protocol::budget::{Budgets, Stage};
use protocol::control::Command;
use protocol::frames::{
    BELOW_FLOOR, DEVICE_CLOCK, DISPLAY_ESTIMATED, FrameRecord, PICTURE_HELD, TIER_CHANGED,
    TRACKING_LOST_SHOWN,
};
use protocol::health::Process;
use protocol::phases::Phase;
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::time::Nanos;
use rustix::process::setpriority_process;
use scene::{DEFAULT_SCENE, SceneFile};
use standby::Order;
use unanswered::Unanswered;
use user::{Keys, User};

/// Runs until a request, a signal or the user stops it.
///
/// # Errors
/// If the scene, the rig or an asset cannot be read, there is no graphics driver or no display, the
/// device is lost, or a file cannot be written.
pub fn run(config: &Config) -> Result<()> {
    // Set before the driver starts its threads, which inherit the niceness.
    if let Some(niceness) = config.niceness {
        let _ = setpriority_process(None, niceness);
    }
    let Some(mut process) = start(config)? else { return Ok(()) };
    ipc::shell::run(&mut process)?;
    process.finish()
}

/// The renderer's process: channels, device, and the state between frames.
struct RendererShell {
    shell: Shell,
    user: User,
    channels: Channels,
    gpu: Gpu,
    present: Present,
    renderer: Renderer,
    governor: Governor,
    clock: GpuClock,
    pacing: Pacing,
    files: PictureFiles,
    composer: Composer,
    read_back: ReadBack,
    /// Number of frames after which the device is destroyed, to test recovery from its loss.
    lose_device_after: Option<u64>,
    /// Header of the current scene.
    scene: Option<SceneHeader>,
    held: Held,
    /// Frames without presentation feedback.
    unanswered: Unanswered,
    pose: Option<TrackerFrame>,
    frame: u64,
    /// Number of display refreshes that showed nothing new.
    missed: u64,
    last_drawn: Nanos,
    shown_tier: Option<usize>,
    /// End of the time in which the picture shows the tier, ns; `None` before the first such picture.
    status_until: Option<Nanos>,
}

/// Resources that take long to create and do not depend on the run's channels.
struct Prepared {
    gpu: Gpu,
    present: Present,
    renderer: Renderer,
    costs: Costs,
    first_tier: usize,
}

impl Prepared {
    /// Creates the resources. `hurry` returns `Some` once the warm-up must be short, with the tier to begin at,
    /// if one is named.
    fn new(config: &Config, hurry: Hurry<'_>) -> Result<Self> {
        let scene =
            SceneFile::load(config.scene.name(DEFAULT_SCENE)).context("the renderer needs the scene")?;
        let (gpu, present) = Present::open(config.window_config().as_ref())?;
        let fixed = config.tier.map(|t| t as usize);
        fixed.map_or(Ok(()), |tier| gpu.check_tier(tier))?;
        let first_tier = start::first_tier(&gpu, fixed);
        let folder = instance_directory(&config.shell.instance)?;
        let assets =
            Assets::load(&config.picture.fundus, config.picture.instruments.as_deref())?.kept_in(folder);
        let (renderer, costs) = start::renderer(&gpu, &scene, config, &assets, first_tier, hurry, now)?;
        Ok(Prepared { gpu, present, renderer, costs, first_tier })
    }
}

/// Creates the process, ready to draw; `None` for a standby that was never promoted.
fn start(config: &Config) -> Result<Option<RendererShell>> {
    let start_tier = config.start_tier.map(|t| t as usize);
    if !config.standby {
        let joined = Shell::start(Process::Renderer, &config.shell)?;
        return RendererShell::open(
            config,
            joined,
            Prepared::new(config, &|| start_tier.map(Some))?,
            start_tier,
        )
        .map(Some);
    }
    let order = Order::listen();
    let prepared = Prepared::new(config, &|| order.given())?;
    let Some(tier) = order.wait() else { return Ok(None) };
    let joined = Shell::start(Process::Renderer, &config.shell)?;
    RendererShell::open(config, joined, prepared, tier.or(start_tier)).map(Some)
}

/// What the window's keys control.
fn keys(config: &Config) -> Keys {
    match (config.desk, config.replay) {
        (true, _) => Keys::Desk,
        (_, true) => Keys::Replay,
        _ => Keys::Run,
    }
}

impl RendererShell {
    /// Opens files and channels. Drawing begins at `start_tier`, or at the best prepared tier if that is worse.
    fn open(
        config: &Config,
        (instance, shell): (Instance, Shell),
        prepared: Prepared,
        start_tier: Option<usize>,
    ) -> Result<Self> {
        let Prepared { gpu, present, renderer, costs, first_tier } = prepared;
        let limit_ns = (Budgets::default().of(Stage::Rendering).limit_ms * 1e6) as u64;
        let fixed = config.tier.map(|t| t as usize);
        let start_tier = start_tier.map_or(start::start_tier(&gpu), |t| t.max(first_tier));
        let mut process = Self {
            user: User::open(&instance, keys(config), config.picture.show_dose)?,
            channels: Channels::open(&instance)?,
            files: PictureFiles::open(config, start::video_px(&gpu, fixed), first_tier)?,
            clock: GpuClock::default(),
            governor: Governor::new(limit_ns, start_tier, fixed, costs),
            pacing: Pacing::new(present.refresh_ns(), limit_ns),
            composer: Composer::new(&gpu),
            read_back: ReadBack::new(&gpu, first_tier),
            lose_device_after: config.picture.lose_device_after,
            shell,
            gpu,
            present,
            renderer,
            scene: None,
            held: Held::default(),
            unanswered: Unanswered::default(),
            pose: None,
            frame: 0,
            missed: 0,
            last_drawn: 0,
            shown_tier: None,
            status_until: None,
        };
        process.begin_picture(config);
        Ok(process)
    }

    /// Sets what the first picture shows: the tier, the layout, and the keys where there is a window.
    fn begin_picture(&mut self, config: &Config) {
        if self.gpu.is_lean {
            let (name, last) = (&self.gpu.name, TIERS.len() - 1);
            tracing::warn!("without Vulkan: {name} draws tiers {FIRST_LEAN} to {last}");
        }
        self.show_tier(None);
        self.renderer.set_arrangement(config.arrangement());
        self.renderer.set_at_desk(config.desk);
        if !self.is_headless() && keys(config) != Keys::Replay {
            self.renderer.set_next_steps(&next_steps());
        }
    }

    /// True if the process waits for a new scene before it draws. A GPU draws at the display's rate, with a
    /// newer prediction each time. A software driver draws each scene once, because the simulation needs the
    /// processor too.
    fn waits_for_scene(&self) -> bool {
        self.is_headless() || self.gpu.is_software || self.scene.is_none()
    }

    fn is_headless(&self) -> bool {
        self.present.is_headless()
    }

    fn await_scene(&self) {
        self.shell.rest(&[&self.channels.scenes], Nanos::MAX);
    }

    /// True if nothing has been drawn for [`IDLE_REDRAW_NS`] although there is a window to redraw, or a held
    /// picture whose mark is due.
    fn is_idle(&self, at: Nanos) -> bool {
        let redraws = !self.is_headless() || (self.held.age_ns(at).is_some() && !self.user.is_paused());
        redraws && at.saturating_sub(self.last_drawn) > IDLE_REDRAW_NS
    }

    /// Draws a frame if the display accepts one. `waited`: the process has waited for a scene, not for the
    /// display.
    fn draw_when_ready(&mut self, woken: Nanos, waited: bool) -> Result<()> {
        match self.present.begin(&self.gpu, now) {
            Ready::At(refreshed) => {
                // A GPU starts as late as possible, to use the newest pose. A software driver starts at once.
                if !waited {
                    sleep_until(self.pacing.start_at(now(), refreshed));
                }
                let frame_start = if self.is_headless() { woken } else { now() };
                self.draw_frame(frame_start, refreshed)?;
            }
            Ready::NotNow => self.await_scene(),
            Ready::Closed => self.shell.stop(),
        }
        Ok(())
    }

    /// Handles the window's events.
    fn serve_window(&mut self) -> Result<()> {
        if self.present.is_closed() {
            self.shell.stop();
        }
        Ok(self.user.forward_inputs(&mut self.present, now())?)
    }

    /// Uploads the newest scene; true if a valid scene has arrived since the last call.
    fn take_scene(&mut self) -> Result<bool> {
        let begun = self.shell.trace.begin();
        let Some(sample) = self.channels.scenes.receive()? else { return Ok(false) };
        if let Err(refused) = self.renderer.take_scene(&self.gpu, sample.header(), sample.payload()) {
            self.shell.report.refused += 1;
            tracing::debug!(field = sample.header().field, "scene refused: {refused}");
            return Ok(false);
        }
        // A scene with triangles that refer to missing nodes is drawn without these triangles, and counted as
        // refused.
        self.shell.report.refused += u64::from(self.renderer.refused_triangles() > 0);
        self.scene = Some(*sample.header());
        self.shell.trace.end(Phase::TakeScene, About::field(sample.header().field), begun);
        self.held.note_scene(now());
        Ok(true)
    }

    /// Updates the overlays: the mark of a held picture, the user's overlay, the light dose.
    fn lay_over(&mut self, at: Nanos) {
        if let Some(mark) = self.held.new_mark(at, self.user.is_paused()) {
            self.renderer.set_held(&mark);
        }
        if let Some(overlay) = self.user.take_overlay() {
            self.renderer.set_overlay(&overlay.lines, overlay.hides_scene_text);
        }
        self.renderer.show_dose(&self.gpu, self.user.shows_dose());
    }

    /// Draws one stereo frame: records commands, latches the newest pose, submits, waits, presents.
    fn draw_frame(&mut self, frame_start: Nanos, refreshed: Nanos) -> Result<()> {
        let tier = self.governor.tier_index();
        let of_scene = About::field(self.scene.as_ref().map_or(0, |s| s.field));
        let begun = self.shell.trace.begin();
        self.lay_over(frame_start);
        self.shell.trace.end(Phase::Overlay, of_scene, begun);
        if self.lose_device_after == Some(self.frame) {
            self.gpu.device.destroy();
        }
        let commands = self.encode(tier, of_scene);
        self.shell.inject_delay();
        let latched_at = now();
        let Some(latched) = self.latch(self.pacing.expected(latched_at, refreshed))? else { return Ok(()) };
        let about = About::field(latched.field);
        self.shell.trace.end(Phase::Latch, about, latched_at);
        let Drawn { done, drawn, transfer_ns, stamped } = self.draw(tier, &latched, commands, latched_at)?;
        self.last_drawn = done;
        // Presenting takes time if the processor copies the picture to the display.
        let text = self.renderer.text();
        let handed = self.present.show(&self.gpu, self.renderer.target(tier), text, self.frame, done);
        self.shell.trace.end(Phase::Present, about, done);
        let shown = if handed == Handed::Nowhere { drawn } else { now() };
        self.pacing.record_frame(frame_start, latched_at, shown);
        let refresh = self.pacing.next_refresh(shown, refreshed);
        self.missed += self.pacing.missed(refreshed, refresh);
        let displayed = self.pacing.shown_after(refresh);
        self.end_status(displayed);
        let mut record = self.record(&latched, tier, stamped);
        (record.frame_start, record.latched) = (frame_start, latched_at);
        (record.drawn, record.displayed) = (drawn, displayed);
        record.transfer_ns = transfer_ns;
        let send_from = self.shell.trace.begin();
        self.unanswered.push(record, handed == Handed::Asked, done);
        self.send_frames(done)?;
        let write_from = self.shell.trace.end(Phase::SendFrame, about, send_from);
        self.frame += 1;
        if self.governor.record_frame(done - frame_start) {
            self.show_tier(Some(&record));
        }
        self.output_frame(tier, &record)?;
        self.shell.trace.end(Phase::WriteFiles, about, write_from);
        self.shell.trace.end(Phase::Picture, of_scene, begun);
        Ok(())
    }

    /// Collects presentation feedback and sends the frame records that are complete.
    fn send_frames(&mut self, at: Nanos) -> Result<()> {
        let (unanswered, pacing) = (&mut self.unanswered, &mut self.pacing);
        self.present.take_answers(|answer| {
            if let Some(later_ns) = unanswered.answer(answer) {
                pacing.note_shown(later_ns);
            }
        });
        while let Some(record) = unanswered.next(at) {
            self.channels.frames.send(&record)?;
        }
        if !unanswered.expects() {
            self.present.stop_asking();
        }
        Ok(())
    }

    /// Removes the tier from the picture after [`STATUS_NS`].
    fn end_status(&mut self, shown: Nanos) {
        if shown > *self.status_until.get_or_insert(shown + STATUS_NS) {
            self.renderer.set_status("");
        }
    }

    /// The newest pose, predicted to time `at`, ns.
    fn latch(&mut self, at: Nanos) -> Result<Option<Latched>> {
        if let Some(newest) = self.channels.poses.next_valid()? {
            self.pose = Some(newest);
        }
        let from_scene = || self.scene.as_ref().map(latch_scene);
        // During a pause poses are not predicted, so that nothing moves or is reported as lost.
        let at = |pose: &TrackerFrame| if self.user.is_paused() { pose.instants.exposed } else { at };
        Ok(self.pose.as_ref().map(|pose| latch(pose, at(pose))).or_else(from_scene))
    }

    /// Creates the record of a frame, except for the timestamps of drawing.
    fn record(&mut self, latched: &Latched, tier: usize, device_clock: bool) -> FrameRecord {
        let mut instants = latched.instants;
        let scene = self.scene.as_ref();
        instants.stepped = scene.map_or(0, |s| s.instants.stepped);
        let flag = |holds, bit| if holds { bit } else { 0 };
        let changed = self.shown_tier.replace(tier).is_some_and(|before| before != tier);
        FrameRecord {
            frame: self.frame,
            field: latched.field,
            scene_field: scene.map_or(0, |s| s.field),
            instants,
            predicted_to: latched.predicted_to,
            missed: self.missed + self.skipped_scenes(),
            tier: tier as u32,
            width_px: TIERS[tier].width_px,
            height_px: TIERS[tier].height_px,
            flags: flag(self.present.refresh_ns().is_some(), DISPLAY_ESTIMATED)
                | flag(changed, TIER_CHANGED)
                | flag(!latched.all_tracked(), TRACKING_LOST_SHOWN)
                | flag(tier > FLOOR, BELOW_FLOOR)
                | flag(device_clock, DEVICE_CLOCK)
                | flag(self.held.is_shown(), PICTURE_HELD)
                | self.governor.reason().why.flags(),
            ..FrameRecord::zeroed()
        }
    }

    /// Number of scenes that were replaced before they were drawn. Without a display, each counts as a missed
    /// frame.
    fn skipped_scenes(&self) -> u64 {
        if self.present.refresh_ns().is_none() { self.channels.scenes.counts().lost } else { 0 }
    }

    /// Puts tier and reason into the next heartbeat and, for [`STATUS_NS`], into the picture. `after`: the
    /// last frame before a change of the tier.
    fn show_tier(&mut self, after: Option<&FrameRecord>) {
        let (index, t, reason) = (self.governor.tier_index(), self.governor.tier(), self.governor.reason());
        let (width, height) = (t.width_px, t.height_px);
        let text = format!("tier {index}: 2×{width}×{height} ({reason}), {}", self.gpu.name);
        self.renderer.set_status(&format!("tier {index}: {width}×{height}\n{reason}"));
        self.status_until = None;
        if let Some(&FrameRecord { field, frame, .. }) = after {
            tracing::info!(field, frame, "{text}");
        }
        if !self.files.write_failed {
            self.shell.set_text(&text);
        }
    }
}

impl Work<anyhow::Error> for RendererShell {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    fn rest(&mut self) {
        if self.waits_for_scene() {
            self.await_scene();
        }
    }

    /// Takes the newest scene, draws a frame if one is due, and publishes pictures, before the window's
    /// events, so that they do not delay a picture.
    fn turn(&mut self, woken: Nanos) -> Result<()> {
        let waited = self.waits_for_scene();
        let fresh = self.take_scene()?;
        if self.scene.is_some() && (fresh || !waited || self.is_idle(woken)) {
            self.draw_when_ready(woken, waited)?;
        }
        self.publish_pictures()?;
        self.send_frames(now())?;
        let (report, channels) = (&mut self.shell.report, &self.channels);
        report.received = channels.scenes.counts().received + channels.poses.counts().received;
        report.sent = channels.frames.sent();
        report.lost = self.files.output.dropped;
        self.serve_window()
    }

    /// The renderer has no state to reset: it draws any scene that arrives.
    fn execute(&mut self, command: Command, argument: u64) -> Result<Served> {
        match command {
            Command::Pause | Command::Start => self.user.pause(command == Command::Pause),
            Command::Help => self.user.show_help(argument == 1),
            Command::Flush => self.held.end(),
            Command::Snapshot if self.files.keeps_last => self.files.snapshot = true,
            Command::Snapshot => {
                return Ok(Served::Refused("no folder for stills: start with --stills DIR".into()));
            }
            _ => return Ok(Served::NothingToDo),
        }
        Ok(Served::Done)
    }
}
