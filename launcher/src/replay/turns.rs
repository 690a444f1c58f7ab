//! A recorded run as a sequence of turns: for every tracker frame the camera-fields it consumed,
//! and for every step the handle and pedal states it consumed. Pure; reads items, not files.
//!
//! The recorder wrote blocks in the order of arrival, which is not quite the order of cause:
//! a field can stand behind the frame that consumed it. So items are read some time ahead, and
//! what belongs together is matched by number.

use protocol::blobs::BlobField;
use protocol::control::RecordedFrame;
use protocol::handles::{HandleState, PedalState};
use protocol::message::Message;
use protocol::poses::{FieldUsed, TrackerFrame};
use protocol::steps::StepRecord;
use protocol::time::Nanos;
use recording::{Item, NoteKind, RecordingError};
use std::collections::VecDeque;

/// How far a consumed block may stand behind what consumed it, ns.
const AHEAD_NS: u64 = 500_000_000;
/// How far a step may stand behind its pose: the simulation may have been started again, ns.
const STEP_AHEAD_NS: u64 = 30_000_000_000;
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
}

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
    /// Why from this turn on the recording does not determine the result; given once.
    pub lost: Option<String>,
}

/// An item whose turn is to come, with its place in the recording.
#[derive(Debug)]
enum Pending {
    Pose(Box<TrackerFrame>),
    Step(StepRecord),
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
    begun: bool,
    /// A loss that no turn has reported yet; at the end, one behind the last turn.
    pub lost: Option<String>,
    /// The error at which the recording ends, if it does not end well.
    pub damage: Option<RecordingError>,
}

impl<I: Iterator<Item = Result<(Nanos, Item), RecordingError>>> Turns<I> {
    /// Turns of `items`.
    pub fn new(items: I) -> Self {
        Turns {
            items,
            ended: false,
            place: 0,
            horizon_ns: 0,
            pending: VecDeque::new(),
            fields: VecDeque::new(),
            handles: Consumed::new("handle", |h: &HandleState| h.seq),
            pedals: Consumed::new("pedal", |p: &PedalState| p.seq),
            last_step: None,
            begun: false,
            lost: None,
            damage: None,
        }
    }

    /// Reads one item; false at the end.
    fn read(&mut self) -> bool {
        let (at, item) = match self.items.next() {
            Some(Ok(next)) if !self.ended => next,
            Some(Err(error)) if !self.ended => {
                (self.ended, self.damage) = (true, Some(error));
                return false;
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
                if self.fields.len() == FIELDS_KEPT {
                    self.fields.pop_front();
                }
                self.fields.push_back(*field);
            }
            Item::Handle(handle) => self.handles.waiting.push_back((self.place, handle)),
            Item::Pedal(pedal) => self.pedals.waiting.push_back((self.place, pedal)),
            Item::Poses(frame) => wait(Pending::Pose(frame)),
            Item::Step(step) => wait(Pending::Step(step)),
            Item::Note(note) if note.kind == NoteKind::Loss => wait(Pending::Lost(note.text)),
            _ => {}
        }
        true
    }

    fn read_until(&mut self, at: Nanos) {
        while self.horizon_ns < at && self.read() {}
    }

    /// Notes the first reason why the result is no longer determined.
    fn lose(&mut self, why: impl FnOnce() -> String) {
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
                Some(self.recorded_step(step))
            }
            // A simulation that resumes makes the steps since its checkpoint again, in silence.
            StepSearch::PassedOver { next, poses } if next > last + 1 && poses < next - last => {
                self.last_step = self.last_step.map(|s| StepRecord { step: s.step + 1, ..s });
                let handles = self.handles.before(place);
                let pedals = self.pedals.before(place);
                Some(StepTurn { fresh: false, handles, pedals, recorded: None })
            }
            _ => None,
        }
    }

    fn recorded_step(&mut self, step: StepRecord) -> StepTurn {
        let fresh = step.step <= 1 && self.last_step.is_some();
        let expected = if fresh { 0 } else { self.last_step.map_or(0, |s| s.step) } + 1;
        if step.step > expected {
            self.lose(|| format!("step {} follows {} (field {})", step.step, expected - 1, step.field));
        }
        self.last_step = Some(step);
        if fresh {
            (self.handles.below, self.pedals.below) = (0, 0);
        }
        let handles = self.handles.below(step.handles_below);
        let pedals = self.pedals.below(step.pedals_below);
        let missing = [handles.as_ref().err(), pedals.as_ref().err()].into_iter().flatten().next().cloned();
        if let Some(what) = missing {
            self.lose(|| format!("{what} (field {})", step.field));
        }
        let (handles, pedals) = (handles.unwrap_or_default(), pedals.unwrap_or_default());
        StepTurn { fresh, handles, pedals, recorded: Some(step) }
    }

    /// A step without its pose: a repeated one is no matter, another one is a loss.
    fn stray_step(&mut self, step: &StepRecord) {
        let repeated = self.last_step.is_some_and(|last| step.step <= last.step && step.step > 1);
        if !repeated {
            self.lose(|| format!("the poses of step {} (field {}) are missing", step.step, step.field));
        }
    }

    fn turn(&mut self, frame: Box<TrackerFrame>, place: u64, at: Nanos) -> Turn {
        self.read_until(at.saturating_add(AHEAD_NS));
        if !std::mem::replace(&mut self.begun, true) && frame.frame != 0 {
            self.lose(|| format!("the recording begins at tracker frame {}, not at 0", frame.frame));
        }
        let mut fields = Vec::with_capacity(frame.used().len());
        for used in frame.used() {
            let is_it = |f: &BlobField| key(f) == (used.camera, used.field, used.exposed_ns);
            match self.fields.iter().position(is_it).and_then(|i| self.fields.remove(i)) {
                Some(field) => fields.push(field),
                None => self.lose(|| format!("field {} of camera {} is missing", used.field, used.camera)),
            }
        }
        let step = self.step_of(&frame, place, at);
        Turn { request: request_of(&frame, &fields), fields, recorded: frame, step, lost: self.lost.take() }
    }
}

impl<I: Iterator<Item = Result<(Nanos, Item), RecordingError>>> Iterator for Turns<I> {
    type Item = Turn;

    fn next(&mut self) -> Option<Turn> {
        loop {
            match self.pending.pop_front() {
                Some((place, at, Pending::Pose(frame))) => return Some(self.turn(frame, place, at)),
                Some((_, _, Pending::Step(step))) => self.stray_step(&step),
                Some((_, _, Pending::Lost(text))) => self.lose(|| text),
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
    seq: fn(&M) -> u64,
    waiting: VecDeque<(u64, M)>,
    below: u64,
}

impl<M: Message> Consumed<M> {
    fn new(name: &'static str, seq: fn(&M) -> u64) -> Self {
        Consumed { name, seq, waiting: VecDeque::new(), below: 0 }
    }

    /// What a step consumed, after which all with numbers below `below` are consumed. A sender
    /// that was started again counts from 0, so numbers say "up to that one", not "all smaller".
    fn below(&mut self, below: u64) -> Result<Vec<M>, String> {
        if below == self.below {
            return Ok(Vec::new());
        }
        let last = self.waiting.iter().position(|(_, m)| (self.seq)(m) + 1 == below);
        let Some(last) = last else {
            return Err(format!("{} state {} is missing", self.name, below.wrapping_sub(1)));
        };
        self.below = below;
        Ok(self.waiting.drain(..=last).map(|(_, m)| m).collect())
    }

    /// What had come before a place of the recording.
    fn before(&mut self, place: u64) -> Vec<M> {
        let count = self.waiting.partition_point(|(at, _)| *at < place);
        let taken: Vec<M> = self.waiting.drain(..count).map(|(_, m)| m).collect();
        if let Some(last) = taken.last() {
            self.below = (self.seq)(last) + 1;
        }
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use recording::Note;

    const MS: u64 = 1_000_000;

    fn blobs(camera: u32, field: u64) -> Item {
        let mut block = BlobField::zeroed();
        (block.camera, block.field, block.exposed_ns) = (camera, field, (field + 1) * 20 * MS);
        Item::Blobs(Box::new(block))
    }

    fn pose(frame: u64, used: &[(u32, u64)]) -> Item {
        let mut block = TrackerFrame::zeroed();
        (block.frame, block.field) = (frame, frame + 10);
        for (slot, &(camera, field)) in block.used.iter_mut().zip(used) {
            *slot = FieldUsed { field, exposed_ns: (field + 1) * 20 * MS, camera, blobs_used: 3 };
        }
        block.used_count = used.len() as u32;
        Item::Poses(Box::new(block))
    }

    fn step(number: u64, frame: u64, handles_below: u64) -> Item {
        Item::Step(StepRecord {
            step: number,
            frame,
            field: frame + 10,
            handles_below,
            state_hash: number * 7,
            ..StepRecord::zeroed()
        })
    }

    fn handle(seq: u64) -> Item {
        Item::Handle(HandleState { seq, ..HandleState::zeroed() })
    }

    fn turns(items: Vec<(u64, Item)>) -> Vec<Turn> {
        Turns::new(items.into_iter().map(|(ms, item)| Ok((ms * MS, item)))).collect()
    }

    fn handles(turn: &Turn) -> Vec<u64> {
        turn.step.as_ref().map_or(Vec::new(), |s| s.handles.iter().map(|h| h.seq).collect())
    }

    #[test]
    fn what_was_consumed_is_found_even_behind_its_consumer() {
        let all = turns(vec![
            (1, blobs(0, 0)),
            (2, pose(0, &[(0, 0), (1, 0)])),
            (2, step(1, 0, 2)),
            (3, handle(0)),
            (3, handle(1)),
            (4, blobs(1, 0)),
            (4, handle(2)),
            (20, blobs(0, 1)),
            (21, pose(1, &[(0, 1)])),
            (23, step(2, 1, 2)),
        ]);
        assert_eq!(all.len(), 2);
        assert!(all.iter().all(|t| t.lost.is_none()), "{:?}", all[0].lost);
        let used = all[0].fields.iter().map(|f| (f.camera, f.field)).collect::<Vec<_>>();
        assert_eq!(used, [(0, 0), (1, 0)]);
        assert_eq!((all[0].request.used_count, all[0].request.field), (2, 10));
        assert_eq!((handles(&all[0]), handles(&all[1])), (vec![0, 1], vec![]));
    }

    #[test]
    fn a_pose_that_was_not_stepped_has_no_step() {
        let all = turns(vec![
            (1, pose(0, &[])),
            (1, step(1, 0, 0)),
            (20, pose(1, &[])),
            (40, pose(2, &[])),
            (41, step(2, 2, 0)),
        ]);
        assert_eq!(all.iter().map(|t| t.step.is_some()).collect::<Vec<_>>(), [true, false, true]);
        assert!(all.iter().all(|t| t.lost.is_none()));
    }

    #[test]
    fn steps_made_again_in_silence_are_made_with_what_had_come() {
        // The simulation died after step 1; its successor made step 2 from pose 1, and published
        // step 3.
        let all = turns(vec![
            (1, pose(0, &[])),
            (1, step(1, 0, 0)),
            (19, handle(0)),
            (20, pose(1, &[])),
            (39, handle(1)),
            (40, pose(2, &[])),
            (41, step(3, 2, 2)),
        ]);
        assert!(all.iter().all(|t| t.lost.is_none()), "{all:?}");
        assert!(all[1].step.as_ref().is_some_and(|s| s.recorded.is_none()));
        assert_eq!((handles(&all[1]), handles(&all[2])), (vec![0], vec![1]));
    }

    #[test]
    fn restarted_senders_are_followed() {
        let all = turns(vec![
            (1, handle(7)),
            (1, handle(8)),
            (2, pose(0, &[])),
            (2, step(1, 0, 9)),
            (3, handle(9)),
            (4, handle(0)),
            (5, handle(1)),
            (6, pose(1, &[])),
            (6, step(2, 1, 1)),
            (7, pose(0, &[])),
            (7, step(1, 0, 2)),
        ]);
        assert_eq!(all.iter().map(handles).collect::<Vec<_>>(), [vec![7, 8], vec![9, 0], vec![1]]);
        let fresh: Vec<_> = all.iter().map(|t| t.step.as_ref().unwrap().fresh).collect();
        assert_eq!(fresh, [false, false, true]);
    }

    #[test]
    fn losses_are_named_once_where_they_are() {
        let lost = |items| turns(items).into_iter().filter_map(|t| t.lost).collect::<Vec<_>>();
        let missing_field =
            vec![(1, pose(0, &[(2, 5)])), (1, step(1, 0, 0)), (2, pose(1, &[])), (2, step(2, 1, 0))];
        assert_eq!(lost(missing_field), ["field 5 of camera 2 is missing"]);
        let middle = vec![(1, pose(4, &[])), (1, step(1, 4, 0))];
        assert_eq!(lost(middle), ["the recording begins at tracker frame 4, not at 0"]);
        let handle_gone = vec![(1, pose(0, &[])), (1, step(1, 0, 4))];
        assert_eq!(lost(handle_gone), ["handle state 3 is missing (field 10)"]);
        let step_gone = vec![(1, pose(0, &[])), (1, step(1, 0, 0)), (2, pose(1, &[])), (2, step(4, 1, 0))];
        assert_eq!(lost(step_gone), ["step 4 follows 1 (field 11)"]);
        let text = "3 items did not fit".to_string();
        let note = Note { instant_ns: 0, kind: NoteKind::Loss, process: None, count: 3, text: text.clone() };
        assert_eq!(lost(vec![(1, Item::Note(note)), (2, pose(0, &[]))]), [text]);
    }

    #[test]
    fn damage_ends_the_turns_and_is_kept() {
        let damage = RecordingError::Truncated { file: "a".into(), offset: 9 };
        let items = vec![Ok((1, pose(0, &[]))), Err(damage), Ok((2, pose(1, &[])))];
        let mut turns = Turns::new(items.into_iter());
        assert_eq!(turns.by_ref().count(), 1);
        assert!(matches!(turns.damage, Some(RecordingError::Truncated { offset: 9, .. })));
    }
}
