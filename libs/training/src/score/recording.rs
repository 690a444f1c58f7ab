//! The score of a recording: its steps, each with the poses that it consumed and the events that it
//! raised, go through the same meter as in the live run.

use super::{Meter, Score, Scorer};
use crate::sample::Sample;
use crate::task::{Phase, TaskState};
use protocol::events::{Event, EventKind};
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use protocol::time::Nanos;
use scene::SceneFile;
use std::collections::{BTreeMap, VecDeque};

/// Poses kept until their step comes; simulation and tracker are never so far apart.
const KEPT_POSES: usize = 512;
/// Events of a step come this long after it at the latest, in steps.
const SETTLE_STEPS: usize = 64;

/// Takes a recording's poses, events and steps in order and scores the attempt in it.
#[derive(Debug)]
pub struct Reader {
    scorer: Scorer,
    meter: Meter,
    poses: VecDeque<Box<TrackerFrame>>,
    /// Steps whose events may still come.
    steps: VecDeque<Box<TrackerFrame>>,
    /// Events by the exposure of their step, in the order of their numbers.
    events: BTreeMap<Nanos, Vec<Event>>,
    last_step: u64,
    live: LiveScore,
    unmatched: u64,
}

/// The score that the live run published.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LiveScore {
    /// Points by category, as far as published.
    pub categories: [Option<f64>; super::table::CATEGORIES],
    /// Points of 100 and their deviation.
    pub total: Option<(f64, f64)>,
    /// Version of the score.
    pub version: u32,
}

impl LiveScore {
    /// Takes an event in.
    pub fn note(&mut self, event: &Event) {
        if event.kind == EventKind::ScoreCategory as u32 {
            if let Some(slot) = self.categories.get_mut(event.subject as usize) {
                *slot = Some(event.value);
            }
        } else if event.kind == EventKind::ScoreTotal as u32 {
            (self.total, self.version) = (Some((event.value, event.limit)), event.subject);
        }
    }
}

/// What a recording says of an attempt.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The score.
    pub score: Score,
    /// The attempt ended in the recording; else this is its score so far.
    pub ended: bool,
    /// What the live run published.
    pub live: LiveScore,
    /// Steps whose poses are not in the recording: the score misses them.
    pub unmatched: u64,
}

impl Verdict {
    /// Whether the live run published the same score, to the bit; `None` if it published none, or
    /// one of another version.
    pub fn agrees(&self) -> Option<bool> {
        let (total, sigma) = self.live.total.filter(|_| self.live.version == self.score.version)?;
        let same = |a: f64, b: f64| a.to_bits() == b.to_bits();
        let categories = self.live.categories.iter().zip(&self.score.categories);
        let categories = categories.filter_map(|(live, own)| live.map(|l| same(l, *own))).all(|ok| ok);
        Some(categories && same(total, self.score.total) && same(sigma, self.score.sigma))
    }
}

impl Reader {
    /// For recordings of a scene, if it has a task.
    pub fn new(scene: &SceneFile) -> Option<Self> {
        let scorer = Scorer::of(scene)?;
        Some(Reader {
            meter: scorer.start(),
            scorer,
            poses: VecDeque::with_capacity(KEPT_POSES),
            steps: VecDeque::new(),
            events: BTreeMap::new(),
            last_step: 0,
            live: LiveScore::default(),
            unmatched: 0,
        })
    }

    /// Topics that the score needs; the rest can be passed over.
    pub const TOPICS: [&'static str; 3] = ["poses", "steps", "events"];

    /// Takes poses in.
    pub fn take_poses(&mut self, frame: Box<TrackerFrame>) {
        if self.poses.len() == KEPT_POSES {
            self.poses.pop_front();
        }
        self.poses.push_back(frame);
    }

    /// Takes an event in.
    pub fn take_event(&mut self, event: Event) {
        self.live.note(&event);
        self.events.entry(event.exposed_ns).or_default().push(event);
    }

    /// Takes a step in. A simulation that was restarted repeats what it had done: that is passed
    /// over.
    pub fn take_step(&mut self, step: &StepRecord) {
        if step.step <= self.last_step {
            return;
        }
        self.last_step = step.step;
        let of_step = |p: &TrackerFrame| p.field == step.field && p.frame == step.frame;
        match self.poses.iter().rposition(|p| of_step(p)).and_then(|at| self.poses.remove(at)) {
            Some(frame) => self.steps.push_back(frame),
            None => self.unmatched += 1,
        }
        if self.steps.len() > SETTLE_STEPS {
            self.settle();
        }
    }

    /// Scores the oldest step that waits for its events.
    fn settle(&mut self) {
        let Some(frame) = self.steps.pop_front() else { return };
        let mut events = self.events.remove(&frame.instants.exposed).unwrap_or_default();
        events.sort_by_key(|e| e.seq);
        events.dedup_by_key(|e| e.seq);
        self.scorer.note(&mut self.meter, &Sample::new(&frame, &events));
        self.events = self.events.split_off(&frame.instants.exposed);
    }

    /// The end of the recording.
    pub fn finish(mut self) -> Verdict {
        while !self.steps.is_empty() {
            self.settle();
        }
        Verdict {
            score: self.scorer.score(&self.meter),
            ended: self.meter.has_ended(),
            live: self.live,
            unmatched: self.unmatched,
        }
    }
}

/// True for an attempt that has ended: the moment at which the live score is published.
pub fn is_over(state: &TaskState) -> bool {
    matches!(state.phase, Phase::Finished | Phase::TimedOut)
}
