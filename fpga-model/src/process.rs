//! The camera hardware's loop: fields of pixels in, fields of blobs out.
//!
//! A field is scanned as soon as it is there, in place, and its blobs are held back until the
//! hardware would have sent them ([`crate::camera_extractor`]): the source may publish a field
//! before its first line has left the sensor. Whether the source is virtual or a camera makes no
//! difference here.

use crate::camera_extractor::CameraExtractor;
use crate::config::Config;
use anyhow::{Context, Result};
use bytemuck::Zeroable;
use ipc::awake::Awake;
use ipc::clock::{now, sleep_until};
use ipc::outbox::Outbox;
use ipc::shell::Shell;
use ipc::{BlockReceiver, BlockSample, Instance, Sender, wait};
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::fields::{FieldHeader, FieldPicture};
use protocol::health::{Process, STATE_DEGRADED, STATE_RUNNING};
use protocol::limits::{FIELD_PERIOD_NS, MAX_CAMERAS, MAX_WAIT_MS};
use protocol::rig::Rig;
use protocol::time::Nanos;

/// Time before an instant from which on channels are not served, ns.
const FINE_NS: u64 = 500_000;

/// Runs the camera hardware until it is stopped.
///
/// # Errors
/// Where the rig cannot be read or simulated, or a channel fails.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.as_deref()).context("--rig")?;
    let extractors = rig.cameras().iter().map(|c| CameraExtractor::new(&rig, c)).collect::<Result<_, _>>()?;
    let mut shell = FpgaModelShell::open(config, extractors)?;
    while !shell.shell.stopping() {
        shell.serve()?;
        shell.wake()?;
        shell.take_fields()?;
        shell.send_due()?;
        shell.rest();
    }
    Ok(())
}

/// Channels of the process, and the blobs held back.
struct FpgaModelShell {
    shell: Shell,
    fields: BlockReceiver<FieldHeader>,
    blobs: Sender<BlobField>,
    extractors: Vec<CameraExtractor>,
    outbox: Outbox,
    /// Number of each camera's newest field.
    newest: [u64; MAX_CAMERAS],
    /// Injected delay of the blobs, for tests of the time budgets, ns.
    delay_ns: u64,
    /// Fields of no camera of the rig, or of another size.
    foreign: u64,
    awake: Awake,
    /// Fields of the past that were passed over.
    passed_over: u64,
    /// Fields for which the outbox had no room.
    no_room: u64,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl FpgaModelShell {
    fn open(config: &Config, extractors: Vec<CameraExtractor>) -> Result<Self> {
        let (instance, mut shell) =
            Shell::start(Process::FpgaModel, &config.shell).context("cannot start")?;
        let (fields, blobs) = (instance.block_receiver()?, instance.sender()?);
        shell.report.state = STATE_RUNNING;
        shell.beat_now(now())?;
        let delay_ns = (config.shell.inject_delay_ms.max(0.0) * 1e6) as u64;
        Ok(FpgaModelShell {
            shell,
            fields,
            blobs,
            extractors,
            outbox: Outbox::default(),
            newest: [0; MAX_CAMERAS],
            delay_ns,
            foreign: 0,
            awake: Awake::default(),
            passed_over: 0,
            no_room: 0,
            _instance: instance,
        })
    }

    /// After a sleep: passes over the fields that were due in it. Hardware does not send what is
    /// past.
    fn wake(&mut self) -> Result<()> {
        let at = now();
        let Some(slept_ns) = self.awake.slept(at) else { return Ok(()) };
        let (past, before) = (at.saturating_sub(FIELD_PERIOD_NS), self.passed_over);
        while self.outbox.due_ns().is_some_and(|due| due < past) && self.outbox.take(past).is_some() {
            self.passed_over += 1;
        }
        while let Some(sample) = self.fields.receive()? {
            if sample.header().read_out_ns() + self.delay_ns < past {
                self.passed_over += 1;
            } else {
                self.take(&sample)?;
            }
        }
        let passed_over = self.passed_over - before;
        if passed_over > 0 {
            tracing::warn!("slept for {:.1} s: {passed_over} fields passed over", slept_ns as f64 * 1e-9);
        }
        Ok(())
    }

    /// Scans the fields received.
    fn take_fields(&mut self) -> Result<()> {
        while let Some(sample) = self.fields.receive()? {
            self.take(&sample)?;
        }
        let counts = self.fields.counts();
        self.shell.report.received = counts.received;
        self.shell.report.lost = counts.lost + self.passed_over + self.no_room;
        self.shell.report.refused = counts.refused + self.foreign;
        Ok(())
    }

    fn take(&mut self, sample: &BlockSample<FieldHeader>) -> Result<()> {
        let header = sample.header();
        let extractor = self.extractors.iter_mut().find(|p| p.takes(header));
        let picture = FieldPicture::in_payload(header, sample.payload());
        let Some((extractor, picture)) = extractor.zip(picture) else { return self.refuse(header) };
        let newest = &mut self.newest[header.camera as usize];
        if header.field < *newest {
            // The source has restarted: its former fields are void.
            self.outbox.clear();
        }
        *newest = header.field;
        let mut field = BlobField::zeroed();
        let due_ns = extractor.extract(header, &picture, &mut field) + self.delay_ns;
        if !self.outbox.put(due_ns, &field) {
            self.no_room += 1;
        }
        Ok(())
    }

    /// Counts a field that fits no camera of the rig, and reports the first in the heartbeat.
    fn refuse(&mut self, header: &FieldHeader) -> Result<()> {
        self.foreign += 1;
        if self.foreign == 1 {
            let FieldHeader { camera, width, height, .. } = header;
            self.shell.report.state = STATE_DEGRADED;
            self.shell.set_text(&format!("no camera {camera} with fields of {width}×{height} px in the rig"));
            self.shell.beat_now(now())?;
        }
        Ok(())
    }

    /// Sends every field whose instant has come.
    fn send_due(&mut self) -> Result<()> {
        while let Some(mut field) = self.outbox.take(now()) {
            field.blobs_out_ns = now();
            self.blobs.send(&field)?;
            self.shell.report.sent = self.blobs.sent();
        }
        Ok(())
    }

    /// Sleeps until a field comes or one is due.
    fn rest(&self) {
        let due: Nanos = self.outbox.due_ns().unwrap_or(u64::MAX);
        let left = due.saturating_sub(now());
        if left <= FINE_NS {
            sleep_until(due);
        } else {
            let bound = (left - FINE_NS / 2).min(MAX_WAIT_MS * 1_000_000);
            wait(&[&self.fields, self.shell.control()], bound);
        }
    }

    /// Serves requests and the heartbeat. Pause and start concern the source of the fields: those
    /// that it has sent are on their way.
    fn serve(&mut self) -> Result<()> {
        while let Some((request, command)) = self.shell.serve(now())? {
            let answer = match command {
                Command::Pause | Command::Start => Ok(()),
                Command::Reset | Command::Load => {
                    self.outbox.clear();
                    while self.fields.receive()?.is_some() {}
                    Ok(())
                }
                _ => Err("the camera hardware knows start, pause, reset and load only"),
            };
            self.shell.answer(&request, answer)?;
        }
        Ok(())
    }
}
