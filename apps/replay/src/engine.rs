//! A recording runs through tracker and simulation again, in one process and without a clock.
//!
//! A recorded run is repeated by its record: the tracker gets the camera-fields that each frame
//! consumed, the simulation what each step consumed, which are the recorded poses; both come out to the
//! bit. An imported stream has no such record: there the tracker decides by the stream's own clock, and
//! the simulation gets what it makes.

pub mod pipelined;

use crate::frames::{FrameTurn, Frames};
use crate::steps::{SavedState, StepAgain, Steps};
use crate::what_if::tuning_or_default;
use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::matches::MatchFrame;
use protocol::message::Message;
use protocol::poses::{ClosedBy, TrackerFrame};
use protocol::steps::StepInput;
use recording::{CUT, Item, Items, Recording, RecordingError};
use rig::Rig;
use simcore::world::{StepReport, World, no_clock};
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;
use tracker::assembler::ClosedFrame;
use tracker::report::Report;
use tracker::stream::StreamTracker;
use tracker::tracker::{close, stamp};
use tracker::{Reference, Tracker};

/// What comes of a recording, in the order in which it comes about.
pub enum Made<'a> {
    /// A recorded frame, what the tracker makes of its fields, and what became of their blobs; nothing of a
    /// desk's.
    Frame(&'a FrameTurn, &'a TrackerFrame, Option<&'a MatchFrame>),
    /// A step.
    Step(&'a StepAgain<'a>),
}

/// A recorded run under way.
pub struct Recorded {
    pub(crate) items: Items,
    /// None at a desk, where no tracker made the poses. On the heap: its states are large, and threads have
    /// little stack.
    pub(crate) tracker: Option<(Box<Tracker>, Report)>,
    /// The frames, and what is missing of them.
    pub frames: Frames,
    /// The steps, and what is missing of them.
    pub steps: Steps,
    /// What is wrong with the file first, if something is.
    pub damage: Option<Arc<RecordingError>>,
    /// The newest frames that the tracker made, which are ahead of their steps.
    pub(crate) made: VecDeque<Arc<TrackerFrame>>,
    /// What the tracker knew where the recording was cut, until the frame before that has come.
    pub(crate) begins_with: Option<(TrackerCheckpointHeader, SavedState)>,
}

/// What a run needs of a recording. Matches and pictures, which the rest depends on by nothing, are most of its
/// bytes: they are not unpacked.
pub(crate) const TOPICS: [&str; 10] = [
    "blobs",
    "handles",
    "pedal",
    "poses",
    "steps",
    "events",
    "frames",
    "checkpoints",
    "notes",
    "tracker-checkpoints",
];

/// Frames that are kept for their steps.
const FRAMES: usize = 32;

impl Recorded {
    /// At the beginning of `recording`, in a world at the start of its scene.
    // What it builds on its way to the heap is large: not in the frame of a caller, who keeps it.
    #[inline(never)]
    pub fn new(recording: &Recording, rig: &Rig, world: World) -> Self {
        let desk = recording.provenance().config.contains_key(recording::DESK);
        let tuning = tuning_or_default(recording.provenance());
        Recorded {
            items: recording.items_of(&TOPICS),
            tracker: (!desk).then(|| (Box::new(Tracker::tuned(rig, true, &tuning)), Report::default())),
            frames: Frames::new(rig.field_period_ns(), desk),
            steps: Steps::of(recording, world),
            damage: None,
            made: VecDeque::new(),
            begins_with: (!desk).then(|| tracker_at_start(recording)).flatten(),
        }
    }

    /// With the recorded poses: no tracker makes its own.
    pub fn as_recorded(mut self) -> Self {
        self.tracker = None;
        self
    }

    /// Runs it to its end, or until `visit` has enough; true where that was so. The next call goes on from
    /// there.
    ///
    /// # Errors
    /// Those of `visit`.
    pub fn run(
        &mut self,
        mut visit: impl FnMut(Made<'_>) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<bool> {
        while self.advance(&mut visit)?.is_continue() {
            if self.steps.is_ended() {
                return Ok(false);
            }
            self.read();
        }
        Ok(true)
    }

    /// Bytes of the file read so far, for a progress bar.
    pub fn bytes_read(&self) -> u64 {
        self.items.bytes_read()
    }

    /// Takes the next item, or the end.
    pub(crate) fn read(&mut self) {
        match self.items.next() {
            Some(Ok((at, item))) => {
                self.frames.note(at, &item);
                self.steps.note(at, item);
            }
            Some(Err(error)) => {
                self.frames.note_damage(&error);
                self.damage.get_or_insert_with(|| Arc::new(error));
            }
            None => {
                self.frames.end();
                self.steps.end();
            }
        }
    }

    /// True for a frame before the place at which the recording was cut; the last of them brings what the
    /// tracker knew then.
    pub(crate) fn is_before_beginning(&mut self, turn: &FrameTurn) -> bool {
        let Recorded { begins_with, tracker, frames, .. } = self;
        is_before_beginning(begins_with, tracker.as_mut().map(|(tracker, _)| &mut **tracker), frames, turn)
    }

    /// What the tracker makes of a frame; `None` at a desk.
    pub(crate) fn track(&mut self, turn: &mut FrameTurn) -> Option<TrackerFrame> {
        let made = track_turn(&mut self.tracker, turn, &mut self.frames)?;
        keep_newest(&mut self.made, made);
        Some(made)
    }

    /// Does what can be done by now. Where `visit` has enough of frames, their steps follow.
    fn advance(
        &mut self,
        visit: &mut impl FnMut(Made<'_>) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<ControlFlow<()>> {
        let mut flow = ControlFlow::Continue(());
        while flow.is_continue()
            && let Some(mut turn) = self.frames.next_turn()
        {
            if self.is_before_beginning(&turn) {
                continue;
            }
            let made = self.track(&mut turn);
            let matches = self.tracker.as_ref().map(|(tracker, _)| tracker.matches());
            flow = visit(Made::Frame(&turn, made.as_ref().unwrap_or(&turn.recorded), matches))?;
        }
        while let Some(mut again) = self.steps.next_step() {
            again.made = made_for(&self.made, &again);
            if visit(Made::Step(&again))?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(flow)
    }
}

/// What the tracker knew where a recording was cut.
pub(crate) fn tracker_at_start(recording: &Recording) -> Option<(TrackerCheckpointHeader, SavedState)> {
    if !recording.provenance().config.contains_key(CUT) {
        return None;
    }
    let mut items = recording.items_of(&["tracker-checkpoints"]).filter_map(Result::ok);
    match items.next() {
        Some((_, Item::TrackerCheckpoint(header, state))) => Some((header, Arc::new(state))),
        _ => None,
    }
}

/// As [`Recorded::is_before_beginning`].
pub(crate) fn is_before_beginning(
    begins_with: &mut Option<(TrackerCheckpointHeader, SavedState)>,
    tracker: Option<&mut Tracker>,
    frames: &mut Frames,
    turn: &FrameTurn,
) -> bool {
    let Some((header, state)) = begins_with else { return false };
    let recorded = &turn.recorded;
    if (recorded.frame, recorded.instants.exposed) != (header.frame, header.exposed_ns) {
        return true;
    }
    let restored = tracker.map_or(Ok(()), |tracker| tracker.restore(state));
    match restored {
        Ok(()) => frames.go_on_determined(),
        Err(problem) => tracing::warn!("the tracker's state at the cut cannot be used: {problem}"),
    }
    frames.due.begin_here();
    *begins_with = None;
    true
}

/// Keeps a frame for its step.
fn keep_newest(newest: &mut VecDeque<Arc<TrackerFrame>>, made: TrackerFrame) {
    if newest.len() == FRAMES {
        newest.pop_front();
    }
    newest.push_back(Arc::new(made));
}

/// What the tracker made for the frame of a step.
fn made_for(newest: &VecDeque<Arc<TrackerFrame>>, step: &StepAgain<'_>) -> Option<Arc<TrackerFrame>> {
    newest.iter().rfind(|made| made.frame == step.poses.frame).cloned()
}

/// What the tracker makes of a frame; `None` at a desk.
fn track_turn(
    tracker: &mut Option<(Box<Tracker>, Report)>,
    turn: &mut FrameTurn,
    frames: &mut Frames,
) -> Option<TrackerFrame> {
    let (tracker, report) = tracker.as_mut()?;
    go_on_over_a_gap(tracker, turn, frames);
    let made = track(tracker, turn);
    report.log(tracker, made.field);
    Some(made)
}

/// Gives the tracker what it knew before this frame, where a gap lies before it.
fn go_on_over_a_gap(tracker: &mut Tracker, turn: &mut FrameTurn, frames: &mut Frames) {
    let Some(Err(problem)) = turn.known.as_ref().map(|known| tracker.restore(known)) else { return };
    let TrackerFrame { field, frame, .. } = *turn.recorded;
    tracing::warn!(field, frame, "the tracker's checkpoint before this frame cannot be used: {problem}");
    frames.go_on_undetermined(turn);
}

/// What a tracker makes of a recorded frame's fields.
pub(crate) fn track(tracker: &mut Tracker, turn: &FrameTurn) -> TrackerFrame {
    let recorded = &turn.recorded;
    if recorded.frame == 0 {
        tracker.reset();
    }
    let reference =
        Reference { camera: recorded.camera, field: recorded.field, exposed_ns: recorded.instants.exposed };
    let mut frame = tracker.track(&turn.fields, &reference);
    close(&mut frame, ClosedBy::from_wire(recorded.closed_by));
    stamp(&mut frame, &turn.fields, recorded.instants.taken);
    frame
}

/// What comes of an imported stream.
pub enum Streamed<'a> {
    /// A camera-field, before the tracker takes it, and the bytes of the file that were read.
    Field(&'a BlobField, u64),
    /// A frame that the tracker made, and the step that the simulation made of it.
    Frame {
        /// The frame.
        frame: &'a TrackerFrame,
        /// What became of its blobs.
        matches: &'a MatchFrame,
        /// The tracker behind it; `None` where it has made further ones already.
        tracker: Option<&'a Tracker>,
        /// The world behind the step.
        world: &'a World,
        /// The step.
        report: StepReport,
    },
}

/// Runs an imported stream to its end, to its first damage, which is returned, or until `visit` has
/// enough.
///
/// # Errors
/// Those of `visit`.
pub fn stream(
    recording: &Recording,
    rig: &Rig,
    mut world: World,
    mut visit: impl FnMut(Streamed<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Option<RecordingError>> {
    let (mut tracker, mut made) = (StreamTracker::new(rig).logging(), Vec::new());
    let mut damage = None;
    let mut items = recording.items();
    while let Some(item) = items.next() {
        let field = match item {
            Ok((_, Item::Blobs(field))) => field,
            Ok(_) => continue,
            Err(error) => {
                damage = Some(error);
                break;
            }
        };
        if visit(Streamed::Field(&field, items.bytes_read()))?.is_break() {
            break;
        }
        tracker
            .push(&field, |frame, used, closed, m| made.push((finished(frame, used, closed), Box::new(*m))));
        if simulate(&mut world, made.drain(..), &tracker, &mut visit)?.is_break() {
            return Ok(None);
        }
    }
    tracker.finish(|frame, used, closed, m| made.push((finished(frame, used, closed), Box::new(*m))));
    let _ = simulate(&mut world, made.drain(..), &tracker, &mut visit)?;
    Ok(damage)
}

fn finished(mut frame: TrackerFrame, used: &[BlobField], closed: &ClosedFrame) -> TrackerFrame {
    close(&mut frame, closed.closed_by);
    stamp(&mut frame, used, closed.taken_ns);
    frame.waited_ns = closed.waited_ns;
    frame
}

/// Makes a step of each frame. Without handles and pedal.
fn simulate(
    world: &mut World,
    frames: impl ExactSizeIterator<Item = (TrackerFrame, Box<MatchFrame>)>,
    tracker: &StreamTracker,
    visit: &mut impl FnMut(Streamed<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<ControlFlow<()>> {
    let newest = frames.len().saturating_sub(1);
    for (i, (mut frame, matches)) in frames.enumerate() {
        frame.fields_refused = tracker.refused();
        if let Err(invalid) = frame.validate() {
            tracing::error!(field = frame.field, "frame withheld: {invalid}");
            continue;
        }
        let input = StepInput { frame: &frame, handles: &[], pedals: &[] };
        let report = world.step(&input, &mut no_clock);
        let tracker = (i == newest).then(|| tracker.tracker());
        if visit(Streamed::Frame { frame: &frame, matches: &matches, tracker, world, report })?.is_break() {
            return Ok(ControlFlow::Break(()));
        }
    }
    Ok(ControlFlow::Continue(()))
}

#[cfg(test)]
mod tests;
