//! The camera hardware's loop: when fields are exposed, when their blobs leave.
//!
//! Field `k` is exposed at `t0 + k·period` (or by its camera's own clock) and has left the sensor `read_out`
//! later. Its blobs leave when the last line in which a marker can appear ([`crate::region`]) has passed the
//! pipeline, counted in pixel clocks; that may be before the last line of the field has left. Its content
//! is computed ahead and held back until then. A machine that falls behind by a field leaves
//! fields out and counts them; nothing queues up.

use crate::cameras::{Cameras, Path};
use crate::config::{Config, LateCamera};
use crate::faults::Faults;
use crate::faults::ledger::{FaultLog, Ledger};
use crate::faults::spec::FaultSpec;
use crate::groups::{Groups, Step};
use crate::onlooker::Seen;
use crate::outbox::Outbox;
use crate::stream::BlobStream;
use anyhow::{Context, Result, ensure};
use bytemuck::Zeroable;
use ipc::clock::{now, sleep_until};
use ipc::logging::message;
use ipc::shell::Shell;
use ipc::{BlockReceiver, Instance, Queue, Receiver, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::events::Event;
use protocol::handles::{HandleState, PedalState, Tool};
use protocol::health::{Process, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING};
use protocol::limits::{INSTRUMENTS, MAX_WAIT_MS};
use protocol::rig::Rig;
use protocol::scene::SceneHeader;
use protocol::time::Nanos;
use scene::SceneFile;
use surgeon::motion::recorded::RecordedMotion;
use surgeon::motion::{MotionSource, MotionUse};

/// From the start of the loop to the first exposure, ns.
const LEAD_NS: u64 = 20_000_000;
/// The last stretch before a deadline is slept through without looking at requests, ns.
const FINE_NS: u64 = 1_000_000;
/// The pedal is sent when it changes, and with every fifth field: 10 times a second.
const PEDAL_EVERY: u64 = 5;
/// Fields in a row that must be in time before the machine counts as fast enough again.
const RECOVERED_AFTER: u64 = 50;
/// Runs until told to stop.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.as_deref())?;
    let surgeon = surgeon(config, &rig)?;
    if let Some(late) = config.late_camera {
        let known = rig.cameras.iter().any(|c| c.id == late.camera);
        ensure!(known, "--late-camera: the rig has no camera {}", late.camera);
    }
    if let Some(path) = &config.blobs {
        let stream = BlobStream::load(path, &rig)?;
        return Station::open(config, &rig, surgeon)?.play(&stream);
    }
    let path = if config.direct { Path::Direct } else { Path::Pixels };
    let faults = match &config.faults.faults {
        Some(text) => Faults::new(FaultSpec::load(text)?, &rig, config.seed)?,
        None => Faults::none(&rig),
    };
    let log = config
        .faults
        .fault_log
        .as_deref()
        .map(|path| FaultLog::create(path).with_context(|| format!("cannot write {}", path.display())));
    let mut cameras = Cameras::with_faults(&rig, path, config.seed, faults)?;
    let mut station = Station::open(config, &rig, surgeon)?;
    station.late = config.late_camera;
    station.fault_log = log.transpose()?;
    station.simulate(&mut cameras)?;
    let mut told = String::new();
    cameras.ledger.summary(&mut told);
    if !told.is_empty() {
        message(tracing::Level::INFO, &told);
    }
    Ok(())
}

/// The surgeon of the scene, with the recorded hand that was asked for.
fn surgeon(config: &Config, rig: &Rig) -> Result<MotionSource> {
    let scene = SceneFile::load(&config.scene)?;
    let hand = config.motion.as_deref().map(RecordedMotion::load).transpose()?;
    let hand = hand.map(if config.motion_full { MotionUse::Full } else { MotionUse::Tremor });
    Ok(MotionSource::new(&scene, rig, hand, config.seed))
}

/// Why a wait ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wake {
    /// The instant has come.
    Due,
    /// Begin anew.
    Restart,
    /// End.
    Stop,
}

/// Handles that are to be sent.
#[derive(Debug, Clone, Copy)]
struct Hands {
    /// When, ns after the start.
    due_ns: u64,
    field: u64,
    jaw_rad: [f64; INSTRUMENTS],
    tool: [Tool; INSTRUMENTS],
    /// Number and instant are set when it is sent.
    pedal: PedalState,
}

impl Hands {
    /// What hands and foot do `t_ns` after the start.
    fn at(surgeon: &mut MotionSource, t_ns: u64, field: u64, due_ns: u64) -> Self {
        let motion = surgeon.at(t_ns);
        let pedal = surgeon.pedal_at(t_ns, 0, 0);
        Hands { due_ns, field, jaw_rad: motion.jaw_rad, tool: motion.tool, pedal }
    }
}

/// What the surgeon looks at, and what was seen last.
struct Sights {
    scenes: BlockReceiver<SceneHeader>,
    events: Receiver<Event>,
    seen: Seen,
    /// A scene has come.
    any: bool,
}

impl Sights {
    fn open(instance: &Instance) -> Result<Self> {
        let (scenes, events) = (instance.block_receiver()?, instance.receiver(Queue::InOrder)?);
        Ok(Sights { scenes, events, seen: Seen::default(), any: false })
    }

    /// Takes in what was told; where the surgeon looks, the newest scene too. Hands are blind until there is one.
    fn show(&mut self, surgeon: &mut MotionSource, exposed_ns: u64) -> Result<()> {
        while let Some(event) = self.events.next_valid()? {
            self.seen.take_event(&event);
        }
        if !surgeon.perceives_now(exposed_ns) {
            return Ok(());
        }
        if let Some(sample) = self.scenes.receive()? {
            self.seen.take_scene(sample.header(), sample.payload());
            self.any = true;
        }
        if self.any {
            surgeon.see(exposed_ns, &self.seen);
        }
        Ok(())
    }
}

/// Channels and schedule.
struct Station {
    shell: Shell,
    blobs: Sender<BlobField>,
    handles: Sender<HandleState>,
    pedal: Sender<PedalState>,
    surgeon: MotionSource,
    /// The surgeon before the first field, who has seen nothing.
    fresh: MotionSource,
    sights: Option<Sights>,
    config: Config,
    rig: Rig,
    /// Start of the schedule; a pause moves it.
    t0: Nanos,
    paused_since: Option<Nanos>,
    period_ns: u64,
    read_out_ns: u64,
    /// Added to the time after which blobs leave, to prove that budgets notice.
    delay_ns: u64,
    late: Option<LateCamera>,
    duration_ns: u64,
    in_time: u64,
    fault_log: Option<FaultLog>,
    /// What the state means, and the health text made from it.
    note: &'static str,
    text: String,
    /// Field with which the pedal is due again.
    next_pedal: u64,
    /// As it was sent last, but for number and instant.
    last_pedal: PedalState,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl Station {
    fn open(config: &Config, rig: &Rig, surgeon: MotionSource) -> Result<Self> {
        let (instance, shell) = Shell::start(Process::FpgaModel, &config.shell).context("cannot start")?;
        let mut station = Station {
            shell,
            blobs: instance.sender()?,
            handles: instance.sender()?,
            pedal: instance.sender()?,
            sights: surgeon.is_reactive().then(|| Sights::open(&instance)).transpose()?,
            fresh: surgeon.clone(),
            surgeon,
            config: config.clone(),
            rig: rig.clone(),
            t0: 0,
            paused_since: None,
            period_ns: rig.field_period_ns(),
            read_out_ns: rig.read_out_ns(),
            delay_ns: (config.shell.inject_delay_ms.max(0.0) * 1e6) as u64,
            late: None,
            duration_ns: config.duration.map_or(u64::MAX, |s| (s * 1e9) as u64),
            in_time: 0,
            fault_log: None,
            note: "",
            text: String::with_capacity(256),
            next_pedal: 0,
            last_pedal: PedalState::zeroed(),
            _instance: instance,
        };
        station.enter(STATE_RUNNING, "")?;
        station.t0 = now() + LEAD_NS;
        Ok(station)
    }

    /// Simulates the cameras, field by field.
    fn simulate(&mut self, cameras: &mut Cameras) -> Result<()> {
        let (mut groups, mut outbox) = (Groups::of(cameras), Outbox::default());
        let mut hands: Option<Hands> = None;
        loop {
            let elapsed = now().saturating_sub(self.t0);
            let send = outbox.due_ns().into_iter().chain(hands.map(|h| h.due_ns)).min();
            let wake = match groups.step(elapsed, send, self.end_ns()) {
                Step::Expose(i) => {
                    let missed = groups.leave_out_missed(i, elapsed);
                    self.judge(missed, groups.0[i].cameras.len() as u64)?;
                    let number = groups.exposed(i);
                    let first = self.expose(cameras, &groups.0[i].cameras, number, &mut outbox);
                    if i == 0 {
                        let exposed = groups.0[i].clock.exposed_ns(number);
                        hands = Some(Hands::at(&mut self.surgeon, exposed, number, first));
                        if let Some(sights) = &mut self.sights {
                            sights.show(&mut self.surgeon, exposed)?;
                        }
                    }
                    continue;
                }
                Step::Wait(until) => self.wait_for(until)?,
                Step::Over => self.finish()?,
            };
            match wake {
                Wake::Stop => return Ok(()),
                Wake::Restart => {
                    outbox.clear();
                    groups.reset();
                    hands = None;
                }
                Wake::Due => {
                    let elapsed = now().saturating_sub(self.t0);
                    if let Some(due) = hands.take_if(|h| h.due_ns <= elapsed) {
                        self.send_hands(&due)?;
                    }
                    while let Some(mut field) = outbox.take(elapsed) {
                        field.exposed_ns += self.t0;
                        field.read_out_ns = field.exposed_ns + self.read_out_ns;
                        self.send(&mut field)?;
                    }
                    self.tell_faults(&mut cameras.ledger)?;
                }
            }
        }
    }

    /// When the last field has been exposed, ns after the start.
    fn end_ns(&self) -> u64 {
        let after = |s: f64| ((self.surgeon.period_s() + s) * 1e9) as u64;
        self.config.after_round.map_or(u64::MAX, after).min(self.duration_ns)
    }

    /// Exposes and stamps field `number` of some cameras. Returns when its first blobs are due, ns after
    /// the start.
    fn expose(&mut self, cameras: &mut Cameras, group: &[usize], number: u64, outbox: &mut Outbox) -> u64 {
        let mut first = u64::MAX;
        for &i in group {
            let exposed = cameras.clock(i).exposed_ns(number);
            let late_ns = self.late.filter(|l| l.camera == cameras.id(i)).map_or(0, |l| l.delay_ns);
            let fate = cameras.fate(i, number);
            let exposure = cameras.expose(i, &mut self.surgeon, number);
            // Since the start; a pause may move that until the field is sent.
            exposure.field.exposed_ns = exposed;
            let (field, out_clock) = (*exposure.field, exposure.out_clock);
            let due = exposed + cameras.after_exposure_ns(out_clock) + self.delay_ns;
            first = first.min(due);
            if !fate.dropped && !outbox.put(due + late_ns + fate.delay_ns, &field) {
                self.shell.report.lost += 1;
            }
        }
        first
    }

    /// Writes down what the faults did and puts it into the next heartbeat.
    fn tell_faults(&mut self, ledger: &mut Ledger) -> Result<()> {
        if ledger.waiting().is_empty() {
            return Ok(());
        }
        if let Some(log) = &mut self.fault_log {
            log.write(ledger.waiting()).context("cannot write the fault log")?;
        }
        ledger.clear_waiting();
        self.text.clear();
        ledger.summary(&mut self.text);
        self.say();
        Ok(())
    }

    /// Puts the state's note and the faults into the next heartbeat.
    fn say(&mut self) {
        if self.note.is_empty() || self.text.is_empty() {
            let text = if self.note.is_empty() { self.text.as_str() } else { self.note };
            self.shell.say(text);
        } else {
            let length = self.text.len();
            self.text.insert_str(0, "; ");
            self.text.insert_str(0, self.note);
            self.shell.say(&self.text);
            self.text.drain(..self.text.len() - length);
        }
    }

    /// Plays a recorded stream; then finishes.
    fn play(&mut self, stream: &BlobStream) -> Result<()> {
        let mut field = BlobField::zeroed();
        let (mut i, mut beats) = (0, 0);
        loop {
            let over = i == stream.len() || stream.due_ns(i) >= self.duration_ns;
            let wake = if over { self.finish()? } else { self.wait_for(stream.due_ns(i))? };
            match wake {
                Wake::Stop => return Ok(()),
                Wake::Restart => {
                    (i, beats) = (0, 0);
                    continue;
                }
                Wake::Due => {}
            }
            // The stream says nothing of the hands: the script's jaws, as often as fields come.
            let elapsed = stream.due_ns(i);
            if elapsed >= beats * self.period_ns {
                let hands = Hands::at(&mut self.surgeon, elapsed, beats, elapsed);
                self.send_hands(&hands)?;
                beats = elapsed / self.period_ns + 1;
            }
            stream.field(i, self.t0, &mut field);
            self.shell.inject_delay();
            self.send(&mut field)?;
            i += 1;
        }
    }

    fn send(&mut self, field: &mut BlobField) -> Result<()> {
        field.blobs_out_ns = now();
        self.blobs.send(field)?;
        self.shell.report.sent = self.blobs.sent() + self.handles.sent() + self.pedal.sent();
        Ok(())
    }

    /// Handles with every field, the pedal when it changes and with some.
    fn send_hands(&mut self, hands: &Hands) -> Result<()> {
        let instant_ns = now();
        for i in 0..INSTRUMENTS {
            self.handles.send(&HandleState {
                seq: self.handles.sent(),
                field: hands.field,
                instant_ns,
                instrument: i as u32,
                tool: hands.tool[i] as u32,
                jaw_rad: hands.jaw_rad[i],
            })?;
        }
        let changed = hands.pedal != self.last_pedal;
        if changed || hands.field >= self.next_pedal || hands.field == 0 {
            self.next_pedal = hands.field + PEDAL_EVERY;
            self.last_pedal = hands.pedal;
            let seq = self.pedal.sent();
            self.pedal.send(&PedalState { seq, instant_ns, ..hands.pedal })?;
        }
        Ok(())
    }

    /// Counts fields that the machine was too slow for.
    fn judge(&mut self, missed: u64, cameras: u64) -> Result<()> {
        if missed > 0 {
            self.shell.report.lost += missed * cameras;
            self.in_time = 0;
            if self.shell.report.state == STATE_RUNNING {
                self.enter(STATE_DEGRADED, "machine too slow: fields are left out")?;
            }
        } else {
            self.in_time += 1;
            if self.in_time == RECOVERED_AFTER && self.shell.report.state == STATE_DEGRADED {
                self.enter(STATE_RUNNING, "")?;
            }
        }
        Ok(())
    }

    /// Waits until `offset_ns` after the start of the schedule, serving requests; a pause moves the
    /// schedule.
    fn wait_for(&mut self, offset_ns: u64) -> Result<Wake> {
        loop {
            if self.serve()? {
                return Ok(Wake::Restart);
            }
            if self.shell.stopping() {
                return Ok(Wake::Stop);
            }
            let due = if self.paused_since.is_some() { u64::MAX } else { self.t0.saturating_add(offset_ns) };
            let left = due.saturating_sub(now());
            if left <= FINE_NS {
                sleep_until(due);
                return Ok(Wake::Due);
            }
            wait(&[self.shell.control()], (left - FINE_NS / 2).min(MAX_WAIT_MS * 1_000_000));
        }
    }

    /// Reports the end and goes on breathing until told otherwise.
    fn finish(&mut self) -> Result<Wake> {
        self.enter(STATE_FINISHED, "finished")?;
        let wake = self.wait_for(u64::MAX)?;
        if wake == Wake::Restart {
            self.enter(STATE_RUNNING, "")?;
        }
        Ok(wake)
    }

    /// Serves requests and the heartbeat; true if everything shall begin anew.
    fn serve(&mut self) -> Result<bool> {
        let mut restart = false;
        while let Some((request, command)) = self.shell.serve(now())? {
            let answer = match command {
                Command::Pause => {
                    self.paused_since.get_or_insert(now());
                    Ok(())
                }
                Command::Start => {
                    let stood_still = self.paused_since.take().map_or(0, |since| now().saturating_sub(since));
                    self.t0 += stood_still;
                    Ok(())
                }
                Command::Reset | Command::Load => {
                    if command == Command::Load
                        && let Err(problem) = self.load(request.argument)
                    {
                        self.shell.answer(&request, Err(&format!("{problem:#}")))?;
                        continue;
                    }
                    self.surgeon = self.fresh.clone();
                    self.t0 = now() + LEAD_NS;
                    self.paused_since = self.paused_since.map(|_| self.t0);
                    restart = true;
                    Ok(())
                }
                _ => Err("the camera hardware knows start, pause, reset and load only"),
            };
            self.shell.answer(&request, answer)?;
        }
        Ok(restart)
    }

    /// Takes the surgeon of the scene that the file holds now; `duration_ms` 0 leaves the duration.
    fn load(&mut self, duration_ms: u64) -> Result<()> {
        self.fresh = surgeon(&self.config, &self.rig)?;
        if duration_ms > 0 {
            self.duration_ns = duration_ms * 1_000_000;
        }
        Ok(())
    }

    fn enter(&mut self, state: u32, note: &'static str) -> Result<()> {
        self.shell.report.state = state;
        self.note = note;
        self.say();
        Ok(self.shell.beat_now(now())?)
    }
}
