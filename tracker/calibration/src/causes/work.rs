//! How much a judgement may cost, counted in fields rather than in time, so that a recording is always judged alike.

use super::measure::{Left, SLICE_NS, START_NS, slices};
use super::trial::{Hypothesis, PART_NS, SHIFTS_MS};
use protocol::blobs::BlobField;
use protocol::time::Nanos;
use rig::Rig;

/// Bounds of the work of a judgement. Those of the solver are its own (`self_calibration`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Work {
    /// Camera-fields in which the begin of a defect is looked for, evenly spread over a recording.
    pub scanned: usize,
    /// Camera-fields that are tracked to try remedies, all remedies together.
    pub tried: usize,
    /// Later stretches that are judged where the first one holds.
    pub later: u64,
}

impl Work {
    /// All that is there.
    pub const FULL: Work = Work { scanned: usize::MAX, tried: usize::MAX, later: 7 };
    /// For the end of a run or a replay, where somebody waits: some seconds of a processor.
    pub const AT_END: Work = Work { scanned: 12_000, tried: 36_000, later: 1 };

    /// What a rig leaves of the fields that are scanned, by slices.
    pub(super) fn slices(&self, rig: &Rig, fields: &[BlobField]) -> Vec<(Nanos, Left)> {
        if fields.len() <= self.scanned {
            return slices(rig, fields);
        }
        let instants = || fields.iter().map(|f| f.exposed_ns);
        let (Some(begin), Some(end)) = (instants().min(), instants().max()) else { return Vec::new() };
        let window_ns = START_NS + SLICE_NS;
        let room_ns = (end - begin).saturating_sub(window_ns);
        let per_window = (fields.len() as f64 * window_ns as f64 / (end - begin).max(1) as f64).max(1.0);
        let windows = ((self.scanned as f64 / per_window) as u64).max(2);
        let of_window = |i: u64| {
            let from = begin + room_ns / (windows - 1) * i;
            let within = |f: &&BlobField| (from..from + window_ns).contains(&f.exposed_ns);
            slices(rig, &fields.iter().filter(within).copied().collect::<Vec<_>>())
        };
        (0..windows).flat_map(of_window).collect()
    }

    /// As much of a stretch, from its begin on, as all hypotheses can be tried on.
    pub(super) fn stretch<'a>(&self, fields: &'a [BlobField], hypotheses: &[Hypothesis]) -> &'a [BlobField] {
        let Some(begin) = fields.first().map(|f| f.exposed_ns) else { return fields };
        let part = fields.iter().filter(|f| f.exposed_ns < begin + PART_NS).count();
        // How often the part and the whole are tracked, as a rule: few causes without a parameter pass the part, and a marker
        // that was not moved takes two or three steps.
        let (mut parts, mut wholes) = (0, 0);
        for hypothesis in hypotheses {
            let (of_part, of_whole) = match hypothesis {
                Hypothesis::Discrete(_) => (1, 0),
                Hypothesis::Shift(_) => (0, SHIFTS_MS.len() + 6),
                Hypothesis::Scale => (33, 9),
                Hypothesis::Camera(_) => (0, 2),
                Hypothesis::Marker(..) => (5, 1),
            };
            (parts, wholes) = (parts + of_part, wholes + of_whole);
        }
        let left = self.tried.saturating_sub(parts * part);
        let most = (left / wholes.max(1)).max(part);
        &fields[..most.min(fields.len())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    /// So many fields, 5 ms apart.
    fn fields(count: u64) -> Vec<BlobField> {
        let field = |n: u64| BlobField { exposed_ns: 1_000_000_000 + n * 5_000_000, ..BlobField::zeroed() };
        (0..count).map(field).collect()
    }

    #[test]
    fn the_more_there_is_to_try_the_shorter_the_stretch_but_never_below_a_part() {
        let fields = fields(600);
        let length = |tried: usize, hypotheses: &[Hypothesis]| {
            Work { scanned: 0, tried, later: 0 }.stretch(&fields, hypotheses).len()
        };
        let shifts = [Hypothesis::Shift(0), Hypothesis::Shift(1)];
        assert_eq!(length(usize::MAX, &shifts), 600);
        assert_eq!(length(30 * 300, &shifts), 300);
        assert_eq!(length(1, &shifts), 160);
    }

    #[test]
    fn windows_are_spread_over_all_that_is_there() {
        let rig = Rig::load_or_shipped(None).unwrap();
        let mut fields = fields(12_000);
        // Frames are made of fields, also of those without a blob.
        for (n, field) in fields.iter_mut().enumerate() {
            (field.camera, field.field) = ((n % 3) as u32, n as u64 / 3);
            field.blobs_out_ns = field.exposed_ns + 1_000_000;
        }
        let begins = |scanned| -> Vec<Nanos> {
            let slices = Work { scanned, tried: 0, later: 0 }.slices(&rig, &fields);
            slices.into_iter().map(|(begin, _)| begin).collect()
        };
        let few = begins(1_600);
        // The last window may end before its frame is complete.
        assert!((9..=10).contains(&few.len()), "{few:?}");
        assert!(few[0] < 2_000_000_000 && few[8] > 53_000_000_000, "{few:?}");
        assert!(begins(usize::MAX).len() > 100);
    }
}
