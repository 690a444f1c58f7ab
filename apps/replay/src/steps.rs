//! The steps of a recording, done again in one world from the recorded poses, handles and pedal. Pure;
//! takes items, not files.
//!
//! Which inputs a step consumed is known in one place, [`InputHistory`], which a simulation that is
//! started again in a run uses too. Where an input is missing the states that follow are not determined,
//! until a checkpoint leads over the gap.

use crate::frames::AHEAD_NS;
use protocol::journal::Entry;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, StepRecord};
use protocol::time::Nanos;
use recording::{CUT, Item, Provenance, Recording};
use simcore::resume::{InputHistory, Repeated};
use simcore::world::{StepReport, World};
use std::collections::VecDeque;
use std::sync::Arc;

/// Checkpoints that are kept. What is missing when this many further ones have come does not come any
/// more.
const CHECKPOINTS: usize = 2;
/// Steps that wait for a checkpoint at most, half a minute of them: some recordings hold none that is of use.
const WAITING: usize = 1500;

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Resimulated {
    /// Steps done.
    pub steps: u64,
    /// Gaps over which a checkpoint led.
    pub gaps: u64,
    /// Recorded steps that could not be done, because inputs are missing.
    pub undone: u64,
    /// Steps that were made and not recorded, by their numbers.
    pub missing: u64,
    /// What is wrong with the file first, if something is.
    pub damage: Option<String>,
    /// The first of them whose state is not the recorded one.
    pub differs_at: Option<u64>,
    /// Version of the recording's state hashes where it is not this build's: states are not
    /// compared.
    pub other_state_hash_version: Option<u32>,
}

impl Resimulated {
    /// True where a part of the recording is missing.
    pub fn has_gaps(&self) -> bool {
        self.undone > 0 || self.gaps > 0 || self.damage.is_some()
    }
}

/// A step that was done again.
pub struct StepAgain<'a> {
    /// The world after it.
    pub world: &'a World,
    /// Recorded steps before it that the recording does not determine.
    pub left_out: u64,
    /// The recorded poses that it consumed.
    pub poses: Box<TrackerFrame>,
    /// What this tracker makes of the same frame, where one does.
    pub made: Option<Arc<TrackerFrame>>,
    /// What was recorded of it.
    pub recorded: StepRecord,
    /// What was recorded of it, with the state and the advance that came of it now.
    pub step: StepRecord,
}

/// Steps that wait until all that they consumed has come.
#[derive(Debug)]
pub struct Steps {
    pub(crate) world: World,
    pub(crate) waiting: Waiting,
    /// What came of it so far.
    pub done: Resimulated,
    /// What is missing, first and since it was last taken.
    pub lost: Option<String>,
}

/// A step or a checkpoint whose inputs may yet come.
#[derive(Debug, Clone)]
enum Pending {
    Step(Box<StepRecord>),
    Checkpoint(CheckpointHeader, SavedState),
}

/// A state as it was recorded. Never changed, so that copies of a run share it.
pub(crate) type SavedState = Arc<Vec<u8>>;

/// What the steps wait with.
#[derive(Debug, Clone, Default)]
pub(crate) struct Waiting {
    past: InputHistory,
    horizon_ns: Nanos,
    ended: bool,
    pending: VecDeque<(Nanos, Pending)>,
    checkpoints: VecDeque<(CheckpointHeader, SavedState)>,
    /// Number of the newest recorded step.
    newest: u64,
    /// Of the steps that were given up, those that were reported.
    reported: u64,
    /// The state from which the run is to go on, once the record of its step has come.
    resume: Option<(CheckpointHeader, SavedState)>,
}

impl Steps {
    /// In a world that stands at the start of the recording's scene.
    pub fn new(world: World, provenance: &Provenance) -> Self {
        let other_state_hash_version = provenance.other_state_hash_version();
        Steps {
            world,
            waiting: Waiting::default(),
            done: Resimulated { other_state_hash_version, ..Resimulated::default() },
            lost: None,
        }
    }

    /// Of a recording, which may begin with a state ([`CUT`]).
    pub fn of(recording: &Recording, world: World) -> Self {
        let mut steps = Self::new(world, recording.provenance());
        if recording.provenance().config.contains_key(CUT) {
            let mut items = recording.items_of(&["checkpoints"]).filter_map(Result::ok);
            if let Some((_, Item::Checkpoint(header, state))) = items.next() {
                steps.resume_after(header, Arc::new(state));
            }
        }
        steps
    }

    /// States are not those of the recording: none are compared.
    pub fn compare_no_states(&mut self) {
        self.done.other_state_hash_version = Some(0);
    }

    /// Takes the next item.
    pub fn note(&mut self, at: Nanos, item: Item) {
        self.waiting.horizon_ns = self.waiting.horizon_ns.max(at);
        match item.into_entry() {
            Some(Entry::Step(step)) => self.waiting.pending.push_back((at, Pending::Step(Box::new(step)))),
            Some(Entry::Checkpoint(header, state)) => {
                self.waiting.pending.push_back((at, Pending::Checkpoint(header, Arc::new(state))));
            }
            Some(input) => self.waiting.past.note(input),
            None => {}
        }
    }

    /// The next step will be the one after this checkpoint's: steps are made once its record has come.
    pub(crate) fn resume_after(&mut self, header: CheckpointHeader, state: SavedState) {
        self.waiting.resume = Some((header, state));
    }

    /// True until the step of [`Steps::resume_after`] has come and its checkpoint was taken.
    pub fn is_resuming(&self) -> bool {
        self.waiting.resume.is_some()
    }

    /// Counts from here on only.
    pub fn begin_here(&mut self) {
        let other_state_hash_version = self.done.other_state_hash_version;
        self.done = Resimulated { other_state_hash_version, ..Resimulated::default() };
        (self.lost, self.waiting.reported) = (None, 0);
    }

    /// No item will come any more.
    pub fn end(&mut self) {
        self.waiting.ended = true;
    }

    /// True once no item will come any more.
    pub fn is_ended(&self) -> bool {
        self.waiting.ended
    }

    /// Does the next step, once all that it can have consumed has come.
    pub fn next_step(&mut self) -> Option<StepAgain<'_>> {
        loop {
            let resuming = self.is_resuming();
            if let Some(repeated) = (!resuming).then(|| self.waiting.past.advance(&mut self.world)).flatten()
            {
                if self.is_proved(&repeated) {
                    return Some(self.done(repeated));
                }
                continue;
            }
            let next = self.waiting.pending.front().map(|(at, _)| at.saturating_add(AHEAD_NS));
            if next.is_some_and(|at| self.waiting.ended || at <= self.waiting.horizon_ns) {
                match self.waiting.pending.pop_front().expect("it is there").1 {
                    Pending::Checkpoint(header, state) => self.take_checkpoint(header, state),
                    Pending::Step(step) => self.take_step(*step),
                }
            } else if resuming || !self.waiting.ended || !self.go_on() {
                return None;
            }
        }
    }

    /// Recorded steps that were given up since this was asked last.
    pub fn left_out(&mut self) -> u64 {
        self.done.undone - std::mem::replace(&mut self.waiting.reported, self.done.undone)
    }

    /// False for a step behind others without a record whose state is another than the recorded one: what
    /// they consumed is not known.
    fn is_proved(&mut self, Repeated { recorded, report, guessed, .. }: &Repeated) -> bool {
        let comparable = self.done.other_state_hash_version.is_none();
        let proved = !guessed || !comparable || report.state_hash == recorded.state_hash;
        if !proved {
            self.waiting.past.go_astray();
            self.done.undone += 1;
            let why = format!("what led to step {} (field {}) is missing", recorded.step, recorded.field);
            self.lost = self.lost.take().or(Some(why));
        }
        proved
    }

    fn done(&mut self, Repeated { poses, recorded, report, .. }: Repeated) -> StepAgain<'_> {
        self.done.steps += 1;
        let StepReport { state_hash, advanced_ns, inputs, .. } = report;
        let comparable = self.done.other_state_hash_version.is_none();
        let differs = comparable && state_hash != recorded.state_hash;
        self.done.differs_at = self.done.differs_at.or(differs.then_some(recorded.step));
        let step = StepRecord { state_hash, advanced_ns, ..recorded }.with_inputs(inputs);
        StepAgain { left_out: self.left_out(), world: &self.world, poses, made: None, recorded, step }
    }

    /// Takes the state to resume from where `step` is the one after which it was saved. One that is of no
    /// use leaves the run without a state.
    fn try_to_resume(&mut self, step: StepRecord) {
        self.waiting.newest = step.step;
        self.waiting.past.note(Entry::Step(step));
        let Some((header, state)) = &self.waiting.resume else { return };
        if (step.step, step.field) != (header.step, header.field) {
            return;
        }
        match self.waiting.past.jump(&mut self.world, header, state) {
            Ok(_) if self.world.state_hash() != header.state_hash => {
                let (step, field) = (header.step, header.field);
                tracing::warn!(field, "step {step}: its checkpoint is not of the state it names");
            }
            Ok(_) => {
                self.waiting.resume = None;
                self.begin_here();
            }
            Err(error) => {
                let field = header.field;
                tracing::warn!(field, "step {}: its checkpoint cannot be used: {error}", header.step);
            }
        }
    }

    fn take_step(&mut self, step: StepRecord) {
        if self.is_resuming() {
            return self.try_to_resume(step);
        }
        let number = step.step;
        if number == 1 {
            // The simulation was restarted: what an earlier one saved or lacked is of no use.
            self.waiting.checkpoints.clear();
            self.waiting.newest = 0;
            let lacking = self.waiting.past.lacking(&self.world);
            self.lost = self.lost.take().or(lacking);
            self.done.undone += self.waiting.past.give_up();
        }
        self.done.missing += number.saturating_sub(self.waiting.newest + 1);
        self.waiting.newest = self.waiting.newest.max(number);
        self.waiting.past.note(Entry::Step(step));
        if self.waiting.past.waiting_steps() > WAITING {
            let lacking = self.waiting.past.lacking(&self.world);
            self.lost = self.lost.take().or(lacking);
            self.waiting.past.give_up_oldest();
            self.done.undone += 1;
        }
    }

    /// Keeps a checkpoint; where steps have been waiting since the one before the last, their inputs
    /// are missing.
    fn take_checkpoint(&mut self, header: CheckpointHeader, state: SavedState) {
        if self.waiting.checkpoints.len() == CHECKPOINTS {
            let oldest = self.waiting.checkpoints.front().expect("two are kept").0.step;
            match self.waiting.past.waiting().filter(|_| !self.is_resuming()) {
                Some(waiting) if waiting.step <= oldest + 1 => drop(self.go_on()),
                _ => drop(self.waiting.checkpoints.pop_front()),
            }
        }
        self.waiting.checkpoints.push_back((header, state));
    }

    /// Goes on from the first checkpoint that leads over what the waiting step lacks; false where no step
    /// is waiting, or none can be done any more.
    fn go_on(&mut self) -> bool {
        let Some(waiting) = self.waiting.past.waiting().map(|s| s.step) else { return false };
        let lacking = self.waiting.past.lacking(&self.world);
        self.lost = self.lost.take().or(lacking);
        while let Some((header, state)) = self.waiting.checkpoints.pop_front() {
            if header.step + 1 < waiting {
                continue;
            }
            match self.waiting.past.jump(&mut self.world, &header, &state) {
                Ok(given_up) => {
                    self.done.undone += given_up;
                    self.done.gaps += 1;
                    return true;
                }
                Err(error) => {
                    let field = header.field;
                    tracing::warn!(field, "step {}: its checkpoint cannot be used: {error}", header.step);
                }
            }
        }
        if self.waiting.ended {
            self.done.undone += self.waiting.past.give_up();
        }
        false
    }
}

#[cfg(test)]
mod tests;
