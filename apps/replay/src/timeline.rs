//! Any place of a recording, at once: a recorded run that stands there as if it had been played there, to
//! the bit.
//!
//! The run goes to the last checkpoints of tracker and simulation before the place ([`pairs`]), reads what
//! was under way around them, and runs on from there. What can be under way is bounded: a field waits for
//! its frame for [`FIELDS_KEPT_NS`] at most, a frame or step for its inputs for [`AHEAD_NS`].
//! [`player`] keeps copies of the run besides, so that it steps back as quickly.
//!
//! Over a gap, a played run waits some seconds for a checkpoint before it goes on. One that begins behind
//! the gap does not: its frames and steps are the same, but frames may come later between the steps.

pub mod index;
pub mod pairs;
pub mod player;
mod resume;
pub mod saving;
mod streamed;

use crate::engine::TOPICS;
use crate::frames::{AHEAD_NS, FIELDS_KEPT_NS};
use pairs::{Known, Pairs};
use protocol::events::Event;
use protocol::steps::StepRecord;
use protocol::time::Nanos;
use recording::{ChunkIndex, Item, Place, Recording, RecordingError};
use simcore::state::State;
use std::cell::OnceCell;

/// Checkpoints that are tried, backwards from the last one before a place, before the run is played from its start.
const TRIED: usize = 4;

/// A place in a recorded run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// Behind the first step of a frame that was exposed at this instant or later, ns.
    Exposed(Nanos),
    /// Behind the first step of this field or a later one.
    Field(u64),
    /// Behind the first step of this number or a later one.
    Step(u64),
}

/// The step behind which a run stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// Exposure of its frame, ns.
    pub exposed_ns: Nanos,
    /// Field of its frame.
    pub field: u64,
    /// Its number.
    pub step: u64,
}

impl Moment {
    /// That of a recorded step.
    pub fn of(step: &StepRecord) -> Self {
        Moment { exposed_ns: step.instants.exposed, field: step.field, step: step.step }
    }

    /// That at which a world stands.
    pub fn of_state(state: &State) -> Self {
        Moment { exposed_ns: state.exposed_ns, field: state.field, step: state.step }
    }
}

impl Target {
    /// True for a run that stands there or behind it.
    pub fn is_reached(self, at: &Moment) -> bool {
        match self {
            Target::Exposed(ns) => at.exposed_ns >= ns,
            Target::Field(field) => at.field >= field,
            Target::Step(step) => at.step >= step,
        }
    }
}

/// What a seek has come to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Arrival {
    /// Where the run stands; `None` where no step follows the place, and the run has come to its end.
    pub at: Option<Moment>,
    /// Recorded steps between the checkpoint that the run went on from and this place that the recording does
    /// not determine.
    pub left_out: u64,
    /// What is missing of the recording there, first.
    pub lost: Option<String>,
}

/// What is known of a recording without playing it: its ends, its checkpoints, its events.
#[derive(Debug)]
pub struct Timeline {
    recording: Recording,
    chunks: ChunkIndex,
    pairs: Option<Pairs>,
    /// The poses are a tracker's.
    tracked: bool,
    ends: Option<[Moment; 2]>,
    /// What is read before a checkpoint, ns of log time: all that was under way then.
    window_ns: u64,
    events: OnceCell<Vec<Event>>,
}

impl Timeline {
    /// Of a recording that is opened here a second time, with its own checkpoints, where they are of this
    /// build's tracker and simulation.
    ///
    /// # Errors
    /// Where it cannot be read.
    pub fn open(recording: &Recording) -> Result<Self, RecordingError> {
        let recording = Recording::open(recording.path())?;
        let chunks = recording.chunk_index()?;
        let provenance = recording.provenance();
        let tracked = !provenance.config.contains_key(recording::DESK);
        let comparable = provenance.other_state_hash_version().is_none()
            && (!tracked || provenance.other_tracker_version().is_none());
        let own = || Pairs::of(Recording::open(recording.path())?, chunks.clone());
        let pairs = comparable.then(own).transpose()?.filter(|pairs| pairs.are_complete(tracked));
        let ends = ends(&recording, &chunks);
        let window_ns = FIELDS_KEPT_NS + AHEAD_NS;
        Ok(Timeline { recording, chunks, pairs, tracked, ends, window_ns, events: OnceCell::new() })
    }

    /// True if there are checkpoints of use to this build.
    pub fn has_checkpoints(&self) -> bool {
        self.pairs.is_some()
    }

    /// With these checkpoints, of an index, in the place of its own.
    fn with_pairs(mut self, pairs: Pairs) -> Self {
        self.pairs = Some(pairs);
        self
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// First and last recorded step; `None` where there is none.
    pub fn ends(&self) -> Option<[Moment; 2]> {
        self.ends
    }

    /// The checkpoints behind which a run can begin; `None` where those of the recording are of no use to this
    /// build, and there is no index.
    pub fn pairs(&self) -> Option<&Pairs> {
        self.pairs.as_ref()
    }

    /// The recorded events, in the order of the file. Read when they are first asked for.
    pub fn events(&self) -> &[Event] {
        self.events.get_or_init(|| {
            let mut events = Vec::new();
            for chunk in self.chunks.holding("events") {
                let items = self.recording.items_of_chunk(&self.chunks, chunk, &["events"]);
                events.extend(items.into_iter().flatten().filter_map(|(_, item)| match item {
                    Item::Event(event) => Some(event),
                    _ => None,
                }));
            }
            events
        })
    }

    /// Checkpoints before a place, the best first: numbers among [`Pairs::heads`]. Numbers of steps and fields
    /// may start again within a recording, so it is the first stretch that can hold the place.
    fn before(&self, target: Target) -> impl Iterator<Item = usize> + use<> {
        let heads = self.pairs.iter().flat_map(Pairs::heads);
        let keys = heads.map(|head| match target {
            // It was made after the exposure.
            Target::Exposed(_) => head.log_time_ns,
            Target::Field(_) => head.header.field,
            Target::Step(_) => head.header.step,
        });
        let wanted = match target {
            Target::Exposed(at) | Target::Field(at) | Target::Step(at) => at,
        };
        let following = keys.clone().skip(1).map(Some).chain([None]);
        let stretch = keys
            .zip(following)
            .position(|(from, to)| from < wanted && to.is_none_or(|to| to >= wanted || to < from));
        (0..stretch.map_or(0, |number| number + 1)).rev().take(TRIED)
    }

    /// A checkpoint, and the place from which on all is read that was under way then.
    fn known(&self, number: usize) -> Option<(Known, Place)> {
        let known = self.pairs.as_ref()?.read(number, self.tracked)?;
        let from_ns = known.from_ns.saturating_sub(self.window_ns);
        let place = self.chunks.place(self.chunks.first_with(from_ns))?.of_topics(&TOPICS);
        Some((known, place))
    }
}

/// First and last step.
fn ends(recording: &Recording, chunks: &ChunkIndex) -> Option<[Moment; 2]> {
    let steps = |chunk: usize| {
        let items = recording.items_of_chunk(chunks, chunk, &["steps"]).unwrap_or_default();
        items.into_iter().filter_map(|(_, item)| match item {
            Item::Step(step) => Some(Moment::of(&step)),
            _ => None,
        })
    };
    let first = chunks.holding("steps").find_map(|chunk| steps(chunk).next())?;
    let last = chunks.holding("steps").rev().find_map(|chunk| steps(chunk).next_back())?;
    Some([first, last])
}

#[cfg(test)]
mod tests;
