//! When it wakes, rehearses and gives up, on instants of the test.

use super::*;
use rig::Rig;

const PERIOD_NS: u64 = 5_000_000;
const AHEAD_NS: u64 = 700_000;

fn ready() -> Readiness {
    Readiness::new(&shipped(), PERIOD_NS, AHEAD_NS)
}

fn shipped() -> Tracker {
    Tracker::new(&Rig::load_or_shipped(None).unwrap())
}

fn note(readiness: &mut Readiness, exposed_ns: Nanos, delay_ns: u64) {
    let reference = Reference { camera: 0, field: exposed_ns / PERIOD_NS, exposed_ns };
    readiness.note(&[], &reference, exposed_ns + delay_ns, 200_000);
}

#[test]
fn it_wakes_before_fields_are_due_and_gives_up_when_they_are_late() {
    let mut readiness = ready();
    assert_eq!((readiness.wake_ns(), readiness.prepare(1)), (None, false), "nothing is known");
    note(&mut readiness, PERIOD_NS, 3_000_000);
    let due_ns = 2 * PERIOD_NS + 3_000_000;
    assert_eq!(readiness.wake_ns(), Some(due_ns - AHEAD_NS));
    assert!(!readiness.prepare(due_ns - AHEAD_NS - 1));
    assert_eq!(readiness.frame.frame, 0);
    assert!(readiness.prepare(due_ns - AHEAD_NS));
    assert_eq!(readiness.frame.field, 1, "the frame before was tracked once more");
    assert!(readiness.prepare(due_ns + LATE_NS));
    assert!(!readiness.prepare(due_ns + LATE_NS + 1));
    assert_eq!(readiness.wake_ns(), None, "until the next frame");
}

#[test]
fn the_least_delay_counts_and_a_longer_one_in_time() {
    let mut readiness = ready();
    let mut exposed_ns = 0;
    let mut due_after = |delay_ns| {
        exposed_ns += PERIOD_NS;
        note(&mut readiness, exposed_ns, delay_ns);
        readiness.due_ns - PERIOD_NS - exposed_ns
    };
    assert_eq!(due_after(3_000_000), 3_000_000);
    assert_eq!(due_after(3_640_000), 3_010_000, "one late field");
    assert_eq!(due_after(2_900_000), 2_900_000);
    let later = (0..1_000_000).map(|_| due_after(3_000_000)).last().unwrap();
    assert!((2_999_900..=3_000_000).contains(&later), "{later}");
}

#[test]
fn a_frame_that_took_long_is_not_rehearsed_and_without_time_nothing_is() {
    let mut readiness = ready();
    let reference = Reference { camera: 0, field: 1, exposed_ns: PERIOD_NS };
    readiness.note(&[], &reference, PERIOD_NS, AHEAD_NS + 1);
    assert!(readiness.prepare(2 * PERIOD_NS));
    assert_eq!(readiness.frame.field, 0);
    let mut never = Readiness::new(&shipped(), PERIOD_NS, 0);
    never.note(&[], &reference, PERIOD_NS, 1);
    assert_eq!((never.wake_ns(), never.prepare(2 * PERIOD_NS)), (None, false));
}
