//! Which causes explain what is left in the pictures, and since when.

use super::beside::{self, hides_an_error};
use super::judgement::{Explanation, Judgement, Verdict};
use super::measure::{CAP_PX, Left, SLICE_NS, START_NS, measure};
use super::together::{FOLLOWS, Together};
use super::trial::{hypotheses, try_all};
use super::work::Work;
use super::{Cause, jitter, later, lenses, progressive, rest, together, verified};
use protocol::blobs::BlobField;
use protocol::time::Nanos;
use rig::Rig;
use std::mem::discriminant;

/// Length of the stretch that is judged, ns.
const STRETCH_NS: u64 = 3_000_000_000;
/// Share of the blobs that measure poses where a rig holds, and what they leave at most, px.
const HOLDS: (f64, f64) = (0.85, 0.2);
/// The same where no remedy makes the share larger, with false blobs in every field and an instrument out of the eye. A few
/// of these are taken for a marker's for some fields, so that more is left.
pub const FOLLOWED: (f64, f64) = (0.6, 0.25);
/// A remedy explains as much as the best where it takes away this share of what the best does.
pub const ALIKE: f64 = 0.93;
/// Least of the mean square that a remedy takes away, px², and share of it: less is no explanation.
const LEAST: (f64, f64) = (0.01, 0.25);
/// A defect has begun where the mean square is this many times that of before, and that more, px².
const BEGUN: (f64, f64) = (1.8, 0.006);
/// Variance of the logarithms of the mean squares where nothing changes.
const SCATTER: f64 = 0.05;
/// Fewest blobs that are judged.
pub(super) const FEWEST: u64 = 200;
/// A later stretch may have so much larger a share of blobs that measure no pose.
const LIKE: f64 = 0.1;
/// A clock whose shift is larger by this after an instant has stepped there, ms.
const STEP_MS: f64 = 0.3;
/// Slices after the begin of a defect, at least: fewer are too little to judge.
const LATER: usize = 3;
/// Mean square that a rig which holds may leave, px²: markers that hide each other.
const FLOOR_PX2: f64 = 0.02;
/// What lies above the noise at least where places change while a recording goes on, px: a marker that moves by 0.05 mm
/// leaves 0.08, a camera that moves by 0.6 px 0.17.
const PASSING_PX: f64 = 0.05;
/// Share of the blobs, at most, that are no marker's and count as nothing wrong.
const STRANGERS: f64 = 0.05;
/// Share of what is above that which a remedy must take away.
const MOST: f64 = 0.75;

/// Judges the fields of a recording, in the order of arrival, with all processors. `go_on` gets how many
/// causes were tried, of how many; where it says no, the search is stopped.
pub fn judge(rig: &Rig, fields: &[BlobField], go_on: impl Fn(usize, usize) -> bool + Sync) -> Judgement {
    judge_within(rig, fields, &Work::FULL, go_on)
}

/// The same with bounded work. The bounds count fields and steps, no time: one recording always gets one judgement.
pub fn judge_within(
    rig: &Rig,
    fields: &[BlobField],
    work: &Work,
    go_on: impl Fn(usize, usize) -> bool + Sync,
) -> Judgement {
    let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0);
    let onset = onset(&work.slices(rig, fields)).filter(|at| *at > begin + START_NS + SLICE_NS);
    // What progressive pictures leave depends on the motion, not on when they began.
    let always = progressive::detect(rig, &stretch(fields, begin)).is_some();
    let from = onset.filter(|_| !always).unwrap_or(begin);
    let mut first = judge_from(rig, fields, [begin, from], work, &go_on);
    let holds = first.verdict == Verdict::NothingWrong;
    if from > begin && !holds && is_no_fault(rig, &stretch(fields, from), &first) {
        let before: Vec<BlobField> = fields.iter().filter(|f| f.exposed_ns < from).copied().collect();
        let held = judge_from(rig, &before, [begin, begin], work, &go_on);
        first = if held.verdict == Verdict::NothingWrong { held } else { first };
    }
    if first.verdict != Verdict::NothingWrong {
        // A clock shows only while something moves: it may be wrong for longer than that.
        let earliest = begin.max(from.saturating_sub(STRETCH_NS));
        return match from > begin {
            true => dated(rig, fields, first, [begin, earliest, from]),
            false => past_a_step(rig, fields, first, begin, work, &go_on),
        };
    }
    judge_later(rig, fields, ([begin, from], &first), work, &go_on).unwrap_or(first)
}

/// The judgement of the first stretch, or of what follows a step within it: a clock's shift that is estimated from both
/// is too small, or explains neither.
fn past_a_step(
    rig: &Rig,
    fields: &[BlobField],
    first: Judgement,
    begin: Nanos,
    work: &Work,
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) -> Judgement {
    let shift = |judgement: &Judgement| match cause_alone(judgement) {
        Some(&Cause::ClockShifted { camera, by_ms }) => Some((camera, by_ms.abs())),
        _ => None,
    };
    let before = shift(&first);
    if before.is_none() && first.verdict != Verdict::Unknown {
        return first;
    }
    let part = stretch(fields, begin);
    let end = |fields: &[BlobField]| fields.iter().map(|f| f.exposed_ns).max().unwrap_or(begin);
    let step =
        cause_alone(&first).and_then(|cause| later::since(rig, fields, cause, &part, [begin, end(&part)]));
    let past = (begin + STRETCH_NS).min(end(fields).saturating_sub(STRETCH_NS / 2));
    let larger = |from: Nanos| {
        let next = judge_from(rig, fields, [begin, from], work, go_on);
        let (camera, by_ms) = shift(&next)?;
        let is_larger = before.is_none_or(|(other, less_ms)| camera == other && by_ms > less_ms + STEP_MS);
        is_larger.then(|| dated(rig, fields, next, [begin, begin, from]))
    };
    let tried = [Some(past), step].into_iter().flatten().filter(|from| *from > begin);
    tried.into_iter().find_map(larger).unwrap_or(first)
}

/// True where a rig that held before holds after this judgement of a later part, too. The blobs that are left belong to a
/// body that is put away, or that too few cameras see; or places seem to have changed by so little that markers which
/// touch or hide each other from then on, or cameras that are silent, have the same effect.
fn is_no_fault(rig: &Rig, part: &[BlobField], judgement: &Judgement) -> bool {
    use Cause::{CameraMoved, CamerasMoved, Drifted, MarkerMoved};
    let is_of_places = |by: &Explanation| {
        matches!(by.cause, CameraMoved { .. } | CamerasMoved { .. } | MarkerMoved { .. } | Drifted)
    };
    match judgement.verdict {
        Verdict::Unknown | Verdict::Stopped => measure(rig, part).is_less((FOLLOWED.0, HOLDS.1)),
        Verdict::Explained => {
            judgement.above_px < PASSING_PX && judgement.explanations.iter().all(is_of_places)
        }
        Verdict::NothingWrong | Verdict::TooLittle => true,
    }
}

/// What is wrong with the parts of fields of which the stretch at `from` is as it should be; `None` where nothing is.
fn judge_later(
    rig: &Rig,
    fields: &[BlobField],
    ([begin, from], first): ([Nanos; 2], &Judgement),
    work: &Work,
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) -> Option<Judgement> {
    let wrong = |from: Nanos| {
        let part = stretch(fields, from);
        if is_like(rig, &part, first) {
            return None;
        }
        let judgement = judge_from(rig, fields, [begin, from], work, go_on);
        (!is_no_fault(rig, &part, &judgement)).then_some((from, judgement))
    };
    let at_begin = (from > begin).then_some(begin);
    let begins: Vec<Nanos> = at_begin.into_iter().chain(later::begins(fields, STRETCH_NS, work)).collect();
    let (at, (from, found)) = begins.iter().enumerate().find_map(|(i, from)| Some((i, wrong(*from)?)))?;
    let right = if at == 0 { begin } else { begins[at - 1] };
    let kind = |judgement: &Judgement| cause_alone(judgement).map(discriminant);
    let is_same = |other: &Judgement| kind(&found).is_some() && kind(&found) == kind(other);
    // It may begin within that stretch. The next one, or the end of the last, says better how large it is.
    let next = begins.get(at + 1).copied().unwrap_or(from + STRETCH_NS / 2);
    let whole = judge_from(rig, fields, [begin, next], work, go_on);
    let (from, judgement) = if is_same(&whole) { (next, whole) } else { (from, found) };
    Some(dated(rig, fields, judgement, [begin, right, from]))
}

/// The only cause that is named.
fn cause_alone(judgement: &Judgement) -> Option<&Cause> {
    match &judgement.explanations[..] {
        [only] => Some(&only.cause),
        _ => None,
    }
}

/// The judgement of the stretch at `from` with the begin of its cause, which is after `right`.
fn dated(
    rig: &Rig,
    fields: &[BlobField],
    judgement: Judgement,
    [begin, right, from]: [Nanos; 3],
) -> Judgement {
    let part = stretch(fields, from);
    let cause = cause_alone(&judgement).zip(part.iter().map(|f| f.exposed_ns).max());
    let since = cause.and_then(|(cause, end)| later::since(rig, fields, cause, &part, [right, end]));
    Judgement { since_s: (since.unwrap_or(from) - begin) as f64 * 1e-9, ..judgement }
}

/// True for a stretch that leaves noise, as the first one did.
fn is_like(rig: &Rig, part: &[BlobField], first: &Judgement) -> bool {
    let left = measure(rig, part);
    let share = (1.0 - first.unexplained - LIKE).min(HOLDS.0);
    left.all.count < FEWEST
        || left.is_less((share, HOLDS.1))
            && together::estimate(rig, part).is_ok_and(|t| t.above.is_noise())
            && !hides_an_error(rig, part)
}

/// Judges the stretch from an exposure on; `begin` is that of the first field.
fn judge_from(
    rig: &Rig,
    fields: &[BlobField],
    [begin, from]: [Nanos; 2],
    work: &Work,
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) -> Judgement {
    let stretch = stretch(fields, from);
    let before = measure(rig, &stretch);
    let mut judgement = beginning(&before, from.saturating_sub(begin));
    if before.all.count < FEWEST {
        return judgement;
    }
    if let Some(cause) = progressive::detect(rig, &stretch) {
        let left = measure(rig, &progressive::first_fields(&cause, &stretch));
        return explained(judgement, explanation((cause, left)));
    }
    if let Some(by) = jitter::detect(rig, &stretch, &before) {
        // Of the markers' blobs, before and after: what the jitter adds is little beside a few blobs that are no marker's.
        let by = of_markers(by);
        judgement.left_px = judgement.used_px;
        judgement.above_px = (judgement.used_px.powi(2) - by.left_px.powi(2)).max(0.0).sqrt();
        return explained(judgement, by);
    }
    if !go_on(0, 0) {
        judgement.verdict = Verdict::Stopped;
        judgement.holds = false;
        return judgement;
    }
    // Small errors: everything at once, without tracking again for each.
    let together = estimated(rig, fields, &stretch, from);
    let followed = together.as_ref().map_or(0.0, |found| found.followed(rig, &stretch));
    if let Some(by) = together.as_ref().and_then(|found| beside_places(rig, &stretch, found, followed)) {
        judgement.tried = rig.cameras.len() + together.map_or(0, |found| found.tried);
        return explained(judgement, by);
    }
    if let Some(found) = together.as_ref().filter(|_| followed > FOLLOWS.0) {
        take(found, &mut judgement);
        if found.leaves_more() {
            judgement.explanations = rest::complete(rig, &stretch, judgement.explanations);
        }
        return judgement;
    }
    search(rig, &stretch, (&before, together, followed), work, &mut judgement, go_on);
    judgement
}

/// What explains a stretch and is no small change of places, or none of places at all: what is estimated together takes up
/// much of it. `followed`: share of the blobs that measure poses with that mended.
fn beside_places(rig: &Rig, stretch: &[BlobField], found: &Together, followed: f64) -> Option<Explanation> {
    if found.above.is_noise() {
        return None;
    }
    let mends = followed > FOLLOWED.0;
    let two_cameras = || verified::two_cameras(rig, stretch, found).map(of_markers);
    let scale = || verified::scale(rig, stretch).map(of_markers);
    (if mends { None } else { two_cameras() })
        .or_else(|| lenses::explain(rig, stretch, found, mends))
        .or_else(|| if found.names_no_part() { scale() } else { None })
}

/// What is estimated together from a stretch.
fn estimated(rig: &Rig, fields: &[BlobField], stretch: &[BlobField], from: Nanos) -> Option<Together> {
    together::estimate(rig, stretch).ok().or_else(|| {
        // A tracker that tries one camera after the other follows too little of the first second; what is found later
        // says as much, if it mends this stretch too.
        let later = together::estimate(rig, &self::stretch(fields, from + STRETCH_NS)).ok();
        later.filter(|found| found.mends(rig, stretch))
    })
}

/// A judgement before anything was looked into.
fn beginning(before: &Left, since_ns: u64) -> Judgement {
    Judgement {
        verdict: Verdict::TooLittle,
        left_px: before.all.rms().unwrap_or(0.0),
        used_px: before.explained.rms().unwrap_or(0.0),
        blobs: before.all.count,
        since_s: since_ns as f64 * 1e-9,
        holds: holds(before),
        above_px: before.all.rms().unwrap_or(0.0),
        unexplained: 1.0 - before.explained_share(),
        explanations: Vec::new(),
        tried: 0,
    }
}

/// A judgement that names one cause.
fn explained(judgement: Judgement, by: Explanation) -> Judgement {
    Judgement { verdict: Verdict::Explained, holds: false, explanations: vec![by], ..judgement }
}

/// Judges by what was estimated together.
fn take(found: &Together, judgement: &mut Judgement) {
    judgement.tried = found.tried;
    judgement.above_px = found.above.px;
    judgement.holds = found.is_noise();
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
    (before, together, followed): (&Left, Option<Together>, f64),
    work: &Work,
    judgement: &mut Judgement,
    go_on: &(impl Fn(usize, usize) -> bool + Sync),
) {
    let hypotheses = hypotheses(rig, stretch);
    let fields = work.stretch(stretch, &hypotheses);
    let before = if fields.len() < stretch.len() { &measure(rig, fields) } else { before };
    let found = try_all(rig, fields, &hypotheses, go_on);
    let was_stopped = found.is_none();
    judgement.tried += if was_stopped { 0 } else { hypotheses.len() };
    let found = found.unwrap_or_default();
    let is_followed = || {
        let leaves_little = before.is_less((0.0, FOLLOWED.1));
        leaves_little && beside::is_followed(rig, fields, before.is_less(FOLLOWED))
    };
    let noise = together.as_ref().filter(|t| t.is_noise() && is_followed());
    // No one cause makes a rig hold where reflections are many: what they leave out is judged by the rest.
    let rest = together.as_ref().filter(|t| !was_stopped && !t.is_noise() && followed > FOLLOWED.0);
    let mut singles = alike(before, found.clone());
    if singles.is_empty() && noise.is_none() && rest.is_none_or(Together::names_no_part) {
        singles = in_order(verified::singles(rig, fields, before, found), of_markers);
    }
    judgement.explanations = rest::complete(rig, fields, singles);
    if let Some(found) = rest.filter(|_| judgement.explanations.is_empty()) {
        let tried = judgement.tried;
        take(found, judgement);
        judgement.tried += tried;
        return;
    }
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

/// True where what is left is noise.
fn holds(left: &Left) -> bool {
    left.is_less(HOLDS)
}

/// The begin of the later slices where they are worse than those before: the split of all slices into two
/// parts that are most likely of two normal distributions of their logarithms. What a defect leaves follows the motion
/// and varies tenfold from slice to slice: neither the worst slice is its begin, nor where the means differ most.
fn onset(slices: &[(Nanos, Left)]) -> Option<Nanos> {
    let logarithms: Vec<f64> = slices.iter().map(|(_, left)| (left.mean() + BEGUN.1).ln()).collect();
    let splits = (1..(slices.len() + 1).saturating_sub(LATER)).filter_map(|at| {
        let [(low, before), (high, after)] = [&logarithms[..at], &logarithms[at..]].map(unlikelihood);
        (high > low).then_some((before + after, at))
    });
    let (_, at) = splits.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let mean = |part: &[(Nanos, Left)]| part.iter().map(|(_, l)| l.mean()).sum::<f64>() / part.len() as f64;
    let (low, high) = (mean(&slices[..at]), mean(&slices[at..]));
    (high > BEGUN.0 * low + BEGUN.1).then(|| slices[at].0)
}

/// Mean of some numbers, and twice the negative logarithm of their likelihood under the normal distribution that fits
/// them best, less what is the same for all.
fn unlikelihood(numbers: &[f64]) -> (f64, f64) {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    let variance = numbers.iter().map(|n| (n - mean) * (n - mean)).sum::<f64>() / count;
    (mean, count * (variance + SCATTER).ln())
}

/// The causes whose remedies make the rig hold, or take away about as much as the best of those.
fn alike(before: &Left, found: Vec<(Cause, Left)>) -> Vec<Explanation> {
    let taken = |left: &Left| before.mean() - left.mean();
    let right = || found.iter().map(|(_, left)| left).filter(|left| holds(left));
    let Some(most) = right().max_by(|a, b| taken(a).total_cmp(&taken(b))) else { return Vec::new() };
    let best = taken(most);
    // A few blobs are no marker's, whatever is mended.
    let strangers = (1.0 - most.explained_share()).min(STRANGERS);
    let floor = FLOOR_PX2 + strangers * CAP_PX * CAP_PX;
    let least = LEAST.0.max(LEAST.1 * before.mean()).max(MOST * (before.mean() - floor));
    if best < least {
        return Vec::new();
    }
    let named = found.into_iter().filter(|(_, left)| holds(left) && taken(left) >= ALIKE * best);
    in_order(named.collect(), explanation)
}

/// Those with the fewest parameters first.
fn in_order(
    mut named: Vec<(Cause, Left)>,
    explanation: impl Fn((Cause, Left)) -> Explanation,
) -> Vec<Explanation> {
    named.sort_by(|a, b| {
        a.0.parameters().cmp(&b.0.parameters()).then_with(|| a.1.mean().total_cmp(&b.1.mean()))
    });
    named.into_iter().map(explanation).collect()
}

fn explanation((cause, left): (Cause, Left)) -> Explanation {
    Explanation { cause, left_px: left.all.rms().unwrap_or(0.0), blobs: left.all.count }
}

/// The same by the blobs that measured poses, where many others belong to no marker.
fn of_markers((cause, left): (Cause, Left)) -> Explanation {
    let used = left.explained;
    Explanation { cause, left_px: used.rms().unwrap_or(0.0), blobs: used.count }
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
        // Of one that is 9.75 ms early: its means differ most at the sixth.
        let slow = slices(&[0.0093, 0.0095, 0.0793, 0.1413, 0.0346, 0.3415, 0.2231, 0.2087, 0.8786]);
        assert_eq!(onset(&slow), Some(2 * SLICE_NS));
        let noise = slices(&[0.0174, 0.0094, 0.0100, 0.0128, 0.0167, 0.0091, 0.0212, 0.0089, 0.0087]);
        assert_eq!(onset(&noise), None);
        let better = slices(&[0.1091, 0.1084, 0.0457, 0.0178, 0.0090, 0.0086, 0.0089, 0.0092, 0.0102]);
        assert_eq!(onset(&better), None, "what becomes better does not begin");
        assert_eq!(onset(&slices(&[0.01, 0.01])), None, "too short for a begin");
    }
}
