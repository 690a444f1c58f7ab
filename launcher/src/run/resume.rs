//! What a restarted simulation needs to go on where its predecessor stood: the newest checkpoint
//! and every input since, in a bounded ring. Pure but for [`Resume::write`].

use anyhow::Context;
use ipc::Instance;
use protocol::journal::{self, Entry};
use protocol::steps::{CheckpointHeader, StepRecord};
use recording::Item;
use std::collections::VecDeque;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Inputs and steps kept since the newest checkpoint. A checkpoint comes every 5 s, in which some
/// 1,300 of them arrive.
const RING: usize = 8192;

/// The newest checkpoint and the inputs since.
#[derive(Debug, Default)]
pub struct Resume {
    checkpoint: Option<Item>,
    items: VecDeque<Item>,
    /// True if inputs since the checkpoint (or the start) were dropped from the ring.
    gap: bool,
}

impl Resume {
    /// Takes an item; other kinds than inputs, steps and checkpoints are passed over.
    pub fn note(&mut self, item: &Item) {
        match item {
            Item::Handle(_) | Item::Pedal(_) | Item::Poses(_) | Item::Step(_) => {
                if self.items.len() == RING {
                    self.items.pop_front();
                    self.gap = true;
                }
                self.items.push_back(item.clone());
            }
            Item::Checkpoint(header, _) => {
                self.trim(header);
                self.checkpoint = Some(item.clone());
                self.gap = false;
            }
            _ => {}
        }
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
        let handle_at = last(&|i| matches!(i, Item::Handle(h) if h.seq + 1 == header.handles_below));
        let pedal_at = last(&|i| matches!(i, Item::Pedal(p) if p.seq + 1 == header.pedals_below));
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

    /// Forgets everything: the simulation starts from its scene.
    pub fn clear(&mut self) {
        *self = Resume::default();
    }

    /// True if the simulation can go on from here. Without a checkpoint it can be computed again
    /// from the start only if no input is missing.
    pub fn is_usable(&self) -> bool {
        self.checkpoint.is_some() || (!self.gap && !self.items.is_empty())
    }

    /// Arguments with which a restarted simulation goes on where its predecessor stood. One that
    /// died while it was resuming starts from its scene: its past may be what kills it.
    pub fn arguments(&mut self, instance: &Instance, was_at_work: bool) -> Vec<String> {
        let file = instance.directory().join("resume.journal");
        if was_at_work && self.is_usable() {
            match self.write(&file).with_context(|| format!("write {}", file.display())) {
                Ok(()) => return vec!["--resume".into(), file.display().to_string()],
                Err(error) => tracing::warn!("simcore starts from its scene: {error:#}"),
            }
        }
        self.clear();
        Vec::new()
    }

    /// Writes the checkpoint and the inputs since as a journal.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&self, file: &Path) -> std::io::Result<()> {
        let entries: Vec<Entry> =
            self.checkpoint.iter().chain(&self.items).filter_map(|i| i.clone().into_entry()).collect();
        journal::write(&mut BufWriter::new(File::create(file)?), entries.iter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::handles::{HandleState, PedalState};
    use protocol::poses::TrackerFrame;

    fn handle(seq: u64) -> Item {
        Item::Handle(HandleState { seq, ..HandleState::zeroed() })
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

    fn kept(resume: &Resume) -> Vec<String> {
        let name = |i: &Item| match i {
            Item::Handle(h) => format!("h{}", h.seq),
            Item::Pedal(p) => format!("p{}", p.seq),
            Item::Poses(p) => format!("f{}/{}", p.field, p.frame),
            Item::Step(s) => format!("s{}", s.step),
            _ => "?".into(),
        };
        resume.items.iter().map(name).collect()
    }

    #[test]
    fn a_checkpoint_drops_what_it_has_consumed_and_keeps_what_overtook_it() {
        let mut resume = Resume::default();
        for item in [handle(0), pose(10, 0), step(0, 10, 0), handle(1), pedal(0), pose(11, 1), step(1, 11, 1)]
        {
            resume.note(&item);
        }
        resume.note(&checkpoint(0, 10, 1));
        assert_eq!(kept(&resume), ["h1", "p0", "f11/1", "s1"]);
        assert!(resume.is_usable());
    }

    #[test]
    fn a_restarted_sender_is_told_from_its_predecessor() {
        let mut resume = Resume::default();
        // Cameras and tracker were restarted: fields, frames and handles count from 0 again.
        for item in [handle(4), pose(7, 7), step(7, 7, 7), handle(0), pose(7, 0), step(8, 7, 0), handle(1)] {
            resume.note(&item);
        }
        resume.note(&checkpoint(8, 7, 1));
        assert_eq!(kept(&resume), ["h1"]);
    }

    #[test]
    fn without_a_checkpoint_the_start_must_be_whole() {
        let mut resume = Resume::default();
        assert!(!resume.is_usable());
        resume.note(&pose(0, 0));
        assert!(resume.is_usable());
        (0..RING as u64).for_each(|seq| resume.note(&handle(seq)));
        assert!(!resume.is_usable());
        assert_eq!(resume.items.len(), RING);
        resume.note(&checkpoint(0, 0, 3));
        assert!(resume.is_usable());
        assert_eq!(kept(&resume).first().map(String::as_str), Some("h3"));
    }
}
