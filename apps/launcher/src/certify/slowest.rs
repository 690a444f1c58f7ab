//! Breakdown of the slowest thousandth of the triples, which shows the parts that were slow in the same
//! triple; percentiles of each part do not. Pure.

use protocol::time::Nanos;
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// One triple in this number is kept: those above the percentile of the goal.
const ONE_IN: u64 = 1_000;
/// Maximum number of kept triples.
const MOST: u64 = 1_000;
/// Maximum number of triples listed in a report.
const LISTED: usize = 50;
/// Number of parts of a latency.
const PARTS: usize = 3;

/// A triple, ordered by its latency.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Slow {
    latency_ns: u64,
    triple: u64,
    sent_ns: Nanos,
    parts_ns: [u64; PARTS],
}

/// Collects the slowest triples of a stream.
#[derive(Debug)]
pub struct Slowest {
    /// Min-heap: the fastest of the kept triples is on top.
    kept: BinaryHeap<Reverse<Slow>>,
    most: usize,
}

impl Slowest {
    /// Collects the slowest thousandth of `triples` triples, at least one.
    pub fn of(triples: u64) -> Self {
        let most = (triples / ONE_IN).clamp(1, MOST) as usize;
        Slowest { kept: BinaryHeap::with_capacity(most + 1), most }
    }

    /// Adds a triple: number, time at which its last blobs were sent, and the parts of its latency, ns.
    pub fn note(&mut self, triple: u64, sent_ns: Nanos, parts_ns: [u64; PARTS]) {
        let latency_ns = parts_ns.iter().sum();
        if self.kept.len() == self.most
            && self.kept.peek().is_some_and(|least| latency_ns <= least.0.latency_ns)
        {
            return;
        }
        self.kept.push(Reverse(Slow { latency_ns, triple, sent_ns, parts_ns }));
        if self.kept.len() > self.most {
            self.kept.pop();
        }
    }

    /// Figures of the kept triples.
    pub fn figures(&self) -> SlowestFigures {
        let mut all: Vec<Slow> = self.kept.iter().map(|slow| slow.0).collect();
        all.sort_by_key(|slow| Reverse(*slow));
        let mean_ms = |of: &dyn Fn(&Slow) -> u64| {
            all.iter().map(of).sum::<u64>() as f64 * 1e-6 / all.len().max(1) as f64
        };
        SlowestFigures {
            count: all.len() as u64,
            mean_ms: mean_ms(&|slow| slow.latency_ns),
            parts_ms: std::array::from_fn(|part| mean_ms(&|slow| slow.parts_ns[part])),
            listed: all.iter().take(LISTED).map(SlowTriple::of).collect(),
        }
    }
}

/// Figures of the slowest triples.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SlowestFigures {
    /// Number of triples.
    pub count: u64,
    /// Mean latency, ms.
    pub mean_ms: f64,
    /// Mean of each part, ms.
    pub parts_ms: [f64; PARTS],
    /// The slowest triples, in descending order.
    pub listed: Vec<SlowTriple>,
}

/// One of the slowest triples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SlowTriple {
    /// Number of the triple.
    pub triple: u64,
    /// Time at which the last blobs were sent, ns of `CLOCK_MONOTONIC`, as in kernel traces.
    pub sent_ns: Nanos,
    /// Latency, ms.
    pub latency_ms: f64,
    /// Parts of the latency, ms.
    pub parts_ms: [f64; PARTS],
}

impl SlowTriple {
    fn of(slow: &Slow) -> Self {
        let ms = |ns: u64| ns as f64 * 1e-6;
        let Slow { triple, sent_ns, .. } = *slow;
        SlowTriple { triple, sent_ns, latency_ms: ms(slow.latency_ns), parts_ms: slow.parts_ns.map(ms) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slowest_thousandth_is_kept_with_its_parts_whatever_the_order() {
        let mut slowest = Slowest::of(3_999);
        // 7919 is prime, so every number below 4000 occurs once, out of order.
        for n in 0..4_000 {
            let n = n * 7_919 % 4_000;
            slowest.note(n, 10 * n, [n, 2 * n, 1_000_000]);
        }
        let figures = slowest.figures();
        assert_eq!(figures.count, 3);
        assert_eq!(figures.listed.iter().map(|slow| slow.triple).collect::<Vec<_>>(), [3_999, 3_998, 3_997]);
        assert_eq!(
            (figures.listed[1].sent_ns, figures.listed[1].parts_ms[1]),
            (39_980, 2.0 * 3_998.0 * 1e-6)
        );
        assert!((figures.parts_ms[0] - 3_998e-6).abs() < 1e-12 && (figures.parts_ms[2] - 1.0).abs() < 1e-12);
        assert!((figures.mean_ms - figures.parts_ms.iter().sum::<f64>()).abs() < 1e-9, "{figures:?}");
    }

    #[test]
    fn a_short_stream_has_one_and_an_empty_one_none() {
        let mut slowest = Slowest::of(5);
        assert_eq!((slowest.figures().count, slowest.figures().mean_ms), (0, 0.0));
        [2, 9, 4].into_iter().for_each(|ns| slowest.note(ns, 0, [ns, 0, 0]));
        assert_eq!(slowest.figures().listed.iter().map(|slow| slow.triple).collect::<Vec<_>>(), [9]);
    }
}
