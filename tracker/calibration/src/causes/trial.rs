//! Tries of remedies: of each hypothesis, its best parameters and what is left with them.

use super::measure::{Left, measure};
use super::remedy::{amended, discrete, rescaled, undone};
use super::search::{best_of, least};
use super::{Cause, colours, places};
use protocol::blobs::BlobField;
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use rig::Rig;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Length of the part by which most causes are tried first, ns, and what a remedy must take away from its mean square for
/// a second try: a share, or so much, px², if that is less.
pub const PART_NS: u64 = 800_000_000;
const LEAST_SHARE: f64 = 0.1;
const LEAST_PX2: f64 = 0.04;
/// Shifts of timestamps that are tried first, ms.
pub const SHIFTS_MS: [f64; 9] = [-16.0, -10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0, 16.0];
/// Scales that are tried first: from, to, step. Bodies are tracked well only where a scale is right to half a per cent.
const SCALES: (f64, f64, f64) = (0.92, 1.08, 0.005);
/// A scale that differs by less from the rig's is found with everything else, without tracking again.
const OTHER_SCALE: f64 = 0.004;

/// Something to try.
#[derive(Debug, Clone)]
pub enum Hypothesis {
    /// A cause without a parameter.
    Discrete(Cause),
    /// Stamps of a camera.
    Shift(u32),
    /// Distances of all cameras.
    Scale,
    /// Place of a camera.
    Camera(u32),
    /// Body and marker.
    Marker(usize, usize),
}

/// Everything that a rig and its blobs allow.
pub fn hypotheses(rig: &Rig, fields: &[BlobField]) -> Vec<Hypothesis> {
    let mut all: Vec<Hypothesis> = discrete(rig, fields).into_iter().map(Hypothesis::Discrete).collect();
    all.extend(colours::swaps(rig, fields).into_iter().map(Hypothesis::Discrete));
    let ids = || rig.cameras.iter().map(|c| c.id);
    all.extend(ids().map(Hypothesis::Shift));
    all.push(Hypothesis::Scale);
    all.extend(ids().map(Hypothesis::Camera));
    for (body, name) in BODY_NAMES.iter().enumerate().take(BODIES) {
        let markers = rig.body(name).map_or(0, |b| b.markers.len());
        all.extend((0..markers).map(|marker| Hypothesis::Marker(body, marker)));
    }
    all
}

/// What remedies are tried on.
struct Stretch<'a> {
    rig: &'a Rig,
    fields: &'a [BlobField],
    part: Vec<BlobField>,
    /// What the rig as it is leaves of the part, px².
    part_left_px2: f64,
}

impl<'a> Stretch<'a> {
    fn new(rig: &'a Rig, fields: &'a [BlobField]) -> Self {
        let begin = fields.first().map_or(0, |f| f.exposed_ns);
        let part: Vec<BlobField> =
            fields.iter().filter(|f| f.exposed_ns < begin + PART_NS).copied().collect();
        let part_left_px2 = measure(rig, &part).mean();
        Stretch { rig, fields, part, part_left_px2 }
    }

    /// True where a remedy helps the part. Most are far from it, and a part says so in less time. Where a large share of
    /// the blobs is no marker's, what a remedy takes away is a smaller share of what there is.
    fn helps(&self, rig: &Rig, part: &[BlobField]) -> bool {
        let least = (LEAST_SHARE * self.part_left_px2).min(LEAST_PX2);
        measure(rig, part).mean() < self.part_left_px2 - least
    }

    /// What the remedy of a hypothesis leaves, with its size; `None` where it has none there.
    fn outcome(&self, hypothesis: &Hypothesis) -> Option<(Cause, Left)> {
        let (rig, fields) = (self.rig, self.fields);
        let of = |cause: &Cause| measure(rig, &undone(rig, cause, fields));
        match *hypothesis {
            Hypothesis::Discrete(ref cause) => {
                let of = |fields: &[BlobField]| (amended(rig, cause), undone(rig, cause, fields));
                let (amended, part) = of(&self.part);
                self.helps(&amended, &part).then(|| (cause.clone(), measure(&amended, &of(fields).1)))
            }
            Hypothesis::Shift(camera) => {
                let cause = |by_ms| Cause::ClockShifted { camera, by_ms };
                let shift = least(&SHIFTS_MS, |by_ms| of(&cause(by_ms)).all.rms());
                shift.map(|(by_ms, _)| (cause(by_ms), of(&cause(by_ms))))
            }
            Hypothesis::Scale => self.scale(),
            Hypothesis::Camera(id) => {
                places::camera_moved(rig, fields, id).map(|(moved, cause)| (cause, measure(&moved, fields)))
            }
            Hypothesis::Marker(body, marker) => {
                let of_part = places::marker_moved(rig, &self.part, body, marker);
                if of_part.is_some_and(|(moved, _)| !self.helps(&moved, &self.part)) {
                    return None;
                }
                places::marker_moved(rig, fields, body, marker)
                    .map(|(moved, cause)| (cause, measure(&moved, fields)))
            }
        }
    }

    fn scale(&self) -> Option<(Cause, Left)> {
        let cost = |factor, fields: &[BlobField]| measure(&rescaled(self.rig, factor), fields);
        let (from, to, step) = SCALES;
        let count = ((to - from) / step).round() as usize;
        let tried = (0..=count).map(|i| from + step * i as f64);
        let (near, _) = best_of(tried, |factor| cost(factor, &self.part).all.rms())?;
        let scale = least(&[near - step, near, near + step], |factor| cost(factor, self.fields).all.rms());
        scale.map(|(factor, _)| (Cause::Scale { camera: None, factor }, cost(factor, self.fields)))
    }
}

/// The scale that leaves least, with what it leaves; `None` where the rig's own is as good as any.
pub fn scale(rig: &Rig, fields: &[BlobField]) -> Option<(Cause, Left)> {
    let (cause, left) = Stretch::new(rig, fields).scale()?;
    let is_another =
        |cause: &Cause| matches!(cause, Cause::Scale { factor, .. } if (factor - 1.0).abs() > OTHER_SCALE);
    is_another(&cause).then_some((cause, left))
}

/// Tries every remedy on a stretch, several at a time; what came of them, in the order of the hypotheses, or `None`
/// where it was stopped.
pub fn try_all(
    rig: &Rig,
    fields: &[BlobField],
    hypotheses: &[Hypothesis],
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) -> Option<Vec<(Cause, Left)>> {
    let tried_on = Stretch::new(rig, fields);
    let (next, tried, stopped) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicBool::new(false));
    let work = || {
        let mut found = Vec::new();
        while !stopped.load(Ordering::Relaxed) {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(hypothesis) = hypotheses.get(at) else { break };
            if !go_on(tried.load(Ordering::Relaxed), hypotheses.len()) {
                stopped.store(true, Ordering::Relaxed);
                break;
            }
            found.extend(tried_on.outcome(hypothesis).map(|found| (at, found)));
            tried.fetch_add(1, Ordering::Relaxed);
        }
        found
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(hypotheses.len());
    let mut found: Vec<(usize, (Cause, Left))> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("a remedy does not panic")).collect()
    });
    found.sort_by_key(|(at, _)| *at);
    (!stopped.load(Ordering::Relaxed)).then(|| found.into_iter().map(|(_, found)| found).collect())
}
