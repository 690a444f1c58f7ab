//! Going on where a predecessor stood: its newest checkpoint, and the recorded inputs since,
//! stepped again in the recorded order. Pure: the entries come from the caller.

use crate::checkpoint::CheckpointError;
use crate::world::{World, no_clock};
use protocol::handles::{HandleState, PedalState};
use protocol::journal::Entry;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, Numbered, StepInput, StepRecord, last_consumed};
use protocol::time::Nanos;
use std::collections::VecDeque;

/// What a recording knows since its newest checkpoint.
#[derive(Debug, Default)]
pub struct InputHistory {
    checkpoint: Option<(CheckpointHeader, Vec<u8>)>,
    steps: VecDeque<StepRecord>,
    poses: VecDeque<Box<TrackerFrame>>,
    handles: VecDeque<HandleState>,
    pedals: VecDeque<PedalState>,
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
            Entry::Poses(frame) => self.poses.push_back(frame),
            Entry::Handle(handle) => self.handles.push_back(handle),
            Entry::Pedal(pedal) => self.pedals.push_back(pedal),
        }
    }

    /// Drops what the checkpoint's state has consumed. Numbers may begin again within a recording,
    /// so the last match counts. What was recorded a little early or late stays.
    fn trim(&mut self, header: &CheckpointHeader) {
        let same = |s: &StepRecord| s.step == header.step && s.state_hash == header.state_hash;
        if let Some(at) = self.steps.iter().rposition(same) {
            let exposed = self.steps[at].instants.exposed;
            let frame = self.poses.iter().rposition(|p| p.instants.exposed == exposed);
            self.poses.drain(..frame.map_or(0, |f| f + 1));
            self.steps.drain(..=at);
        }
        let consumed = self.handles.iter().rposition(|h| h.seq.wrapping_add(1) == header.handles_below);
        self.handles.drain(..consumed.map_or(0, |at| at + 1));
        let consumed = self.pedals.iter().rposition(|p| p.seq.wrapping_add(1) == header.pedals_below);
        self.pedals.drain(..consumed.map_or(0, |at| at + 1));
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
        while let Some(step) = self.steps.front().copied() {
            let Some((_, hash)) = self.repeat_step(world, &step) else { break };
            agrees = hash == step.state_hash;
            self.steps.pop_front();
            steps += 1;
        }
        Ok(ResumeOutcome { steps, missing: self.steps.len() as u64, agrees })
    }

    /// Handle and pedal states that no step has consumed yet, and the number of poses; all in the
    /// order in which they came.
    pub fn unconsumed(self) -> (Vec<HandleState>, Vec<PedalState>, u64) {
        (self.handles.into(), self.pedals.into(), self.poses.len() as u64)
    }

    /// Does the oldest recorded step that is waiting, from where `world` stands; its pose, its
    /// record and the hash of the state it led to. `None` while an input is missing. A record that
    /// begins anew resets the world.
    pub fn advance(&mut self, world: &mut World) -> Option<(Box<TrackerFrame>, StepRecord, u64)> {
        loop {
            let step = *self.steps.front()?;
            let done = world.state().step;
            if step.step == 1 && done > 0 {
                world.reset();
            } else if step.step <= done {
                // A restarted simulation sends its last steps again.
                self.steps.pop_front();
                continue;
            }
            let (frame, hash) = self.repeat_step(world, &step)?;
            self.steps.pop_front();
            return Some((frame, step, hash));
        }
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
        let waiting = self.steps.len();
        self.trim(header);
        // The step of the checkpoint, or its inputs, may be among what is missing.
        let next = self.steps.iter().position(|s| s.step > header.step).unwrap_or(self.steps.len());
        self.steps.drain(..next);
        self.handles.retain(|h| h.seq >= header.handles_below);
        self.pedals.retain(|p| p.seq >= header.pedals_below);
        Ok((waiting - self.steps.len()) as u64)
    }

    /// The oldest recorded step that is waiting.
    pub fn waiting(&self) -> Option<&StepRecord> {
        self.steps.front()
    }

    /// Recorded steps that are waiting.
    pub fn waiting_steps(&self) -> u64 {
        self.steps.len() as u64
    }

    /// One recorded step: its pose and the hash of the state; `None` where an input is missing.
    fn repeat_step(&mut self, world: &mut World, step: &StepRecord) -> Option<(Box<TrackerFrame>, u64)> {
        let state = world.state();
        if step.step != state.step + 1 {
            return None;
        }
        let exposed = step.instants.exposed;
        let pose = self.poses.iter().position(|p| p.frame == step.frame && p.instants.exposed == exposed)?;
        let stepped_ns = step.instants.stepped;
        let handles = take(&mut self.handles, state.handles_below, step.handles_below, stepped_ns)?;
        let pedals = take(&mut self.pedals, state.pedals_below, step.pedals_below, stepped_ns)?;
        let frame = self.poses.drain(..=pose).next_back()?;
        let input = StepInput { frame: &frame, handles: &handles, pedals: &pedals };
        let state_hash = world.step(&input, &mut no_clock).state_hash;
        Some((frame, state_hash))
    }
}

/// Takes what a step consumed off the front of a queue: up to the input with number `below` − 1.
/// `None` if that one is missing, or one before it.
fn take<T: Numbered>(queue: &mut VecDeque<T>, before: u64, below: u64, stepped_ns: Nanos) -> Option<Vec<T>> {
    let Some(last) = last_consumed(queue.iter(), [before, below], stepped_ns) else {
        // Nothing was consumed, or it is missing.
        return (below == before).then(Vec::new);
    };
    let numbers = queue.range(..=last).map(T::number);
    // At its start a record may begin anywhere.
    let follows = |next: &mut u64, number: u64| {
        let follows = number == *next || number == 0 || *next == 0;
        *next = number.wrapping_add(1);
        Some(follows)
    };
    numbers.scan(before, follows).all(|follows| follows).then(|| queue.drain(..=last).collect())
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
