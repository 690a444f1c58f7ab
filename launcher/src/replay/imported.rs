//! Replay of an imported stream: the tracker closes frames itself, by the clock of the stream.

use super::outputs::Outputs;
use super::pace::{Pace, Part};
use super::processes::ReplayProcesses;
use protocol::blobs::BlobField;
use protocol::control::Command;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use recording::{Item, Recording, RecordingError};
use std::collections::VecDeque;
use tokio::time::Instant;

/// Camera-fields sent but not known to be taken in. Every field can close a frame, so this is also
/// the most frames that can wait in the tracker's queue.
const WINDOW: u64 = 96;
const _: () = assert!((WINDOW as usize) < BlobField::QUEUE, "fields must not be overwritten");
const _: () = assert!((WINDOW as usize) < TrackerFrame::QUEUE, "frames must not be overwritten");

/// The fields that were sent, and how many of them the tracker has surely taken in.
#[derive(Debug, Default)]
struct Sent {
    count: u64,
    taken: u64,
    recent: VecDeque<(u32, u64, Nanos)>,
}

impl Sent {
    fn note(&mut self, field: &BlobField) {
        if self.recent.len() == 4 * WINDOW as usize {
            self.recent.pop_front();
        }
        self.recent.push_back((field.camera, field.field, field.exposed_ns));
        self.count += 1;
    }

    /// The tracker takes fields in order: all before one that it used have been taken.
    fn used(&mut self, frame: &TrackerFrame) {
        for used in frame.used() {
            let key = (used.camera, used.field, used.exposed_ns);
            if let Some(behind) = self.recent.iter().rev().position(|k| *k == key) {
                self.taken = self.taken.max(self.count - behind as u64);
            }
        }
    }

    fn is_full(&self) -> bool {
        self.count - self.taken >= WINDOW
    }
}

/// Runs the stream once; returns the problem at which it ended, if it did not end well.
///
/// # Errors
/// Where a process fails, a file cannot be written, or the user stops.
pub async fn run(
    recording: &Recording,
    processes: &mut ReplayProcesses,
    pace: &mut Pace,
    outputs: &mut Outputs,
) -> anyhow::Result<Option<RecordingError>> {
    let mut sent = Sent::default();
    let before = processes.tracker.received;
    let mut damage = None;
    for item in recording.items() {
        let field = match item {
            Ok((_, Item::Blobs(field))) => field,
            Ok(_) => continue,
            Err(error) => {
                damage = Some(error);
                break;
            }
        };
        let part = pace.part(field.exposed_ns);
        if part == Part::After {
            break;
        }
        if part == Part::Shown {
            pace.await_due(field.blobs_out_ns).await?;
        }
        processes.blobs.send(&field)?;
        sent.note(&field);
        outputs.field(&field, part == Part::Shown)?;
        let since = Instant::now();
        take_frames(processes, pace, outputs, &mut sent).await?;
        while sent.is_full() {
            processes.tracker.wait(since, "tracking the stream").await?;
            // Fields that were refused show in no frame, but in the heartbeat.
            sent.taken = sent.taken.max((processes.tracker.received - before).min(sent.count));
            take_frames(processes, pace, outputs, &mut sent).await?;
        }
    }
    let (flush, since) = (processes.tracker.request(Command::Flush)?, Instant::now());
    while processes.tracker.answer(flush)?.is_none() {
        take_frames(processes, pace, outputs, &mut sent).await?;
        processes.tracker.wait(since, "finishing the stream").await?;
    }
    take_frames(processes, pace, outputs, &mut sent).await?;
    Ok(damage)
}

/// Takes the frames that are there and steps the simulation with each.
async fn take_frames(
    processes: &mut ReplayProcesses,
    pace: &mut Pace,
    outputs: &mut Outputs,
    sent: &mut Sent,
) -> anyhow::Result<()> {
    while let Some(frame) = processes.try_frame()? {
        sent.used(&frame);
        let part = pace.part(frame.instants.exposed);
        outputs.frame(&frame, part == Part::Shown)?;
        let made = processes.step(&[], &[], &frame).await?;
        outputs.step(&made);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::poses::FieldUsed;

    #[test]
    fn a_used_field_tells_that_all_before_it_were_taken() {
        let mut sent = Sent::default();
        for field in 0..WINDOW {
            assert!(!sent.is_full());
            sent.note(&BlobField { field, camera: 1, ..BlobField::zeroed() });
        }
        assert!(sent.is_full());
        let mut frame = TrackerFrame::zeroed();
        frame.used[0] = FieldUsed { field: 9, exposed_ns: 0, camera: 1, blobs_used: 0 };
        frame.used_count = 1;
        sent.used(&frame);
        assert_eq!((sent.taken, sent.is_full()), (10, false));
    }
}
