//! What a restarted simulation needs to go on where its predecessor stood: a checkpoint and every
//! input since, in a bounded ring. Pure but for the journals it writes.
//!
//! A simulation that dies while it is resuming is resumed again from the same past. If that past
//! may be what kills it, the checkpoint before the newest is tried, which leads to the same state
//! by other steps; at last it begins at its scene, and the state is lost.

use ipc::Instance;
use protocol::journal::{self, Entry};
use protocol::steps::{CheckpointHeader, StepRecord};
use recording::Item;
use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// Inputs and steps kept since a checkpoint. One comes every 5 s at least, in which some 1,300 of
/// them arrive; two such times are kept.
const RING: usize = 8192;
/// Deaths in a row while resuming after which another past is tried: that since the checkpoint
/// before the newest, then none.
const NEWEST_TRIES: u32 = 3;
const OLDER_TRIES: u32 = 2;

/// A checkpoint and the inputs and steps since.
#[derive(Debug, Clone, Default)]
struct Trail {
    checkpoint: Option<Item>,
    items: VecDeque<Item>,
    /// True if inputs since the checkpoint (or the start) were dropped from the ring.
    gap: bool,
}

/// The newest two checkpoints and the inputs since.
#[derive(Debug, Default)]
pub struct Resume {
    newest: Trail,
    /// Since the checkpoint before, or the start.
    older: Trail,
    /// A step was made since the start.
    begun: bool,
    /// Simulations in a row that died while they were resuming.
    failed: u32,
    /// Where the simulation started last waits for its journal.
    waiting: Option<PathBuf>,
    journals: u32,
}

/// From where a restarted simulation goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Where its predecessor stood.
    Past,
    /// The scene: there is no past yet.
    Beginning,
    /// The scene: the state is lost.
    Lost,
}

impl Trail {
    fn push(&mut self, item: Item) {
        if self.items.len() == RING {
            self.items.pop_front();
            self.gap = true;
        }
        self.items.push_back(item);
    }

    /// True if the simulation can go on from here. Without a checkpoint it can be computed again
    /// from the start only if no input is missing.
    fn is_usable(&self) -> bool {
        self.checkpoint.is_some() || (!self.gap && !self.items.is_empty())
    }

    /// Drops what the checkpoint's state has consumed. Matching is by place, not by number alone:
    /// a restarted sender counts from 0 again.
    fn trim(&mut self, header: &CheckpointHeader) {
        let last = |matches: &dyn Fn(&Item) -> bool| self.items.iter().rposition(matches);
        let is_step = |s: &StepRecord| s.step == header.step && s.state_hash == header.state_hash;
        let step_at = last(&|i| matches!(i, Item::Step(s) if is_step(s)));
        let frame = step_at.and_then(|at| match &self.items[at] {
            Item::Step(step) => Some(step.frame),
            _ => None,
        });
        let of_step = |field: u64, number: u64| field == header.field && frame.is_none_or(|f| f == number);
        let pose_at = last(&|i| matches!(i, Item::Poses(p) if of_step(p.field, p.frame)));
        let handle_at =
            last(&|i| matches!(i, Item::Handle(h) if h.seq.wrapping_add(1) == header.handles_below));
        let pedal_at = last(&|i| matches!(i, Item::Pedal(p) if p.seq.wrapping_add(1) == header.pedals_below));
        let mut place = 0;
        self.items.retain(|item| {
            let consumed_to = match item {
                Item::Step(_) => step_at,
                Item::Poses(_) => pose_at,
                Item::Handle(_) => handle_at,
                _ => pedal_at,
            };
            place += 1;
            consumed_to.is_none_or(|last| place - 1 > last)
        });
    }

    /// Writes it as a journal, whole or not at all.
    fn write(&self, file: &Path) -> io::Result<()> {
        let items = self.checkpoint.iter().chain(&self.items);
        let entries: Vec<Entry> = items.filter_map(|i| i.clone().into_entry()).collect();
        let part = file.with_extension("part");
        journal::write(&mut BufWriter::new(File::create(&part)?), entries.iter())?;
        fs::rename(part, file)
    }
}

impl Resume {
    /// Takes an item; other kinds than inputs, steps and checkpoints are passed over.
    pub fn note(&mut self, item: &Item) {
        match item {
            Item::Handle(_) | Item::Pedal(_) | Item::Poses(_) | Item::Step(_) => {
                self.begun |= matches!(item, Item::Step(_));
                self.older.push(item.clone());
                self.newest.push(item.clone());
            }
            Item::Checkpoint(header, _) => {
                let items = self.newest.items.clone();
                let mut next = Trail { checkpoint: Some(item.clone()), items, gap: false };
                next.trim(header);
                self.older = std::mem::replace(&mut self.newest, next);
            }
            _ => {}
        }
    }

    /// Forgets everything: the simulation starts from its scene.
    pub fn clear(&mut self) {
        *self = Resume { journals: self.journals, ..Resume::default() };
    }

    /// Decides from where a simulation is started again; the one before was at work when it died,
    /// or was not.
    fn origin(&mut self, was_at_work: bool) -> Origin {
        self.failed = if was_at_work { 0 } else { self.failed + 1 };
        let tries = NEWEST_TRIES + if self.older.is_usable() { OLDER_TRIES } else { 0 };
        match self.begun {
            true if self.newest.is_usable() && self.failed < tries => Origin::Past,
            true => Origin::Lost,
            false => Origin::Beginning,
        }
    }

    /// Arguments with which a restarted simulation goes on where its predecessor stood. Its journal
    /// is written once it has opened its channels ([`Resume::serve`]), so that no input falls in
    /// between.
    pub fn arguments(&mut self, instance: &Instance, was_at_work: bool) -> (Vec<String>, Origin) {
        if let Some(unread) = self.waiting.take() {
            let _ = fs::remove_file(unread);
        }
        let origin = self.origin(was_at_work);
        if origin != Origin::Past {
            self.clear();
            return (Vec::new(), origin);
        }
        // A name of its own: the simulation starts as soon as there is such a file.
        let file = instance.directory().join(format!("resume-{}.journal", self.journals));
        self.journals += 1;
        self.waiting = Some(file.clone());
        (vec!["--resume".into(), file.display().to_string()], origin)
    }

    /// Writes the journal for which the simulation waits that was started last. Everything sent
    /// until it opened its channels must have been noted.
    ///
    /// # Errors
    /// Where the file cannot be written; the simulation then gives up waiting, and is started again.
    pub fn serve(&self) -> io::Result<()> {
        let Some(file) = self.waiting.as_deref() else { return Ok(()) };
        let trail = if self.failed < NEWEST_TRIES { &self.newest } else { &self.older };
        trail.write(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::handles::{HandleState, PedalState};
    use protocol::poses::TrackerFrame;

    fn handle(seq: u64) -> Item {
        Item::Handle(HandleState { seq, tool: 1, ..HandleState::zeroed() })
    }

    fn pedal(seq: u64) -> Item {
        Item::Pedal(PedalState { seq, ..PedalState::zeroed() })
    }

    fn pose(field: u64, frame: u64) -> Item {
        Item::Poses(Box::new(TrackerFrame { field, frame, ..TrackerFrame::zeroed() }))
    }

    fn step(step: u64, field: u64, frame: u64) -> Item {
        let record = StepRecord { step, field, frame, state_hash: 100 + step, ..StepRecord::zeroed() };
        Item::Step(record)
    }

    fn checkpoint(step: u64, field: u64, handles_below: u64) -> Item {
        let state_hash = 100 + step;
        let header = CheckpointHeader { step, field, handles_below, pedals_below: 0, state_hash, bytes: 0 };
        Item::Checkpoint(header, Vec::new())
    }

    fn kept(trail: &Trail) -> Vec<String> {
        let name = |i: &Item| match i {
            Item::Handle(h) => format!("h{}", h.seq),
            Item::Pedal(p) => format!("p{}", p.seq),
            Item::Poses(p) => format!("f{}/{}", p.field, p.frame),
            Item::Step(s) => format!("s{}", s.step),
            _ => "?".into(),
        };
        trail.items.iter().map(name).collect()
    }

    #[test]
    fn a_checkpoint_drops_what_it_has_consumed_and_keeps_what_overtook_it() {
        let mut resume = Resume::default();
        for item in [handle(0), pose(10, 0), step(0, 10, 0), handle(1), pedal(0), pose(11, 1), step(1, 11, 1)]
        {
            resume.note(&item);
        }
        resume.note(&checkpoint(0, 10, 1));
        assert_eq!(kept(&resume.newest), ["h1", "p0", "f11/1", "s1"]);
        assert_eq!(kept(&resume.older).len(), 7, "everything since the start");
        resume.note(&handle(2));
        assert_eq!((kept(&resume.newest).len(), kept(&resume.older).len()), (5, 8));
    }

    #[test]
    fn a_restarted_sender_is_told_from_its_predecessor() {
        let mut resume = Resume::default();
        // Cameras and tracker were restarted: fields, frames and handles count from 0 again.
        for item in [handle(4), pose(7, 7), step(7, 7, 7), handle(0), pose(7, 0), step(8, 7, 0), handle(1)] {
            resume.note(&item);
        }
        resume.note(&checkpoint(8, 7, 1));
        assert_eq!(kept(&resume.newest), ["h1"]);
    }

    #[test]
    fn without_a_checkpoint_the_start_must_be_whole() {
        let mut trail = Trail::default();
        assert!(!trail.is_usable());
        trail.push(pose(0, 0));
        assert!(trail.is_usable());
        (0..RING as u64).for_each(|seq| trail.push(handle(seq)));
        assert!(!trail.is_usable());
        assert_eq!(trail.items.len(), RING);
    }

    #[test]
    fn one_that_dies_while_resuming_is_resumed_again_then_from_an_older_past_and_last_from_the_scene() {
        let mut resume = Resume::default();
        assert_eq!(resume.origin(false), Origin::Beginning, "nothing was done yet");
        for item in [pose(10, 0), step(1, 10, 0), checkpoint(1, 10, 0), pose(11, 1), step(2, 11, 1)] {
            resume.note(&item);
        }
        assert_eq!(resume.origin(true), Origin::Past);
        for _ in 1..NEWEST_TRIES + OLDER_TRIES {
            assert_eq!(resume.origin(false), Origin::Past);
        }
        assert_eq!(resume.origin(false), Origin::Lost);
        assert_eq!(resume.origin(true), Origin::Past, "one that was at work gets every try again");
    }

    #[test]
    fn the_journal_holds_what_came_until_the_channels_were_open() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.journal");
        let mut resume = Resume { waiting: Some(file.clone()), ..Resume::default() };
        for item in [handle(0), checkpoint(1, 10, 1), handle(1)] {
            resume.note(&item);
        }
        assert!(!file.exists());
        resume.note(&handle(2));
        let entries = |resume: &Resume| {
            resume.serve().unwrap();
            let mut journal =
                journal::Reader::new(std::io::BufReader::new(File::open(&file).unwrap())).unwrap();
            let all = std::iter::from_fn(|| journal.next_entry().unwrap());
            all.map(|e| matches!(e, Entry::Checkpoint(..))).collect::<Vec<_>>()
        };
        assert_eq!(entries(&resume), [true, false, false], "the checkpoint and two handles");
        resume.failed = NEWEST_TRIES;
        assert_eq!(entries(&resume), [false; 3], "from the start: every handle");
    }
}
