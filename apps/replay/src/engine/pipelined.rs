//! A recorded run to its end, on two cores: one thread reads and tracks ahead, the other does the steps.
//!
//! A step consumes the recorded poses, not those that the tracker makes now, so that neither waits for the
//! other's results. What comes of the run comes in the order of [`Recorded::run`], with the same bits.

use super::{Made, Recorded, track_turn};
use crate::frames::{FrameTurn, Frames};
use crate::steps::Steps;
use diagnosis::Due;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use recording::{Item, Items, RecordingError};
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
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

/// What was read, and the frames whose turn came with it. At a desk nothing is made of them.
type Ahead = (Read, Vec<(FrameTurn, Option<TrackerFrame>)>);

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
        let Recorded { items, tracker, frames, steps, damage } = self;
        let due = frames.due.clone();
        let mut ended = Ended { stopped: false, due, frames_lost: None, steps, damage };
        thread::scope(|scope| {
            let (send, receive) = sync_channel(BATCHES);
            let ahead = scope.spawn(move || read_ahead(items, tracker, frames, &send));
            let stopped = ended.follow(&receive, visit);
            // Else the other thread would wait for room.
            drop(receive);
            ended.frames_lost = ahead.join().unwrap_or_else(|panic| resume_unwind(panic));
            ended.stopped = stopped?;
            Ok(ended)
        })
    }
}

/// Reads and tracks until the end, or until nobody follows; what is missing behind the last frame.
fn read_ahead(
    mut items: Items,
    mut tracker: Option<(Tracker, Report)>,
    mut frames: Frames,
    send: &SyncSender<Vec<Ahead>>,
) -> Option<String> {
    loop {
        let mut batch = Vec::with_capacity(BATCH);
        let mut at_end = false;
        while batch.len() < BATCH && !at_end {
            let read: Read = items.next().map(|read| read.map_err(Arc::new));
            match &read {
                Some(Ok((at, item))) => frames.note(*at, item),
                Some(Err(error)) => frames.note_damage(error),
                None => {
                    frames.end();
                    at_end = true;
                }
            }
            let mut turns = Vec::new();
            while let Some(mut turn) = frames.next_turn() {
                let made = track_turn(&mut tracker, &mut turn, &mut frames);
                turns.push((turn, made));
            }
            batch.push((read, turns));
        }
        if send.send(batch).is_err() || at_end {
            return frames.lost;
        }
    }
}

impl Ended {
    /// Does the steps, and gives all to `visit`; true where that had enough.
    fn follow(
        &mut self,
        receive: &Receiver<Vec<Ahead>>,
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
            for (turn, made) in turns {
                self.due.note_frame(&turn.recorded);
                flow = visit(Made::Frame(&turn, made.as_ref().unwrap_or(&turn.recorded)))?;
                if flow.is_break() {
                    break;
                }
            }
            while let Some(again) = self.steps.next_step() {
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
