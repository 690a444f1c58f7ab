//! Replaying a recorded run: the tracker tracks the recorded frames' fields, the simulation gets
//! what each step consumed, which are the recorded poses. Where the recording has a gap, the states are
//! verified from the next checkpoint on.

use super::Shown;
use super::outputs::Outputs;
use super::pace::{Pace, Part};
use super::processes::ReplayProcesses;
use super::turns::{StepTurn, Turn, Turns};
use super::verify::Verdict;
use anyhow::bail;
use protocol::control::Command;
use protocol::poses::TrackerFrame;
use recording::{Recording, RecordingError};
use std::collections::VecDeque;

/// Frames that the tracker may be ahead of the simulation. Each consumes at most 16 camera-fields,
/// and the queue holds 256.
const WINDOW: usize = 12;

/// Runs the recording once; returns what is wrong with the file first, if something is.
///
/// # Errors
/// Where a process fails, a file cannot be written, or the user stops.
pub async fn run(
    recording: &Recording,
    processes: &mut ReplayProcesses,
    pace: &mut Pace,
    shown: &mut Shown<'_>,
) -> anyhow::Result<Option<RecordingError>> {
    let Shown { outputs, verdict } = shown;
    let mut turns = Turns::new(recording.items(), outputs.field_period_ns());
    turns.desk = outputs.figures.desk;
    // The simulation's state is one that the recording determines.
    let mut known = true;
    let mut under_way: VecDeque<(Turn, bool)> = VecDeque::with_capacity(WINDOW);
    let (mut more, mut stopped_early) = (true, false);
    loop {
        let room = if pace.is_lockstep() { WINDOW } else { 1 };
        while more && under_way.len() < room {
            let next = turns.next().map(|turn| (pace.part(turn.recorded.instants.exposed), turn));
            match next {
                None => more = false,
                Some((Part::After, _)) => (more, stopped_early) = (false, true),
                Some((part, turn)) => {
                    let shown = part == Part::Shown;
                    if shown {
                        pace.await_due(turn.recorded.instants.tracked).await?;
                    }
                    begin(&turn, shown, processes, outputs)?;
                    under_way.push_back((turn, shown));
                }
            }
        }
        let Some((turn, shown)) = under_way.pop_front() else { break };
        let frame = processes.await_frame(turn.recorded.field).await?;
        if frame.field != turn.recorded.field {
            bail!("the tracker answered with field {} where {} was asked", frame.field, turn.recorded.field);
        }
        outputs.frame(&frame, shown)?;
        if let (Some(why), None) = (&turn.lost, &outputs.figures.lost) {
            outputs.figures.lost = Some(format!("field {}: {why}", turn.recorded.field));
        }
        match verdict {
            Some(verdict) if turn.determined => verdict.pose(&turn.recorded, &frame),
            Some(verdict) => verdict.pass_over_pose(),
            None => {}
        }
        if let Some(step) = &turn.step {
            known &= step.determined;
            if let (Some(checkpoint), Some(_)) = (&step.resume, &verdict) {
                known = processes.restore(checkpoint).await?;
            }
            known |= step.fresh && step.determined;
            simulate(step, &turn.recorded, processes, outputs, verdict.as_deref_mut(), known).await?;
        }
    }
    if let Some(verdict) = verdict {
        verdict.states.missing += turns.missing;
        verdict.pass_over_steps(turns.strays);
    }
    if stopped_early {
        turns.due.end_here();
    }
    outputs.count_by(turns.due.clone());
    if let (Some(why), None, false) = (&turns.lost, &outputs.figures.lost, stopped_early) {
        outputs.figures.lost = Some(format!("the last field: {why}"));
    }
    Ok(turns.damage)
}

/// Sends a turn's camera-fields and the request for its frame.
fn begin(
    turn: &Turn,
    shown: bool,
    processes: &mut ReplayProcesses,
    outputs: &mut Outputs,
) -> anyhow::Result<()> {
    for field in &turn.fields {
        processes.blobs.send(field)?;
        outputs.field(field, shown)?;
    }
    Ok(processes.recorded.send(&turn.request)?)
}

async fn simulate(
    step: &StepTurn,
    frame: &TrackerFrame,
    processes: &mut ReplayProcesses,
    outputs: &mut Outputs,
    verdict: Option<&mut Verdict>,
    known: bool,
) -> anyhow::Result<()> {
    if step.fresh {
        processes.world.command(Command::Reset).await?;
    }
    let made = processes.step(&step.handles, &step.pedals, frame).await?;
    outputs.step(&made);
    match (&step.recorded, verdict) {
        (Some(recorded), Some(verdict)) if known => verdict.step(recorded, &made),
        (Some(_), Some(verdict)) => verdict.pass_over_steps(1),
        _ => {}
    }
    Ok(())
}
