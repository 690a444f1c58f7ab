//! A receiver on every channel of an instance, for the launcher.

use crate::runtime::Wakeups;
use ipc::{BlockReceiver, BlockSample, Instance, IpcError, MAX_SOURCES, Queue, Receiver, Wakes, wait};
use protocol::blobs::BlobField;
use protocol::checkpoints::TrackerCheckpointHeader;
use protocol::control::{Answer, Request};
use protocol::events::Event;
use protocol::frames::{FrameRecord, PictureHeader};
use protocol::handles::{HandleState, PedalState};
use protocol::health::Health;
use protocol::inputs::InputEvent;
use protocol::matches::MatchFrame;
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, StepRecord};
use protocol::time::Nanos;
use recording::Item;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::{Interval, MissedTickBehavior, interval};

/// Period of draining the data channels. Waking up for each of some hundred blocks per second would cost more
/// than taking several at once; the queues are long enough for more than a second.
const DRAIN_PERIOD: Duration = Duration::from_millis(10);

/// A receiver on every channel of an instance.
pub struct ChannelTap {
    blobs: Receiver<BlobField>,
    handles: Receiver<HandleState>,
    pedal: Receiver<PedalState>,
    poses: Receiver<TrackerFrame>,
    matches: Receiver<MatchFrame>,
    steps: Receiver<StepRecord>,
    events: Receiver<Event>,
    frames: Receiver<FrameRecord>,
    checkpoints: BlockReceiver<CheckpointHeader>,
    tracker_checkpoints: BlockReceiver<TrackerCheckpointHeader>,
    pictures: BlockReceiver<PictureHeader>,
    /// Heartbeats of the processes.
    pub health: Receiver<Health>,
    /// Inputs from keyboard, mouse and gamepad.
    pub inputs: Receiver<InputEvent>,
    /// Requests from any sender to any process.
    pub requests: Receiver<Request>,
    /// Answers from the processes.
    pub answers: Receiver<Answer>,
    /// Wakes up on inputs, requests and answers.
    control: Wakeups,
    due: Interval,
}

fn drain<M: Message + std::fmt::Debug>(
    receiver: &mut Receiver<M>,
    now: Nanos,
    item: impl Fn(M) -> Item,
    take: &mut impl FnMut(Nanos, Item),
) -> Result<(), IpcError> {
    while let Some(message) = receiver.next_valid()? {
        let item = item(message);
        take(item.instant_ns().unwrap_or(now), item);
    }
    Ok(())
}

/// Copies the used part of a payload.
fn payload_of<H: Message>(sample: &BlockSample<H>, bytes: u64) -> Vec<u8> {
    sample.payload()[..(bytes as usize).min(sample.payload().len())].to_vec()
}

impl ChannelTap {
    /// Opens every channel. To be called before the processes are started, so that no message is missed.
    ///
    /// # Errors
    /// If a channel cannot be opened.
    pub fn open(instance: &Instance) -> anyhow::Result<Self> {
        let mut due = interval(DRAIN_PERIOD);
        due.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let inputs = instance.receiver(Queue::InOrder)?;
        let (requests, answers) = (instance.receiver(Queue::InOrder)?, instance.receiver(Queue::InOrder)?);
        Ok(ChannelTap {
            control: Wakeups::of(&[&inputs, &requests, &answers])?,
            due,
            blobs: instance.receiver(Queue::InOrder)?,
            handles: instance.receiver(Queue::InOrder)?,
            pedal: instance.receiver(Queue::InOrder)?,
            poses: instance.receiver(Queue::InOrder)?,
            matches: instance.receiver(Queue::InOrder)?,
            steps: instance.receiver(Queue::InOrder)?,
            events: instance.receiver(Queue::InOrder)?,
            frames: instance.receiver(Queue::InOrder)?,
            checkpoints: instance.block_receiver()?,
            tracker_checkpoints: instance.block_receiver()?,
            pictures: instance.block_receiver()?,
            health: instance.receiver(Queue::InOrder)?,
            inputs,
            requests,
            answers,
        })
    }

    fn sources(&self) -> [&dyn Wakes; 15] {
        [
            &self.blobs,
            &self.handles,
            &self.pedal,
            &self.poses,
            &self.matches,
            &self.steps,
            &self.events,
            &self.frames,
            &self.checkpoints,
            &self.tracker_checkpoints,
            &self.pictures,
            &self.health,
            &self.inputs,
            &self.requests,
            &self.answers,
        ]
    }

    /// Waits until a request, an input or an answer arrives, or the data channels are due to be drained.
    pub async fn wait(&mut self) {
        tokio::select! {
            _ = self.due.tick() => {}
            () = self.control.wait(DRAIN_PERIOD) => {}
        }
    }

    /// Gives every received item to `take`, together with its log time, ns. Inputs come before the results
    /// computed from them, so that a reader of the recording gets them in that order.
    ///
    /// # Errors
    /// If a channel fails.
    pub fn drain(&mut self, now: Nanos, mut take: impl FnMut(Nanos, Item)) -> Result<(), IpcError> {
        self.sources().chunks(MAX_SOURCES).for_each(|sources| wait(sources, 0));
        // Results first, so that their inputs are already queued when their channels are drained.
        let of_tracker = self.tracker_checkpoints.receive()?;
        let of_tracker =
            of_tracker.map(|s| Item::TrackerCheckpoint(*s.header(), payload_of(&s, s.header().bytes)));
        let checkpoint = self.checkpoints.receive()?;
        let checkpoint = checkpoint.map(|s| Item::Checkpoint(*s.header(), payload_of(&s, s.header().bytes)));
        let (mut steps, mut poses) = (Vec::new(), Vec::new());
        drain(&mut self.steps, now, Item::Step, &mut |at, item| steps.push((at, item)))?;
        drain(&mut self.poses, now, |p| Item::Poses(Box::new(p)), &mut |at, item| poses.push((at, item)))?;
        drain(&mut self.blobs, now, |b| Item::Blobs(Box::new(b)), &mut take)?;
        drain(&mut self.handles, now, Item::Handle, &mut take)?;
        drain(&mut self.pedal, now, Item::Pedal, &mut take)?;
        poses.into_iter().chain(steps).for_each(|(at, item)| take(at, item));
        drain(&mut self.matches, now, |m| Item::Matches(Box::new(m)), &mut take)?;
        drain(&mut self.events, now, Item::Event, &mut take)?;
        drain(&mut self.frames, now, Item::Frame, &mut take)?;
        of_tracker.into_iter().chain(checkpoint).for_each(|item| take(now, item));
        if let Some(sample) = self.pictures.receive()? {
            let item = Item::Picture(*sample.header(), payload_of(&sample, sample.header().bytes));
            take(item.instant_ns().unwrap_or(now), item);
        }
        Ok(())
    }

    /// Number of messages that were overwritten before the launcher read them or were invalid, by channel.
    /// Checkpoints and pictures are newest-wins channels and not counted.
    pub fn lost(&self) -> BTreeMap<&'static str, u64> {
        let counts = [
            (BlobField::CHANNEL, self.blobs.counts()),
            (HandleState::CHANNEL, self.handles.counts()),
            (PedalState::CHANNEL, self.pedal.counts()),
            (TrackerFrame::CHANNEL, self.poses.counts()),
            (MatchFrame::CHANNEL, self.matches.counts()),
            (StepRecord::CHANNEL, self.steps.counts()),
            (Event::CHANNEL, self.events.counts()),
            (FrameRecord::CHANNEL, self.frames.counts()),
        ];
        counts.map(|(channel, c)| (channel, c.lost + c.refused)).into_iter().filter(|(_, n)| *n > 0).collect()
    }
}
