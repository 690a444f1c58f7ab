//! The state from which a restarted simulation resumes: a checkpoint and every input since, in a bounded
//! queue. The simulation knows which inputs its checkpoint has consumed. Pure except for writing the
//! journals.
//!
//! A simulation that dies while it resumes is resumed again from the same checkpoint. If the state itself
//! causes the crash, the previous checkpoint is used, from which the simulation reaches the same state by
//! other steps. If that fails too, the simulation restarts from its scene, and the state is lost.

use ipc::Instance;
use protocol::journal::{self, Entry};
use recording::Item;
use std::collections::VecDeque;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Number of kept checkpoints: two from which a simulation can resume, and the one before them, because all
/// inputs since that one may be needed for the older of the two.
const CHECKPOINTS: usize = 3;
/// Maximum number of kept items. A checkpoint comes at least every 2 s, in which about 500 items arrive.
const ROOM: usize = 16_384;
/// Number of deaths in a row while resuming, after which another checkpoint is used: for the newest
/// checkpoint, and in addition for the one before it. After these the state is given up.
const NEWEST_TRIES: u32 = 3;
const OLDER_TRIES: u32 = 2;

/// The newest checkpoints, and the inputs and steps since the oldest of them.
#[derive(Debug, Default)]
pub struct Resume {
    /// Items in the order of arrival, since the oldest kept checkpoint or the start.
    items: VecDeque<Item>,
    /// True if items since the start have been dropped.
    gap: bool,
    /// True if the simulation has made a step since the start.
    begun: bool,
    /// Number of simulations in a row that died while they resumed.
    failed: u32,
    /// Path of the journal for which the newest simulation waits.
    waiting: Option<PathBuf>,
    journals: u32,
}

/// Where a restarted simulation starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Where the previous one stopped.
    Past,
    /// At the scene, because no step has been made yet.
    Beginning,
    /// At the scene, because the state is lost.
    Lost,
}

impl Resume {
    /// Adds an input, a step or a checkpoint; other items are ignored.
    pub fn note(&mut self, item: &Item) {
        match item {
            Item::Handle(_) | Item::Pedal(_) | Item::Poses(_) | Item::Step(_) => {
                self.begun |= matches!(item, Item::Step(_));
            }
            Item::Checkpoint(..) => self.forget_before(CHECKPOINTS - 1),
            _ => return,
        }
        if self.items.len() == ROOM {
            self.items.pop_front();
            self.gap = true;
        }
        self.items.push_back(item.clone());
    }

    /// Drops all items before the `kept`th newest checkpoint, if there are that many.
    fn forget_before(&mut self, kept: usize) {
        if let Some(oldest) = self.checkpoint(kept - 1) {
            self.items.drain(..oldest);
            self.gap = true;
        }
    }

    /// Index of the checkpoint `back` places before the newest.
    fn checkpoint(&self, back: usize) -> Option<usize> {
        let places = self.items.iter().enumerate().filter(|(_, i)| matches!(i, Item::Checkpoint(..)));
        places.rev().nth(back).map(|(at, _)| at)
    }

    /// True if the simulation can resume from the checkpoint `back` places before the newest. Without that
    /// checkpoint it can still be computed from the start, if no input is missing.
    fn is_usable(&self, back: usize) -> bool {
        self.checkpoint(back).is_some() || (!self.gap && !self.items.is_empty())
    }

    /// The checkpoint `back` places before the newest, and all items that it may not have consumed, in the
    /// order of arrival.
    fn past(&self, back: usize) -> impl Iterator<Item = &Item> {
        let (from, before) = (self.checkpoint(back), self.checkpoint(back + 1).map_or(0, |at| at + 1));
        let items = self.items.iter().enumerate().skip(before);
        items.filter(move |(at, i)| !matches!(i, Item::Checkpoint(..)) || Some(*at) == from).map(|(_, i)| i)
    }

    /// Writes checkpoint and items as a journal. The file appears complete or not at all.
    fn write(&self, back: usize, file: &Path) -> io::Result<()> {
        let entries: Vec<Entry> = self.past(back).filter_map(|i| i.clone().into_entry()).collect();
        ipc::write_whole(file, |to| journal::write(to, entries.iter()))
    }

    /// Drops all items: the simulation starts from its scene.
    pub fn clear(&mut self) {
        *self = Resume { journals: self.journals, ..Resume::default() };
    }

    /// Decides where a simulation is restarted. `was_at_work`: the previous one had finished resuming when it
    /// died.
    fn origin(&mut self, was_at_work: bool) -> Origin {
        self.failed = if was_at_work { 0 } else { self.failed + 1 };
        let tries = NEWEST_TRIES + if self.is_usable(1) { OLDER_TRIES } else { 0 };
        match self.begun {
            true if self.is_usable(0) && self.failed < tries => Origin::Past,
            true => Origin::Lost,
            false => Origin::Beginning,
        }
    }

    /// Arguments with which a restarted simulation resumes where the previous one stopped. Its journal is
    /// written later ([`Resume::serve`]), once the simulation has opened its channels, so that no input is
    /// missed in between.
    pub fn arguments(&mut self, instance: &Instance, was_at_work: bool) -> (Vec<String>, Origin) {
        if let Some(unread) = self.waiting.take() {
            let _ = fs::remove_file(unread);
        }
        let origin = self.origin(was_at_work);
        if origin != Origin::Past {
            self.clear();
            return (Vec::new(), origin);
        }
        // Each journal has its own name, because a simulation starts as soon as the file exists.
        let file = instance.directory().join(format!("resume-{}.journal", self.journals));
        self.journals += 1;
        self.waiting = Some(file.clone());
        (vec!["--resume".into(), file.display().to_string()], origin)
    }

    /// Writes the journal for which the newest simulation waits. Everything that was sent before it opened
    /// its channels must have been added.
    ///
    /// # Errors
    /// If the file cannot be written. The simulation then times out and is restarted.
    pub fn serve(&self) -> io::Result<()> {
        let Some(file) = self.waiting.as_deref() else { return Ok(()) };
        self.write(usize::from(self.failed >= NEWEST_TRIES), file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::handles::{HandleState, PedalState};
    use protocol::poses::TrackerFrame;
    use protocol::steps::{CheckpointHeader, StepRecord};
    use std::fs::File;

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

    fn past(resume: &Resume, back: usize) -> Vec<String> {
        let name = |i: &Item| match i {
            Item::Handle(h) => format!("h{}", h.seq),
            Item::Pedal(p) => format!("p{}", p.seq),
            Item::Poses(p) => format!("f{}", p.field),
            Item::Step(s) => format!("s{}", s.step),
            Item::Checkpoint(c, _) => format!("c{}", c.step),
            _ => "?".into(),
        };
        resume.past(back).map(name).collect()
    }

    #[test]
    fn a_past_is_a_checkpoint_and_everything_since_the_one_before() {
        let mut resume = Resume::default();
        for n in 1..=4 {
            [handle(n), pose(10 + n, n), step(n, 10 + n, n)].iter().for_each(|item| resume.note(item));
            if n == 1 {
                assert_eq!(past(&resume, 0), ["h1", "f11", "s1"], "there is no checkpoint");
            }
            resume.note(&checkpoint(n, 10 + n, n + 1));
        }
        resume.note(&pedal(0));
        assert_eq!(past(&resume, 0), ["h4", "f14", "s4", "c4", "p0"]);
        assert_eq!(past(&resume, 1), ["h3", "f13", "s3", "c3", "h4", "f14", "s4", "p0"]);
        let kept = resume.items.iter().filter(|i| matches!(i, Item::Checkpoint(..))).count();
        assert_eq!((kept, resume.items.len()), (CHECKPOINTS, 10));
    }

    #[test]
    fn without_a_checkpoint_the_start_must_be_whole() {
        let mut resume = Resume::default();
        assert!(!resume.is_usable(0));
        resume.note(&pose(0, 0));
        assert!(resume.is_usable(0) && resume.is_usable(1));
        (0..ROOM as u64).for_each(|seq| resume.note(&handle(seq)));
        assert!(!resume.is_usable(0) && !resume.is_usable(1));
        assert_eq!(resume.items.len(), ROOM);
        resume.note(&checkpoint(1, 10, 0));
        assert!(resume.is_usable(0) && !resume.is_usable(1));
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
        assert_eq!(entries(&resume), [false, true, false, false], "the checkpoint among the handles");
        resume.failed = NEWEST_TRIES;
        assert_eq!(entries(&resume), [false; 3], "from the start: every handle");
    }
}
