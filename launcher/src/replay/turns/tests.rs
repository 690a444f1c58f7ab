//! Whole and lossy recordings as turns.

use super::*;
use bytemuck::Zeroable;
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

fn step(number: u64, frame: u64, handles_below: u64) -> Item {
    Item::Step(StepRecord {
        step: number,
        frame,
        field: frame + 10,
        handles_below,
        state_hash: number * 7,
        ..StepRecord::zeroed()
    })
}

fn handle(seq: u64) -> Item {
    Item::Handle(HandleState { seq, ..HandleState::zeroed() })
}

fn turns(items: Vec<(u64, Item)>) -> Vec<Turn> {
    Turns::new(items.into_iter().map(|(ms, item)| Ok((ms * MS, item))), 20 * MS).collect()
}

fn handles(turn: &Turn) -> Vec<u64> {
    turn.step.as_ref().map_or(Vec::new(), |s| s.handles.iter().map(|h| h.seq).collect())
}

#[test]
fn what_was_consumed_is_found_even_behind_its_consumer() {
    let all = turns(vec![
        (1, blobs(0, 0)),
        (2, pose(0, &[(0, 0), (1, 0)])),
        (2, step(1, 0, 2)),
        (3, handle(0)),
        (3, handle(1)),
        (4, blobs(1, 0)),
        (4, handle(2)),
        (20, blobs(0, 1)),
        (21, pose(1, &[(0, 1)])),
        (23, step(2, 1, 2)),
    ]);
    assert_eq!(all.len(), 2);
    assert!(all.iter().all(|t| t.lost.is_none()), "{:?}", all[0].lost);
    let used = all[0].fields.iter().map(|f| (f.camera, f.field)).collect::<Vec<_>>();
    assert_eq!(used, [(0, 0), (1, 0)]);
    assert_eq!((all[0].request.used_count, all[0].request.field), (2, 10));
    assert_eq!((handles(&all[0]), handles(&all[1])), (vec![0, 1], vec![]));
}

#[test]
fn a_pose_that_was_not_stepped_has_no_step() {
    let all = turns(vec![
        (1, pose(0, &[])),
        (1, step(1, 0, 0)),
        (20, pose(1, &[])),
        (40, pose(2, &[])),
        (41, step(2, 2, 0)),
    ]);
    assert_eq!(all.iter().map(|t| t.step.is_some()).collect::<Vec<_>>(), [true, false, true]);
    assert!(all.iter().all(|t| t.lost.is_none()));
}

#[test]
fn steps_made_again_in_silence_are_made_with_what_had_come() {
    // The simulation died after step 1; its successor made step 2 from pose 1, and published
    // step 3.
    let all = turns(vec![
        (1, pose(0, &[])),
        (1, step(1, 0, 0)),
        (19, handle(0)),
        (20, pose(1, &[])),
        (39, handle(1)),
        (40, pose(2, &[])),
        (41, step(3, 2, 2)),
    ]);
    assert!(all.iter().all(|t| t.lost.is_none()), "{all:?}");
    assert!(all[1].step.as_ref().is_some_and(|s| s.recorded.is_none()));
    assert_eq!((handles(&all[1]), handles(&all[2])), (vec![0], vec![1]));
}

#[test]
fn restarted_senders_are_followed() {
    let all = turns(vec![
        (1, handle(7)),
        (1, handle(8)),
        (2, pose(0, &[])),
        (2, step(1, 0, 9)),
        (3, handle(9)),
        (4, handle(0)),
        (5, handle(1)),
        (6, pose(1, &[])),
        (6, step(2, 1, 1)),
        (7, pose(0, &[])),
        (7, step(1, 0, 2)),
    ]);
    assert_eq!(all.iter().map(handles).collect::<Vec<_>>(), [vec![7, 8], vec![9, 0], vec![1]]);
    let fresh: Vec<_> = all.iter().map(|t| t.step.as_ref().unwrap().fresh).collect();
    assert_eq!(fresh, [false, false, true]);
}

#[test]
fn of_several_senders_between_two_steps_all_are_consumed() {
    let sent =
        |seq, ms| (ms, Item::Handle(HandleState { seq, instant_ns: ms * MS, ..HandleState::zeroed() }));
    let done = |number, frame, below, ms| match step(number, frame, below) {
        Item::Step(mut step) => {
            step.instants.stepped = ms * MS;
            (ms, Item::Step(step))
        }
        _ => unreachable!("a step"),
    };
    let all = turns(vec![
        sent(7, 1),
        (2, pose(0, &[])),
        done(1, 0, 8, 2),
        // While there is no simulation, one sender and another; the third is at work when it is back.
        sent(0, 10),
        sent(1, 11),
        sent(0, 20),
        sent(0, 30),
        sent(1, 31),
        (32, pose(1, &[])),
        done(2, 1, 2, 33),
        (34, pose(2, &[])),
        done(3, 2, 2, 35),
        // A fourth comes as far as the third in the same time.
        sent(0, 40),
        sent(1, 41),
        (42, pose(3, &[])),
        done(4, 3, 2, 43),
    ]);
    let consumed: Vec<_> = all.iter().map(handles).collect();
    assert_eq!(consumed, [vec![7], vec![0, 1, 0, 0, 1], vec![], vec![0, 1]]);
    assert!(all.iter().all(|t| t.lost.is_none()), "{:?}", all.iter().find_map(|t| t.lost.clone()));
}

#[test]
fn losses_are_named_once_where_they_are() {
    let lost = |items| turns(items).into_iter().filter_map(|t| t.lost).collect::<Vec<_>>();
    let missing_field =
        vec![(1, pose(0, &[(2, 5)])), (1, step(1, 0, 0)), (2, pose(1, &[])), (2, step(2, 1, 0))];
    assert_eq!(lost(missing_field), ["field 5 of camera 2 is missing"]);
    let middle = vec![(1, pose(4, &[])), (1, step(1, 4, 0))];
    assert_eq!(lost(middle), ["the recording begins at tracker frame 4, not at 0"]);
    let handle_gone = vec![(1, pose(0, &[])), (1, step(1, 0, 4))];
    assert_eq!(lost(handle_gone), ["handle state 3 is missing (field 10)"]);
    let step_gone = vec![(1, pose(0, &[])), (1, step(1, 0, 0)), (2, pose(1, &[])), (2, step(4, 1, 0))];
    assert_eq!(lost(step_gone), ["step 4 follows 1 (field 11)"]);
    let text = "3 items did not fit".to_string();
    let note = Note { instant_ns: 0, kind: NoteKind::Loss, process: None, count: 3, text: text.clone() };
    assert_eq!(lost(vec![(1, Item::Note(note)), (2, pose(0, &[]))]), [text]);
}

fn checkpoint(of: u64, handles_below: u64) -> Item {
    let header =
        CheckpointHeader { step: of, handles_below, state_hash: of * 7, ..CheckpointHeader::zeroed() };
    Item::Checkpoint(header, vec![of as u8])
}

fn determined(all: &[Turn]) -> Vec<(u64, bool, bool)> {
    let of = |s: &StepTurn| (s.recorded.unwrap().step, s.determined, s.resume.is_some());
    all.iter().filter_map(|t| t.step.as_ref().map(of)).collect()
}

#[test]
fn after_a_gap_steps_are_determined_from_the_next_checkpoint_on() {
    let mut items = vec![(1, pose(0, &[])), (1, step(1, 0, 0)), (1, checkpoint(1, 0))];
    // Step 2 with its pose and handles 0 and 1 are missing.
    items.extend([(41, handle(2)), (42, pose(2, &[])), (42, step(3, 2, 3))]);
    items.extend([(61, handle(3)), (62, pose(3, &[])), (62, step(4, 3, 4)), (62, checkpoint(4, 4))]);
    items.extend([(81, handle(4)), (82, pose(4, &[])), (82, step(5, 4, 5))]);
    items.extend([(101, pose(5, &[])), (102, step(6, 5, 5))]);
    let items = items.into_iter().map(|(ms, item)| Ok((ms * MS, item)));
    let mut turns = Turns::new(items, 20 * MS);
    let all: Vec<Turn> = turns.by_ref().collect();
    let expected =
        [(1, true, false), (3, false, false), (4, false, false), (5, true, true), (6, true, false)];
    assert_eq!(determined(&all), expected);
    assert_eq!((turns.missing, turns.strays), (1, 0));
    assert_eq!(handles(&all[3]), [4]);
    assert_eq!(all.iter().filter(|t| t.lost.is_some()).count(), 1);
}

#[test]
fn a_checkpoint_that_was_filed_seconds_late_is_found() {
    let mut items = vec![(1, pose(0, &[])), (1, step(1, 0, 0)), (42, pose(2, &[])), (42, step(3, 2, 0))];
    items.extend([(62, pose(3, &[])), (62, step(4, 3, 0)), (3000, checkpoint(3, 0))]);
    assert_eq!(determined(&turns(items)), [(1, true, false), (3, false, false), (4, true, true)]);
}

#[test]
fn a_missing_field_or_a_note_of_loss_leaves_the_steps_determined() {
    let note = Note::loss(0, 3, "3 items".into());
    let all = turns(vec![
        (1, pose(0, &[(2, 5)])),
        (1, step(1, 0, 0)),
        (2, Item::Note(note)),
        (20, pose(1, &[])),
        (20, step(2, 1, 0)),
    ]);
    assert!(all.iter().all(|t| t.lost.is_some()));
    assert_eq!(determined(&all), [(1, true, false), (2, true, false)]);
}

#[test]
fn a_handle_missing_among_others_is_noticed() {
    let items = vec![
        (1, handle(0)),
        (2, pose(0, &[])),
        (2, step(1, 0, 1)),
        (3, handle(1)),
        (4, handle(3)),
        (5, pose(1, &[])),
        (5, step(2, 1, 4)),
    ];
    let all = turns(items);
    assert_eq!(determined(&all), [(1, true, false), (2, false, false)]);
    assert_eq!(all[1].lost.as_deref(), Some("handle state 2 is missing (field 11)"));
}

#[test]
fn damage_is_a_loss_behind_which_the_turns_go_on() {
    let damaged = || RecordingError::Damaged { file: "a".into(), offset: 9, problem: "p".into() };
    let items = vec![Ok((1, pose(0, &[]))), Err(damaged()), Ok((2, pose(1, &[]))), Err(damaged())];
    let mut turns = Turns::new(items.into_iter(), 20 * MS);
    let lost: Vec<bool> = turns.by_ref().map(|t| t.lost.is_some()).collect();
    assert_eq!(lost, [false, true]);
    assert!(matches!(turns.damage, Some(RecordingError::Damaged { offset: 9, .. })));
    let cut = RecordingError::Truncated { file: "a".into(), offset: 9 };
    let mut turns = Turns::new(vec![Ok((1, pose(0, &[]))), Err(cut)].into_iter(), 20 * MS);
    assert!(turns.by_ref().all(|t| t.lost.is_none()));
    assert!(turns.lost.is_none() && turns.damage.is_some(), "what follows a cut is nobody's loss");
}

#[test]
fn poses_and_states_are_determined_each_by_their_own_inputs() {
    let poses = |items| turns(items).iter().map(|t| t.determined).collect::<Vec<_>>();
    let states =
        |items| determined(&turns(items)).iter().map(|(_, determined, _)| *determined).collect::<Vec<_>>();
    let field_gone = || {
        let first = vec![(1, blobs(0, 0)), (1, pose(0, &[(0, 0)])), (1, step(1, 0, 0))];
        [
            first,
            vec![
                (2, pose(1, &[(0, 1)])),
                (2, step(2, 1, 0)),
                (3, blobs(0, 2)),
                (3, pose(2, &[(0, 2)])),
                (3, step(3, 2, 0)),
            ],
        ]
        .concat()
    };
    assert_eq!((poses(field_gone()), states(field_gone())), (vec![true, false, false], vec![true; 3]));
    let handle_gone = || {
        let first = vec![(1, blobs(0, 0)), (1, pose(0, &[(0, 0)])), (1, step(1, 0, 4))];
        [first, vec![(2, blobs(0, 1)), (2, pose(1, &[(0, 1)])), (2, step(2, 1, 4))]].concat()
    };
    assert_eq!((poses(handle_gone()), states(handle_gone())), (vec![true; 2], vec![false; 2]));
    // A tracker that was started again remembers nothing of what is missing.
    let restarted = vec![
        (1, blobs(0, 0)),
        (1, pose(0, &[(0, 0)])),
        (2, pose(2, &[(0, 0)])),
        (3, blobs(0, 5)),
        (3, pose(0, &[(0, 5)])),
    ];
    assert_eq!(poses(restarted), [true, false, true]);
    assert_eq!(poses(vec![(1, pose(0, &[])), (1, step(1, 0, 0))]), [false], "no camera-fields at all");
}
