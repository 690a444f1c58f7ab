//! The camera hardware's loop: when fields are exposed, when their blobs leave.
//!
//! Field `k` is exposed at `t0 + k·period`, has left the sensor `read_out` later and its blobs are sent
//! 2 ms after that. Its content is computed ahead and held back until then. A machine that falls behind
//! by a field leaves fields out and counts them; nothing queues up.

use crate::cameras::{Cameras, Path};
use crate::config::{Config, LateCamera};
use crate::motion::hand::Hand;
use crate::motion::{HandRole, MotionSource};
use crate::stream::BlobStream;
use anyhow::{Context, Result, ensure};
use bytemuck::Zeroable;
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::handles::{HandleState, PedalState};
use protocol::health::{Process, STATE_DEGRADED, STATE_FINISHED, STATE_RUNNING};
use protocol::ipc::{Instance, Sender, wait};
use protocol::limits::{INSTRUMENTS, MAX_CAMERAS, MAX_WAIT_MS};
use protocol::rig::Rig;
use protocol::scene_file::SceneFile;
use protocol::shell::Shell;
use protocol::time::{Nanos, now, sleep_until};
use std::collections::VecDeque;

/// From the last line of a field to its blobs, ns: what the extraction in hardware takes.
const EXTRACTION_NS: u64 = 2_000_000;
/// From the start of the loop to the first exposure, ns.
const LEAD_NS: u64 = 20_000_000;
/// The last stretch before a deadline is slept through without looking at requests, ns.
const FINE_NS: u64 = 1_000_000;
/// The pedal is sent with every fifth field: 10 times a second.
const PEDAL_EVERY: u64 = 5;
/// Fields in a row that must be in time before the machine counts as fast enough again.
const RECOVERED_AFTER: u64 = 50;
/// Late fields that can wait: half a second of every camera at 50 Hz.
const LATE_FIELDS: usize = 25 * MAX_CAMERAS + 1;

/// Runs until told to stop.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.as_deref())?;
    let scene = SceneFile::load(&config.scene)?;
    let hand = config.motion.as_deref().map(Hand::load).transpose()?;
    let hand = hand.map(if config.motion_full { HandRole::Leads } else { HandRole::Shakes });
    let surgeon = MotionSource::new(&scene, &rig, hand, config.seed);
    if let Some(late) = config.late_camera {
        let known = rig.cameras.iter().any(|c| c.id == late.camera);
        ensure!(known, "--late-camera: the rig has no camera {}", late.camera);
    }
    if let Some(path) = &config.blobs {
        let stream = BlobStream::load(path, &rig)?;
        return Station::open(config, &rig, &scene, surgeon)?.play(&stream);
    }
    let path = if config.direct { Path::Direct } else { Path::Pixels };
    let cameras = Cameras::new(&rig, path, config.seed)?;
    Station::open(config, &rig, &scene, surgeon)?.simulate(cameras, config.late_camera)
}

/// Fields of a late camera with the time after the start at which they are due, ns.
type Late = VecDeque<(u64, BlobField)>;

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

/// Channels and schedule.
struct Station {
    shell: Shell,
    blobs: Sender<BlobField>,
    handles: Sender<HandleState>,
    pedal: Sender<PedalState>,
    surgeon: MotionSource,
    tools: [u32; INSTRUMENTS],
    /// Start of the schedule; a pause moves it.
    t0: Nanos,
    paused_since: Option<Nanos>,
    period_ns: u64,
    read_out_ns: u64,
    /// From exposure to blobs.
    out_after_ns: u64,
    duration_ns: u64,
    in_time: u64,
    /// Field with which the pedal is due again.
    next_pedal: u64,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl Station {
    fn open(config: &Config, rig: &Rig, scene: &SceneFile, surgeon: MotionSource) -> Result<Self> {
        let (instance, shell) = Shell::start(Process::FpgaModel, &config.shell).context("cannot start")?;
        let mut station = Station {
            shell,
            blobs: instance.sender()?,
            handles: instance.sender()?,
            pedal: instance.sender()?,
            surgeon,
            tools: std::array::from_fn(|i| scene.instruments[i].tool as u32),
            t0: 0,
            paused_since: None,
            period_ns: rig.field_period_ns(),
            read_out_ns: rig.read_out_ns(),
            out_after_ns: rig.read_out_ns() + EXTRACTION_NS,
            duration_ns: config.duration.map_or(u64::MAX, |s| (s * 1e9) as u64),
            in_time: 0,
            next_pedal: 0,
            _instance: instance,
        };
        station.enter(STATE_RUNNING, "")?;
        station.t0 = now() + LEAD_NS;
        Ok(station)
    }

    /// Simulates the cameras, field by field.
    fn simulate(&mut self, mut cameras: Cameras, late: Option<LateCamera>) -> Result<()> {
        let mut waiting = VecDeque::with_capacity(LATE_FIELDS);
        let mut k = 0;
        loop {
            let exposed = k * self.period_ns;
            let motion = self.surgeon.at(exposed);
            let fields = cameras.expose(&motion, k);
            let over = exposed >= self.duration_ns;
            let due = if over { u64::MAX } else { exposed + self.out_after_ns };
            let mut wake = self.send_late(&mut waiting, due)?;
            if wake == Wake::Due {
                wake = if over { self.finish()? } else { self.wait_for(due)? };
            }
            match wake {
                Wake::Stop => return Ok(()),
                Wake::Restart => {
                    waiting.clear();
                    k = 0;
                }
                Wake::Due => {
                    self.send_hands(k, motion.jaw_rad)?;
                    self.send_fields(exposed, fields, late, &mut waiting)?;
                    k = self.next_field(k, fields.len() as u64)?;
                }
            }
        }
    }

    /// Stamps and sends the fields exposed at `exposed` after the start; those of a late camera wait.
    fn send_fields(
        &mut self,
        exposed: u64,
        fields: &mut [BlobField],
        late: Option<LateCamera>,
        waiting: &mut Late,
    ) -> Result<()> {
        self.shell.inject_delay();
        for field in fields {
            field.exposed_ns = self.t0 + exposed;
            field.read_out_ns = field.exposed_ns + self.read_out_ns;
            match late.filter(|l| l.camera == field.camera && waiting.len() < LATE_FIELDS) {
                Some(late) => waiting.push_back((exposed + self.out_after_ns + late.delay_ns, *field)),
                None => self.send(field)?,
            }
        }
        Ok(())
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
                let jaws = self.surgeon.at(elapsed).jaw_rad;
                self.send_hands(beats, jaws)?;
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

    /// Sends late fields whose time comes before `until`.
    fn send_late(&mut self, waiting: &mut Late, until: u64) -> Result<Wake> {
        while let Some((due, mut field)) = waiting.front().copied().filter(|(due, _)| *due <= until) {
            let wake = self.wait_for(due)?;
            if wake != Wake::Due {
                return Ok(wake);
            }
            self.send(&mut field)?;
            waiting.pop_front();
        }
        Ok(Wake::Due)
    }

    /// Handles with every field, the pedal with some.
    fn send_hands(&mut self, field: u64, jaw_rad: [f64; INSTRUMENTS]) -> Result<()> {
        let instant_ns = now();
        for (i, jaw_rad) in jaw_rad.into_iter().enumerate() {
            let (seq, tool) = (self.handles.sent(), self.tools[i]);
            self.handles.send(&HandleState {
                seq,
                field,
                instant_ns,
                instrument: i as u32,
                tool,
                jaw_rad,
            })?;
        }
        if field >= self.next_pedal || field == 0 {
            self.next_pedal = field + PEDAL_EVERY;
            let seq = self.pedal.sent();
            self.pedal.send(&PedalState { seq, instant_ns, axes: [0.0; 2], buttons: 0, mode: 0 })?;
        }
        Ok(())
    }

    /// The field after `k`, or a later one where the machine is more than a field behind.
    fn next_field(&mut self, k: u64, cameras: u64) -> Result<u64> {
        let next = k + 1;
        let behind =
            now().saturating_sub(self.t0 + next * self.period_ns + self.out_after_ns) / self.period_ns;
        if behind > 0 {
            self.shell.report.lost += behind * cameras;
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
        Ok(next + behind)
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
                Command::Reset => {
                    self.t0 = now() + LEAD_NS;
                    self.paused_since = self.paused_since.map(|_| self.t0);
                    restart = true;
                    Ok(())
                }
                _ => Err("the camera hardware knows start, pause and reset only"),
            };
            self.shell.answer(&request, answer)?;
        }
        Ok(restart)
    }

    fn enter(&mut self, state: u32, text: &str) -> Result<()> {
        self.shell.report.state = state;
        self.shell.say(text);
        Ok(self.shell.beat_now(now())?)
    }
}
