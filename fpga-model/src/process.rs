//! The camera hardware's process: fields of pixels in, fields of blobs out.
//!
//! A field is scanned as soon as it is there, in place, and its blobs are held back until the
//! hardware would have sent them ([`crate::camera_extractor`]): the source may publish a field
//! before its first line has left the sensor. Whether the source is virtual or a camera makes no
//! difference here.

use crate::camera_extractor::CameraExtractor;
use crate::colours::file::ColourFile;
use crate::config::Config;
use anyhow::{Context, Result};
use bytemuck::Zeroable;
use ipc::clock::now;
use ipc::outbox::{Outbox, Placed};
use ipc::shell::{Served, Shell, Work};
use ipc::trace::About;
use ipc::{BlockReceiver, BlockSample, Instance, Sender};
use protocol::blobs::{BlobField, WHOLE_FRAME};
use protocol::control::Command;
use protocol::fields::{FieldHeader, PixelFormat};
use protocol::health::{Process, STATE_DEGRADED};
use protocol::limits::MAX_CAMERAS;
use protocol::phases::Phase;
use protocol::time::Nanos;
use rig::Rig;

/// Longest time for which fields are scanned without a heartbeat, ns.
const TURN_NS: u64 = 200_000_000;

/// Runs the camera hardware until it is stopped.
///
/// # Errors
/// Where the rig cannot be read or simulated, or a channel fails.
pub fn run(config: &Config) -> Result<()> {
    let rig = Rig::load_or_shipped(config.rig.rig.as_deref()).context("--rig")?;
    let colours = ColourFile::load_or_shipped(config.extraction.colours.as_deref()).context("--colours")?;
    let extractor = |camera| CameraExtractor::finding(&rig, camera, &colours);
    let extractors = rig.cameras().iter().map(extractor).collect::<Result<_, _>>()?;
    ipc::shell::run(&mut FpgaModelShell::open(config, extractors, rig.longest_period_ns())?)
}

/// Channels of the process, and the blobs held back.
struct FpgaModelShell {
    shell: Shell,
    fields: BlockReceiver<FieldHeader>,
    blobs: Sender<BlobField>,
    extractors: Vec<CameraExtractor>,
    /// From one field of the slowest camera to the next, ns.
    period_ns: u64,
    outbox: Outbox,
    /// Fields wait that the last turn had no time for.
    is_behind: bool,
    /// Number of each camera's newest field.
    newest: [u64; MAX_CAMERAS],
    /// Fields of no camera of the rig, or of another size.
    foreign: u64,
    /// Fields of the past that were passed over.
    passed_over: u64,
    /// Fields for which the outbox had no room.
    no_room: u64,
    /// Keeps the node alive; dropped last.
    _instance: Instance,
}

impl FpgaModelShell {
    fn open(config: &Config, extractors: Vec<CameraExtractor>, period_ns: u64) -> Result<Self> {
        let (instance, shell) = Shell::start(Process::FpgaModel, &config.shell).context("cannot start")?;
        let (fields, blobs) = (instance.block_receiver()?, Outbox::sender(&instance)?);
        Ok(FpgaModelShell {
            shell,
            fields,
            blobs,
            extractors,
            period_ns,
            outbox: Outbox::default(),
            is_behind: false,
            newest: [0; MAX_CAMERAS],
            foreign: 0,
            passed_over: 0,
            no_room: 0,
            _instance: instance,
        })
    }

    /// Scans the fields received. Where they come faster than they can be scanned, blobs and heartbeats leave
    /// between them.
    fn take_fields(&mut self) -> Result<()> {
        let until = now() + TURN_NS;
        self.is_behind = false;
        while let Some(sample) = self.fields.receive()? {
            self.take(&sample)?;
            self.is_behind = now() >= until;
            if self.is_behind {
                break;
            }
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
        let Some(extractor) = extractor.filter(|_| sample.payload().len() >= header.bytes()) else {
            return self.refuse(header);
        };
        let newest = &mut self.newest[header.camera as usize];
        if header.field < *newest {
            // The source has restarted: its former fields are void.
            self.outbox.clear();
        }
        *newest = header.field;
        let begun = self.shell.trace.begin();
        let delay_ns = self.shell.delay_ns();
        let placed = self.outbox.put(&mut self.blobs, |field| {
            *field = BlobField::zeroed();
            let due_ns = extractor.extract_payload(header, sample.payload(), field)?;
            Some(due_ns + delay_ns)
        })?;
        let FieldHeader { field, camera, .. } = *header;
        match placed {
            Placed::Waits => {}
            Placed::Refused => return self.refuse(header),
            Placed::NoRoom => {
                tracing::debug!(field, camera, "no room for the blobs of a field");
                self.no_room += 1;
            }
        }
        self.shell.trace.end(Phase::Scan, About::camera(field, camera), begun);
        Ok(())
    }

    /// Counts a field that fits no camera of the rig, and reports the first in the heartbeat.
    fn refuse(&mut self, header: &FieldHeader) -> Result<()> {
        let FieldHeader { field, camera, width, height, parity, format, .. } = header;
        tracing::debug!(
            field,
            camera,
            width,
            height,
            parity,
            format,
            "a field of a camera that the rig lacks"
        );
        self.foreign += 1;
        if self.foreign == 1 {
            self.shell.report.state = STATE_DEGRADED;
            let what = if *parity == WHOLE_FRAME { "whole frames" } else { "fields" };
            let format = PixelFormat::from_wire(*format).map_or("unknown", PixelFormat::name);
            let text = format!("no camera {camera} with {what} of {width}×{height} px ({format}) in the rig");
            self.shell.set_text(&text);
            self.shell.beat_now(now())?;
        }
        Ok(())
    }

    /// Sends every field whose instant has come.
    fn send_due(&mut self) -> Result<()> {
        while let Some(mut lease) = self.outbox.take(now()) {
            let field = lease.block();
            let at = now();
            field.blobs_out_ns = at;
            let about = About::camera(field.field, field.camera);
            self.blobs.send_lease(lease)?;
            self.shell.trace.end(Phase::SendScanned, about, at);
            self.shell.report.sent = self.blobs.sent();
        }
        Ok(())
    }
}

impl Work<anyhow::Error> for FpgaModelShell {
    fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// Until a field comes or one is due; not at all while fields wait.
    fn rest(&mut self) {
        if self.is_behind {
            return;
        }
        self.shell.rest_to(&[&self.fields], self.outbox.due_ns().unwrap_or(Nanos::MAX));
    }

    /// Hardware does not send what is past.
    fn slept(&mut self, _slept_ns: u64) -> Result<u64> {
        let (past, before) = (now().saturating_sub(self.period_ns), self.passed_over);
        while self.outbox.due_ns().is_some_and(|due| due < past) && self.outbox.take(past).is_some() {
            self.passed_over += 1;
        }
        while let Some(sample) = self.fields.receive()? {
            if sample.header().read_out_ns() + self.shell.delay_ns() < past {
                self.passed_over += 1;
            } else {
                self.take(&sample)?;
            }
        }
        Ok(self.passed_over - before)
    }

    fn turn(&mut self, _woken: Nanos) -> Result<()> {
        self.take_fields()?;
        self.send_due()
    }

    /// Pause and start concern the source of the fields: those that it has sent are on their way.
    fn execute(&mut self, command: Command, _argument: u64) -> Result<Served> {
        let (Command::Reset | Command::Load) = command else { return Ok(Served::NothingToDo) };
        self.outbox.clear();
        while self.fields.receive()?.is_some() {}
        Ok(Served::Done)
    }
}
