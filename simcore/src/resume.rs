//! Going on where a predecessor stood: its newest checkpoint, and the recorded inputs since,
//! stepped again in the recorded order. Pure: the entries come from the caller.

use crate::checkpoint::CheckpointError;
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
    /// is missing. A record that begins anew resets the world.
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

    /// Tells that the newest state is not the recorded one: only a checkpoint leads on.
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
        let is_its = |p: &TrackerFrame| p.frame == next.frame && p.instants.exposed == next.instants.exposed;
        if !pose.is_some_and(|p| is_its(p)) || self.missing_input(world, next).is_some() {
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
        let exposed = step.instants.exposed;
        if step.step != state.step + 1 {
            return Some(format!("step {} follows {} (field {})", step.step, state.step, step.field));
        }
        if !self.poses.iter().any(|p| p.frame == step.frame && p.instants.exposed == exposed) {
            return Some(format!("the poses of step {} (field {}) are missing", step.step, step.field));
        }
        let missing = self.missing_input(world, step);
        missing.map(|(name, number)| format!("{name} state {number} is missing (field {})", step.field))
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
        let exposed = step.instants.exposed;
        let pose = self.poses.iter().position(|p| p.frame == step.frame && p.instants.exposed == exposed)?;
        // Nothing is taken before all is there.
        if self.missing_input(world, step).is_some() {
            return None;
        }
        let stepped_ns = step.instants.stepped;
        let handles = take(&mut self.handles, [state.handles_below, step.handles_below], stepped_ns);
        let pedals = take(&mut self.pedals, [state.pedals_below, step.pedals_below], stepped_ns);
        let frame = self.poses.drain(..=pose).next_back()?;
        let input = StepInput { frame: &frame, handles: &handles, pedals: &pedals };
        let report = world.step(&input, &mut no_clock);
        Some((frame, report))
    }
}

/// Keeps an input; where there is no room the oldest is dropped, for which no step has come.
fn keep<T>(queue: &mut VecDeque<T>, input: T) {
    if queue.len() == ROOM {
        queue.pop_front();
    }
    queue.push_back(input);
}

/// Takes what a step consumed, and what came before it, off the front of a queue. All below number
/// `before` were consumed before it, all below `below` are after it.
fn take<T: Numbered>(queue: &mut VecDeque<T>, [before, below]: [u64; 2], stepped_ns: Nanos) -> Vec<T> {
    let last = last_consumed(queue.iter(), [before, below], stepped_ns);
    queue.drain(..last.map_or(0, |last| last + 1)).collect()
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
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use scene::SceneFile;
    use surgeon::rehearsal::Rehearsal;

    /// A run of `fields` fields as a recorder sees it, with a checkpoint after each of `saves`.
    fn record(fields: u64, saves: &[u64]) -> (World, Vec<Entry>) {
        let scene = SceneFile::load("peel").unwrap();
        let (rehearsal, mut world) = (Rehearsal::shipped(&scene), World::new(&scene).unwrap());
        let mut items = Vec::new();
        for field in 200..200 + fields {
            let (frame, handles) = rehearsal.field(field);
            let pedal = PedalState { seq: field, axes: [0.5, 0.1], ..PedalState::zeroed() };
            items.extend(handles.map(Entry::Handle));
            items.push(Entry::Pedal(pedal));
            items.push(Entry::Poses(Box::new(frame)));
            let input = StepInput { frame: &frame, handles: &handles, pedals: &[pedal] };
            let report = world.step(&input, &mut no_clock);
            let mut step = StepRecord::zeroed();
            (step.step, step.field, step.frame) = (world.state().step, frame.field, frame.frame);
            (step.instants, step.state_hash) = (frame.instants, report.state_hash);
            step.handles_below = world.state().handles_below;
            step.pedals_below = world.state().pedals_below;
            items.push(Entry::Step(step));
            if saves.contains(&(field - 200)) {
                items.push(checkpoint(&world, &step));
            }
        }
        (world, items)
    }

    fn checkpoint(world: &World, step: &StepRecord) -> Entry {
        let mut bytes = Vec::new();
        world.save(&mut bytes).unwrap();
        let mut header = CheckpointHeader::zeroed();
        (header.step, header.field, header.state_hash) = (step.step, step.field, step.state_hash);
        (header.handles_below, header.pedals_below) = (step.handles_below, step.pedals_below);
        header.bytes = bytes.len() as u64;
        Entry::Checkpoint(header, bytes)
    }

    fn repeat(items: Vec<Entry>) -> (World, ResumeOutcome) {
        let mut world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut past = InputHistory::default();
        items.into_iter().for_each(|i| past.note(i));
        let resumed = past.replay(&mut world).unwrap();
        (world, resumed)
    }

    #[test]
    fn goes_on_from_the_newest_checkpoint_to_the_last_step() {
        let (world, items) = record(100, &[10, 60]);
        let (again, resumed) = repeat(items);
        assert_eq!(resumed, ResumeOutcome { steps: 39, missing: 0, agrees: true });
        assert_eq!(again.state(), world.state());
    }

    #[test]
    fn a_checkpoint_may_come_before_the_record_of_its_step() {
        for save in [10, 0] {
            let (world, mut items) = record(30, &[save]);
            let at = items.iter().position(|i| matches!(i, Entry::Checkpoint(..))).unwrap();
            assert!(matches!(items[at - 1], Entry::Step(_)));
            items.swap(at - 1, at);
            let mut again = World::new(&SceneFile::load("peel").unwrap()).unwrap();
            let mut past = InputHistory::default();
            items.into_iter().for_each(|i| past.note(i));
            let resumed = past.replay(&mut again).unwrap();
            assert_eq!(resumed, ResumeOutcome { steps: 29 - save, missing: 0, agrees: true });
            assert_eq!(again.state(), world.state());
            assert_eq!(past.unconsumed().2, 0, "poses that nobody has consumed");
        }
    }

    #[test]
    fn over_a_gap_it_goes_on_from_a_later_checkpoint() {
        let (world, items) = record(100, &[10, 60]);
        let mut again = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut past = InputHistory::default();
        let mut checkpoints = Vec::new();
        let lost = |item: &Entry| matches!(item, Entry::Handle(h) if h.field == 230);
        for item in items.into_iter().filter(|item| !lost(item)) {
            match item {
                Entry::Checkpoint(header, bytes) => checkpoints.push((header, bytes)),
                other => past.note(other),
            }
        }
        let mut steps = 0;
        while past.advance(&mut again).is_some() {
            steps += 1;
        }
        assert_eq!((steps, past.waiting().map(|s| s.step)), (30, Some(31)));
        let (header, bytes) = &checkpoints[1];
        assert_eq!(past.jump(&mut again, header, bytes).unwrap(), 31);
        while past.advance(&mut again).is_some() {
            steps += 1;
        }
        assert_eq!(steps, 30 + 39);
        assert_eq!(again.state(), world.state());
    }

    #[test]
    fn without_a_checkpoint_it_begins_at_the_start() {
        let (world, items) = record(30, &[]);
        let (again, resumed) = repeat(items);
        assert_eq!(resumed, ResumeOutcome { steps: 30, missing: 0, agrees: true });
        assert_eq!(again.state_hash(), world.state_hash());
    }

    #[test]
    fn a_missing_pose_ends_it_there() {
        let (_, mut items) = record(40, &[5]);
        let gone = items.iter().rposition(|i| matches!(i, Entry::Poses(p) if p.field == 220)).unwrap();
        items.remove(gone);
        let (world, resumed) = repeat(items);
        assert_eq!((resumed.missing, resumed.agrees), (20, true));
        assert_eq!(world.state().field, 219);
    }

    #[test]
    fn inputs_that_no_step_consumed_are_left() {
        let (_, mut items) = record(20, &[5]);
        // The last step was not made: its pose and handles wait.
        items.pop();
        let mut world = World::new(&SceneFile::load("peel").unwrap()).unwrap();
        let mut past = InputHistory::default();
        items.into_iter().for_each(|i| past.note(i));
        past.replay(&mut world).unwrap();
        let (handles, pedals, poses) = past.unconsumed();
        assert_eq!((handles.len(), pedals.len(), poses), (2, 1, 1));
        assert_eq!((pedals[0].seq, world.state().field), (219, 218));
    }

    #[test]
    fn another_state_is_noticed() {
        let (_, mut items) = record(20, &[5]);
        let last = items.last_mut().unwrap();
        if let Entry::Step(step) = last {
            step.state_hash ^= 1;
        }
        assert!(!repeat(items).1.agrees);
    }
}
