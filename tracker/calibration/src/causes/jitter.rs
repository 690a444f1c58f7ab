//! Timestamps that jitter: a driver that stamps pictures when they arrive, and not when they were exposed.
//!
//! A camera exposes at equal intervals, so the intervals of its timestamps say how they jitter, without a pose. That they
//! jitter and the exposures do not is shown by what is left in the pictures: less with timestamps at equal intervals.

use super::measure::{Left, measure};
use super::{Cause, together};
use crate::median;
use protocol::blobs::BlobField;
use rig::Rig;

/// Fewest fields of a camera.
const FEWEST: usize = 50;
/// Median difference of a camera's intervals from their median above which its timestamps jitter, ns.
const JITTER_NS: f64 = 200_000.0;
/// Share of the mean square of the blobs that measure poses which is left with equal intervals, at most, and share of the
/// blobs by which fewer may measure poses.
const LEFT: (f64, f64) = (0.98, 0.005);

/// The camera whose timestamps jitter most, and what is left with equal intervals of all that jitter; `None` where that is
/// no less. `before`: what is left with the timestamps as they are.
pub fn detect(rig: &Rig, fields: &[BlobField], before: &Left) -> Option<(Cause, Left)> {
    let lines: Vec<Line> = rig.cameras.iter().filter_map(|c| Line::of(fields, c.id)).collect();
    let worst = lines.iter().max_by(|a, b| a.rms_ns.total_cmp(&b.rms_ns))?;
    let mut even = fields.to_vec();
    for field in &mut even {
        if let Some(line) = lines.iter().find(|line| line.camera == field.camera) {
            field.exposed_ns = line.at(field.field);
        }
    }
    let left = measure(rig, &even);
    let [old, new] = [before, &left].map(|left| left.explained.rms().unwrap_or(f64::MAX));
    let is_better =
        new * new < LEFT.0 * old * old && left.explained_share() > before.explained_share() - LEFT.1;
    // Where more is wrong beside it, that is what has to be said.
    let is_all = || together::estimate(rig, &even).is_ok_and(|rest| rest.above.is_noise());
    let cause = Cause::TimestampsJitter { camera: worst.camera, rms_ms: worst.rms_ns * 1e-6 };
    (is_better && is_all()).then_some((cause, left))
}

/// The exposures of a camera at equal intervals.
struct Line {
    camera: u32,
    first_field: u64,
    first_ns: u64,
    /// Offset from `first_ns`, and interval, ns.
    offset_ns: f64,
    interval_ns: f64,
    /// Root mean square of the timestamps' deviations.
    rms_ns: f64,
}

impl Line {
    /// Of a camera whose timestamps jitter.
    fn of(fields: &[BlobField], camera: u32) -> Option<Self> {
        let own: Vec<&BlobField> = fields.iter().filter(|f| f.camera == camera).collect();
        let first = own.first().filter(|_| own.len() >= FEWEST)?;
        let place = |f: &BlobField| {
            let number = f.field.wrapping_sub(first.field) as i64 as f64;
            (number, f.exposed_ns.wrapping_sub(first.exposed_ns) as i64 as f64)
        };
        let intervals: Vec<f64> = own
            .windows(2)
            .map(|pair| (place(pair[0]), place(pair[1])))
            .filter(|((a, _), (b, _))| b > a)
            .map(|((a, from), (b, to))| (to - from) / (b - a))
            .collect();
        let usual = median(intervals.iter().copied())?;
        // A step of the clock is one odd interval, and leaves the median as it is.
        let jitter = median(intervals.iter().map(|interval| (interval - usual).abs()))?;
        if jitter < JITTER_NS {
            return None;
        }
        let count = own.len() as f64;
        let mean = |of: &dyn Fn((f64, f64)) -> f64| own.iter().map(|f| of(place(f))).sum::<f64>() / count;
        let (n, t) = (mean(&|(n, _)| n), mean(&|(_, t)| t));
        let spread = mean(&|(x, _)| (x - n) * (x - n));
        let interval_ns = mean(&|(x, y)| (x - n) * (y - t)) / spread;
        let offset_ns = t - interval_ns * n;
        let square = mean(&|(x, y)| (y - offset_ns - interval_ns * x).powi(2));
        let (first_field, first_ns) = (first.field, first.exposed_ns);
        Some(Line { camera, first_field, first_ns, offset_ns, interval_ns, rms_ns: square.sqrt() })
    }

    fn at(&self, field: u64) -> u64 {
        let number = field.wrapping_sub(self.first_field) as i64 as f64;
        let since_ns = self.offset_ns + self.interval_ns * number;
        self.first_ns.saturating_add_signed(since_ns as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn fields(at: impl Fn(u64) -> f64) -> Vec<BlobField> {
        let field = |n: u64| BlobField {
            camera: 1,
            field: 7 + n,
            exposed_ns: 1_000_000_000 + at(n) as u64,
            ..BlobField::zeroed()
        };
        // One in ten was lost.
        (0..150).filter(|n| n % 10 != 3).map(field).collect()
    }

    /// Within ± 1.
    fn noise(n: u64) -> f64 {
        (78.2 * (12.9 * n as f64).sin()).sin()
    }

    #[test]
    fn timestamps_that_jitter_differ_from_steps_and_from_another_rate() {
        let period = 20e6;
        let even = |n: u64| n as f64 * period;
        assert!(Line::of(&fields(even), 1).is_none());
        assert!(Line::of(&fields(|n| n as f64 * 19.7e6), 1).is_none(), "another rate");
        assert!(Line::of(&fields(|n| even(n) + if n > 70 { 5e6 } else { 0.0 }), 1).is_none(), "a step");
        let line = Line::of(&fields(|n| even(n) + 4e6 + 3e6 * noise(n)), 1).expect("jitter");
        assert!((line.interval_ns / period - 1.0).abs() < 1e-3);
        assert!((1.5e6..2.5e6).contains(&line.rms_ns), "{} ns", line.rms_ns);
        let off = line.at(7 + 149).abs_diff(1_000_000_000 + 4_000_000 + 149 * 20_000_000);
        assert!(off < 1_000_000, "{off} ns");
        assert!(Line::of(&fields(even)[..20], 1).is_none(), "too few");
    }
}
