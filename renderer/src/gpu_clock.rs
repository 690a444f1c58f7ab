//! The graphics device's clock beside the processor's: pure, fed with instants.
//!
//! The device's timestamps of a frame's begin and end are on a clock with its own origin. A frame
//! begins after its submission and is known to be finished after its end, so every frame bounds the
//! difference of the clocks from both sides. Waking up takes 20 µs to 2 ms, so the least upper
//! bound of the last frames is the best estimate.

use protocol::time::Nanos;

/// Frames remembered: at 85 Hz clocks that differ by 50 parts in a million drift by 40 µs over
/// them.
const FRAMES: usize = 64;

/// Begin and end of a frame on the device's clock, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// The first pass began.
    pub begin_ns: u64,
    /// The last pass ended.
    pub end_ns: u64,
}

/// Bounds of processor time minus device time, ns.
#[derive(Debug, Clone)]
pub struct GpuClock {
    bounds: [(i64, i64); FRAMES],
    count: usize,
}

impl Default for GpuClock {
    fn default() -> Self {
        Self { bounds: [(i64::MIN, i64::MAX); FRAMES], count: 0 }
    }
}

impl GpuClock {
    /// Instant, on the processor's clock, at which the device finished a frame that was submitted
    /// at `submitted` and known to be finished at `seen`; never outside these two. Inconsistent
    /// timestamps give `seen`.
    pub fn finished_at(&mut self, submitted: Nanos, span: Span, seen: Nanos) -> Nanos {
        if span.end_ns < span.begin_ns || seen < submitted || span.end_ns - span.begin_ns > seen - submitted {
            return seen;
        }
        let lower = (submitted as i64).wrapping_sub(span.begin_ns as i64);
        let upper = (seen as i64).wrapping_sub(span.end_ns as i64);
        self.bounds[self.count % FRAMES] = (lower, upper);
        self.count += 1;
        let known = &self.bounds[..self.count.min(FRAMES)];
        let least = known.iter().map(|b| b.1).min().unwrap_or(upper);
        // A clock that jumped contradicts the frames before: then this frame alone counts.
        let offset = if least < lower { upper } else { least };
        ((span.end_ns as i64).wrapping_add(offset) as u64).clamp(submitted, seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A device whose clock shows `origin` at processor time 0 and runs `ppm` fast.
    fn stamp(origin: u64, ppm: f64, at: u64) -> u64 {
        origin + (at as f64 * (1.0 + ppm * 1e-6)) as u64
    }

    proptest! {
        #[test]
        fn the_end_is_found_though_waking_takes_its_time(
            origin in 0u64..1 << 50, ppm in -50.0..50.0f64, late in prop::collection::vec(20_000u64..2_000_000, 200),
        ) {
            let mut clock = GpuClock::default();
            for (i, late) in late.iter().enumerate() {
                let submitted = 1_000_000_000 + i as u64 * 11_764_706;
                let (begin, end) = (submitted + 60_000, submitted + 4_060_000);
                let span = Span { begin_ns: stamp(origin, ppm, begin), end_ns: stamp(origin, ppm, end) };
                let found = clock.finished_at(submitted, span, end + late);
                prop_assert!((submitted..=end + late).contains(&found));
                if i > FRAMES {
                    // The quickest wake-up of 64 from a range of 2 ms, and the drift since then.
                    prop_assert!(found.abs_diff(end) < 400_000, "frame {}: {} from {}", i, found, end);
                }
            }
        }
    }

    #[test]
    fn a_clock_that_jumps_is_followed_at_once() {
        let mut clock = GpuClock::default();
        let frame = |clock: &mut GpuClock, at: u64, origin: u64| {
            clock.finished_at(at, Span { begin_ns: origin + at + 10, end_ns: origin + at + 500 }, at + 520)
        };
        assert_eq!(frame(&mut clock, 1_000, 7_000_000), 1_520);
        assert_eq!(frame(&mut clock, 2_000, 9_000_000_000), 2_520);
    }

    #[test]
    fn stamps_without_sense_are_not_believed() {
        let mut clock = GpuClock::default();
        assert_eq!(clock.finished_at(100, Span { begin_ns: 50, end_ns: 20 }, 300), 300);
        assert_eq!(
            clock.finished_at(100, Span { begin_ns: 0, end_ns: 900 }, 300),
            300,
            "longer than it can have taken"
        );
        assert_eq!(clock.count, 0);
    }
}
