//! The tracker's frames of a recording, and the camera-fields that each consumed. Pure; takes items,
//! not files.
//!
//! The recorder wrote blocks in the order of arrival, which is not quite the order of cause: a field can
//! stand behind the frame that consumed it. So a frame's turn comes some time behind it, and what
//! belongs together is matched by number.
//!
//! Where a field or a frame is missing, the poses that follow are not determined any more, because the
//! tracker remembers what it saw, until a checkpoint says what it knew or a tracker that was started again
//! counts from 0.

use diagnosis::Due;
use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use recording::{Item, NoteKind, RecordingError};
use std::collections::VecDeque;
use std::sync::Arc;

/// How far a consumed block may stand behind what consumed it, ns.
pub const AHEAD_NS: u64 = 500_000_000;
/// How long a camera-field is kept for frames to come, ns of log time. So what a run knows follows from the
/// items of that time and what tracker and world knew, wherever reading began.
pub const FIELDS_KEPT_NS: u64 = 10_000_000_000;
/// Camera-fields kept at most: more than those of three cameras in that time.
const FIELDS_KEPT: usize = 2048;
/// Checkpoints of the tracker kept for frames to come. One comes every two seconds, and after a restart.
const CHECKPOINTS: usize = 4;

/// One recorded frame.
#[derive(Debug, Clone)]
pub struct FrameTurn {
    /// The camera-fields that it consumed, as far as they were recorded, in that order.
    pub fields: Vec<BlobField>,
    /// What was recorded.
    pub recorded: Box<TrackerFrame>,
    /// The recording determines the poses: the tracker has been given all that it saw.
    pub determined: bool,
    /// What of the recording is missing here; given once for each loss.
    pub lost: Option<String>,
    /// What the tracker knew before this frame, where a gap lies before it: with it, the poses are
    /// determined again.
    pub known: Option<Arc<Vec<u8>>>,
}

/// What waits for its turn, with its place in time.
#[derive(Debug, Clone)]
enum Pending {
    Pose(Box<TrackerFrame>),
    Lost(String),
}

/// Frames that wait until all that they consumed has come.
#[derive(Debug, Clone)]
pub struct Frames {
    horizon_ns: Nanos,
    ended: bool,
    pending: VecDeque<(Nanos, Pending)>,
    /// Camera-fields with their log times.
    fields: VecDeque<(Nanos, Arc<BlobField>)>,
    last_frame: Option<u64>,
    /// Since the last loss no pose has been determined.
    undetermined: bool,
    /// The newest checkpoints of the tracker, which stand behind their frames as fields may.
    checkpoints: VecDeque<(TrackerCheckpointHeader, Arc<Vec<u8>>)>,
    fields_read: u64,
    /// The poses are a desk's: no tracker made them.
    desk: bool,
    /// Frames that should have been.
    pub due: Due,
    /// A loss that no frame has reported yet; at the end, one behind the last frame.
    pub lost: Option<String>,
}

impl Frames {
    /// Of cameras with this field period, ns, or of a desk.
    pub fn new(period_ns: u64, desk: bool) -> Self {
        Frames {
            horizon_ns: 0,
            ended: false,
            pending: VecDeque::new(),
            fields: VecDeque::new(),
            last_frame: None,
            undetermined: false,
            checkpoints: VecDeque::new(),
            fields_read: 0,
            desk,
            due: Due::new(period_ns),
            lost: None,
        }
    }

    /// Takes the next item.
    pub fn note(&mut self, at: Nanos, item: &Item) {
        self.horizon_ns = self.horizon_ns.max(at);
        let is_old = |at: &Nanos| at.saturating_add(FIELDS_KEPT_NS) < self.horizon_ns;
        while self.fields.front().is_some_and(|(at, _)| is_old(at)) {
            self.fields.pop_front();
        }
        match item {
            Item::Blobs(field) => {
                self.due.note_field(field);
                self.fields_read += 1;
                if self.fields.len() == FIELDS_KEPT {
                    self.fields.pop_front();
                }
                self.fields.push_back((at, Arc::new(**field)));
            }
            Item::Poses(frame) => self.pending.push_back((at, Pending::Pose(frame.clone()))),
            Item::TrackerCheckpoint(header, state) => {
                if self.checkpoints.len() == CHECKPOINTS {
                    self.checkpoints.pop_front();
                }
                self.checkpoints.push_back((*header, Arc::new(state.clone())));
            }
            Item::Note(note) if note.kind == NoteKind::Loss => self.note_loss(note.text.clone()),
            _ => {}
        }
    }

    /// Takes what is wrong with the file here. Where it was cut, nothing follows that is missing.
    pub fn note_damage(&mut self, error: &RecordingError) {
        if !matches!(error, RecordingError::Truncated { .. }) {
            self.note_loss(error.to_string());
        }
    }

    /// Takes what is missing of the recording here.
    pub fn note_loss(&mut self, what: String) {
        self.pending.push_back((self.horizon_ns, Pending::Lost(what)));
    }

    /// No item will come any more.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// The next frame, once all that it can have consumed has come.
    pub fn next_turn(&mut self) -> Option<FrameTurn> {
        loop {
            let (at, _) = self.pending.front()?;
            if !self.ended && self.horizon_ns < at.saturating_add(AHEAD_NS) {
                return None;
            }
            match self.pending.pop_front()?.1 {
                Pending::Pose(frame) => return Some(self.turn(frame)),
                Pending::Lost(text) => self.lose(|| text),
            }
        }
    }

    /// Notes that something is missing. What follows is determined all the same where, by their numbers,
    /// no inputs are.
    fn lose(&mut self, why: impl FnOnce() -> String) {
        if self.lost.is_none() {
            self.lost = Some(why());
        }
    }

    /// Notes why poses are no longer determined.
    fn lose_poses(&mut self, why: impl FnOnce() -> String) {
        self.undetermined = true;
        if !self.desk {
            self.lose(why);
        }
    }

    fn turn(&mut self, frame: Box<TrackerFrame>) -> FrameTurn {
        self.due.note_frame(&frame);
        // A tracker that was started again remembers nothing.
        self.undetermined &= frame.frame != 0;
        match self.last_frame.replace(frame.frame) {
            _ if frame.frame == 0 => {}
            None => {
                self.lose_poses(|| {
                    format!("the recording begins at tracker frame {}, not at 0", frame.frame)
                });
            }
            Some(before) if frame.frame != before + 1 => {
                self.lose_poses(|| format!("tracker frame {} follows {before}", frame.frame));
            }
            Some(_) => {}
        }
        let known = self.known_before(&frame);
        self.undetermined &= known.is_none();
        // Without any field, frames that used none prove nothing.
        self.undetermined |= self.fields_read == 0;
        let mut fields = Vec::with_capacity(frame.used().len());
        for used in frame.used() {
            let is_it = |(_, f): &(Nanos, Arc<BlobField>)| {
                (f.camera, f.field, f.exposed_ns) == (used.camera, used.field, used.exposed_ns)
            };
            match self.fields.iter().position(is_it).and_then(|i| self.fields.remove(i)) {
                Some((_, field)) => fields.push(*field),
                None => {
                    self.lose_poses(|| format!("field {} of camera {} is missing", used.field, used.camera));
                }
            }
        }
        FrameTurn { fields, recorded: frame, determined: !self.undetermined, lost: self.lost.take(), known }
    }

    /// What the tracker knew when it made the frame before this one, where that is not known otherwise.
    fn known_before(&self, frame: &TrackerFrame) -> Option<Arc<Vec<u8>>> {
        let exposed = frame.instants.exposed;
        let is_its = |h: &TrackerCheckpointHeader| {
            h.frame.checked_add(1) == Some(frame.frame)
                && (1..=AHEAD_NS).contains(&exposed.wrapping_sub(h.exposed_ns))
        };
        let found = self.checkpoints.iter().rev().find(|(header, _)| is_its(header));
        found.filter(|_| self.undetermined).map(|(_, state)| Arc::clone(state))
    }

    /// Newest log time that was read, ns.
    pub fn horizon_ns(&self) -> Nanos {
        self.horizon_ns
    }

    /// The tracker has been given what one knew that saw everything up to the newest frame: what is missing
    /// before it does not matter.
    pub fn go_on_determined(&mut self) {
        (self.undetermined, self.lost) = (false, None);
    }

    /// The checkpoint that a turn came with is of no use: poses are no more determined than before.
    pub fn go_on_undetermined(&mut self, turn: &mut FrameTurn) {
        (self.undetermined, turn.determined) = (true, false);
    }
}

#[cfg(test)]
mod tests;
