//! A recorded run as a sequence of turns: for every tracker frame the camera-fields it consumed,
//! and for every step the handle and pedal states it consumed. Pure; reads items, not files.
//!
//! The recorder wrote blocks in the order of arrival, which is not quite the order of cause:
//! a field can stand behind the frame that consumed it. So items are read some time ahead, and
//! what belongs together is matched by number.
//!
//! Poses and states are determined each by their own inputs. Where a field or a pose is missing, the poses
//! that follow are not determined any more, because the tracker remembers what it saw, until a tracker
//! that was started again counts from 0. Steps are made of the recorded poses; where one lacks an input,
//! states are determined again from the next checkpoint on.

use crate::tracking::Due;
use protocol::blobs::BlobField;
use protocol::control::RecordedFrame;
use protocol::handles::{HandleState, PedalState};
use protocol::poses::{FieldUsed, TrackerFrame};
use protocol::steps::{CheckpointHeader, Numbered, StepRecord, last_consumed};
use protocol::time::Nanos;
use recording::{Item, NoteKind, RecordingError};
use std::collections::VecDeque;

/// How far a consumed block may stand behind what consumed it, ns.
const AHEAD_NS: u64 = 500_000_000;
/// How far a step may stand behind its pose: the simulation may have been started again, ns.
const STEP_AHEAD_NS: u64 = 30_000_000_000;
/// How far a checkpoint may stand behind the steps after it, where a recorder that stood still filed
/// what had waited channel by channel, ns.
const CHECKPOINT_AHEAD_NS: u64 = 10_000_000_000;
/// Camera-fields kept for frames to come: more than ten seconds of three cameras.
const FIELDS_KEPT: usize = 2048;

/// What a turn's step consumed, where the simulation stepped.
#[derive(Debug, Clone, PartialEq)]
pub struct StepTurn {
    /// The simulation was reset before this step.
    pub fresh: bool,
    /// Handle states consumed by this step.
    pub handles: Vec<HandleState>,
    /// Pedal states consumed by this step.
    pub pedals: Vec<PedalState>,
    /// What was recorded; `None` for a step that a restarted simulation made again in silence.
    pub recorded: Option<StepRecord>,
    /// The recording determines its state.
    pub determined: bool,
    /// The state before it, where it is determined again after a loss.
    pub resume: Option<Box<Checkpoint>>,
}

/// A recorded state of the simulation.
pub type Checkpoint = (CheckpointHeader, Vec<u8>);

/// One tracker frame and the step made of it.
#[derive(Debug, Clone)]
pub struct Turn {
    /// The camera-fields it consumed, in that order.
    pub fields: Vec<BlobField>,
    /// The request for the frame, to the tracker.
    pub request: RecordedFrame,
    /// What was recorded.
    pub recorded: Box<TrackerFrame>,
    /// The step, if the simulation made one.
    pub step: Option<StepTurn>,
    /// The recording determines the poses: the tracker has been given all that it saw.
    pub determined: bool,
    /// What of the recording is missing here; given once for each loss.
    pub lost: Option<String>,
}

/// An item whose turn is to come, with its place in the recording.
#[derive(Debug)]
enum Pending {
    Pose(Box<TrackerFrame>),
    Step(Box<StepRecord>),
    Checkpoint(Box<Checkpoint>),
    Lost(String),
}

/// Iterator over the turns of a recording.
pub struct Turns<I> {
    items: I,
    ended: bool,
    place: u64,
    horizon_ns: Nanos,
    pending: VecDeque<(u64, Nanos, Pending)>,
    fields: VecDeque<BlobField>,
    handles: Consumed<HandleState>,
    pedals: Consumed<PedalState>,
    last_step: Option<StepRecord>,
    last_frame: Option<u64>,
    begun: bool,
    /// Since the last loss no pose has been determined.
    poses_undetermined: bool,
    /// Since the last loss no state has been determined.
    undetermined: bool,
    /// The poses are a desk's: no tracker made them.
    pub desk: bool,
    /// Frames that should have been.
    pub due: Due,
    fields_read: u64,
    /// Recorded steps without their poses.
    pub strays: u64,
    /// Steps that were made and whose poses or records are missing, by their numbers.
    pub missing: u64,
    /// The newest checkpoint that was passed.
    checkpoint: Option<Box<Checkpoint>>,
    /// A loss that no turn has reported yet; at the end, one behind the last turn.
    pub lost: Option<String>,
    /// What is wrong with the file first, if something is.
    pub damage: Option<RecordingError>,
}

impl<I: Iterator<Item = Result<(Nanos, Item), RecordingError>>> Turns<I> {
    /// Turns of `items`, of cameras with this field period, ns.
    pub fn new(items: I, period_ns: u64) -> Self {
        Turns {
            items,
            ended: false,
            place: 0,
            horizon_ns: 0,
            pending: VecDeque::new(),
            fields: VecDeque::new(),
            handles: Consumed::new("handle"),
            pedals: Consumed::new("pedal"),
            last_step: None,
            last_frame: None,
            begun: false,
            poses_undetermined: false,
            undetermined: false,
            desk: false,
            due: Due::new(period_ns),
            fields_read: 0,
            strays: 0,
            missing: 0,
            checkpoint: None,
            lost: None,
            damage: None,
        }
    }

    /// Reads one item; false at the end.
    fn read(&mut self) -> bool {
        let (at, item) = match self.items.next() {
            Some(Ok(next)) if !self.ended => next,
            Some(Err(error)) if !self.ended => {
                if !matches!(error, RecordingError::Truncated { .. }) {
                    let lost = Pending::Lost(error.to_string());
                    self.pending.push_back((self.place, self.horizon_ns, lost));
                }
                self.damage.get_or_insert(error);
                return true;
            }
            _ => {
                self.ended = true;
                return false;
            }
        };
        self.place += 1;
        self.horizon_ns = self.horizon_ns.max(at);
        let mut wait = |pending| self.pending.push_back((self.place, at, pending));
        match item {
            Item::Blobs(field) => {
                self.due.note_field(&field);
                self.fields_read += 1;
                if self.fields.len() == FIELDS_KEPT {
                    self.fields.pop_front();
                }
                self.fields.push_back(*field);
            }
            Item::Handle(handle) => self.handles.waiting.push_back((self.place, handle)),
            Item::Pedal(pedal) => self.pedals.waiting.push_back((self.place, pedal)),
            Item::Poses(frame) => wait(Pending::Pose(frame)),
            Item::Step(step) => wait(Pending::Step(Box::new(step))),
            Item::Checkpoint(header, state) => wait(Pending::Checkpoint(Box::new((header, state)))),
            Item::Note(note) if note.kind == NoteKind::Loss => wait(Pending::Lost(note.text)),
            _ => {}
        }
        true
    }

    fn read_until(&mut self, at: Nanos) {
        while self.horizon_ns < at && self.read() {}
    }

    /// Notes why states are no longer determined.
    fn lose_states(&mut self, why: impl FnOnce() -> String) {
        self.undetermined = true;
        self.note_loss(why);
    }

    /// Notes why poses are no longer determined.
    fn lose_poses(&mut self, why: impl FnOnce() -> String) {
        self.poses_undetermined = true;
        if !self.desk {
            self.note_loss(why);
        }
    }

    /// Notes that something is missing. What follows is determined all the same where, by their numbers,
    /// no inputs are.
    fn note_loss(&mut self, why: impl FnOnce() -> String) {
        if self.lost.is_none() {
            self.lost = Some(why());
        }
    }

    /// Place among the pending of the step made of a pose, if there is one. Reads on until it is
    /// found, or a step of a later pose, which means that this pose was passed over.
    fn find_step(&mut self, frame: &TrackerFrame, at: Nanos) -> StepSearch {
        let mut looked = 0;
        let mut later_poses = Vec::new();
        loop {
            while let Some((_, _, pending)) = self.pending.get(looked) {
                match pending {
                    Pending::Step(s) if (s.frame, s.field) == (frame.frame, frame.field) => {
                        return StepSearch::Found(looked);
                    }
                    Pending::Step(s) if later_poses.contains(&(s.frame, s.field)) => {
                        let ahead = later_poses.iter().position(|p| *p == (s.frame, s.field));
                        return StepSearch::PassedOver { next: s.step, poses: 1 + ahead.unwrap_or(0) as u64 };
                    }
                    Pending::Pose(p) => later_poses.push((p.frame, p.field)),
                    _ => {}
                }
                looked += 1;
            }
            if self.horizon_ns > at.saturating_add(STEP_AHEAD_NS) || !self.read() {
                return StepSearch::None;
            }
        }
    }

    /// The step made of a pose at `place`, and what it consumed.
    fn step_of(&mut self, frame: &TrackerFrame, place: u64, at: Nanos) -> Option<StepTurn> {
        let last = self.last_step.map_or(0, |s| s.step);
        match self.find_step(frame, at) {
            StepSearch::Found(index) => {
                let (_, _, Pending::Step(step)) = self.pending.remove(index)? else { return None };
                Some(self.recorded_step(*step, at))
            }
            // A simulation that resumes makes the steps since its checkpoint again, in silence.
            StepSearch::PassedOver { next, poses } if next > last + 1 && poses < next - last => {
                self.last_step = self.last_step.map(|s| StepRecord { step: s.step + 1, ..s });
                let handles = self.handles.before(place);
                let pedals = self.pedals.before(place);
                let determined = !self.undetermined;
                Some(StepTurn { fresh: false, handles, pedals, recorded: None, determined, resume: None })
            }
            _ => None,
        }
    }

    fn recorded_step(&mut self, step: StepRecord, at: Nanos) -> StepTurn {
        let fresh = step.step <= 1 && self.last_step.is_some();
        let expected = if fresh { 0 } else { self.last_step.map_or(0, |s| s.step) } + 1;
        if step.step > expected {
            self.missing += step.step - expected;
            self.lose_states(|| {
                format!("step {} follows {} (field {})", step.step, expected - 1, step.field)
            });
        }
        if self.undetermined {
            self.read_until(at.saturating_add(CHECKPOINT_AHEAD_NS));
        }
        let resume = self.undetermined.then(|| self.checkpoint_before(&step)).flatten();
        if let Some((header, _)) = resume.as_deref() {
            self.handles.skip(header.handles_below, step.instants.stepped);
            self.pedals.skip(header.pedals_below, step.instants.stepped);
        }
        self.undetermined &= resume.is_none() && !fresh;
        self.last_step = Some(step);
        if fresh {
            (self.handles.below, self.pedals.below) = (0, 0);
        }
        let handles = self.handles.below(step.handles_below, step.instants.stepped);
        let pedals = self.pedals.below(step.pedals_below, step.instants.stepped);
        let missing = [handles.as_ref().err(), pedals.as_ref().err()].into_iter().flatten().next().cloned();
        if let Some(what) = missing {
            self.lose_states(|| format!("{what} (field {})", step.field));
        }
        let (handles, pedals) = (handles.unwrap_or_default(), pedals.unwrap_or_default());
        let determined = !self.undetermined;
        let resume = resume.filter(|_| determined);
        StepTurn { fresh, handles, pedals, recorded: Some(step), determined, resume }
    }

    /// The checkpoint of the state before a step. It may stand a little behind the step in the
    /// recording; one of the same number but another state belongs to an earlier run of the
    /// simulation.
    fn checkpoint_before(&self, step: &StepRecord) -> Option<Box<Checkpoint>> {
        let ahead = self.pending.iter().filter_map(|(_, _, pending)| match pending {
            Pending::Checkpoint(checkpoint) => Some(checkpoint),
            _ => None,
        });
        let last = self.last_step.filter(|last| last.step + 1 == step.step);
        let fits = |of: &CheckpointHeader| {
            of.step + 1 == step.step && last.is_none_or(|last| last.state_hash == of.state_hash)
        };
        self.checkpoint.iter().chain(ahead).find(|checkpoint| fits(&checkpoint.0)).cloned()
    }

    /// A step without its pose: a repeated one is no matter, another one is a loss.
    fn stray_step(&mut self, step: &StepRecord) {
        let repeated = self.last_step.is_some_and(|last| step.step <= last.step && step.step > 1);
        if !repeated {
            self.strays += 1;
            self.last_step = Some(*step);
            self.lose_states(|| {
                format!("the poses of step {} (field {}) are missing", step.step, step.field)
            });
        }
    }

    fn turn(&mut self, frame: Box<TrackerFrame>, place: u64, at: Nanos) -> Turn {
        self.due.note_frame(&frame);
        // A tracker that was started again remembers nothing.
        self.poses_undetermined &= frame.frame != 0;
        let before = self.last_frame.replace(frame.frame);
        if before.is_some_and(|before| frame.frame != before + 1 && frame.frame != 0) {
            self.lose_poses(|| format!("tracker frame {} follows {}", frame.frame, before.unwrap_or(0)));
        }
        self.read_until(at.saturating_add(AHEAD_NS));
        if !std::mem::replace(&mut self.begun, true) && frame.frame != 0 {
            self.lose_poses(|| format!("the recording begins at tracker frame {}, not at 0", frame.frame));
        }
        // Without any field, frames that used none tell nothing.
        self.poses_undetermined |= self.fields_read == 0;
        let mut fields = Vec::with_capacity(frame.used().len());
        for used in frame.used() {
            let is_it = |f: &BlobField| key(f) == (used.camera, used.field, used.exposed_ns);
            match self.fields.iter().position(is_it).and_then(|i| self.fields.remove(i)) {
                Some(field) => fields.push(field),
                None => {
                    self.lose_poses(|| format!("field {} of camera {} is missing", used.field, used.camera))
                }
            }
        }
        let step = self.step_of(&frame, place, at);
        let (request, determined) = (request_of(&frame, &fields), !self.poses_undetermined);
        Turn { request, fields, recorded: frame, step, determined, lost: self.lost.take() }
    }
}

impl<I: Iterator<Item = Result<(Nanos, Item), RecordingError>>> Iterator for Turns<I> {
    type Item = Turn;

    fn next(&mut self) -> Option<Turn> {
        loop {
            match self.pending.pop_front() {
                Some((place, at, Pending::Pose(frame))) => return Some(self.turn(frame, place, at)),
                Some((_, _, Pending::Step(step))) => self.stray_step(&step),
                Some((_, _, Pending::Lost(text))) => self.note_loss(|| text),
                Some((_, _, Pending::Checkpoint(checkpoint))) => self.checkpoint = Some(checkpoint),
                None => {
                    if !self.read() {
                        return None;
                    }
                }
            }
        }
    }
}

/// What [`Turns::find_step`] found.
enum StepSearch {
    Found(usize),
    /// The next recorded step is that of the pose `poses` further on.
    PassedOver {
        next: u64,
        poses: u64,
    },
    None,
}

fn key(field: &BlobField) -> (u32, u64, Nanos) {
    (field.camera, field.field, field.exposed_ns)
}

/// The request for a recorded frame, with the fields that are in the recording.
fn request_of(frame: &TrackerFrame, fields: &[BlobField]) -> RecordedFrame {
    let mut used = frame.used;
    for (slot, f) in used.iter_mut().zip(fields) {
        *slot = FieldUsed { field: f.field, exposed_ns: f.exposed_ns, camera: f.camera, blobs_used: 0 };
    }
    RecordedFrame {
        frame: frame.frame,
        field: frame.field,
        exposed_ns: frame.instants.exposed,
        camera: frame.camera,
        closed_by: frame.closed_by,
        used,
        used_count: fields.len() as u32,
        reserved: 0,
    }
}

/// Inputs of the simulation that wait to be consumed.
struct Consumed<M> {
    name: &'static str,
    waiting: VecDeque<(u64, M)>,
    below: u64,
}

impl<M: Numbered> Consumed<M> {
    fn new(name: &'static str) -> Self {
        Consumed { name, waiting: VecDeque::new(), below: 0 }
    }

    fn last(&self, below: u64, stepped_ns: Nanos) -> Option<usize> {
        last_consumed(self.waiting.iter().map(|(_, m)| m), [self.below, below], stepped_ns)
    }

    /// What a step that was done at `stepped_ns` consumed, after which all with numbers below `below`
    /// are consumed. A sender that was started again counts from 0, so numbers say "up to that one",
    /// not "all smaller".
    fn below(&mut self, below: u64, stepped_ns: Nanos) -> Result<Vec<M>, String> {
        let Some(last) = self.last(below, stepped_ns) else {
            if below == self.below {
                return Ok(Vec::new());
            }
            return Err(format!("{} state {} is missing", self.name, below.wrapping_sub(1)));
        };
        let mut next = self.below;
        let taken: Vec<M> = self.waiting.drain(..=last).map(|(_, m)| m).collect();
        self.below = below;
        for number in taken.iter().map(M::number) {
            // A recording may begin anywhere, and a sender that was started again counts from 0.
            if number != next && number != 0 && next != 0 {
                return Err(format!("{} state {next} is missing", self.name));
            }
            next = number.wrapping_add(1);
        }
        Ok(taken)
    }

    /// Forgets what a checkpoint's state before a step that was done at `stepped_ns` has consumed.
    fn skip(&mut self, below: u64, stepped_ns: Nanos) {
        match self.last(below, stepped_ns) {
            Some(last) => drop(self.waiting.drain(..=last)),
            None => self.waiting.retain(|(_, m)| m.number() >= below),
        }
        self.below = below;
    }

    /// What had come before a place of the recording.
    fn before(&mut self, place: u64) -> Vec<M> {
        let count = self.waiting.partition_point(|(at, _)| *at < place);
        let taken: Vec<M> = self.waiting.drain(..count).map(|(_, m)| m).collect();
        if let Some(last) = taken.last() {
            self.below = last.number().wrapping_add(1);
        }
        taken
    }
}

#[cfg(test)]
mod tests;
