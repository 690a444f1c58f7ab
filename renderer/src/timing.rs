//! Times of a frame's passes by timestamps of the device, where it has them.

use crate::gpu::Gpu;
use crate::gpu_clock::Span;
use crate::passes::buffer;
use protocol::time::Nanos;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use wgpu::{Buffer, BufferUsages, CommandEncoder, MapMode, QuerySet, RenderPassTimestampWrites};

/// A pass that is timed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Pass {
    Shadow = 0,
    Picture = 1,
    Focus = 2,
}

/// Passes in their order.
pub const PASSES: [(&str, Pass); 3] =
    [("shadow", Pass::Shadow), ("picture", Pass::Picture), ("focus", Pass::Focus)];
const STAMPS: u32 = 2 * PASSES.len() as u32;
const BYTES: u64 = STAMPS as u64 * 8;

/// Times of a frame by the device's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PassTimes {
    /// Begin of the first pass to end of the last.
    pub whole: Span,
    /// Each of [`PASSES`], ns; 0 where a tier has none.
    pub passes_ns: [u64; PASSES.len()],
    /// When each began, ns on the device's clock.
    pub begun_ns: [u64; PASSES.len()],
}

impl PassTimes {
    /// Begin and end of each of [`PASSES`] on the processor's clock, of a frame that was submitted at the first
    /// of these instants and finished at the second. A device may begin a pass before the one before it
    /// has ended; here it then begins with that end. `None` for a pass that a tier does not have.
    pub fn on_processor_clock(
        &self,
        [submitted, finished]: [Nanos; 2],
    ) -> [Option<[Nanos; 2]>; PASSES.len()] {
        let mut free_from = submitted;
        std::array::from_fn(|i| {
            let before_end_ns = self.whole.end_ns.checked_sub(self.begun_ns[i])?;
            let begun = finished.saturating_sub(before_end_ns);
            let ended = begun.saturating_add(self.passes_ns[i]).min(finished);
            let from = begun.max(free_from);
            free_from = free_from.max(ended);
            (self.passes_ns[i] > 0 && from < ended).then_some([from, ended])
        })
    }
}

/// Timestamp queries of one frame, and the buffers through which they come back.
pub struct Timing {
    stamps: QuerySet,
    resolved: Buffer,
    back: Buffer,
    period_ns: f64,
    /// The way back was asked for, and whether the stamps are there.
    asked: bool,
    arrived: Arc<AtomicBool>,
}

impl Timing {
    /// `None` where the adapter has no timestamps.
    pub fn new(gpu: &Gpu) -> Option<Self> {
        if !gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let buffer = |label, usage| buffer(&gpu.device, label, BYTES as usize, usage);
        Some(Self {
            stamps: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("stamps"),
                ty: wgpu::QueryType::Timestamp,
                count: STAMPS,
            }),
            resolved: buffer("stamps", BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC),
            back: buffer("stamps back", BufferUsages::MAP_READ),
            period_ns: f64::from(gpu.queue.get_timestamp_period()),
            asked: false,
            arrived: Arc::default(),
        })
    }

    /// For the descriptor of `pass`.
    pub fn writes(&self, pass: Pass) -> RenderPassTimestampWrites<'_> {
        let first = 2 * pass as u32;
        RenderPassTimestampWrites {
            query_set: &self.stamps,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        }
    }

    /// Ends a frame's commands, whose last pass was `last`: resolves the timestamps into a mappable
    /// buffer.
    pub fn resolve(&self, encoder: &mut CommandEncoder, last: Pass) {
        let written = 2 * last as u32 + 2;
        encoder.clear_buffer(&self.resolved, 0, None);
        encoder.resolve_query_set(&self.stamps, 0..written, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.back, 0, BYTES);
    }

    /// Before a frame is submitted: drops timestamps of the frame before that were not read.
    pub fn before_submit(&mut self) {
        if std::mem::take(&mut self.asked) {
            self.back.unmap();
        }
        self.arrived.store(false, Ordering::Release);
    }

    /// After a frame was submitted: requests its timestamps, which arrive when the device is done.
    pub fn after_submit(&mut self) {
        let arrived = Arc::clone(&self.arrived);
        self.back.slice(..).map_async(MapMode::Read, move |result| {
            arrived.store(result.is_ok(), Ordering::Release);
        });
        self.asked = true;
    }

    /// Times of the last frame; `None` before it is done, or if they were read already.
    pub fn read(&mut self) -> Option<PassTimes> {
        if !self.asked || !self.arrived.load(Ordering::Acquire) {
            return None;
        }
        let mapped = self.back.slice(..).get_mapped_range().ok()?;
        let mut ns = [0u64; STAMPS as usize];
        for (ns, ticks) in ns.iter_mut().zip(mapped.chunks_exact(8)) {
            let ticks = u64::from_le_bytes(ticks.try_into().unwrap_or_default());
            // Whole ticks first: their product with the period may need more than the 53 bits of a
            // number.
            let whole = self.period_ns.floor();
            *ns = ticks.wrapping_mul(whole as u64) + (ticks as f64 * (self.period_ns - whole)) as u64;
        }
        drop(mapped);
        self.before_submit();
        let pass = |i: usize| ns[2 * i + 1].saturating_sub(ns[2 * i]);
        let whole = Span { begin_ns: ns[0], end_ns: ns.into_iter().max().unwrap_or_default() };
        let begun_ns = std::array::from_fn(|i| ns[2 * i]);
        Some(PassTimes { whole, passes_ns: std::array::from_fn(pass), begun_ns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn passes_stand_before_the_end_of_their_frame() {
        let whole = Span { begin_ns: 1_000, end_ns: 1_900 };
        let times = PassTimes { whole, passes_ns: [100, 500, 300], begun_ns: [1_000, 1_050, 1_600] };
        let found = times.on_processor_clock([50_000, 60_000]);
        assert_eq!(found, [Some([59_100, 59_200]), Some([59_200, 59_650]), Some([59_700, 60_000])]);
        let without = PassTimes { passes_ns: [100, 500, 0], begun_ns: [1_000, 1_100, 0], ..times };
        assert_eq!(without.on_processor_clock([50_000, 60_000])[2], None);
    }

    proptest! {
        #[test]
        fn passes_never_overlap_and_stay_within_their_frame(
            begun_ns: [u64; 3], passes_ns: [u64; 3], end_ns: u64, frame in 0u64..1 << 50, took in 0u64..1 << 40,
        ) {
            let times = PassTimes { whole: Span { begin_ns: 0, end_ns }, passes_ns, begun_ns };
            let mut before = frame;
            for [from, to] in times.on_processor_clock([frame, frame + took]).into_iter().flatten() {
                prop_assert!(before <= from && from < to && to <= frame + took);
                before = to;
            }
        }
    }
}
