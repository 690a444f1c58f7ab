//! Over a gap, tracker and world go on from their checkpoints.

use super::*;
use crate::test_runs::{begin, golden};
use protocol::checkpoints::TrackerCheckpointHeader;
use recording::Writer;
use std::path::{Path, PathBuf};

/// Frame after which the copy of the golden recording has a checkpoint of its tracker.
const SAVED: u64 = 40;

/// What the golden recording's tracker knew after a frame.
fn known_after(frame: u64) -> Item {
    let recording = golden();
    let mut run = begin(&recording);
    let mut header = TrackerCheckpointHeader { frame, field: 0, exposed_ns: 0, bytes: 0 };
    let until = |made: Made<'_>| {
        let Made::Frame(turn, ..) = made else { return Ok(ControlFlow::Continue(())) };
        (header.field, header.exposed_ns) = (turn.recorded.field, turn.recorded.instants.exposed);
        let reached = turn.recorded.frame == frame;
        Ok(if reached { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    };
    assert!(run.run(until).unwrap());
    let mut state = Vec::new();
    run.tracker.as_ref().unwrap().0.save(&mut state).unwrap();
    header.bytes = state.len() as u64;
    Item::TrackerCheckpoint(header, state)
}

/// The golden recording with a checkpoint of the tracker, without the items that `lost` names.
fn copy(folder: &Path, spoil: bool, lost: impl Fn(&Item) -> bool) -> PathBuf {
    let (from, path) = (golden(), folder.join("copy.mcap"));
    let mut checkpoint = known_after(SAVED);
    if let (true, Item::TrackerCheckpoint(_, state)) = (spoil, &mut checkpoint) {
        state.truncate(1000);
    }
    let mut writer = Writer::create(&path, from.provenance()).unwrap();
    for item in from.items() {
        let (at, item) = item.unwrap();
        let saved = matches!(&item, Item::Poses(frame) if frame.frame == SAVED);
        if !lost(&item) {
            writer.write(at, &item).unwrap();
        }
        if saved {
            writer.write(at, &checkpoint).unwrap();
        }
    }
    writer.finish().unwrap();
    path
}

/// Frames that are determined, each of which is as it was recorded.
fn determined(file: &Path) -> Vec<u64> {
    let recording = Recording::open(file).unwrap();
    let mut frames = Vec::new();
    let take = |made: Made<'_>| {
        if let Made::Frame(turn, frame, _) = made
            && turn.determined
        {
            let bytes = |frame: &TrackerFrame| bytemuck::bytes_of(&frame.bodies).to_vec();
            assert!(bytes(frame) == bytes(&turn.recorded), "frame {}", frame.frame);
            frames.push(frame.frame);
        }
        Ok(ControlFlow::Continue(()))
    };
    begin(&recording).run(take).unwrap();
    frames
}

#[test]
fn poses_behind_a_gap_are_determined_again_from_the_trackers_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let field = |item: &Item, fields: std::ops::Range<u64>| match item {
        Item::Blobs(blobs) => fields.contains(&blobs.field),
        _ => false,
    };
    let all = determined(&copy(folder.path(), false, |_| false));
    let last = *all.last().unwrap();
    assert!(last > SAVED + 40 && all.len() as u64 == last + 1, "{all:?}");
    for gap in [12..13, 12..20, 5..41] {
        let left = determined(&copy(folder.path(), false, |item| field(item, gap.clone())));
        assert!(left.iter().copied().eq((0..gap.start).chain(SAVED + 1..=last)), "{gap:?}: {left:?}");
    }
    // Fields and frames of a second, the frame of the checkpoint among them.
    let both = |item: &Item| match item {
        Item::Poses(frame) => (20..=SAVED).contains(&frame.frame),
        other => field(other, 20..SAVED + 1),
    };
    let left = determined(&copy(folder.path(), false, both));
    assert!(left.iter().copied().eq((0..20).chain(SAVED + 1..=last)), "{left:?}");
    let left = determined(&copy(folder.path(), true, |item| field(item, 12..13)));
    assert!(left.iter().copied().eq(0..12), "a checkpoint that is damaged is of no use: {left:?}");
}

/// `make golden` lets a run write all that runs write.
#[test]
#[ignore = "rewrites the golden recording"]
fn leave_out_what_the_golden_recording_does_not_need() {
    let from = golden();
    let path = from.path().with_extension("thin");
    let mut writer = Writer::create(&path, from.provenance()).unwrap();
    for item in from.items() {
        let (at, item) = item.unwrap();
        let later = matches!(&item, Item::Checkpoint(header, _) if header.step > 1);
        if !later && !matches!(item, Item::TrackerCheckpoint(..) | Item::Matches(..)) {
            writer.write(at, &item).unwrap();
        }
    }
    writer.finish().unwrap();
    std::fs::rename(&path, from.path()).unwrap();
}
