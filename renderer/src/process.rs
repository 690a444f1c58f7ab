//! The loop: a new scene wakes it, it draws one stereo frame with the newest pose, and says when.

mod person;

use crate::config::{Config, IDLE_REDRAW_NS, NICENESS, STATUS_NS, STILL_NS, VIDEO_HZ};
use crate::frame::Renderer;
use crate::governor::{FLOOR, Governor, TIERS};
use crate::gpu::Gpu;
use crate::gpu_clock::GpuClock;
use crate::latch::{Latched, latch, latch_scene};
use crate::output::{Finished, Output, OutputPlan, Wanted};
use crate::pacing::{Pacing, Ticks};
use crate::present::{Present, Ready};
use crate::readback::ReadBack;
use crate::start;
use anyhow::{Context, Result};
use ipc::clock::{now, sleep_until};
use ipc::shell::Shell;
use ipc::{BlockReceiver, BlockSender, Queue, Receiver, Sender, wait};
use person::Person;
use protocol::budget::{Budgets, Stage};
use protocol::control::Command;
use protocol::frames::{
    BELOW_FLOOR, DEVICE_CLOCK, DISPLAY_ESTIMATED, FrameRecord, PictureHeader, TIER_CHANGED,
    TRACKING_LOST_SHOWN,
};
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::limits::{MAX_PICTURE_BYTES, MAX_WAIT_MS};
use protocol::poses::TrackerFrame;
use protocol::scene::SceneHeader;
use protocol::time::Nanos;

/// Runs until it is told to stop.
pub fn run(config: &Config) -> Result<()> {
    // Before the driver starts its threads, which inherit it.
    let _ = rustix::process::nice(NICENESS);
    let (instance, shell) = Shell::start(Process::Renderer, &config.shell)?;
    let scene = start::load_scene(config)?;
    let (gpu, present) = Present::open(config.window_plan().as_ref())?;
    let limit_ns = (Budgets::default().of(Stage::Rendering).limit_ms * 1e6) as u64;
    let fixed = config.tier.map(|t| t as usize);
    let first_tier = start::first_tier(&gpu, fixed);
    let (renderer, costs) = start::renderer(&gpu, &scene, config, first_tier, now)?;
    let output_plan = OutputPlan {
        stills: config.stills.clone(),
        video: config.video.clone(),
        video_px: start::video_px(&gpu, fixed),
        video_hz: VIDEO_HZ,
        arrangement: config.arrange.for_files(),
    };
    let output = Output::start(&output_plan, first_tier).context("files for stills or video")?;
    let rate = |wanted: bool, hz: f64| Ticks::new(if wanted { hz } else { 0.0 });
    let mut running = Running {
        person: Person::open(&instance, config.desk, config.show_dose)?,
        poses: instance.receiver(Queue::Newest)?,
        scenes: instance.block_receiver()?,
        frames: instance.sender()?,
        pictures: instance.block_sender(MAX_PICTURE_BYTES)?,
        clock: GpuClock::default(),
        governor: Governor::new(limit_ns, start::start_tier(&gpu), fixed, costs),
        pacing: Pacing::new(present.refresh_ns(), limit_ns),
        read_back: ReadBack::new(&gpu, first_tier),
        stills: rate(config.stills.is_some(), 1e9 / STILL_NS as f64),
        video: rate(config.video.is_some(), f64::from(VIDEO_HZ)),
        small: Ticks::new(config.pictures_hz),
        keeps_last: config.stills.is_some(),
        snapshot: false,
        lose_device_after: config.lose_device_after,
        shell,
        gpu,
        present,
        renderer,
        output,
        scene: None,
        pose: None,
        frame: 0,
        missed: 0,
        last_drawn: 0,
        shown_tier: None,
        status_until: None,
        write_failed: false,
    };
    running.shell.report.state = STATE_RUNNING;
    running.say_tier(false);
    running.shell.beat_now(now())?;
    while !running.shell.stopping() {
        running.turn()?;
    }
    running.finish()
}

struct Running {
    shell: Shell,
    person: Person,
    poses: Receiver<TrackerFrame>,
    scenes: BlockReceiver<SceneHeader>,
    frames: Sender<FrameRecord>,
    pictures: BlockSender<PictureHeader>,
    gpu: Gpu,
    present: Present,
    renderer: Renderer,
    governor: Governor,
    clock: GpuClock,
    pacing: Pacing,
    output: Output,
    read_back: ReadBack,
    stills: Ticks,
    video: Ticks,
    small: Ticks,
    keeps_last: bool,
    snapshot: bool,
    /// Frames after which the device is given away, to rehearse its loss.
    lose_device_after: Option<u64>,
    /// Header of the scene that is drawn.
    scene: Option<SceneHeader>,
    pose: Option<TrackerFrame>,
    frame: u64,
    /// Refreshes of the display that showed nothing new.
    missed: u64,
    last_drawn: Nanos,
    shown_tier: Option<usize>,
    /// Until when the picture tells the tier; `None` before the first such picture.
    status_until: Option<Nanos>,
    write_failed: bool,
}

impl Running {
    fn turn(&mut self) -> Result<()> {
        let headless = matches!(self.present, Present::Headless);
        self.hear_person()?;
        // A GPU draws at the display's rate, with a newer prediction each time; a processor, which
        // the simulation needs too, only what is new.
        let waits = headless || self.gpu.is_software || self.scene.is_none();
        if waits {
            wait(&[&self.scenes, self.shell.control()], MAX_WAIT_MS * 1_000_000);
        }
        let woken = now();
        let fresh = self.take_scene()?;
        let idle = !headless && woken.saturating_sub(self.last_drawn) > IDLE_REDRAW_NS;
        if self.scene.is_some() && (fresh || !waits || idle) {
            match self.present.begin(&self.gpu, now) {
                Ready::At(refreshed) => {
                    // A GPU waits for the last moment; a processor that draws has none to lose.
                    if !waits {
                        sleep_until(self.pacing.start_at(now(), refreshed));
                    }
                    self.draw_frame(if headless { woken } else { now() }, refreshed)?
                }
                Ready::NotNow => wait(&[&self.scenes, self.shell.control()], MAX_WAIT_MS * 1_000_000),
                Ready::Closed => self.shell.stop(),
            }
        } else if self.scene.is_none() && self.present.is_closed() {
            self.shell.stop();
        }
        self.collect_pictures()?;
        self.serve()
    }

    /// Serves the window, and puts onto the picture what a person shall know.
    fn hear_person(&mut self) -> Result<()> {
        if self.present.is_closed() {
            self.shell.stop();
        }
        self.person.hear(&mut self.present, now())?;
        self.renderer.show_dose(&self.gpu, self.person.shows_dose());
        if let Some((lines, alone)) = self.person.overlay() {
            self.renderer.overlay(&lines, alone);
        }
        Ok(())
    }

    /// The newest scene, if there is one since the last call.
    fn take_scene(&mut self) -> Result<bool> {
        let Some(sample) = self.scenes.receive()? else { return Ok(false) };
        if let Err(refused) = self.renderer.take_scene(&self.gpu, sample.header(), sample.payload()) {
            self.shell.report.refused += 1;
            tracing::debug!(field = sample.header().field, "scene refused: {refused}");
            return Ok(false);
        }
        // A scene with triangles that name no node is drawn without them, and counts as refused too.
        self.shell.report.refused += u64::from(self.renderer.refused_triangles() > 0);
        self.scene = Some(*sample.header());
        Ok(true)
    }

    /// One stereo frame: commands first, then the newest pose, then the device.
    fn draw_frame(&mut self, frame_start: Nanos, refreshed: Nanos) -> Result<()> {
        let tier = self.governor.tier_index();
        if self.lose_device_after == Some(self.frame) {
            self.gpu.device.destroy();
        }
        let commands = self.renderer.encode(&self.gpu, tier);
        self.shell.inject_delay();
        let latched_at = now();
        let Some(latched) = self.latch(self.pacing.expected(latched_at, refreshed))? else { return Ok(()) };
        self.renderer.submit(&self.gpu, tier, &latched, commands);
        self.present.copy(&self.gpu, self.renderer.target(tier));
        self.gpu.wait()?;
        let done = now();
        let stamped = self.renderer.pass_times();
        let drawn = stamped.map_or(done, |times| self.clock.drawn(latched_at, times.whole, done));
        self.last_drawn = done;
        // Handing over may take its time where the processor copies the picture to the display.
        let shown = if self.present.show(&self.gpu, self.renderer.target(tier)) { now() } else { drawn };
        self.pacing.note(frame_start, latched_at, shown);
        let displayed = self.pacing.seen(shown, refreshed);
        self.missed += self.pacing.missed(refreshed, displayed);
        self.end_status(displayed);
        let mut record = self.record(&latched, tier, [frame_start, latched_at, drawn, displayed]);
        record.flags |= if stamped.is_some() { DEVICE_CLOCK } else { 0 };
        self.frames.send(&record)?;
        self.frame += 1;
        if self.governor.note(done - frame_start) {
            self.say_tier(true);
        }
        self.hand_out(tier, &record)
    }

    /// Takes the words about the tier from the picture when they have been read.
    fn end_status(&mut self, shown: Nanos) {
        if shown > *self.status_until.get_or_insert(shown + STATUS_NS) {
            self.renderer.say("");
        }
    }

    /// The newest pose, predicted to `at`.
    fn latch(&mut self, at: Nanos) -> Result<Option<Latched>> {
        if let Some(newest) = self.poses.next_valid()? {
            self.pose = Some(newest);
        }
        let from_scene = || self.scene.as_ref().map(latch_scene);
        // While everything stands still nobody is lost, and nothing moves on.
        let at = |pose: &TrackerFrame| if self.person.is_paused() { pose.instants.exposed } else { at };
        Ok(self.pose.as_ref().map(|pose| latch(pose, at(pose))).or_else(from_scene))
    }

    fn record(
        &mut self,
        latched: &Latched,
        tier: usize,
        [start, at, drawn, displayed]: [Nanos; 4],
    ) -> FrameRecord {
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
            frame_start: start,
            latched: at,
            drawn,
            displayed,
            predicted_to: latched.predicted_to,
            missed: self.missed + self.passed_over(),
            tier: tier as u32,
            width_px: TIERS[tier].width_px,
            height_px: TIERS[tier].height_px,
            flags: flag(self.present.refresh_ns().is_some(), DISPLAY_ESTIMATED)
                | flag(changed, TIER_CHANGED)
                | flag(!latched.all_tracked(), TRACKING_LOST_SHOWN)
                | flag(tier > FLOOR, BELOW_FLOOR)
                | self.governor.reason().why.flags(),
        }
    }

    /// Scenes that were replaced before they could be drawn: a missed frame, if there is no display.
    fn passed_over(&self) -> u64 {
        if self.present.refresh_ns().is_none() { self.scenes.counts().lost } else { 0 }
    }

    /// Gives the picture to whoever is due for one.
    fn hand_out(&mut self, tier: usize, record: &FrameRecord) -> Result<()> {
        let at = record.displayed;
        let wanted = Wanted {
            frame: record.frame,
            field: record.field,
            displayed: at,
            still: self.stills.due(at) > 0 || std::mem::take(&mut self.snapshot),
            last: false,
            jpeg: self.small.due(at) > 0,
            video: self.video.due(at),
        };
        self.hand_over(tier, wanted)
    }

    fn hand_over(&mut self, tier: usize, wanted: Wanted) -> Result<()> {
        if wanted.is_nothing() {
            return Ok(());
        }
        let (gpu, target) = (&self.gpu, self.renderer.target(tier));
        self.output.hand_over(wanted, |picture| self.read_back.read(gpu, target, picture))?;
        Ok(())
    }

    /// Publishes finished small pictures; a file that cannot be written is reported once.
    fn collect_pictures(&mut self) -> Result<()> {
        let mut problem = None;
        let pictures = &mut self.pictures;
        let mut sent = Ok(());
        self.output.collect(|finished| match finished {
            Finished::Jpeg(of, jpeg) => {
                let bytes = jpeg.len().min(MAX_PICTURE_BYTES);
                let header = PictureHeader {
                    frame: of.frame,
                    field: of.field,
                    displayed: of.displayed,
                    bytes: bytes as u64,
                };
                sent = pictures.send(bytes, |to| {
                    to[..bytes].copy_from_slice(&jpeg[..bytes]);
                    header
                });
            }
            Finished::Failed(error) => problem = Some(error),
        });
        sent?;
        if let (Some(problem), false) = (problem, self.write_failed) {
            self.write_failed = true;
            self.shell.report.state = STATE_DEGRADED;
            self.shell.say(&format!("a picture file cannot be written: {problem}"));
        }
        Ok(())
    }

    /// Heartbeat and requests.
    fn serve(&mut self) -> Result<()> {
        let (scenes, poses) = (self.scenes.counts(), self.poses.counts());
        let report = &mut self.shell.report;
        report.received = scenes.received + poses.received;
        report.sent = self.frames.sent();
        report.lost = self.output.dropped;
        while let Some((request, command)) = self.shell.serve(now())? {
            match command {
                Command::Pause => self.person.pause(true),
                Command::Start => self.person.pause(false),
                _ => {}
            }
            let answer = match command {
                Command::Snapshot if self.keeps_last => {
                    self.snapshot = true;
                    Ok(())
                }
                Command::Snapshot => Err("no folder for stills: start with --stills DIR"),
                // It has no other state to pause or reset: it draws whatever scene comes.
                _ => Ok(()),
            };
            self.shell.answer(&request, answer)?;
        }
        Ok(())
    }

    /// Names tier and reason in the next heartbeat and, for a while, on the picture; on a change of tier only.
    fn say_tier(&mut self, changed: bool) {
        let (index, t, reason) = (self.governor.tier_index(), self.governor.tier(), self.governor.reason());
        let (width, height) = (t.width_px, t.height_px);
        let text = format!("tier {index}: 2×{width}×{height} ({reason}), {}", self.gpu.name);
        self.renderer.say(&format!("tier {index}: {width}*{height}\n{reason}"));
        self.status_until = None;
        if changed {
            tracing::info!("{text}");
        }
        if !self.write_failed {
            self.shell.say(&text);
        }
    }

    /// Saves the last picture and closes the files.
    fn finish(mut self) -> Result<()> {
        if let (true, Some(tier)) = (self.keeps_last, self.shown_tier) {
            self.output.wait_for_room();
            let wanted = Wanted { frame: self.frame.saturating_sub(1), last: true, ..Wanted::default() };
            self.hand_over(tier, wanted)?;
        }
        match self.output.finish() {
            Some(problem) => Err(anyhow::anyhow!("a picture file could not be written: {problem}")),
            None => Ok(()),
        }
    }
}
