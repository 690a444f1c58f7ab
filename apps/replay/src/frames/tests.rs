//! Whole and lossy recordings as frames.

use super::*;
use bytemuck::Zeroable;
use protocol::poses::FieldUsed;
use recording::Note;

const MS: u64 = 1_000_000;

fn blobs(camera: u32, field: u64) -> Item {
    let mut block = BlobField::zeroed();
    (block.camera, block.field, block.exposed_ns) = (camera, field, (field + 1) * 20 * MS);
    Item::Blobs(Box::new(block))
}

fn pose(frame: u64, used: &[(u32, u64)]) -> Item {
    let mut block = TrackerFrame::zeroed();
    (block.frame, block.field) = (frame, frame + 10);
    for (slot, &(camera, field)) in block.used.iter_mut().zip(used) {
        *slot = FieldUsed { field, exposed_ns: (field + 1) * 20 * MS, camera, blobs_used: 3 };
    }
    block.used_count = used.len() as u32;
    Item::Poses(Box::new(block))
}

fn turns(items: Vec<(u64, Item)>) -> Vec<FrameTurn> {
    let mut frames = Frames::new(20 * MS, false);
    let mut all = Vec::new();
    for (ms, item) in &items {
        frames.note(ms * MS, item);
        all.extend(std::iter::from_fn(|| frames.next_turn()));
    }
    frames.end();
    all.extend(std::iter::from_fn(|| frames.next_turn()));
    all
}

#[test]
fn what_was_consumed_is_found_even_behind_its_consumer() {
    let all = turns(vec![
        (1, blobs(0, 0)),
        (2, pose(0, &[(0, 0), (1, 0)])),
        (4, blobs(1, 0)),
        (20, blobs(0, 1)),
        (21, pose(1, &[(0, 1)])),
    ]);
    assert_eq!(all.len(), 2);
    assert!(all.iter().all(|t| t.lost.is_none() && t.determined), "{:?}", all[0].lost);
    let used = all[0].fields.iter().map(|f| (f.camera, f.field)).collect::<Vec<_>>();
    assert_eq!(used, [(0, 0), (1, 0)]);
}

#[test]
fn a_frame_waits_for_what_may_stand_behind_it() {
    let mut frames = Frames::new(20 * MS, false);
    frames.note(0, &pose(0, &[(0, 0)]));
    assert!(frames.next_turn().is_none());
    frames.note(AHEAD_NS - 1, &blobs(0, 0));
    assert!(frames.next_turn().is_none());
    frames.note(AHEAD_NS, &blobs(0, 1));
    assert!(frames.next_turn().is_some_and(|turn| turn.determined));
}

#[test]
fn losses_are_named_once_where_they_are() {
    let lost = |items| turns(items).into_iter().filter_map(|t| t.lost).collect::<Vec<_>>();
    assert_eq!(lost(vec![(1, pose(0, &[(2, 5)])), (2, pose(1, &[]))]), ["field 5 of camera 2 is missing"]);
    assert_eq!(lost(vec![(1, pose(4, &[]))]), ["the recording begins at tracker frame 4, not at 0"]);
    assert_eq!(lost(vec![(1, pose(0, &[])), (2, pose(2, &[]))]), ["tracker frame 2 follows 0"]);
    let text = "3 items did not fit".to_string();
    let note = Note { instant_ns: 0, kind: NoteKind::Loss, process: None, count: 3, text: text.clone() };
    assert_eq!(lost(vec![(1, Item::Note(note)), (2, pose(0, &[]))]), [text]);
}

#[test]
fn poses_are_determined_until_a_field_is_missing_and_again_by_a_tracker_that_was_started_again() {
    let determined = |items| turns(items).iter().map(|t| t.determined).collect::<Vec<_>>();
    let field_gone = vec![
        (1, blobs(0, 0)),
        (1, pose(0, &[(0, 0)])),
        (2, pose(1, &[(0, 1)])),
        (3, blobs(0, 2)),
        (3, pose(2, &[(0, 2)])),
    ];
    assert_eq!(determined(field_gone), [true, false, false]);
    let restarted = vec![
        (1, blobs(0, 0)),
        (1, pose(0, &[(0, 0)])),
        (2, pose(2, &[(0, 0)])),
        (3, blobs(0, 5)),
        (3, pose(0, &[(0, 5)])),
    ];
    assert_eq!(determined(restarted), [true, false, true]);
    assert_eq!(determined(vec![(1, pose(0, &[]))]), [false], "no camera-fields at all");
}

#[test]
fn a_note_of_loss_leaves_the_poses_determined() {
    let note = Note::loss(0, 3, "3 items".into());
    let all = turns(vec![
        (1, blobs(0, 0)),
        (1, pose(0, &[(0, 0)])),
        (2, Item::Note(note)),
        (20, blobs(0, 1)),
        (20, pose(1, &[(0, 1)])),
    ]);
    assert!(all.iter().all(|t| t.determined));
    assert_eq!(all.iter().map(|t| t.lost.is_some()).collect::<Vec<_>>(), [false, true]);
}

fn checkpoint(frame: u64, exposed_ns: u64) -> Item {
    let header = TrackerCheckpointHeader { frame, field: frame + 10, exposed_ns, bytes: 1 };
    Item::TrackerCheckpoint(header, vec![frame as u8])
}

/// A frame of its own field, with its exposure.
fn exposed(frame: u64) -> Item {
    let Item::Poses(mut block) = pose(frame, &[(0, frame)]) else { unreachable!() };
    block.instants.exposed = (frame + 1) * 20 * MS;
    Item::Poses(block)
}

#[test]
fn a_checkpoint_leads_over_a_gap_from_the_frame_after_it() {
    let with = |checkpoints: &[(u64, u64)]| {
        let mut items = Vec::new();
        for frame in (0..8).filter(|frame| *frame != 2) {
            items.extend([(20 * frame, blobs(0, frame)), (20 * frame + 1, exposed(frame))]);
            let own = checkpoints.iter().filter(|(of, _)| *of == frame);
            items.extend(own.map(|(of, at)| (20 * frame + 2, checkpoint(*of, *at))));
        }
        let all = turns(items);
        let known = all.iter().map(|t| t.known.as_ref().map(|known| known[0])).collect::<Vec<_>>();
        (all.iter().map(|t| t.determined).collect::<Vec<_>>(), known)
    };
    let of = |frame: u64| (frame, (frame + 1) * 20 * MS);
    let (determined, known) = with(&[of(1), of(4), of(6)]);
    assert_eq!(determined, [true, true, false, false, true, true, true], "from frame 5 on");
    assert_eq!(known, [None, None, None, None, Some(4), None, None], "others are not needed");
    // Of another run of the tracker, whose frames have the same numbers.
    assert_eq!(with(&[(4, 900_000 * MS)]).0, [true, true, false, false, false, false, false]);
}
