//! Output of the simulated cameras: fields of pixels, or blobs.

use crate::cameras::{Exposure, Path};
use anyhow::Result;
use bytemuck::Zeroable;
use ipc::outbox::{Outbox, Placed};
use ipc::{BlockSender, Instance, Sender};
use protocol::blobs::BlobField;
use protocol::fields::FieldHeader;
use protocol::phases::Phase;
use protocol::time::Nanos;

/// Where the fields go.
pub(super) struct Output {
    /// Pixels to the camera hardware, published ahead; `None` on the direct path.
    fields: Option<Box<BlockSender<FieldHeader>>>,
    /// Blobs to the tracker on the direct path, held back until they are due.
    pub(super) blobs: Outbox,
}

/// Instants of a field.
pub(super) struct FieldTiming {
    /// Start of the schedule.
    pub(super) start_ns: Nanos,
    /// Delay of the first line, ns.
    pub(super) late_ns: u64,
    /// When blobs leave, ns after the start.
    pub(super) due_ns: u64,
}

impl Output {
    pub(super) fn open(instance: &Instance, path: Path, payload_bytes: usize) -> Result<Self> {
        let sender = || anyhow::Ok(Box::new(instance.block_sender(payload_bytes)?));
        let fields = (path == Path::Pixels).then(sender).transpose()?;
        Ok(Output { fields, blobs: Outbox::default() })
    }

    /// Publishes the pixels of a field, or holds its blobs back in memory lent by `blobs`; false where the outbox
    /// is full.
    pub(super) fn put(
        &mut self,
        exposure: &mut Exposure,
        timing: &FieldTiming,
        blobs: &mut Sender<BlobField>,
    ) -> Result<bool> {
        let Some(fields) = &mut self.fields else {
            let placed = self.blobs.put(blobs, |field| {
                *field = BlobField::zeroed();
                exposure.blobs(field);
                Some(timing.due_ns)
            })?;
            return Ok(placed != Placed::NoRoom);
        };
        let mut header = exposure.header();
        header.exposed_ns += timing.start_ns;
        header.first_line_ns += timing.start_ns + timing.late_ns;
        fields.send(header.bytes(), |payload| {
            exposure.paint(payload);
            header
        })?;
        Ok(true)
    }

    /// What [`Output::put`] does in a trace.
    pub(super) fn phase(&self) -> Phase {
        if self.fields.is_some() { Phase::Paint } else { Phase::MakeBlobs }
    }

    /// Fields of pixels sent so far.
    pub(super) fn sent(&self) -> u64 {
        self.fields.as_ref().map_or(0, |fields| fields.sent())
    }
}
