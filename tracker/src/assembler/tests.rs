//! The assembler: which fields close a frame, and when.

use super::*;
use bytemuck::Zeroable;
use proptest::prelude::*;

const MS: u64 = 1_000_000;
const AGE: u64 = 24 * MS;

fn assembler() -> FrameAssembler {
    FrameAssembler::new(&Rig::load_or_shipped(None).unwrap())
}

fn field(camera: u32, number: u64, exposed_ns: u64) -> BlobField {
    let mut field = BlobField::zeroed();
    (field.camera, field.field, field.exposed_ns) = (camera, number, exposed_ns);
    (field.parity, field.blobs_out_ns) = ((number & 1) as u32, exposed_ns + AGE);
    field
}

/// Feeds fields in the order of arrival, time-outs in between, as the stream clock does.
fn run(assembler: &mut FrameAssembler, fields: &[(BlobField, u64)]) -> Vec<(ClosedFrame, Vec<(u32, u64)>)> {
    let mut frames = Vec::new();
    for (field, now) in fields {
        while let Some(closed) = assembler.expired(*now) {
            frames.push((closed, used_by(assembler)));
        }
        let _ = assembler.push(field, *now);
        while let Some(closed) = assembler.complete(*now) {
            frames.push((closed, used_by(assembler)));
        }
    }
    frames
}

fn used_by(assembler: &FrameAssembler) -> Vec<(u32, u64)> {
    assembler.used().iter().map(|f| (f.camera, f.field)).collect()
}

fn stream(phases_ns: [u64; 3], periods: u64, keep: impl Fn(u32, u64) -> bool) -> Vec<(BlobField, u64)> {
    let mut all: Vec<(BlobField, u64)> = (0..periods)
        .flat_map(|n| (0..3u32).map(move |c| (c, n)))
        .filter(|&(c, n)| keep(c, n))
        .map(|(c, n)| field(c, n, 100 * MS + n * 20 * MS + phases_ns[c as usize]))
        .map(|f| (f, f.blobs_out_ns))
        .collect();
    all.sort_by_key(|(_, now)| *now);
    all
}

#[test]
fn genlocked_cameras_close_on_their_last_field() {
    let frames = run(&mut assembler(), &stream([30_000, 0, 70_000], 10, |_, _| true));
    assert_eq!(frames.len(), 10);
    for (n, (closed, used)) in frames.iter().enumerate() {
        let n = n as u64;
        assert_eq!((closed.closed_by, closed.reference.camera), (ClosedBy::Inputs, 0));
        assert_eq!((closed.reference.field, closed.waited_ns), (n, 70_000));
        assert_eq!(*used, [(1, n), (0, n), (2, n)]);
    }
}

#[test]
fn free_running_cameras_are_not_waited_for() {
    let frames = run(&mut assembler(), &stream([0, 7 * MS, 13 * MS], 10, |_, _| true));
    assert_eq!(frames.len(), 10);
    for (n, (closed, used)) in frames.iter().enumerate().skip(1) {
        let n = n as u64;
        assert_eq!((closed.closed_by, closed.waited_ns), (ClosedBy::Inputs, 0));
        assert_eq!(*used, [(1, n - 1), (2, n - 1), (0, n)]);
    }
}

#[test]
fn a_missing_field_costs_three_milliseconds() {
    let frames = run(&mut assembler(), &stream([0, 0, 50_000], 10, |c, n| (c, n) != (2, 4)));
    let (closed, used) = &frames[4];
    assert_eq!((closed.closed_by, closed.waited_ns), (ClosedBy::TimeOut, CAMERA_WAIT_NS));
    assert_eq!(*used, [(0, 4), (1, 4)]);
    assert_eq!(closed.taken_ns, 180 * MS + AGE + CAMERA_WAIT_NS);
    assert!(frames.iter().filter(|(c, _)| c.closed_by == ClosedBy::TimeOut).count() == 1);
}

#[test]
fn another_camera_stands_in_for_the_reference() {
    let frames = run(&mut assembler(), &stream([0, 10_000, 20_000], 10, |c, n| (c, n) != (0, 4)));
    assert_eq!(frames.len(), 10);
    let (closed, used) = &frames[4];
    assert_eq!((closed.reference.camera, closed.reference.field), (1, 4));
    assert_eq!((closed.closed_by, used.as_slice()), (ClosedBy::TimeOut, &[(1, 4), (2, 4)][..]));
}

#[test]
fn a_field_missed_by_a_free_running_reference_leaves_no_gap() {
    let (phases, missing) = ([0, 7 * MS, 13 * MS], 4);
    let frames = run(&mut assembler(), &stream(phases, 10, |c, n| (c, n) != (0, missing)));
    assert_eq!(frames.len(), 10);
    let (closed, used) = &frames[missing as usize];
    let due = 100 * MS + missing * 20 * MS;
    assert_eq!(closed.reference, Reference { camera: 0, field: missing, exposed_ns: due });
    assert_eq!((closed.closed_by, closed.waited_ns), (ClosedBy::TimeOut, CAMERA_WAIT_NS));
    assert_eq!(closed.taken_ns, due + AGE + CAMERA_WAIT_NS);
    assert_eq!(*used, [(1, missing - 1), (2, missing - 1)]);
}

#[test]
fn a_dead_camera_is_not_waited_for_and_comes_back() {
    let frames = run(&mut assembler(), &stream([0, 0, 0], 40, |c, n| c != 0 || !(10..30).contains(&n)));
    assert_eq!(frames.len(), 40);
    let time_outs: Vec<_> = (0..40).filter(|&n| frames[n].0.closed_by == ClosedBy::TimeOut).collect();
    assert!(time_outs.iter().all(|n| (10..15).contains(n)), "{time_outs:?}");
    assert!((15..30).all(|n| frames[n].0.reference.camera == 1));
    assert!((31..40).all(|n| frames[n].0.reference.camera == 0 && frames[n].1.len() == 3));
}

#[test]
fn a_late_field_goes_into_the_next_frame() {
    let mut fields = stream([0, 0, 0], 6, |_, _| true);
    let late = fields.iter().position(|(f, _)| (f.camera, f.field) == (2, 3)).unwrap();
    fields[late].1 += 10 * MS;
    fields.sort_by_key(|(_, now)| *now);
    let frames = run(&mut assembler(), &fields);
    assert_eq!(frames[3].0.closed_by, ClosedBy::TimeOut);
    assert_eq!(frames[4].1, [(2, 3), (0, 4), (1, 4), (2, 4)]);
    assert_eq!(frames.len(), 6);
}

#[test]
fn the_next_field_of_the_reference_closes_a_frame() {
    let mut assembler = assembler();
    let now = 300 * MS;
    assembler.push(&field(0, 0, 100 * MS), now).unwrap();
    assert_eq!(assembler.complete(now), None);
    assembler.push(&field(0, 1, 120 * MS), now).unwrap();
    let closed = assembler.complete(now).unwrap();
    assert_eq!((closed.reference.field, closed.closed_by), (0, ClosedBy::NextField));
}

#[test]
fn bad_fields_are_refused_and_counted() {
    let mut assembler = assembler();
    let now = 1000 * MS;
    assembler.push(&field(1, 5, 200 * MS), now).unwrap();
    let mut wrong = field(1, 6, 220 * MS);
    wrong.count = 65;
    assert_eq!(assembler.push(&wrong, now), Err(Refusal::Invalid));
    assert_eq!(assembler.push(&field(7, 6, 220 * MS), now), Err(Refusal::UnknownCamera(7)));
    assert_eq!(assembler.push(&field(99, 6, 220 * MS), now), Err(Refusal::UnknownCamera(99)));
    assert_eq!(assembler.push(&field(1, 6, 2000 * MS), now), Err(Refusal::FromTheFuture(1)));
    assert!(matches!(assembler.push(&field(1, 5, 200 * MS), now), Err(Refusal::NotNewer { .. })));
    assert!(matches!(assembler.push(&field(1, 4, 180 * MS), now), Err(Refusal::NotNewer { .. })));
    assert_eq!(assembler.refused(), 6);
    assembler.push(&field(1, 0, 240 * MS), now).expect("a restarted camera counts from 0 again");
}

#[test]
fn a_clock_set_back_is_believed_in_the_end() {
    let mut assembler = assembler();
    let mut taken = Vec::new();
    assembler.push(&field(0, 0, 9000 * MS), 9999 * MS).unwrap();
    for n in 1..40 {
        if assembler.push(&field(0, n, n * 20 * MS), 9999 * MS + n).is_ok() {
            taken.push(n);
        }
    }
    assert_eq!(taken, (25..40).collect::<Vec<_>>());
}

/// Cameras of 50, 100 and 200 Hz; the fields in the order of arrival.
fn mixed_stream(ms: u64, phases_ns: [u64; 3], keep: impl Fn(u32, u64) -> bool) -> Vec<(BlobField, u64)> {
    let mut all = Vec::new();
    for (camera, period_ms) in [(0, 20), (1, 10), (2, 5)] {
        for n in (0..ms / period_ms).filter(|n| keep(camera, *n)) {
            let exposed_ns = 100 * MS + n * period_ms * MS + phases_ns[camera as usize];
            all.push(BlobField { blobs_out_ns: exposed_ns + 4 * MS, ..field(camera, n, exposed_ns) });
        }
    }
    let mut all: Vec<_> = all.into_iter().map(|f| (f, f.blobs_out_ns)).collect();
    all.sort_by_key(|(f, now)| (*now, f.camera));
    all
}

fn mixed_assembler() -> FrameAssembler {
    let mut rig = Rig::load_or_shipped(None).unwrap();
    (rig.field_hz, rig.line_ns, rig.exposure_ns) = (200.0, 10_000, 1_000_000);
    (rig.cameras[0].field_hz, rig.cameras[1].field_hz) = (Some(50.0), Some(100.0));
    FrameAssembler::new(&Rig::parse(&rig.to_json(), "mixed").unwrap())
}

#[test]
fn the_fastest_camera_makes_the_frames_and_slower_ones_are_awaited_when_they_are_due() {
    let frames = run(&mut mixed_assembler(), &mixed_stream(100, [40_000, 0, 10_000], |_, _| true));
    assert_eq!(frames.len(), 20);
    for (n, (closed, used)) in frames.iter().enumerate() {
        let n = n as u64;
        assert_eq!((closed.reference.camera, closed.reference.field), (2, n));
        assert_eq!(closed.closed_by, ClosedBy::Inputs, "frame {n}");
        let expected: Vec<_> = [(1, 2), (2, 1), (0, 4)]
            .into_iter()
            .filter(|&(_, every)| n.is_multiple_of(every))
            .map(|(camera, every)| (camera, n / every))
            .collect();
        assert_eq!(*used, expected, "frame {n}");
    }
}

#[test]
fn a_field_that_a_slow_camera_misses_holds_up_one_frame_alone() {
    let frames = run(&mut mixed_assembler(), &mixed_stream(100, [0; 3], |c, n| (c, n) != (0, 2)));
    let held_up: Vec<_> = (0..20).filter(|&n| frames[n].0.closed_by == ClosedBy::TimeOut).collect();
    assert_eq!(held_up, [8]);
    assert_eq!(frames[8].0.waited_ns, 2_500_000, "half a period");
}

#[test]
fn slow_cameras_that_run_free_are_not_waited_for() {
    let frames = run(&mut mixed_assembler(), &mixed_stream(100, [7 * MS, 3 * MS, 0], |_, _| true));
    assert_eq!(frames.len(), 20);
    assert!(frames.iter().skip(8).all(|(c, _)| (c.closed_by, c.waited_ns) == (ClosedBy::Inputs, 0)));
    let slow: Vec<_> = frames.iter().flat_map(|(_, used)| used).filter(|(c, _)| *c == 0).collect();
    assert_eq!(slow.len(), 5);
}

#[test]
fn without_the_fastest_camera_the_next_makes_the_frames_and_their_numbers_go_on() {
    let frames = run(&mut mixed_assembler(), &mixed_stream(600, [0; 3], |c, n| c != 2 || n < 40));
    let numbers: Vec<u64> = frames.iter().map(|(c, _)| c.reference.field).collect();
    assert!(numbers.windows(2).all(|w| w[1] > w[0]), "{numbers:?}");
    assert_eq!(numbers[..40], (0..40).collect::<Vec<u64>>());
    // 100 Hz: every second number, each of the instant at which the fastest would have exposed.
    assert_eq!(numbers[numbers.len() - 20..], (0..20).map(|n| 80 + 2 * n).collect::<Vec<u64>>());
    let on_time = |c: &ClosedFrame| c.reference.exposed_ns == 100 * MS + c.reference.field * 5 * MS;
    assert!(frames.iter().all(|(c, _)| on_time(c)));
    let last = &frames[frames.len() - 1].0;
    assert_eq!((last.reference.camera, last.closed_by), (1, ClosedBy::Inputs));
}

#[test]
fn a_slow_camera_whose_lines_take_longer_is_not_waited_for() {
    let mut rig = Rig::load_or_shipped(None).unwrap();
    (rig.field_hz, rig.line_ns, rig.exposure_ns) = (200.0, 10_000, 1_000_000);
    (rig.cameras[0].field_hz, rig.cameras[0].line_ns) = (Some(50.0), Some(64_000));
    let mut assembler = FrameAssembler::new(&Rig::parse(&rig.to_json(), "slow lines").unwrap());
    let mut fields = mixed_stream(200, [0; 3], |c, _| c != 1);
    fields.iter_mut().filter(|(f, _)| f.camera == 0).for_each(|(_, now)| *now += 14 * MS);
    for n in 0..40 {
        let exposed_ns = 100 * MS + n * 5 * MS;
        fields.push((field(1, n, exposed_ns), exposed_ns + 4 * MS));
    }
    fields.sort_by_key(|(f, now)| (*now, f.camera));
    let frames = run(&mut assembler, &fields);
    let waited = frames.iter().skip(4).filter(|(c, _)| c.waited_ns > 0).count();
    assert_eq!(waited, 0, "{:?}", frames.iter().map(|(c, _)| c.waited_ns).collect::<Vec<_>>());
    let slow = frames.iter().flat_map(|(_, used)| used).filter(|(c, _)| *c == 0).count();
    assert!(slow >= 9, "{slow} of 10: each goes into the next frame");
}

proptest! {
    #[test]
    fn any_order_of_fields_keeps_the_rules(
        fields in prop::collection::vec((0u32..9, 0u64..60, 0u64..1_200_000_000u64, 0u64..8), 1..300),
    ) {
        let mut assembler = assembler();
        let (mut now, mut last_ns) = (0, 0);
        for (camera, number, exposed_ns, step) in fields {
            now += step * MS;
            let closing = [assembler.expired(now), None];
            let _ = assembler.push(&field(camera, number, exposed_ns.min(now)), now);
            let mut next = closing.into_iter().flatten().next();
            loop {
                if let Some(closed) = next {
                    prop_assert!(closed.waited_ns <= CAMERA_WAIT_NS);
                    prop_assert!(assembler.used().len() <= MAX_FIELDS_USED);
                    if assembler.cameras.iter().all(|c| u64::from(c.refused_in_a_row) + 1 < CLOCK_SET_BACK_NS / 20_000_000) {
                        prop_assert!(closed.reference.exposed_ns > last_ns || last_ns == 0);
                    }
                    last_ns = assembler.last_frame_ns;
                }
                next = assembler.complete(now);
                if next.is_none() { break; }
            }
            prop_assert!(assembler.pending.len() <= MAX_FIELDS_USED);
        }
    }
}
