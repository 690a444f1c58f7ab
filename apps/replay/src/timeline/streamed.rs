//! An imported stream as a recorded run: the frames that the tracker makes of it by the stream's own clock, the
//! steps that follow, and checkpoints of both.

use super::saving;
use crate::engine::{Streamed, stream};
use crate::pace::Stopped;
use crate::stop::StopSignal;
use bytemuck::Zeroable;
use protocol::checkpoints::{CheckpointTimes, TrackerCheckpointHeader};
use protocol::poses::TrackerFrame;
use protocol::steps::StepRecord;
use protocol::time::{Instants, Nanos};
use recording::{Item, Recording};
use rig::Rig;
use simcore::world::{StepReport, World};
use std::ops::ControlFlow;

/// Plays a stream, and hands its fields, frames, steps and checkpoints to `write`, with their log times.
/// `progress` gets the bytes that were read.
///
/// # Errors
/// Those of `write`, and where the user stops it.
pub fn save(
    recording: &Recording,
    rig: &Rig,
    world: World,
    stop: &StopSignal,
    mut progress: impl FnMut(u64),
    mut write: impl FnMut(Nanos, &Item) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut times = CheckpointTimes::default();
    let (mut now_ns, mut due) = (0, false);
    let damage = stream(recording, rig, world, |made| {
        if stop.is_raised() {
            return Err(Stopped.into());
        }
        match made {
            Streamed::Field(field, bytes) => {
                now_ns = field.blobs_out_ns.max(now_ns);
                progress(bytes);
                write(now_ns, &Item::Blobs(Box::new(*field)))?;
            }
            Streamed::Frame { frame, tracker, world, report, .. } => {
                write(now_ns, &Item::Poses(Box::new(*frame)))?;
                write(now_ns, &Item::Step(record_of(frame, world, &report, now_ns)))?;
                due |= times.after_frame(frame.instants.exposed);
                if let Some(tracker) = tracker.filter(|_| due) {
                    due = false;
                    let TrackerFrame { frame: number, field, .. } = *frame;
                    let exposed_ns = frame.instants.exposed;
                    let header = TrackerCheckpointHeader { frame: number, field, exposed_ns, bytes: 0 };
                    write(now_ns, &saving::of_tracker(header, tracker)?)?;
                    write(now_ns, &saving::of_world(world)?)?;
                }
            }
        }
        Ok(ControlFlow::Continue(()))
    })?;
    if let Some(problem) = damage {
        tracing::warn!("the stream ends where it is damaged: {problem}");
    }
    Ok(())
}

fn record_of(frame: &TrackerFrame, world: &World, report: &StepReport, stepped_ns: Nanos) -> StepRecord {
    let state = world.state();
    let mut record = StepRecord::zeroed();
    (record.step, record.field, record.frame) = (state.step, frame.field, frame.frame);
    record.instants = Instants { stepped: stepped_ns, ..frame.instants };
    (record.handles_below, record.pedals_below) = (state.handles_below, state.pedals_below);
    (record.advanced_ns, record.state_hash) = (report.advanced_ns, report.state_hash);
    record.with_inputs(report.inputs)
}
