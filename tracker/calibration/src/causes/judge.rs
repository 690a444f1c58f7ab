//! Which causes explain what is left in the pictures, and since when.

use super::measure::{Left, SLICE_NS, START_NS, measure, slices};
use super::remedy::{discrete, rescaled, undone};
use super::search::least;
use super::{Cause, places, progressive};
use protocol::blobs::BlobField;
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use protocol::time::Nanos;
use rig::Rig;
use serde::Serialize;

/// Length of the stretch that is judged, ns.
const STRETCH_NS: u64 = 3_000_000_000;
/// A rig that holds leaves less in the blobs that measured poses, px.
const HOLDS_PX: f64 = 0.2;
/// Share of the blobs that measure poses where a rig holds.
const HOLDS_SHARE: f64 = 0.85;
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
/// Shifts of time stamps that are tried first, ms.
const SHIFTS_MS: [f64; 9] = [-16.0, -10.0, -5.0, -2.0, 0.0, 2.0, 5.0, 10.0, 16.0];
/// Scales that are tried first.
const SCALES: [f64; 9] = [0.92, 0.95, 0.97, 0.985, 1.0, 1.015, 1.03, 1.05, 1.08];

/// A cause with its evidence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Explanation {
    /// The cause.
    #[serde(flatten)]
    pub cause: Cause,
    /// Root mean square of what is left in the pictures with its remedy, px.
    pub left_px: f64,
    /// Blobs by which it was judged.
    pub blobs: u64,
}

/// What the judge says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// There was too little to judge.
    TooLittle,
    /// The rig holds.
    NothingWrong,
    /// Something is wrong, and no cause of the catalogue explains it.
    Unknown,
    /// The causes named explain it, one as well as another.
    Explained,
}

/// What is wrong with a recording, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// In short.
    pub verdict: Verdict,
    /// Root mean square of what is left in the pictures, px; a blob that no marker explains counts as 2 px.
    pub left_px: f64,
    /// Blobs by which that was measured.
    pub blobs: u64,
    /// Exposure from which on something is wrong, s after the first field; 0 from the start.
    pub since_s: f64,
    /// The causes that explain it alike, those with the fewest parameters first.
    pub explanations: Vec<Explanation>,
    /// Causes that were tried.
    pub tried: usize,
}

impl Judgement {
    /// In a sentence.
    pub fn text(&self) -> String {
        let left = format!("{:.2} px are left of {} blobs", self.left_px, self.blobs);
        let since = format!("from {:.1} s on {left}", self.since_s);
        match self.verdict {
            Verdict::TooLittle => format!("too little to judge: {} blobs", self.blobs),
            Verdict::NothingWrong => format!("nothing is wrong: {left}"),
            Verdict::Unknown => format!("{since}; none of {} causes explains it", self.tried),
            Verdict::Explained => {
                let named =
                    self.explanations.iter().map(|e| format!("{} ({:.2} px then)", e.cause, e.left_px));
                format!("{since}: {}", named.collect::<Vec<_>>().join(", or "))
            }
        }
    }
}

/// Judges the fields of a recording, in the order of arrival. `progress` is called with the causes done and
/// those to be tried.
pub fn judge(rig: &Rig, fields: &[BlobField], mut progress: impl FnMut(usize, usize)) -> Judgement {
    let begin = fields.iter().map(|f| f.exposed_ns).min().unwrap_or(0);
    let onset = onset(&slices(rig, fields)).filter(|at| *at > begin + START_NS + SLICE_NS);
    // What progressive pictures leave depends on the motion, not on when they began.
    let always = progressive::detect(rig, &stretch(fields, begin)).is_some();
    let from = onset.filter(|_| !always).unwrap_or(begin);
    let stretch = stretch(fields, from);
    let before = measure(rig, &stretch);
    let mut judgement = Judgement {
        verdict: Verdict::TooLittle,
        left_px: before.all.rms().unwrap_or(0.0),
        blobs: before.all.count,
        since_s: from.saturating_sub(begin) as f64 * 1e-9,
        explanations: Vec::new(),
        tried: 0,
    };
    if before.all.count < 200 {
        return judgement;
    }
    if let Some(cause) = progressive::detect(rig, &stretch) {
        let left = measure(rig, &progressive::first_fields(&cause, &stretch));
        judgement.verdict = Verdict::Explained;
        judgement.explanations = vec![explanation((cause, left))];
        return judgement;
    }
    if before.mean() < LEAST.0 {
        judgement.verdict = Verdict::NothingWrong;
        return judgement;
    }
    let found = try_all(rig, &stretch, &mut progress, &mut judgement.tried);
    judgement.explanations = alike(&before, found);
    judgement.verdict = match (judgement.explanations.is_empty(), holds(&before)) {
        (false, _) => Verdict::Explained,
        (true, true) => Verdict::NothingWrong,
        (true, false) => Verdict::Unknown,
    };
    judgement
}

/// The fields that are judged, from an exposure on.
fn stretch(fields: &[BlobField], from: Nanos) -> Vec<BlobField> {
    let within = |f: &&BlobField| (from..from + STRETCH_NS).contains(&f.exposed_ns);
    fields.iter().filter(within).copied().collect()
}

/// Tries every remedy on a stretch, and counts them.
fn try_all(
    rig: &Rig,
    fields: &[BlobField],
    progress: &mut impl FnMut(usize, usize),
    tried: &mut usize,
) -> Vec<(Cause, Left)> {
    let mut trial = Trial { rig, fields, found: Vec::new() };
    let hypotheses = hypotheses(rig, fields);
    for (done, hypothesis) in hypotheses.iter().enumerate() {
        progress(done, hypotheses.len());
        trial.run(*hypothesis);
    }
    progress(hypotheses.len(), hypotheses.len());
    *tried = hypotheses.len();
    trial.found
}

/// True where what is left is noise.
fn holds(left: &Left) -> bool {
    let share = left.explained.count as f64 / left.all.count.max(1) as f64;
    share > HOLDS_SHARE && left.explained.rms().is_some_and(|px| px < HOLDS_PX)
}

/// The begin of the later slices where they are worse than those before: the split of all slices into two
/// parts with the largest difference between their means.
fn onset(slices: &[(Nanos, Left)]) -> Option<Nanos> {
    let mean = |part: &[(Nanos, Left)]| part.iter().map(|(_, l)| l.mean()).sum::<f64>() / part.len() as f64;
    let splits = (1..(slices.len() + 1).saturating_sub(LATER)).map(|at| {
        let (before, after) = slices.split_at(at);
        let [low, high] = [before, after].map(mean);
        let weight = (before.len() * after.len()) as f64;
        (weight * (high - low) * (high - low).abs(), at, low, high)
    });
    let (_, at, low, high) = splits.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (high > BEGUN.0 * low + BEGUN.1).then(|| slices[at].0)
}

/// Something to try.
#[derive(Debug, Clone, Copy)]
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

/// Remedies tried on a stretch.
struct Trial<'a> {
    rig: &'a Rig,
    fields: &'a [BlobField],
    found: Vec<(Cause, Left)>,
}

impl Trial<'_> {
    fn run(&mut self, hypothesis: Hypothesis) {
        let (rig, fields) = (self.rig, self.fields);
        let of = |cause: &Cause| measure(rig, &undone(cause, fields));
        let found = match hypothesis {
            Hypothesis::Discrete(cause) => Some((cause, of(&cause))),
            Hypothesis::Shift(camera) => {
                let cause = |late_ms| Cause::StampsShifted { camera, late_ms };
                let shift = least(&SHIFTS_MS, |late_ms| of(&cause(late_ms)).all.rms());
                shift.map(|(late_ms, _)| (cause(late_ms), of(&cause(late_ms))))
            }
            Hypothesis::Scale => {
                let cost = |factor| measure(&rescaled(rig, factor), fields);
                let scale = least(&SCALES, |factor| cost(factor).all.rms());
                scale.map(|(factor, _)| (Cause::Scale { factor }, cost(factor)))
            }
            Hypothesis::Camera(id) => {
                places::camera_moved(rig, fields, id).map(|(moved, cause)| (cause, measure(&moved, fields)))
            }
            Hypothesis::Marker(body, marker) => places::marker_moved(rig, fields, body, marker)
                .map(|(moved, cause)| (cause, measure(&moved, fields))),
        };
        self.found.extend(found);
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
