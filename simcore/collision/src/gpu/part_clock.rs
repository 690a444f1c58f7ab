//! Times of the parts of a query by the adapter's own clock, as in the paper's Table 1.

use super::device::GpuDevice;
use super::{GpuError, Part};
use wgpu::{Buffer, BufferUsages, CommandEncoder, Features, QuerySet};

/// Timestamps of a query: before it, and after each [`Part`].
const STAMPS: u32 = 4;
/// Size of a timestamp, bytes.
const STAMP_BYTES: u64 = 8;

/// What an adapter needs in order to time parts.
pub(super) const FEATURES: Features =
    Features::TIMESTAMP_QUERY.union(Features::TIMESTAMP_QUERY_INSIDE_ENCODERS);

/// Times of the parts of a query on an adapter, by its clock, ns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartTimes {
    /// Drawing of the membrane: cull, depths and triangles' numbers.
    pub draw: f64,
    /// Comparison of depths, and retrieval of triangles and nodes.
    pub analyse: f64,
    /// Copy of the results to memory that the processor reads.
    pub read_back: f64,
}

/// Timestamps of the parts of one query.
#[derive(Debug)]
pub(super) struct PartClock {
    stamps: QuerySet,
    resolved: Buffer,
    staging: Buffer,
    period_ns: f64,
}

impl PartClock {
    /// `None` where the adapter has no timestamps between commands.
    pub(super) fn new(gpu: &GpuDevice) -> Option<Self> {
        if !gpu.device.features().contains(FEATURES) {
            return None;
        }
        let words = 2 * STAMPS as usize;
        Some(PartClock {
            stamps: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("parts"),
                ty: wgpu::QueryType::Timestamp,
                count: STAMPS,
            }),
            resolved: gpu.buffer("parts", words, BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
            staging: gpu.buffer("parts back", words, BufferUsages::MAP_READ | BufferUsages::COPY_DST),
            period_ns: f64::from(gpu.queue.get_timestamp_period()),
        })
    }

    /// Before the first part.
    pub(super) fn begin(&self, encoder: &mut CommandEncoder) {
        encoder.write_timestamp(&self.stamps, 0);
    }

    /// After a part.
    pub(super) fn end(&self, encoder: &mut CommandEncoder, part: Part) {
        encoder.write_timestamp(&self.stamps, 1 + part as u32);
    }

    /// The times of the last query.
    pub(super) fn read(&self, gpu: &GpuDevice) -> Result<PartTimes, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bytes = u64::from(STAMPS) * STAMP_BYTES;
        encoder.resolve_query_set(&self.stamps, 0..STAMPS, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, bytes);
        let ticks: Vec<u64> = gpu.run(encoder, &self.staging, bytes, |words| {
            words.chunks_exact(2).map(|w| u64::from(w[0]) | u64::from(w[1]) << 32).collect()
        })?;
        let ns = |part: Part| {
            let end = 1 + part as usize;
            ticks[end].saturating_sub(ticks[end - 1]) as f64 * self.period_ns
        };
        Ok(PartTimes { draw: ns(Part::Draw), analyse: ns(Part::Analyse), read_back: ns(Part::ReadBack) })
    }
}
