//! Output of the simulated cameras: fields of pixels, or blobs.

use crate::cameras::{Exposure, Path};
use anyhow::Result;
use bytemuck::Zeroable;
use ipc::outbox::Outbox;
use ipc::{BlockSender, Instance};
use protocol::blobs::BlobField;
use protocol::fields::FieldHeader;
use protocol::time::Nanos;

/// Where the fields go.
pub(super) enum Output {
    /// Pixels to the camera hardware, published ahead.
    Fields(Box<BlockSender<FieldHeader>>),
    /// Blobs to the tracker, held back until they are due.
    Blobs(Outbox),
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
        Ok(match path {
            Path::Pixels => Output::Fields(Box::new(instance.block_sender(payload_bytes)?)),
            Path::Direct => Output::Blobs(Outbox::default()),
        })
    }

    /// Publishes the pixels of a field, or holds its blobs back; false where the outbox is full.
    pub(super) fn put(&mut self, exposure: &mut Exposure, timing: &FieldTiming) -> Result<bool> {
        match self {
            Output::Fields(fields) => {
                let mut header = exposure.header();
                header.exposed_ns += timing.start_ns;
                header.first_line_ns += timing.start_ns + timing.late_ns;
                fields.send(header.bytes(), |payload| {
                    exposure.paint(payload);
                    header
                })?;
                Ok(true)
            }
            Output::Blobs(outbox) => {
                let mut field = BlobField::zeroed();
                exposure.blobs(&mut field);
                Ok(outbox.put(timing.due_ns, &field))
            }
        }
    }

    /// Takes the next blobs that are due `elapsed_ns` after the start.
    pub(super) fn take_due(&mut self, elapsed_ns: u64) -> Option<BlobField> {
        match self {
            Output::Fields(_) => None,
            Output::Blobs(outbox) => outbox.take(elapsed_ns),
        }
    }

    /// When the next blobs are due, ns after the start.
    pub(super) fn due_ns(&self) -> Option<u64> {
        match self {
            Output::Fields(_) => None,
            Output::Blobs(outbox) => outbox.due_ns(),
        }
    }

    /// Drops the blobs held back.
    pub(super) fn clear(&mut self) {
        if let Output::Blobs(outbox) = self {
            outbox.clear();
        }
    }

    /// Fields of pixels sent so far.
    pub(super) fn sent(&self) -> u64 {
        match self {
            Output::Fields(fields) => fields.sent(),
            Output::Blobs(_) => 0,
        }
    }
}
