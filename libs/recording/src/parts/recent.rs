//! The end of what was written: with it the next part begins, so that it is determined alone.
//!
//! Kept are the inputs, poses and steps of the last seconds, and the newest checkpoints of tracker and
//! simulation. Where both have saved after the same frame, and what they saved has come with its step and its
//! frame, a part can begin: with these two, and with what has been under way since.

use crate::{CUT, DESK, Item, Provenance, Source};
use protocol::poses::TrackerFrame;
use protocol::time::Nanos;
use std::collections::VecDeque;

/// How long items are kept, ns: from one pair of checkpoints to the next, and what was under way before it.
const KEPT_NS: Nanos = 4_000_000_000;
/// How far before a step all stands that was under way when it was made, ns.
const UNDER_WAY_NS: Nanos = 1_000_000_000;
/// How long inputs may stand behind what consumed them, ns.
const LATE_NS: Nanos = 500_000_000;
/// How much later than the last frame a camera that is not in step may have exposed what it consumed, ns.
const OUT_OF_STEP_NS: Nanos = 20_000_000;

/// An item as it was written: log time, item, number among those of its topic.
pub(super) type Written = (Nanos, Item, u32);

/// What a part begins with.
pub(super) struct Prologue {
    /// In the order in which they are written.
    pub items: Vec<Written>,
    /// The step after which it begins, where it is determined alone.
    pub after_step: Option<u64>,
}

/// What of the items to come the part before needs, which ends now.
pub(super) struct Late {
    /// Last log time.
    pub until_ns: Nanos,
    /// Exposure of the newest frame in it, and of the frame of its newest step.
    frame_ns: Nanos,
    stepped_ns: Nanos,
}

impl Late {
    /// Whether a part that ended needs this one.
    pub fn wants(&self, item: &Item) -> bool {
        match item {
            Item::Blobs(field) => field.exposed_ns <= self.frame_ns + OUT_OF_STEP_NS,
            Item::Poses(frame) => frame.instants.exposed <= self.stepped_ns,
            Item::Handle(_) | Item::Pedal(_) => true,
            _ => false,
        }
    }

    /// True if what comes at this log time is too late for it.
    pub fn is_over(&self, at: Nanos) -> bool {
        at > self.until_ns
    }
}

/// The newest items.
pub(super) struct Recent {
    /// Nothing but blobs is in it, and no state belongs to any place.
    stream: bool,
    /// No tracker made the poses.
    desk: bool,
    newest_ns: Nanos,
    items: VecDeque<Written>,
    world: Option<Written>,
    tracker: Option<Written>,
    /// Exposure of the newest frame, and of the newest step.
    frame_ns: Nanos,
    stepped_ns: Nanos,
}

impl Recent {
    /// Of a recording of which nothing is written.
    pub fn new(provenance: &Provenance) -> Self {
        Recent {
            stream: provenance.source == Source::Import,
            desk: provenance.config.contains_key(DESK),
            newest_ns: 0,
            items: VecDeque::new(),
            world: None,
            tracker: None,
            frame_ns: 0,
            stepped_ns: 0,
        }
    }

    /// Takes an item that was written.
    pub fn note(&mut self, at: Nanos, item: &Item, number: u32) {
        self.newest_ns = self.newest_ns.max(at);
        if self.stream {
            return;
        }
        let written = || (at, item.clone(), number);
        match item {
            Item::Checkpoint(..) => self.world = Some(written()),
            Item::TrackerCheckpoint(..) => self.tracker = Some(written()),
            Item::Blobs(_) | Item::Handle(_) | Item::Pedal(_) => self.items.push_back(written()),
            Item::Poses(frame) => {
                self.frame_ns = frame.instants.exposed;
                self.items.push_back(written());
            }
            Item::Step(step) => {
                self.stepped_ns = step.instants.exposed;
                self.items.push_back(written());
            }
            _ => {}
        }
        let old = |(at, ..): &Written| at.saturating_add(KEPT_NS) < self.newest_ns;
        while self.items.front().is_some_and(old) {
            self.items.pop_front();
        }
    }

    /// Newest log time, ns.
    pub fn newest_ns(&self) -> Nanos {
        self.newest_ns
    }

    /// What the part that ends now needs of the items to come.
    pub fn late(&self) -> Late {
        let until_ns = self.newest_ns.saturating_add(LATE_NS);
        Late { until_ns, frame_ns: self.frame_ns, stepped_ns: self.stepped_ns }
    }

    /// What a part that begins now begins with, if it can be determined alone. A part of a stream begins with
    /// nothing, as the stream itself does.
    pub fn prologue(&self) -> Option<Prologue> {
        if self.stream {
            return Some(Prologue { items: Vec::new(), after_step: None });
        }
        let world = self.world.as_ref()?;
        let Item::Checkpoint(header, _) = &world.1 else { return None };
        let step_at = self.items.iter().rposition(
            |(_, item, _)| matches!(item, Item::Step(step) if (step.step, step.field) == (header.step, header.field)),
        )?;
        let Item::Step(step) = &self.items[step_at].1 else { return None };
        let from_ns = step.instants.stepped.saturating_sub(UNDER_WAY_NS);
        // Else something that was under way is forgotten.
        if from_ns.saturating_add(KEPT_NS) < self.newest_ns {
            return None;
        }
        let mut frame = step.frame;
        let mut known = vec![world];
        if !self.desk {
            let tracker = self.tracker.as_ref()?;
            let Item::TrackerCheckpoint(made, _) = &tracker.1 else { return None };
            if made.field != header.field {
                return None;
            }
            self.frame_at(|f| (f.frame, f.field) == (made.frame, made.field))?;
            frame = frame.min(made.frame);
            known.push(tracker);
        }
        let frame_at = self.frame_at(|f| f.frame == frame)?;
        let under_way = |(i, (at, item, _)): &(usize, &Written)| match item {
            Item::Step(_) => *i >= step_at,
            Item::Poses(_) => *i >= frame_at,
            _ => *at >= from_ns,
        };
        let under_way: Vec<&Written> =
            self.items.iter().enumerate().filter(under_way).map(|(_, w)| w).collect();
        let begin = under_way.first()?.0;
        // Before what led to them: so reading from there on goes through all that was under way.
        let known = known.into_iter().map(|(_, item, number)| (begin, item.clone(), *number));
        let items = known.chain(under_way.into_iter().cloned()).collect();
        Some(Prologue { items, after_step: Some(header.step) })
    }

    /// The next part begins with later ones.
    pub fn forget_checkpoints(&mut self) {
        (self.world, self.tracker) = (None, None);
    }

    /// The newest frame of this kind among the items.
    fn frame_at(&self, is_it: impl Fn(&TrackerFrame) -> bool) -> Option<usize> {
        self.items.iter().rposition(|(_, item, _)| matches!(item, Item::Poses(frame) if is_it(frame)))
    }

    /// What a part begins with whose beginning is not determined alone: the inputs that were under way.
    pub fn undetermined(&self) -> Prologue {
        let from_ns = self.newest_ns.saturating_sub(UNDER_WAY_NS);
        let inputs = self.items.iter().filter(|(at, item, _)| {
            *at >= from_ns && matches!(item, Item::Blobs(_) | Item::Handle(_) | Item::Pedal(_))
        });
        Prologue { items: inputs.cloned().collect(), after_step: None }
    }
}

/// The provenance of a part of a recording.
pub(super) fn provenance_of_part(whole: &Provenance, name: &str, after_step: Option<u64>) -> Provenance {
    let mut provenance = whole.clone();
    provenance.config.remove(CUT);
    if let Some(step) = after_step {
        provenance.config.insert(CUT.into(), format!("after step {step} of {name}"));
    }
    provenance
}
