//! Going on where a predecessor stood: its newest checkpoint, and the recorded inputs since,
//! stepped again in the recorded order. Pure: the entries come from the caller.

use crate::checkpoint::{CheckpointError, inputs_digest};
use crate::world::{StepReport, World, no_clock};
use protocol::handles::{HandleState, PedalState};
use protocol::journal::Entry;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, Numbered, StepInput, StepRecord, last_consumed};
use protocol::time::Nanos;
use std::collections::VecDeque;

/// Inputs of a kind that are kept for steps to come: poses of five minutes.
const ROOM: usize = 16_384;

/// What a recording knows since its newest checkpoint.
#[derive(Debug, Clone, Default)]
pub struct InputHistory {
    checkpoint: Option<(CheckpointHeader, Vec<u8>)>,
    steps: VecDeque<StepRecord>,
    poses: VecDeque<Box<TrackerFrame>>,
    handles: VecDeque<HandleState>,
    pedals: VecDeque<PedalState>,
    /// The newest step was done without its record.
    guessed: bool,
    /// The state is not the recorded one: only a checkpoint leads on.
    astray: bool,
}

/// A recorded step that was done again.
#[derive(Debug, Clone)]
pub struct Repeated {
    /// The recorded poses that it consumed.
    pub poses: Box<TrackerFrame>,
    /// What was recorded of it.
    pub recorded: StepRecord,
    /// What came of it.
    pub report: StepReport,
    /// Steps before it had no record, and were done with what had come by their poses: that this one's
    /// state is the recorded one proves them right.
    pub guessed: bool,
}

/// How far the past led.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ResumeOutcome {
    /// Steps that were computed again.
    pub steps: u64,
    /// Recorded steps that could not be, because inputs are missing.
    pub missing: u64,
    /// True if the state is the recorded one, to the bit.
    pub agrees: bool,
}

impl InputHistory {
    /// Takes the next entry.
    pub fn note(&mut self, entry: Entry) {
        match entry {
            Entry::Checkpoint(header, bytes) => {
                self.trim(&header);
                self.checkpoint = Some((header, bytes));
            }
            Entry::Step(step) => self.steps.push_back(step),
            Entry::Poses(frame) => keep(&mut self.poses, frame),
            Entry::Handle(handle) => keep(&mut self.handles, handle),
            Entry::Pedal(pedal) => keep(&mut self.pedals, pedal),
        }
    }

    /// Drops what the checkpoint's state has consumed; returns whether the last handle and the last pedal
    /// state of that were there. Numbers may begin again within a recording, so the last match counts. What
    /// was recorded a little early or late stays.
    fn trim(&mut self, header: &CheckpointHeader) -> [bool; 2] {
        let same = |s: &StepRecord| s.step == header.step && s.state_hash == header.state_hash;
        let step = self.steps.iter().rposition(same);
        let exposed = step.map(|at| self.steps[at].instants.exposed);
        let is_its =
            |p: &TrackerFrame| exposed.map_or(p.field == header.field, |at| p.instants.exposed == at);
        let pose = self.poses.iter().rposition(|p| is_its(p));
        self.poses.drain(..pose.map_or(0, |at| at + 1));
        match step {
            Some(at) => drop(self.steps.drain(..=at)),
            // Its own record comes behind it, or never.
            None => self.steps.retain(|s| s.step > header.step),
        }
        let handle = self.handles.iter().rposition(|h| h.seq.wrapping_add(1) == header.handles_below);
        self.handles.drain(..handle.map_or(0, |at| at + 1));
        let pedal = self.pedals.iter().rposition(|p| p.seq.wrapping_add(1) == header.pedals_below);
        self.pedals.drain(..pedal.map_or(0, |at| at + 1));
        [handle.is_some(), pedal.is_some()]
    }

    /// Restores the checkpoint (or takes `world` as it is, at its start) and repeats the steps
    /// since.
    ///
    /// # Errors
    /// [`CheckpointError`] for a checkpoint that is damaged or belongs to another scene.
    pub fn replay(&mut self, world: &mut World) -> Result<ResumeOutcome, CheckpointError> {
        let mut agrees = true;
        if let Some((header, bytes)) = &self.checkpoint {
            let used = bytes.get(..header.bytes as usize).unwrap_or(bytes);
            world.restore(used)?;
            agrees = world.state_hash() == header.state_hash;
        }
        let mut steps = 0;
        while let Some(Repeated { recorded, report, .. }) = self.advance(world) {
            agrees = report.state_hash == recorded.state_hash;
            steps += 1;
        }
        Ok(ResumeOutcome { steps, missing: self.steps.len() as u64, agrees })
    }

    /// Handle and pedal states that no step has consumed yet, and the number of poses; all in the
    /// order in which they came.
    pub fn unconsumed(self) -> (Vec<HandleState>, Vec<PedalState>, u64) {
        (self.handles.into(), self.pedals.into(), self.poses.len() as u64)
    }

    /// Does the oldest recorded step that is waiting, from where `world` stands; `None` while an input
    /// is missing. A record that starts again at the first step resets the world.
    pub fn advance(&mut self, world: &mut World) -> Option<Repeated> {
        while !self.astray {
            let step = *self.steps.front()?;
            let done = world.state().step;
            let began_anew = step.step == 1 && (done > 1 || step.state_hash != world.state_hash());
            if began_anew && done > 0 {
                world.reset();
                self.guessed = false;
            } else if step.step <= done {
                // A restarted simulation sends its last steps again.
                self.steps.pop_front();
                continue;
            }
            if self.make_step_without_record(world, &step) {
                continue;
            }
            let (poses, report) = self.repeat_step(world, &step)?;
            self.steps.pop_front();
            let guessed = std::mem::take(&mut self.guessed);
            return Some(Repeated { poses, recorded: step, report, guessed });
        }
        None
    }

    /// Notes that the newest state is not the recorded one: only a checkpoint can continue.
    pub fn go_astray(&mut self) {
        self.astray = true;
    }

    /// Makes the step after `world`'s where `next`, which is to follow later, is the oldest one with a
    /// record, though the poses of all before it are there. It consumes what was sent before its poses.
    fn make_step_without_record(&mut self, world: &mut World, next: &StepRecord) -> bool {
        let state = world.state();
        let without_record = next.step.saturating_sub(state.step + 1);
        // Where no clock said when something was sent, nothing is known.
        let by_ns = self.poses.front().map_or(0, |frame| frame.instants.tracked);
        if without_record == 0 || state.step == 0 || by_ns == 0 {
            return false;
        }
        let pose = self.poses.get(without_record as usize);
        if !pose.is_some_and(|p| is_frame_of(p, next)) || self.missing_input(world, next).is_some() {
            return false;
        }
        let Some(frame) = self.poses.pop_front() else { return false };
        let handles = sent_by(&mut self.handles, by_ns);
        let pedals = sent_by(&mut self.pedals, by_ns);
        world.step(&StepInput { frame: &frame, handles: &handles, pedals: &pedals }, &mut no_clock);
        self.guessed = true;
        true
    }

    /// Gives up the steps that are waiting and goes on where a later checkpoint stood; how many of
    /// them were given up. For a record with gaps.
    ///
    /// # Errors
    /// [`CheckpointError`] for a checkpoint that is damaged or belongs to another scene.
    pub fn jump(
        &mut self,
        world: &mut World,
        header: &CheckpointHeader,
        bytes: &[u8],
    ) -> Result<u64, CheckpointError> {
        world.restore(bytes.get(..header.bytes as usize).unwrap_or(bytes))?;
        (self.astray, self.guessed) = (false, false);
        let waiting = self.steps.len();
        let [handle_found, pedal_found] = self.trim(header);
        // The step of the checkpoint, or its inputs, may be among what is missing.
        let next = self.steps.iter().position(|s| s.step > header.step).unwrap_or(self.steps.len());
        self.steps.drain(..next);
        // Behind what was consumed a sender that was started again may count from 0.
        self.handles.retain(|h| handle_found || h.seq >= header.handles_below);
        self.pedals.retain(|p| pedal_found || p.seq >= header.pedals_below);
        Ok((waiting - self.steps.len()) as u64)
    }

    /// The oldest recorded step that is waiting.
    pub fn waiting(&self) -> Option<&StepRecord> {
        self.steps.front()
    }

    /// Gives up the steps that are waiting; how many.
    pub fn give_up(&mut self) -> u64 {
        (self.astray, self.guessed) = (false, false);
        self.steps.drain(..).len() as u64
    }

    /// What the oldest step that is waiting lacks, in words; `None` where it lacks nothing.
    pub fn lacking(&self, world: &World) -> Option<String> {
        let (step, state) = (self.steps.front()?, world.state());
        if step.step != state.step + 1 {
            return Some(format!("step {} follows {} (field {})", step.step, state.step, step.field));
        }
        if !self.poses.iter().any(|p| is_frame_of(p, step)) {
            return Some(format!("the poses of step {} (field {}) are missing", step.step, step.field));
        }
        if let Some((name, number)) = self.missing_input(world, step) {
            return Some(format!("{name} state {number} is missing (field {})", step.field));
        }
        let other = || format!("step {} (field {}) consumed other inputs than these", step.step, step.field);
        self.find_inputs(world, step).is_none().then(other)
    }

    /// Kind and number of the first input that a step needs, from where `world` stands, and that is not
    /// there.
    fn missing_input(&self, world: &World, step: &StepRecord) -> Option<(&'static str, u64)> {
        let (state, stepped_ns) = (world.state(), step.instants.stepped);
        let handle = first_missing(&self.handles, [state.handles_below, step.handles_below], stepped_ns);
        let pedal = || first_missing(&self.pedals, [state.pedals_below, step.pedals_below], stepped_ns);
        handle.map(|number| ("handle", number)).or_else(|| pedal().map(|number| ("pedal", number)))
    }

    /// Recorded steps that are waiting.
    pub fn waiting_steps(&self) -> usize {
        self.steps.len()
    }

    /// Gives up the oldest step that is waiting, and what it consumed.
    pub fn give_up_oldest(&mut self) {
        let Some(step) = self.steps.pop_front() else { return };
        let older = |p: &TrackerFrame| p.instants.exposed <= step.instants.exposed;
        let poses = self.poses.iter().take_while(|p| older(p)).count();
        self.poses.drain(..poses);
        sent_by(&mut self.handles, step.instants.exposed);
        sent_by(&mut self.pedals, step.instants.exposed);
    }

    /// One recorded step: its pose and what came of it; `None` where an input is missing.
    fn repeat_step(
        &mut self,
        world: &mut World,
        step: &StepRecord,
    ) -> Option<(Box<TrackerFrame>, StepReport)> {
        let state = world.state();
        if step.step != state.step + 1 {
            return None;
        }
        // Nothing is taken before all is there.
        let Found { pose, ends: [handles_end, pedals_end], handles, pedals } =
            self.missing_input(world, step).is_none().then(|| self.find_inputs(world, step)).flatten()?;
        let frame = self.poses.drain(..=pose).next_back()?;
        self.handles.drain(..handles_end);
        self.pedals.drain(..pedals_end);
        let input = StepInput { frame: &frame, handles: &handles, pedals: &pedals };
        let report = world.step(&input, &mut no_clock);
        Some((frame, report))
    }

    /// What a step consumed; `None` where that is not there, or something else in its place.
    fn find_inputs(&self, world: &World, step: &StepRecord) -> Option<Found> {
        let (state, stepped_ns) = (world.state(), step.instants.stepped);
        let digest = step.inputs();
        let [handles, pedals] = digest.taken().map_or([None; 2], |taken| taken.map(Some));
        let handles_end = end_of(&self.handles, [state.handles_below, step.handles_below], stepped_ns);
        let pedals_end = end_of(&self.pedals, [state.pedals_below, step.pedals_below], stepped_ns);
        let handles = newest(&self.handles, handles_end, handles)?;
        let pedals = newest(&self.pedals, pedals_end, pedals)?;
        let is_its = |frame: &TrackerFrame| {
            let input = StepInput { frame, handles: &handles, pedals: &pedals };
            is_frame_of(frame, step) && digest.allows(&inputs_digest(&input))
        };
        let pose = self.poses.iter().position(|p| is_its(p))?;
        Some(Found { pose, ends: [handles_end, pedals_end], handles, pedals })
    }
}

/// What a step consumed, and where it lies in the queues.
struct Found {
    pose: usize,
    /// Places behind the last handle and the last pedal state.
    ends: [usize; 2],
    handles: Vec<HandleState>,
    pedals: Vec<PedalState>,
}

fn is_frame_of(frame: &TrackerFrame, step: &StepRecord) -> bool {
    frame.frame == step.frame && frame.instants.exposed == step.instants.exposed
}

/// Keeps an input; where there is no room the oldest is dropped, for which no step has come.
fn keep<T>(queue: &mut VecDeque<T>, input: T) {
    if queue.len() == ROOM {
        queue.pop_front();
    }
    queue.push_back(input);
}

/// Place behind the last input that a step consumed. All below number `before` were consumed before it, all
/// below `below` are after it.
fn end_of<T: Numbered>(queue: &VecDeque<T>, [before, below]: [u64; 2], stepped_ns: Nanos) -> usize {
    last_consumed(queue.iter(), [before, below], stepped_ns).map_or(0, |last| last + 1)
}

/// The last `count` inputs before place `end`, or all of them; `None` where there are fewer.
fn newest<T: Copy>(queue: &VecDeque<T>, end: usize, count: Option<u32>) -> Option<Vec<T>> {
    let begin = count.map_or(Some(0), |count| end.checked_sub(count as usize))?;
    Some(queue.range(begin..end).copied().collect())
}

/// Takes what was sent by an instant off the front of a queue.
fn sent_by<T: Numbered>(queue: &mut VecDeque<T>, by_ns: Nanos) -> Vec<T> {
    let count = queue.iter().take_while(|input| input.sent_ns() <= by_ns).count();
    queue.drain(..count).collect()
}

/// Number of the first input that a step consumed and that is not in a queue; `None` where all are.
fn first_missing<T: Numbered>(
    queue: &VecDeque<T>,
    [before, below]: [u64; 2],
    stepped_ns: Nanos,
) -> Option<u64> {
    let Some(last) = last_consumed(queue.iter(), [before, below], stepped_ns) else {
        // Nothing was consumed, or it is missing.
        return (below != before).then(|| below.wrapping_sub(1));
    };
    let mut next = before;
    for number in queue.range(..=last).map(T::number) {
        // At its start a record may begin anywhere, and a sender that was started again counts from 0.
        if number != next && number != 0 && next != 0 {
            return Some(next);
        }
        next = number.wrapping_add(1);
    }
    None
}

#[cfg(test)]
mod tests;
