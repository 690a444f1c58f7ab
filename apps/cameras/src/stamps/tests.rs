//! Checks of instants by drivers' stamps.

use super::*;
use proptest::prelude::*;

const MS: u64 = 1_000_000;
const P: u64 = 20 * MS;
/// The first picture, and the lead of the wall clock.
const FIRST: Nanos = 5_000 * MS;
const WALL: u64 = 1_700_000_000_000 * MS;

fn stamp(ns: Nanos) -> Stamp {
    Stamp { ns, clock: StampClock::Monotonic, is_start: false }
}

/// Pictures with numbers `k`, stamped `off` ns beside their time and there 3 ms later.
fn take(stamps: &mut Stamps, k: u64, off: i64) -> Taken {
    let at = FIRST + k * P;
    stamps.take(stamp(at.wrapping_add_signed(off)), k as u32, at + 3 * MS, WALL)
}

#[test]
fn a_camera_that_keeps_its_pace_is_stamped_as_its_driver_says() {
    let mut stamps = Stamps::new(P, 0);
    for k in 0..100 {
        let taken = take(&mut stamps, k, 0);
        assert_eq!((taken.read_out_ns, taken.lost, taken.is_odd), (FIRST + k * P, 0, false));
        assert_eq!(taken.jitter_ns, (k > 0).then_some(0));
    }
}

#[test]
fn jitter_is_measured_and_does_not_get_into_the_instants() {
    let mut stamps = Stamps::new(P, 0);
    // ±1 ms in turn, an average of 0.
    let worst = (0..400).map(|k| {
        let taken = take(&mut stamps, k, if k % 2 == 0 { 1 } else { -1 } * MS as i64);
        let off = taken.read_out_ns.abs_diff(FIRST + k * P);
        if k < 100 { (0, MS) } else { (off, taken.jitter_ns.expect("compared")) }
    });
    let (off, jitter): (Vec<u64>, Vec<u64>) = worst.unzip();
    assert!(*off.iter().max().unwrap() < MS / 5, "{off:?}");
    assert!(jitter.iter().all(|j| (MS / 2..2 * MS).contains(j)), "{jitter:?}");
}

#[test]
fn a_camera_that_is_a_little_fast_is_followed() {
    let mut stamps = Stamps::new(P, 0);
    // 200 ppm: 4 µs a picture.
    let off = |k: u64| -(4_000 * k as i64);
    let taken = (0..2_000).map(|k| take(&mut stamps, k, off(k))).last().unwrap();
    let truth = (FIRST + 1_999 * P).wrapping_add_signed(off(1_999));
    assert!(taken.read_out_ns.abs_diff(truth) < 5_000, "{} ns", taken.read_out_ns.abs_diff(truth));
}

#[test]
fn lost_frames_are_counted_and_leave_their_time_free() {
    let mut stamps = Stamps::new(P, 0);
    take(&mut stamps, 0, 0);
    let taken = take(&mut stamps, 4, 0);
    assert_eq!((taken.lost, taken.read_out_ns), (3, FIRST + 4 * P));
    // The driver's count was reset.
    let again = stamps.take(stamp(FIRST + 5 * P), 0, FIRST + 5 * P + 1, WALL);
    assert_eq!((again.lost, again.read_out_ns), (0, FIRST + 5 * P));
    // Two fields of one frame.
    assert_eq!(stamps.take(stamp(FIRST + 6 * P), 0, FIRST + 6 * P + 1, WALL).lost, 0);
}

#[test]
fn stamps_that_cannot_be_true_are_replaced_by_the_arrival() {
    let hour = 3_600_000 * MS;
    for (ns, what) in [
        (FIRST + 9 * P + hour, "an hour ahead"),
        (FIRST + 9 * P - hour.min(FIRST), "an hour back"),
        (FIRST + 3 * P, "back before the picture that came last"),
        (0, "none at all"),
        (u64::MAX, "nonsense"),
    ] {
        let mut stamps = Stamps::new(P, 0);
        (0..9).for_each(|k| assert!(!take(&mut stamps, k, 0).is_odd));
        let arrived = FIRST + 9 * P + 3 * MS;
        let taken = stamps.take(stamp(ns), 9, arrived, WALL);
        assert!(taken.is_odd, "{what}");
        assert!(taken.read_out_ns.abs_diff(FIRST + 9 * P) <= 3 * MS, "{what}: {taken:?}");
        let next = take(&mut stamps, 10, 0);
        assert!(!next.is_odd && next.read_out_ns.abs_diff(FIRST + 10 * P) < MS, "{what}: {next:?}");
    }
}

#[test]
fn stamps_of_other_clocks_are_converted_or_not_believed() {
    let of = |clock, ns, is_start| {
        let mut stamps = Stamps::new(P, 2 * MS);
        let taken = stamps.take(Stamp { ns, clock, is_start }, 0, FIRST + 3 * MS, WALL);
        (taken.read_out_ns, taken.is_odd)
    };
    assert_eq!(of(StampClock::Unknown, FIRST + WALL, false), (FIRST, false));
    assert_eq!(of(StampClock::Unknown, FIRST, false), (FIRST, false));
    assert_eq!(of(StampClock::Monotonic, FIRST, true), (FIRST + 2 * MS, false));
    assert_eq!(of(StampClock::Monotonic, FIRST + WALL, false), (FIRST + 3 * MS, true));
    assert_eq!(of(StampClock::Copied, FIRST, false), (FIRST + 3 * MS, true));
}

proptest! {
    #[test]
    fn instants_are_near_the_arrival_whatever_the_driver_says(
        told in prop::collection::vec((any::<u64>(), any::<u32>(), 0u64..3, 0u64..3_000, any::<bool>()), 1..80)
    ) {
        let (mut stamps, mut at) = (Stamps::new(P, 5 * MS), FIRST);
        for (ns, sequence, clock, wait_ms, near) in told {
            at += wait_ms * MS;
            let clock = [StampClock::Monotonic, StampClock::Unknown, StampClock::Copied][clock as usize];
            let ns = if near { at - ns % MS } else { ns };
            let taken = stamps.take(Stamp { ns, clock, is_start: near }, sequence, at, WALL);
            prop_assert!(taken.read_out_ns <= at + AHEAD_NS);
            prop_assert!(taken.read_out_ns + LATEST_NS + P >= at, "{} {at}", taken.read_out_ns);
        }
    }
}
