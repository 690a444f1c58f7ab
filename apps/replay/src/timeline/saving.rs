//! Checkpoints of tracker and simulation, made of a recording that is played.

use crate::engine::{Made, Recorded};
use crate::pace::Stopped;
use crate::stop::StopSignal;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::poses::TrackerFrame;
use protocol::steps::CheckpointHeader;
use protocol::time::Nanos;
use recording::Item;
use simcore::world::World;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use tracker::Tracker;

/// Plays a run to its end, and hands a checkpoint of tracker and simulation after each frame that `due`
/// selects by its exposure, if it is determined, to `write`, with its log time. `progress` gets the bytes of
/// the file that were read.
///
/// # Errors
/// Those of `write`, and where the user stops it.
pub fn save(
    run: &mut Recorded,
    stop: &StopSignal,
    mut progress: impl FnMut(u64),
    mut due: impl FnMut(Nanos) -> bool,
    mut write: impl FnMut(Nanos, &Item) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut wanted = BTreeSet::new();
    loop {
        // Behind a frame for which the run stops, steps may follow up to one for which it does.
        let (mut frame, mut step) = (None, None);
        let stopped = run.run(|made| {
            if stop.is_raised() {
                return Err(Stopped.into());
            }
            match made {
                Made::Frame(turn, made, _) if due(made.instants.exposed) => {
                    wanted.insert(made.instants.exposed);
                    frame = turn.determined.then(|| (turn.recorded.instants.tracked, header_of(made)));
                }
                Made::Step(again) if wanted.remove(&again.recorded.instants.exposed) => {
                    step = Some(again.step.instants.stepped);
                }
                _ => return Ok(ControlFlow::Continue(())),
            }
            Ok(ControlFlow::Break(()))
        })?;
        progress(run.bytes_read());
        if let (Some((at, header)), Some((tracker, _))) = (frame, &run.tracker) {
            write(at, &of_tracker(header, tracker)?)?;
        }
        if let Some(at) = step {
            write(at, &of_world(&run.steps.world)?)?;
        }
        if !stopped {
            return Ok(());
        }
    }
}

fn header_of(frame: &TrackerFrame) -> TrackerCheckpointHeader {
    let TrackerFrame { frame: number, field, .. } = *frame;
    TrackerCheckpointHeader { frame: number, field, exposed_ns: frame.instants.exposed, bytes: 0 }
}

/// A checkpoint of a tracker.
///
/// # Errors
/// Where it cannot be encoded.
pub fn of_tracker(header: TrackerCheckpointHeader, tracker: &Tracker) -> anyhow::Result<Item> {
    let mut state = Vec::new();
    tracker.save(&mut state)?;
    Ok(Item::TrackerCheckpoint(TrackerCheckpointHeader { bytes: state.len() as u64, ..header }, state))
}

/// A checkpoint of a world.
///
/// # Errors
/// Where it cannot be encoded.
pub fn of_world(world: &World) -> anyhow::Result<Item> {
    let mut saved = Vec::new();
    world.save(&mut saved)?;
    let state = world.state();
    let header = CheckpointHeader {
        step: state.step,
        field: state.field,
        handles_below: state.handles_below,
        pedals_below: state.pedals_below,
        state_hash: world.state_hash(),
        bytes: saved.len() as u64,
    };
    Ok(Item::Checkpoint(header, saved))
}
