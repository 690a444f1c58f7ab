//! Streams that last as long as a session: a minute of motion, noise and faults, again and again. What the
//! tracker makes of a late minute can then be compared with what it made of an early one.

use super::score::{Score, Tracked, rms};
use super::{Recipe, Scenario, Stream};
use protocol::blobs::BlobField;
use rig::Rig;
use std::time::Duration;
use tracker::Tracker;
use tracker::assembler::FrameAssembler;

/// Length of what repeats, s.
const MINUTE_S: f64 = 60.0;
const MINUTE_NS: u64 = 60_000_000_000;
/// Largest ratio of the errors of a late minute to those of an early one.
const ERROR_RATIO: f64 = 1.1;
/// Largest loss of coverage between them.
const COVERAGE_LOSS: f64 = 0.001;

/// A tracker that runs on a stream, minute by minute.
pub struct Lasting {
    stream: Stream,
    assembler: FrameAssembler,
    tracker: Tracker,
    minute: u64,
}

/// What came of a minute.
pub struct Minute {
    /// From 1.
    pub number: u64,
    /// Errors and coverage.
    pub score: Score,
    /// Exposures of the reference camera, and frames made of them.
    pub exposures: usize,
    /// Frames.
    pub frames: usize,
    /// Filters and predictors that were not finite and were reset.
    pub restarts: u64,
    /// Processor time that the tracker took.
    pub took: Duration,
}

impl Minute {
    /// Root mean squares of tips and shown tips, µm.
    pub fn errors_um(&self) -> [f64; 2] {
        [rms(&self.score.tips_um), rms(&self.score.shown_um)]
    }

    /// What is wrong with the minute alone, and, beside an early one, what is worse.
    pub fn defects(&self, early: Option<&Minute>) -> Vec<String> {
        let mut found = Vec::new();
        if self.restarts > 0 {
            found.push(format!("{} filters or predictors were not finite", self.restarts));
        }
        if self.frames + 2 < self.exposures {
            found.push(format!("{} frames of {} exposures", self.frames, self.exposures));
        }
        let Some(early) = early else { return found };
        let errors = self.errors_um().into_iter().zip(early.errors_um()).zip(["tips", "shown tips"]);
        for ((late, before), what) in errors.filter(|((late, before), _)| *late > ERROR_RATIO * before) {
            found.push(format!("{what} of {late:.1} µm, {before:.1} in minute {}", early.number));
        }
        let lost = early.score.coverage() - self.score.coverage();
        if lost > COVERAGE_LOSS {
            found.push(format!("coverage fell by {lost:.4} since minute {}", early.number));
        }
        found
    }
}

impl Lasting {
    /// A fresh tracker of a scenario on a rig; everything random comes from `seed`.
    pub fn new(rig: &Rig, scenario: Scenario, seed: u64) -> Self {
        let recipe = Recipe { scenario, seed, seconds: MINUTE_S, knocks: vec![] };
        Lasting {
            stream: recipe.draw_periodic(rig),
            assembler: FrameAssembler::new(rig),
            tracker: Tracker::new(rig),
            minute: 0,
        }
    }

    /// Tracks the next minute.
    ///
    /// # Panics
    /// Where a frame is not valid: the process would withhold it.
    pub fn minute(&mut self) -> Minute {
        let Lasting { stream, assembler, tracker, minute } = self;
        let (offset_ns, restarts) = (*minute * MINUTE_NS, tracker.restarts());
        let begin = thread_cpu();
        let mut tracked = Tracked::default();
        for field in &stream.fields {
            let shifted = shifted(field, *minute, offset_ns);
            assembler.add(&shifted, shifted.blobs_out_ns, |used, closed| {
                let mut frame = tracker.track(used, &closed.reference);
                protocol::message::Message::validate(&frame).expect("a valid frame");
                // Scored as if it were the first minute; the first frame may belong to the one before.
                frame.instants.exposed = frame.instants.exposed.saturating_sub(offset_ns);
                tracked.push(frame, field.blobs_out_ns);
            });
        }
        let took = thread_cpu() - begin;
        *minute += 1;
        Minute {
            number: *minute,
            score: Score::of(&tracked, stream, 0.0, MINUTE_S),
            exposures: stream.reference_exposures(),
            frames: tracked.frames.len(),
            restarts: tracker.restarts() - restarts,
            took,
        }
    }
}

/// Processor time of this thread: unlike the clock, it does not depend on what else runs.
pub fn thread_cpu() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

fn shifted(field: &BlobField, minute: u64, offset_ns: u64) -> BlobField {
    let mut shifted = *field;
    shifted.field += minute * (MINUTE_NS / protocol::limits::FIELD_PERIOD_NS);
    for instant in [&mut shifted.exposed_ns, &mut shifted.read_out_ns, &mut shifted.blobs_out_ns] {
        *instant += offset_ns;
    }
    shifted
}
