//! What became of the blobs of a recording, frame by frame: as recorded, or, where that was not recorded,
//! as this tracker finds it. Without a simulation.

use crate::frames::{FrameTurn, Frames};
use outputs::progress::bytes_bar;
use protocol::blobs::BlobField;
use protocol::matches::MatchFrame;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use recording::{Item, Recording, RecordingError, Source};
use rig::Rig;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use tracker::assembler::ClosedFrame;
use tracker::stream::StreamTracker;
use tracker::{Reference, Tracker};

/// Frames whose matches wait for their turn: more than the half second by which a turn comes later.
const KEPT: usize = 512;

/// A frame, the camera-fields that it used, and what became of their blobs.
pub struct Matched<'a> {
    /// The poses.
    pub frame: &'a TrackerFrame,
    /// The camera-fields, in order, as far as they were recorded.
    pub fields: &'a [BlobField],
    /// What became of their blobs.
    pub matches: &'a MatchFrame,
}

/// Where the matches come from, and how the recording ends.
pub struct Outcome {
    /// True where they were recorded; else this tracker found them.
    pub recorded: bool,
    /// What is wrong with the file first, if something is.
    pub damage: Option<RecordingError>,
}

/// Hands every frame of a recording to `visit`, until it has enough.
///
/// # Errors
/// Those of `visit`.
pub fn run(
    recording: &Recording,
    rig: &Rig,
    what: &'static str,
    visit: impl FnMut(Matched<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Outcome> {
    match recording.provenance().source {
        Source::Import => imported(recording, rig, what, visit),
        Source::Live => live(recording, rig, what, visit),
    }
}

fn live(
    recording: &Recording,
    rig: &Rig,
    what: &'static str,
    mut visit: impl FnMut(Matched<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Outcome> {
    let recorded = recording.items_of(&[MatchFrame::CHANNEL]).any(|item| item.is_ok());
    let mut source = Found { recorded, waiting: VecDeque::new(), tracker: Tracker::new(rig) };
    let bar = bytes_bar(recording.bytes(), what);
    let mut frames = Frames::new(rig.field_period_ns(), false);
    let mut items = recording.items();
    let mut damage = None;
    loop {
        let next = items.next();
        let ended = next.is_none();
        match next {
            Some(Ok((_, Item::Matches(matches)))) => source.keep(matches),
            Some(Ok((at, item))) => frames.note(at, &item),
            Some(Err(error)) => {
                frames.note_loss(error.to_string());
                damage = damage.or(Some(error));
            }
            None => frames.end(),
        }
        bar.set_position(items.bytes_read());
        while let Some(turn) = frames.next_turn() {
            let Some(matches) = source.of_turn(&turn) else { continue };
            let matched = Matched { frame: &turn.recorded, fields: &turn.fields, matches };
            if visit(matched)?.is_break() {
                return Ok(Outcome { recorded, damage });
            }
        }
        if ended {
            bar.finish_and_clear();
            return Ok(Outcome { recorded, damage });
        }
    }
}

/// Finds the matches of a recorded frame.
struct Found {
    recorded: bool,
    waiting: VecDeque<Box<MatchFrame>>,
    tracker: Tracker,
}

impl Found {
    fn keep(&mut self, matches: Box<MatchFrame>) {
        if self.waiting.len() == KEPT {
            self.waiting.pop_front();
        }
        self.waiting.push_back(matches);
    }

    /// Those recorded of this frame; `None` where they are missing. Without any, those that this tracker
    /// makes of its fields.
    fn of_turn(&mut self, turn: &FrameTurn) -> Option<&MatchFrame> {
        let frame = &turn.recorded;
        if self.recorded {
            let its = |m: &MatchFrame| (m.frame, m.exposed_ns) == (frame.frame, frame.instants.exposed);
            let at = self.waiting.iter().position(|m| its(m))?;
            self.waiting.drain(..at);
            return self.waiting.front().map(|m| &**m);
        }
        if frame.frame == 0 {
            self.tracker.reset();
        }
        let exposed_ns = frame.instants.exposed;
        self.tracker.track(&turn.fields, &Reference { camera: frame.camera, field: frame.field, exposed_ns });
        Some(self.tracker.matches())
    }
}

fn imported(
    recording: &Recording,
    rig: &Rig,
    what: &'static str,
    mut visit: impl FnMut(Matched<'_>) -> anyhow::Result<ControlFlow<()>>,
) -> anyhow::Result<Outcome> {
    let bar = bytes_bar(recording.bytes(), what);
    let (mut tracker, mut items) = (StreamTracker::new(rig), recording.items());
    let mut outcome = Outcome { recorded: false, damage: None };
    let mut flow = Ok(ControlFlow::Continue(()));
    let mut take = |frame: TrackerFrame, fields: &[BlobField], _: &ClosedFrame, matches: &MatchFrame| {
        if matches!(flow, Ok(ControlFlow::Continue(()))) {
            flow = visit(Matched { frame: &frame, fields, matches });
        }
    };
    while let Some(item) = items.next() {
        match item {
            Ok((_, Item::Blobs(field))) => tracker.push(&field, &mut take),
            Ok(_) => {}
            Err(error) => {
                outcome.damage = Some(error);
                break;
            }
        }
        bar.set_position(items.bytes_read());
    }
    tracker.finish(&mut take);
    bar.finish_and_clear();
    flow.map(|_| outcome)
}
