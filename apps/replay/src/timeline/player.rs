//! A recorded run that goes to any place of its recording, forwards and backwards.

use super::{Arrival, Moment, Target, Timeline};
use crate::engine::{Made, Recorded};
use crate::snapshot::Snapshot;
use anyhow::Context;
use protocol::events::Event;
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use recording::Recording;
use rig::Rig;
use simcore::world::World;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Steps from one copy to the next.
const COPY_EVERY: usize = 10;
/// Copies that are kept: six seconds of steps. One is a third of a megabyte, in large scenes two.
const COPIES: usize = 32;
/// Steps back that are made from a copy at most; ns.
const COPY_REACH_NS: u64 = 1_000_000_000;
/// How far before a step the run goes for the one before it, ns; four times as far where that is not enough.
const BACK_NS: u64 = 300_000_000;

/// A recorded run, and the timeline of its recording.
pub struct Player {
    timeline: Timeline,
    run: Recorded,
    begin: Snapshot,
    at: Option<Moment>,
    /// The step behind which the run stands, as far as it was done since the last leap.
    last: Option<Arc<LastStep>>,
    copies: VecDeque<(Moment, Copy)>,
    /// Steps since the last copy.
    since_copy: usize,
}

/// A step, with what is to be seen of it besides the world.
#[derive(Debug)]
pub struct LastStep {
    /// Its record, with the state and the advance that came of it now.
    pub record: StepRecord,
    /// The poses that this tracker makes of its frame, else the recorded ones.
    pub poses: TrackerFrame,
}

/// A copy of the run, and the step behind which it stands.
type Copy = (Snapshot, Option<Arc<LastStep>>);

impl Player {
    /// At the beginning of a recording, in a world at the start of its scene.
    ///
    /// # Errors
    /// Where the recording's rig is refused.
    pub fn new(timeline: Timeline, world: World) -> anyhow::Result<Self> {
        Self::begin(timeline, world, |run| run)
    }

    /// As [`Player::new`], with the recorded poses in the place of a tracker.
    ///
    /// # Errors
    /// As there.
    pub fn as_recorded(timeline: Timeline, world: World) -> anyhow::Result<Self> {
        Self::begin(timeline, world, Recorded::as_recorded)
    }

    fn begin(
        timeline: Timeline,
        world: World,
        how: impl FnOnce(Recorded) -> Recorded,
    ) -> anyhow::Result<Self> {
        let recording = timeline.recording();
        let rig = Rig::parse(&recording.provenance().rig_json, "of the recording")?;
        tracker::rig_check::check(&rig).context("the recording's rig is not usable")?;
        let run = how(Recorded::new(recording, &rig, world));
        let begin = run.snapshot();
        let copies = VecDeque::new();
        Ok(Player { timeline, run, begin, at: None, last: None, copies, since_copy: 0 })
    }

    /// The timeline.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        self.timeline.recording()
    }

    /// The run as it stands.
    pub fn run(&self) -> &Recorded {
        &self.run
    }

    /// The world as it stands.
    pub fn world(&self) -> &World {
        &self.run.steps.world
    }

    /// The step behind which the run stands; `None` before the first.
    pub fn at(&self) -> Option<Moment> {
        self.at
    }

    /// The step behind which the run stands; `None` before the first.
    pub fn last(&self) -> Option<&LastStep> {
        self.last.as_deref()
    }

    /// Plays on until `visit` has enough, or to the end; true where `visit` had enough.
    ///
    /// # Errors
    /// Those of `visit`.
    pub fn play(
        &mut self,
        mut visit: impl FnMut(Made<'_>) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<bool> {
        loop {
            let mut enough = false;
            let stopped = self.run.run(|made| {
                if let Made::Step(again) = &made {
                    self.at = Some(Moment::of(&again.recorded));
                    let poses = *again.made.as_deref().unwrap_or(&again.poses);
                    self.last = Some(Arc::new(LastStep { record: again.step, poses }));
                    self.since_copy += 1;
                }
                enough = visit(made)?.is_break();
                Ok(until(enough || self.since_copy >= COPY_EVERY))
            })?;
            if self.since_copy >= COPY_EVERY {
                self.keep_copy();
            }
            if enough || !stopped {
                return Ok(enough);
            }
        }
    }

    /// Does the next step; where the run stands then, `None` at its end.
    ///
    /// # Errors
    /// None of its own.
    pub fn step_forward(&mut self) -> anyhow::Result<Option<Moment>> {
        let stepped = self.play(|made| Ok(until(matches!(made, Made::Step(_)))))?;
        Ok(self.at.filter(|_| stepped))
    }

    /// Goes to a place, whence the run goes on as if it had been played there.
    ///
    /// # Errors
    /// Where the world is of another scene.
    pub fn seek(&mut self, target: Target) -> anyhow::Result<Arrival> {
        for number in self.timeline.before(target) {
            let Some((known, place)) = self.timeline.known(number) else { continue };
            if self.run.resume(&self.begin, &place, known)? {
                let at = Moment::of_state(self.world().state());
                // Else the place was passed while the run caught up with what was under way.
                if !target.is_reached(&at) {
                    (self.at, self.last) = (Some(at), None);
                    return self.run_to(target);
                }
            }
        }
        self.rewind()?;
        self.run_to(target)
    }

    /// Goes back before the first step.
    ///
    /// # Errors
    /// Where the world is of another scene.
    pub fn rewind(&mut self) -> anyhow::Result<()> {
        (self.at, self.last) = (None, None);
        Ok(self.run.restore(&self.begin)?)
    }

    /// Goes back behind the step before the one behind which the run stands; `None` where that was the first,
    /// and the run stands at its beginning.
    ///
    /// # Errors
    /// Where the world is of another scene.
    pub fn step_back(&mut self) -> anyhow::Result<Option<Moment>> {
        let Some(now) = self.at else { return Ok(None) };
        let mut back_ns = BACK_NS;
        loop {
            let start = match self.copy_before(&now) {
                Some((at, (copy, last))) => {
                    self.run.restore(&copy)?;
                    (self.at, self.last) = (Some(at), last);
                    Some(copy)
                }
                None => {
                    let target = now.exposed_ns.checked_sub(back_ns);
                    back_ns = back_ns.saturating_mul(4);
                    match target {
                        Some(target) => drop(self.seek(Target::Exposed(target))?),
                        None => self.rewind()?,
                    }
                    None
                }
            };
            let begin = start.unwrap_or_else(|| self.run.snapshot());
            let (from, last) = (self.at, self.last.clone());
            if from.is_some_and(|at| at.exposed_ns >= now.exposed_ns) {
                continue;
            }
            let mut steps = 0;
            while self.step_forward()?.is_some_and(|at| at.exposed_ns < now.exposed_ns) {
                steps += 1;
            }
            self.run.restore(&begin)?;
            (self.at, self.last) = (from, last);
            for _ in 0..steps {
                self.step_forward()?;
            }
            return Ok(self.at);
        }
    }

    /// Goes to the first step behind this one with an event; the first of its events, or `None` where there is
    /// none, and the run stays where it is.
    ///
    /// # Errors
    /// Where the world is of another scene.
    pub fn next_event(&mut self) -> anyhow::Result<Option<Event>> {
        let now = self.at.map_or(0, |at| at.exposed_ns + 1);
        let later = self.timeline.events().iter().filter(|event| event.exposed_ns >= now);
        let next = later.min_by_key(|event| event.exposed_ns).copied();
        self.go_to_event(next)
    }

    /// Goes to the last step before this one with an event; as [`Player::next_event`].
    ///
    /// # Errors
    /// Where the world is of another scene.
    pub fn previous_event(&mut self) -> anyhow::Result<Option<Event>> {
        let now = self.at.map_or(0, |at| at.exposed_ns);
        let earlier = self.timeline.events().iter().filter(|event| event.exposed_ns < now);
        let previous = earlier.rev().max_by_key(|event| event.exposed_ns).copied();
        self.go_to_event(previous)
    }

    fn go_to_event(&mut self, event: Option<Event>) -> anyhow::Result<Option<Event>> {
        if let Some(event) = &event {
            self.seek(Target::Exposed(event.exposed_ns))?;
        }
        Ok(event)
    }

    /// Runs to a place that lies ahead.
    fn run_to(&mut self, target: Target) -> anyhow::Result<Arrival> {
        let mut left_out = 0;
        let reached = self.play(|made| {
            let Made::Step(again) = made else { return Ok(ControlFlow::Continue(())) };
            left_out += again.left_out;
            Ok(until(target.is_reached(&Moment::of(&again.recorded))))
        })?;
        left_out += self.run.steps.left_out();
        let lost = self.run.steps.lost.clone();
        self.run.steps.begin_here();
        self.run.frames.due.begin_here();
        Ok(Arrival { at: self.at.filter(|_| reached), left_out, lost })
    }

    fn keep_copy(&mut self) {
        self.since_copy = 0;
        let Some(at) = self.at.filter(|at| self.copies.iter().all(|(of, _)| of != at)) else { return };
        if self.copies.len() == COPIES {
            self.copies.pop_front();
        }
        self.copies.push_back((at, (self.run.snapshot(), self.last.clone())));
    }

    /// The nearest copy before a step.
    fn copy_before(&self, now: &Moment) -> Option<(Moment, Copy)> {
        let reach = now.exposed_ns.saturating_sub(COPY_REACH_NS)..now.exposed_ns;
        let near = self.copies.iter().filter(|(at, _)| reach.contains(&at.exposed_ns));
        near.max_by_key(|(at, _)| at.exposed_ns).cloned()
    }
}

pub(super) fn until(enough: bool) -> ControlFlow<()> {
    if enough { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}
