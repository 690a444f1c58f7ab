//! Which causes explain what is left in the pictures, and since when.

use super::judgement::{Explanation, Judgement, Verdict};
use super::measure::{Left, SLICE_NS, START_NS, measure, slices};
use super::remedy::{discrete, rescaled, undone};
use super::search::least;
use super::together::Together;
use super::{Cause, places, progressive, together};
use protocol::blobs::BlobField;
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use protocol::time::Nanos;
use rig::Rig;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Length of the stretch that is judged, ns.
const STRETCH_NS: u64 = 3_000_000_000;
/// A rig that holds leaves less in the blobs that measured poses, px.
const HOLDS_PX: f64 = 0.2;
/// Share of the blobs that measure poses where a rig holds.
const HOLDS_SHARE: f64 = 0.85;
/// The same where no remedy makes it larger, with false blobs in every field and an instrument out of the eye.
const TRACKED_SHARE: f64 = 0.6;
/// A remedy explains as much as the best where it takes away this share of what the best does.
const ALIKE: f64 = 0.93;
/// Least of the mean square that a remedy takes away, px², and share of it: less is no explanation.
const LEAST: (f64, f64) = (0.01, 0.25);
/// A defect has begun where the mean square is this many times that of before, and that more, px².
const BEGUN: (f64, f64) = (1.8, 0.006);
/// Slices after the begin of a defect, at least: fewer are too little to judge.
const LATER: usize = 3;
/// Mean square that a rig which holds may leave, px²: markers that hide each other.
const FLOOR_PX2: f64 = 0.02;
/// Share of what is above that which a remedy must take away.
const MOST: f64 = 0.75;
/// Length of the part by which causes without a parameter are tried first, ns, and the share of the mean square that
/// must be left at most for a second try.
const PART_NS: u64 = 800_000_000;
const MUCH: f64 = 0.9;
/// Shifts of time stamps that are tried first, ms.
const SHIFTS_MS: [f64; 9] = [-16.0, -10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0, 16.0];
/// Scales that are tried first.
const SCALES: [f64; 9] = [0.92, 0.95, 0.97, 0.985, 1.0, 1.015, 1.03, 1.05, 1.08];

/// Judges the fields of a recording, in the order of arrival, with all processors. `go_on` gets how many
/// causes were tried, of how many; where it says no, the search is stopped.
pub fn judge(rig: &Rig, fields: &[BlobField], go_on: impl Fn(usize, usize) -> bool + Sync) -> Judgement {
    judge_where(rig, fields, |_| true, go_on)
}

/// The same where the rig does not hold; what is small is not looked into, which takes time.
pub fn judge_what_breaks(
    rig: &Rig,
    fields: &[BlobField],
    go_on: impl Fn(usize, usize) -> bool + Sync,
) -> Judgement {
    judge_where(rig, fields, |left| !holds(left), go_on)
}

fn judge_where(
    rig: &Rig,
    fields: &[BlobField],
    is_looked_into: impl Fn(&Left) -> bool,
    go_on: impl Fn(usize, usize) -> bool + Sync,
) -> Judgement {
    let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0);
    let onset = onset(&slices(rig, fields)).filter(|at| *at > begin + START_NS + SLICE_NS);
    // What progressive pictures leave depends on the motion, not on when they began.
    let always = progressive::detect(rig, &stretch(fields, begin)).is_some();
    let from = onset.filter(|_| !always).unwrap_or(begin);
    let stretch = stretch(fields, from);
    let before = measure(rig, &stretch);
    let mut judgement = beginning(&before, from.saturating_sub(begin));
    if before.all.count < 200 {
        return judgement;
    }
    if let Some(cause) = progressive::detect(rig, &stretch) {
        let left = measure(rig, &progressive::first_fields(&cause, &stretch));
        judgement.verdict = Verdict::Explained;
        judgement.holds = false;
        judgement.explanations = vec![explanation((cause, left))];
        return judgement;
    }
    if !is_looked_into(&before) {
        judgement.verdict = Verdict::NothingWrong;
        return judgement;
    }
    // Small errors: everything at once, without tracking again for each.
    let together = together::estimate(rig, &stretch).ok();
    if let Some(found) = together.as_ref().filter(|found| found.mends(rig, &stretch)) {
        take(found, &mut judgement);
        return judgement;
    }
    search(rig, &stretch, (&before, together), &mut judgement, &go_on);
    judgement
}

/// A judgement before anything was looked into.
fn beginning(before: &Left, since_ns: u64) -> Judgement {
    Judgement {
        verdict: Verdict::TooLittle,
        left_px: before.all.rms().unwrap_or(0.0),
        blobs: before.all.count,
        since_s: since_ns as f64 * 1e-9,
        holds: holds(before),
        above_px: before.all.rms().unwrap_or(0.0),
        unexplained: 1.0 - before.explained_share(),
        explanations: Vec::new(),
        tried: 0,
    }
}

/// Judges by what was estimated together.
fn take(found: &Together, judgement: &mut Judgement) {
    judgement.tried = found.tried;
    judgement.above_px = found.above.px;
    judgement.holds = found.above.is_noise();
    if !judgement.holds {
        judgement.explanations = found.explanations(judgement.blobs);
    }
    judgement.verdict = match (judgement.holds, judgement.explanations.is_empty()) {
        (true, _) => Verdict::NothingWrong,
        (false, false) => Verdict::Explained,
        (false, true) => Verdict::Unknown,
    };
}

/// Tries every remedy. Where none explains what is left, and the blobs that measured poses leave noise, the others
/// belong to no marker (reflections, markers of an instrument that is out of the eye), which is no error of the rig.
fn search(
    rig: &Rig,
    stretch: &[BlobField],
    (before, together): (&Left, Option<Together>),
    judgement: &mut Judgement,
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) {
    let hypotheses = hypotheses(rig, stretch);
    let found = try_all(rig, stretch, &hypotheses, go_on);
    let was_stopped = found.is_none();
    judgement.tried += if was_stopped { 0 } else { hypotheses.len() };
    judgement.explanations = found.map_or_else(Vec::new, |found| alike(before, found));
    let noise = together.filter(|t| t.above.is_noise() && leaves_little(before, TRACKED_SHARE));
    judgement.holds = judgement.explanations.is_empty() && noise.is_some();
    judgement.above_px = noise.filter(|_| judgement.holds).map_or(judgement.above_px, |t| t.above.px);
    judgement.verdict = match (judgement.explanations.is_empty(), judgement.holds, was_stopped) {
        (false, ..) => Verdict::Explained,
        (true, true, _) => Verdict::NothingWrong,
        (true, false, true) => Verdict::Stopped,
        (true, false, false) => Verdict::Unknown,
    };
}

/// The fields that are judged, from an exposure on.
fn stretch(fields: &[BlobField], from: Nanos) -> Vec<BlobField> {
    let within = |f: &&BlobField| (from..from + STRETCH_NS).contains(&f.exposed_ns);
    fields.iter().filter(within).copied().collect()
}

/// Tries every remedy on a stretch, several at a time; what came of them, in the order of the hypotheses, or `None`
/// where it was stopped.
fn try_all(
    rig: &Rig,
    fields: &[BlobField],
    hypotheses: &[Hypothesis],
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) -> Option<Vec<(Cause, Left)>> {
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
            found.extend(tried_out(rig, fields, hypothesis).map(|found| (at, found)));
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

/// True where what is left is noise.
fn holds(left: &Left) -> bool {
    leaves_little(left, HOLDS_SHARE)
}

/// True where more than this share of the blobs measured poses, and left little.
fn leaves_little(left: &Left, share: f64) -> bool {
    left.explained_share() > share && left.explained.rms().is_some_and(|px| px < HOLDS_PX)
}

/// The begin of the later slices where they are worse than those before: the split of all slices into two
/// parts with the largest difference between the means of their logarithms. What a defect leaves follows the motion and
/// varies tenfold from slice to slice; the worst slice is not its begin.
fn onset(slices: &[(Nanos, Left)]) -> Option<Nanos> {
    let mean = |part: &[(Nanos, Left)], of: &dyn Fn(f64) -> f64| {
        part.iter().map(|(_, left)| of(left.mean())).sum::<f64>() / part.len() as f64
    };
    let splits = (1..(slices.len() + 1).saturating_sub(LATER)).map(|at| {
        let (before, after) = slices.split_at(at);
        let [low, high] = [before, after].map(|part| mean(part, &|square| (square + BEGUN.1).ln()));
        let weight = (before.len() * after.len()) as f64;
        (weight * (high - low) * (high - low).abs(), at)
    });
    let (_, at) = splits.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let [low, high] = [&slices[..at], &slices[at..]].map(|part| mean(part, &|square| square));
    (high > BEGUN.0 * low + BEGUN.1).then(|| slices[at].0)
}

/// Something to try.
#[derive(Debug, Clone)]
enum Hypothesis {
    Discrete(Cause),
    Shift(u32),
    Scale,
    Camera(u32),
    Marker(usize, usize),
}

fn hypotheses(rig: &Rig, fields: &[BlobField]) -> Vec<Hypothesis> {
    let mut all: Vec<Hypothesis> = discrete(rig, fields).into_iter().map(Hypothesis::Discrete).collect();
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

/// What the remedy of a hypothesis leaves, with its size; `None` where it has none there.
fn tried_out(rig: &Rig, fields: &[BlobField], hypothesis: &Hypothesis) -> Option<(Cause, Left)> {
    let of = |cause: &Cause| measure(rig, &undone(rig, cause, fields));
    let begin = fields.first().map_or(0, |f| f.exposed_ns);
    let part: Vec<BlobField> = fields.iter().filter(|f| f.exposed_ns < begin + PART_NS).copied().collect();
    match *hypothesis {
        Hypothesis::Discrete(ref cause) => {
            // Most are far from it: a part of the stretch says so in less time.
            let [before, after] =
                [&part, &undone(rig, cause, &part)].map(|fields| measure(rig, fields).mean());
            (after < MUCH * before).then(|| (cause.clone(), of(cause)))
        }
        Hypothesis::Shift(camera) => {
            let cause = |by_ms| Cause::ClockShifted { camera, by_ms };
            let shift = least(&SHIFTS_MS, |by_ms| of(&cause(by_ms)).all.rms());
            shift.map(|(by_ms, _)| (cause(by_ms), of(&cause(by_ms))))
        }
        Hypothesis::Scale => {
            let cost = |factor| measure(&rescaled(rig, factor), fields);
            let scale = least(&SCALES, |factor| cost(factor).all.rms());
            scale.map(|(factor, _)| (Cause::Scale { camera: None, factor }, cost(factor)))
        }
        Hypothesis::Camera(id) => {
            places::camera_moved(rig, fields, id).map(|(moved, cause)| (cause, measure(&moved, fields)))
        }
        Hypothesis::Marker(body, marker) => places::marker_moved(rig, fields, body, marker)
            .map(|(moved, cause)| (cause, measure(&moved, fields))),
    }
}

/// The causes whose remedies make the rig hold, or take away about as much as the best of those.
fn alike(before: &Left, found: Vec<(Cause, Left)>) -> Vec<Explanation> {
    let taken = |left: &Left| before.mean() - left.mean();
    let best = found.iter().filter(|(_, left)| holds(left)).map(|(_, left)| taken(left)).fold(0.0, f64::max);
    let least = LEAST.0.max(LEAST.1 * before.mean()).max(MOST * (before.mean() - FLOOR_PX2));
    if best < least {
        return Vec::new();
    }
    let mut named: Vec<(Cause, Left)> =
        found.into_iter().filter(|(_, left)| holds(left) && taken(left) >= ALIKE * best).collect();
    named.sort_by(|a, b| {
        a.0.parameters().cmp(&b.0.parameters()).then_with(|| a.1.mean().total_cmp(&b.1.mean()))
    });
    named.into_iter().map(explanation).collect()
}

fn explanation((cause, left): (Cause, Left)) -> Explanation {
    Explanation { cause, left_px: left.all.rms().unwrap_or(0.0), blobs: left.all.count }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::causes::Squares;

    fn slices(squares: &[f64]) -> Vec<(Nanos, Left)> {
        let left = |square: f64| Left { all: Squares { sum: square * 100.0, count: 100 }, ..Left::default() };
        (0..).map(|n| n * SLICE_NS).zip(squares.iter().map(|square| left(*square))).collect()
    }

    #[test]
    fn a_defect_begins_where_slices_become_worse_and_not_at_the_worst_of_them() {
        // Of a clock that is 9.65 ms early, px².
        let early = slices(&[0.0174, 0.0094, 0.0758, 0.2493, 0.0697, 0.3297, 0.0800, 0.3573, 1.0445]);
        assert_eq!(onset(&early), Some(2 * SLICE_NS));
        let noise = slices(&[0.0174, 0.0094, 0.0100, 0.0128, 0.0167, 0.0091, 0.0212, 0.0089, 0.0087]);
        assert_eq!(onset(&noise), None);
        let better = slices(&[0.1091, 0.1084, 0.0457, 0.0178, 0.0090, 0.0086, 0.0089, 0.0092, 0.0102]);
        assert_eq!(onset(&better), None, "what becomes better does not begin");
        assert_eq!(onset(&slices(&[0.01, 0.01])), None, "too short for a begin");
    }
}
