//! What comes of a recording with another rig, scene or constants, item by item and in the order of the
//! recording. Pure but for the reading of its file.

use super::beginning::Beginning;
use crate::engine::{is_before_beginning, track};
use crate::frames::Frames;
use crate::steps::{StepAgain, Steps};
use anyhow::Context;
use protocol::blobs::BlobField;
use protocol::checkpoints::{CheckpointTimes, TrackerCheckpointHeader};
use protocol::message::Message;
use protocol::poses::TrackerFrame;
use protocol::steps::{CheckpointHeader, StepInput, StepProfile, StepRecord};
use protocol::time::Nanos;
use recording::{DESK, Item, Provenance, Recording, Source};
use rig::Rig;
use scene::SceneFile;
use simcore::world::{World, no_clock};
use std::collections::VecDeque;
use tracker::assembler::ClosedFrame;
use tracker::stream::StreamTracker;
use tracker::tracker::{close, stamp};
use tracker::{Tracker, Tuning};

/// Topics that are inputs or are computed again. What a display showed and what was saved belong to the old run.
const TOPICS: [&str; 6] = ["blobs", "handles", "pedal", "poses", "steps", "notes"];

/// What a recording is run again with.
#[derive(Debug, Clone)]
pub struct Setting {
    /// The rig.
    pub rig: Rig,
    /// The scene.
    pub scene: SceneFile,
    /// Constants of the tracker.
    pub tuning: Tuning,
    /// Provenance of what comes of it.
    pub provenance: Provenance,
}

/// What was done.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Done {
    /// Tracker frames made.
    pub frames: u64,
    /// Steps made.
    pub steps: u64,
    /// What the recording lacks first.
    pub lost: Option<String>,
}

/// An item of the outcome, or one that is yet to be made.
enum Slot {
    Ready(Box<Item>),
    Poses,
    Step(u64),
}

impl Slot {
    fn ready(item: Item) -> Self {
        Slot::Ready(Box::new(item))
    }
}

/// A run under way.
pub struct Outcome<'a> {
    recording: &'a Recording,
    rig: &'a Rig,
    tuning: &'a Tuning,
    tracker: Option<Tracker>,
    frames: Frames,
    steps: Steps,
    /// In the order of the recording.
    waiting: VecDeque<(Nanos, Vec<Slot>)>,
    /// When tracker and simulation save what they know.
    times: [CheckpointTimes; 2],
    /// What is known where the recording was cut, until the frame before that has come.
    beginning: Beginning,
    /// Number of the step after which the outcome begins.
    begins_after: u64,
    done: Done,
}

impl<'a> Outcome<'a> {
    /// At the beginning.
    ///
    /// # Errors
    /// Where the scene cannot be simulated, or is another one than that of a recording that was cut.
    pub fn new(recording: &'a Recording, setting: &'a Setting) -> anyhow::Result<Self> {
        let desk = setting.provenance.config.contains_key(DESK);
        let world = World::new(&setting.scene).context("scene")?.unseen();
        let mut steps = Steps::new(world, &setting.provenance);
        // The recorded states are of another scene or of other poses.
        steps.compare_no_states();
        let beginning = Beginning::of(recording, setting)?;
        if let Some((header, state)) = &beginning.world {
            steps.resume_after(*header, state.clone());
        }
        Ok(Outcome {
            recording,
            rig: &setting.rig,
            tuning: &setting.tuning,
            tracker: (!desk).then(|| Tracker::tuned(&setting.rig, true, &setting.tuning)),
            frames: Frames::new(setting.rig.field_period_ns(), desk),
            steps,
            waiting: VecDeque::new(),
            times: Default::default(),
            begins_after: beginning.world.as_ref().map_or(0, |(header, _)| header.step),
            beginning,
            done: Done::default(),
        })
    }

    /// Runs it to the end; gives every item of the outcome to `put`.
    ///
    /// # Errors
    /// Those of `put`, and where nothing can be made of the recording.
    pub fn run(mut self, mut put: impl FnMut(Nanos, &Item) -> anyhow::Result<()>) -> anyhow::Result<Done> {
        if self.recording.provenance().source == Source::Import {
            return self.run_stream(put);
        }
        let mut known = self.beginning.items().into_iter();
        for item in self.recording.items_of(&TOPICS) {
            match item {
                Ok((at, item)) => {
                    known.by_ref().try_for_each(|known| put(at, &known))?;
                    self.take(at, item);
                }
                Err(problem) => self.frames.note_loss(problem.to_string()),
            }
            self.advance();
            self.give(&mut put)?;
        }
        self.frames.end();
        self.advance();
        self.steps.end();
        self.advance();
        // What is still waiting lacks its inputs.
        self.waiting.iter_mut().for_each(|(_, slots)| slots.retain(|slot| matches!(slot, Slot::Ready(_))));
        self.give(&mut put)?;
        self.done.lost = self.done.lost.or(self.steps.lost).or(self.frames.lost);
        Ok(self.done)
    }

    fn take(&mut self, at: Nanos, item: Item) {
        self.frames.note(at, &item);
        let slot = match &item {
            Item::Poses(_) => Slot::Poses,
            // Before the beginning a step is what it was.
            Item::Step(step) if step.step > self.begins_after || !self.steps.is_resuming() => {
                Slot::Step(step.step)
            }
            _ => Slot::ready(item.clone()),
        };
        self.waiting.push_back((at, vec![slot]));
        match item {
            Item::Poses(_) => {}
            // It consumes newly tracked poses, which do not match the digest of the recorded ones.
            Item::Step(step) if self.tracker.is_some() => {
                self.steps.note(at, Item::Step(step.with_inputs(step.inputs().without_poses())));
            }
            other => self.steps.note(at, other),
        }
    }

    /// Makes the frames and steps whose inputs have come.
    fn advance(&mut self) {
        while let Some(turn) = self.frames.next_turn() {
            let tracker = self.tracker.as_mut();
            if is_before_beginning(&mut self.beginning.tracker, tracker, &mut self.frames, &turn) {
                self.put_recorded(*turn.recorded);
                continue;
            }
            self.done.lost = self.done.lost.take().or(turn.lost.clone());
            let mut frame = *turn.recorded;
            if let Some(tracker) = &mut self.tracker {
                let (tracked_ns, waited_ns) = (frame.instants.tracked, frame.waited_ns);
                let refused = frame.fields_refused;
                frame = track(tracker, &turn);
                (frame.instants.tracked, frame.waited_ns, frame.fields_refused) =
                    (tracked_ns, waited_ns, refused);
            }
            self.put_frame(frame);
        }
        while let Some(again) = self.steps.next_step() {
            self.done.steps += 1;
            let made = items_of_step(&again, &mut self.times[1]);
            fill(&mut self.waiting, again.step.step, made);
        }
    }

    /// Leaves a frame before the beginning as it was recorded: the first steps may have consumed it.
    fn put_recorded(&mut self, frame: TrackerFrame) {
        let Some((at, slots)) = self.waiting.iter_mut().find(is_place) else { return };
        *slots = vec![Slot::ready(Item::Poses(Box::new(frame)))];
        let at = *at;
        self.steps.note(at, Item::Poses(Box::new(frame)));
    }

    /// Puts a frame in the place of the recorded one, and gives it to the simulation.
    fn put_frame(&mut self, frame: TrackerFrame) {
        let Some((at, slots)) = self.waiting.iter_mut().find(is_place) else { return };
        slots.clear();
        if let Err(invalid) = frame.validate() {
            tracing::error!(field = frame.field, "frame withheld: {invalid}");
            return;
        }
        self.done.frames += 1;
        slots.push(Slot::ready(Item::Poses(Box::new(frame))));
        slots.extend(
            self.tracker
                .as_ref()
                .and_then(|tracker| saved(tracker, &frame, &mut self.times[0]))
                .map(Slot::ready),
        );
        let at = *at;
        self.steps.note(at, Item::Poses(Box::new(frame)));
    }

    /// Gives away what is ready, in order.
    fn give(&mut self, put: &mut impl FnMut(Nanos, &Item) -> anyhow::Result<()>) -> anyhow::Result<()> {
        while self
            .waiting
            .front()
            .is_some_and(|(_, slots)| slots.iter().all(|slot| matches!(slot, Slot::Ready(_))))
        {
            let Some((at, slots)) = self.waiting.pop_front() else { break };
            for slot in &slots {
                if let Slot::Ready(item) = slot {
                    put(at, item)?;
                }
            }
        }
        Ok(())
    }

    /// An imported stream: the tracker decides by the stream's own clock which fields make a frame, as in a
    /// replay. Without handles and pedal.
    fn run_stream(mut self, mut put: impl FnMut(Nanos, &Item) -> anyhow::Result<()>) -> anyhow::Result<Done> {
        let mut tracker = StreamTracker::tuned(self.rig, self.tuning);
        let mut made = Vec::new();
        for item in self.recording.items_of(&["blobs"]) {
            let (at, field) = match item {
                Ok((at, Item::Blobs(field))) => (at, field),
                Ok(_) => continue,
                Err(problem) => {
                    self.done.lost = Some(problem.to_string());
                    break;
                }
            };
            put(at, &Item::Blobs(field.clone()))?;
            tracker.push(&field, |frame, used, closed, _| made.push(closed_frame(frame, used, closed)));
            self.put_streamed(&mut made, at, &mut put)?;
        }
        tracker.finish(|frame, used, closed, _| made.push(closed_frame(frame, used, closed)));
        self.put_streamed(&mut made, 0, &mut put)?;
        Ok(self.done)
    }

    fn put_streamed(
        &mut self,
        made: &mut Vec<TrackerFrame>,
        at: Nanos,
        put: &mut impl FnMut(Nanos, &Item) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        for frame in made.drain(..).filter(|frame| frame.validate().is_ok()) {
            let at = at.max(frame.instants.taken);
            put(at, &Item::Poses(Box::new(frame)))?;
            let world = &mut self.steps.world;
            let report = world.step(&StepInput { frame: &frame, handles: &[], pedals: &[] }, &mut no_clock);
            let mut step: StepRecord = bytemuck::Zeroable::zeroed();
            (step.step, step.field, step.frame) = (world.state().step, frame.field, frame.frame);
            (step.instants, step.advanced_ns, step.state_hash) =
                (frame.instants, report.advanced_ns, report.state_hash);
            put(at, &Item::Step(with_figures(step.with_inputs(report.inputs), world)))?;
            for event in world.events() {
                put(at, &Item::Event(*event))?;
            }
            self.done.frames += 1;
            self.done.steps += 1;
        }
        Ok(())
    }
}

/// The place of a frame that is yet to be made.
fn is_place((_, slots): &&mut (Nanos, Vec<Slot>)) -> bool {
    matches!(slots[..], [Slot::Poses])
}

fn closed_frame(mut frame: TrackerFrame, used: &[BlobField], closed: &ClosedFrame) -> TrackerFrame {
    close(&mut frame, closed.closed_by);
    stamp(&mut frame, used, closed.taken_ns);
    frame.waited_ns = closed.waited_ns;
    frame.instants.tracked = closed.taken_ns;
    frame
}

/// A step, its events, and what the simulation saves after it.
fn items_of_step(again: &StepAgain<'_>, times: &mut CheckpointTimes) -> Vec<Item> {
    let step = with_figures(again.step, again.world);
    let mut made = vec![Item::Step(step)];
    made.extend(again.world.events().iter().map(|event| Item::Event(*event)));
    let mut state = Vec::new();
    if times.after_frame(step.instants.exposed) && again.world.save(&mut state).is_ok() {
        let StepRecord { step, field, handles_below, pedals_below, state_hash, .. } = step;
        let bytes = state.len() as u64;
        made.push(Item::Checkpoint(
            CheckpointHeader { step, field, handles_below, pedals_below, state_hash, bytes },
            state,
        ));
    }
    made
}

/// The record of a step with what its world says; what it took was not measured.
fn with_figures(step: StepRecord, world: &World) -> StepRecord {
    let removed = world.removed();
    StepRecord {
        profile: StepProfile::default(),
        membrane_cut_um2: removed.membrane_um2,
        retina_cut_um2: removed.retina_um2,
        vitreous_removed_um3: removed.vitreous_um3,
        vitreous_left_um3: removed.vitreous_left_um3,
        contacts: world.contacts(),
        ..step
    }
}

/// What the tracker knows, where it is saved after this frame.
fn saved(tracker: &Tracker, frame: &TrackerFrame, times: &mut CheckpointTimes) -> Option<Item> {
    let (exposed_ns, mut state) = (frame.instants.exposed, Vec::new());
    if !times.after_frame(exposed_ns) || tracker.save(&mut state).is_err() {
        return None;
    }
    let header = TrackerCheckpointHeader {
        frame: frame.frame,
        field: frame.field,
        exposed_ns,
        bytes: state.len() as u64,
    };
    Some(Item::TrackerCheckpoint(header, state))
}

/// Puts what came of a step in its place; recorded steps before it were given up.
fn fill(waiting: &mut VecDeque<(Nanos, Vec<Slot>)>, number: u64, made: Vec<Item>) {
    for (_, slots) in waiting.iter_mut() {
        match slots[..] {
            [Slot::Step(step)] if step == number => {
                *slots = made.into_iter().map(Slot::ready).collect();
                return;
            }
            [Slot::Step(step)] if step < number => slots.clear(),
            _ => {}
        }
    }
}
