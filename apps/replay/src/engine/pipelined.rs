//! A recorded run to its end, on several cores: one thread reads ahead, one tracks, one does the steps. Where there
//! are two cores, the system shares them out as the work is: some recordings cost more to track, others more to
//! step.
//!
//! A step consumes the recorded poses, not those that the tracker makes now, so that neither waits for the
//! other's results. What comes of the run comes in the order of [`Recorded::run`], with the same bits.

use super::{Made, Recorded, is_before_beginning, keep_newest, made_for, track_turn};
use crate::frames::{FrameTurn, Frames};
use crate::steps::{SavedState, Steps};
use bytemuck::Zeroable;
use diagnosis::Due;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::matches::MatchFrame;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use recording::{Item, Items, RecordingError};
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread;
use tracker::Tracker;
use tracker::report::Report;

/// Items that go from thread to thread together, and how many such batches wait at most.
const BATCH: usize = 128;
const BATCHES: usize = 8;

/// How a run has ended.
pub struct Ended {
    /// `visit` had enough.
    pub stopped: bool,
    /// Frames that should have been, of those that were visited.
    pub due: Due,
    /// What is missing behind the last frame; of no use where the run was stopped.
    pub frames_lost: Option<String>,
    /// The steps.
    pub steps: Steps,
    /// What is wrong with the file first, if something is.
    pub damage: Option<Arc<RecordingError>>,
}

/// What was read; `None` at the end.
type Read = Option<Result<(Nanos, Item), Arc<RecordingError>>>;

/// A frame whose turn has come.
struct Turn {
    turn: FrameTurn,
    /// What the tracker makes of it, and of its blobs; nothing at a desk.
    made: Option<(TrackerFrame, Box<MatchFrame>)>,
    /// It is before the place at which the recording was cut.
    before_beginning: bool,
    /// It is the last of those.
    leads_in: bool,
}

/// What was read, and the frames whose turn came with it.
type Ahead = (Read, Vec<Turn>);

/// The thread that tracks.
struct Tracking {
    tracker: Option<(Box<Tracker>, Report)>,
    frames: Frames,
    begins_with: Option<(TrackerCheckpointHeader, SavedState)>,
    /// Matches that were visited come back to be written over: they are large.
    visited: Receiver<Box<MatchFrame>>,
}

impl Recorded {
    /// Runs it to its end, or until `visit` has enough.
    ///
    /// # Errors
    /// Those of `visit`.
    ///
    /// # Panics
    /// Where the tracker panics.
    pub fn run_to_end(
        mut self,
        visit: impl FnMut(Made<'_>) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<Ended> {
        if thread::available_parallelism().is_ok_and(|cores| cores.get() == 1) {
            let stopped = self.run(visit)?;
            let Recorded { frames, steps, damage, .. } = self;
            return Ok(Ended { stopped, due: frames.due, frames_lost: frames.lost, steps, damage });
        }
        let Recorded { items, tracker, frames, begins_with, steps, damage, made } = self;
        let due = frames.due.clone();
        let (give_back, visited) = channel();
        let tracking = Tracking { tracker, frames, begins_with, visited };
        let mut ended = Ended { stopped: false, due, frames_lost: None, steps, damage };
        thread::scope(|scope| {
            let (send_read, read) = sync_channel(BATCHES);
            let (send_tracked, tracked) = sync_channel(BATCHES);
            let reader = scope.spawn(move || read_ahead(items, &send_read));
            let tracker = scope.spawn(move || tracking.track_ahead(&read, &send_tracked));
            let stopped = ended.follow(&tracked, &give_back, made, visit);
            // Else the other threads would wait for room.
            drop(tracked);
            ended.frames_lost = tracker.join().unwrap_or_else(|panic| resume_unwind(panic));
            reader.join().unwrap_or_else(|panic| resume_unwind(panic));
            ended.stopped = stopped?;
            Ok(ended)
        })
    }
}

/// Reads until the end, or until the receiver is dropped.
fn read_ahead(mut items: Items, send: &SyncSender<Vec<Read>>) {
    let mut at_end = false;
    while !at_end {
        let mut batch = Vec::with_capacity(BATCH);
        while batch.len() < BATCH && !at_end {
            let read = items.next().map(|read| read.map_err(Arc::new));
            at_end = read.is_none();
            batch.push(read);
        }
        at_end |= send.send(batch).is_err();
    }
}

impl Tracking {
    /// Tracks until the end, or until the receiver is dropped; returns what is missing after the last frame.
    fn track_ahead(mut self, receive: &Receiver<Vec<Read>>, send: &SyncSender<Vec<Ahead>>) -> Option<String> {
        for batch in receive {
            let ahead = batch.into_iter().map(|read| {
                match &read {
                    Some(Ok((at, item))) => self.frames.note(*at, item),
                    Some(Err(error)) => self.frames.note_damage(error),
                    None => self.frames.end(),
                }
                let turns = std::iter::from_fn(|| self.next_turn()).collect();
                (read, turns)
            });
            if send.send(ahead.collect()).is_err() {
                break;
            }
        }
        self.frames.lost
    }

    /// The next frame whose turn has come, and what the tracker makes of it.
    fn next_turn(&mut self) -> Option<Turn> {
        let Tracking { tracker, frames, begins_with, visited } = self;
        let mut turn = frames.next_turn()?;
        let own = tracker.as_mut().map(|(tracker, _)| &mut **tracker);
        let before_beginning = is_before_beginning(begins_with, own, frames, &turn);
        let leads_in = before_beginning && begins_with.is_none();
        let made = if before_beginning { None } else { track_turn(tracker, &mut turn, frames) };
        let matches = tracker.as_ref().filter(|_| made.is_some()).map(|(tracker, _)| {
            let mut matches = visited.try_recv().unwrap_or_else(|_| Box::new(MatchFrame::zeroed()));
            matches.copy_from(tracker.matches());
            matches
        });
        Some(Turn { turn, made: made.zip(matches), before_beginning, leads_in })
    }
}

impl Ended {
    /// Does the steps, and gives all to `visit`; true where that had enough.
    fn follow(
        &mut self,
        receive: &Receiver<Vec<Ahead>>,
        give_back: &Sender<Box<MatchFrame>>,
        mut newest: VecDeque<Arc<TrackerFrame>>,
        mut visit: impl FnMut(Made<'_>) -> anyhow::Result<ControlFlow<()>>,
    ) -> anyhow::Result<bool> {
        for (read, turns) in receive.iter().flatten() {
            match read {
                Some(Ok((at, item))) => {
                    if let Item::Blobs(field) = &item {
                        self.due.note_field(field);
                    }
                    self.steps.note(at, item);
                }
                Some(Err(damage)) => drop(self.damage.get_or_insert(damage)),
                None => self.steps.end(),
            }
            let mut flow = ControlFlow::Continue(());
            for Turn { turn, made, before_beginning, leads_in } in turns {
                self.due.note_frame(&turn.recorded);
                if leads_in {
                    self.due.begin_here();
                }
                if before_beginning {
                    continue;
                }
                made.iter().for_each(|(frame, _)| keep_newest(&mut newest, *frame));
                let frame = made.as_ref().map_or(&*turn.recorded, |(frame, _)| frame);
                let matches = made.as_ref().map(|(_, matches)| &**matches);
                flow = visit(Made::Frame(&turn, frame, matches))?;
                if flow.is_break() {
                    break;
                }
                // At the end the receiver may be gone.
                made.into_iter().for_each(|(_, matches)| drop(give_back.send(matches)));
            }
            while let Some(mut again) = self.steps.next_step() {
                again.made = made_for(&newest, &again);
                if visit(Made::Step(&again))?.is_break() {
                    return Ok(true);
                }
            }
            if flow.is_break() {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
