//! Checks of numbers and instants.

use super::*;
use proptest::prelude::*;

const MS: u64 = 1_000_000;
const P: u64 = 20 * MS;
const CLOCK: Clock = Clock { start_ns: 7_000 * MS, period_ns: P, lines_ns: 18_432_000, patience_ns: 3 * MS };

/// Numbers of fields that come at these instants after the start, ms, and are looked at when they come.
fn placed(numbering: &mut Numbering, at_ms: impl IntoIterator<Item = u64>) -> Vec<Option<u64>> {
    let place = |ms| {
        let at = CLOCK.start_ns + ms * MS;
        match numbering.place(&CLOCK, at, at) {
            Place::Taken { number, .. } => Some(number),
            Place::Late | Place::Before | Place::Surplus => None,
        }
    };
    at_ms.into_iter().map(place).collect()
}

#[test]
fn a_field_is_read_out_as_the_rig_says() {
    assert_eq!(CLOCK.read_out(3), CLOCK.start_ns + 3 * P);
    assert_eq!(CLOCK.read_out(3) - CLOCK.first_line(3), 288 * 64_000);
}

#[test]
fn cameras_of_other_rates_count_from_the_same_start() {
    let fast = Clock { period_ns: P / 4, ..CLOCK };
    for number in [0, 1, 7, 1_000_000] {
        assert_eq!(CLOCK.first_from(CLOCK.read_out(number)), number);
        assert_eq!(fast.first_from(CLOCK.read_out(number)), 4 * number);
        assert_eq!(CLOCK.first_from(fast.read_out(4 * number + 1)), number + 1);
    }
    assert_eq!(CLOCK.first_from(0), 0);
}

#[test]
fn what_waited_in_the_pipe_has_no_delay_and_what_came_later_has_its_own() {
    let mut numbering = Numbering::default();
    let (early, late) = (CLOCK.start_ns - 50 * MS, CLOCK.start_ns + P + 3 * MS);
    assert_eq!(numbering.place(&CLOCK, early, CLOCK.start_ns), Place::Taken { number: 0, delay_ns: 0 });
    assert_eq!(numbering.place(&CLOCK, late, late), Place::Taken { number: 1, delay_ns: 3 * MS });
}

#[test]
fn a_field_waits_for_those_of_the_others_as_long_as_the_budget_allows() {
    assert_eq!(patience_ns(P, 20_432_000, 25 * MS), 25 * MS - 20_432_000 - HARDWARE_NS);
    assert_eq!(patience_ns(5 * MS, 3 * MS, 25 * MS), 5 * MS / 2, "no longer than half a period");
    assert_eq!(patience_ns(P, 24 * MS, 25 * MS), 0);
    let mut numbering = Numbering::default();
    placed(&mut numbering, [0]);
    assert_eq!(numbering.due(&CLOCK, true), CLOCK.first_line(1));
    assert_eq!(numbering.due(&CLOCK, false), CLOCK.read_out(1) + CLOCK.patience_ns);
}

#[test]
fn a_writer_that_catches_up_is_in_step_again() {
    let mut numbering = Numbering::default();
    assert_eq!(placed(&mut numbering, [0, 20]), [Some(0), Some(1)]);
    // Held up for half a second, then 25 fields as fast as the pipe takes them.
    let burst = placed(&mut numbering, (2..27).map(|k| 520 + k));
    assert!(burst[..20].iter().all(Option::is_none), "{burst:?}");
    assert_eq!(burst[24], Some(26));
    assert_eq!(placed(&mut numbering, [547, 560]), [Some(27), Some(28)]);
}

#[test]
fn a_writer_that_lags_for_good_is_taken_up_anew() {
    let mut numbering = Numbering::default();
    assert_eq!(placed(&mut numbering, [0]), [Some(0)]);
    // It stood still for a second and does not make up for it.
    let lagging = placed(&mut numbering, (1..40).map(|k| 1_000 + 20 * k));
    let late = lagging.iter().take_while(|n| n.is_none()).count();
    assert_eq!(late, LAGS_AFTER as usize);
    let numbers: Vec<u64> = lagging[late..].iter().copied().map(|n| n.expect("in time")).collect();
    assert_eq!(numbers[0], 50 + late as u64 + 1);
    assert!(numbers.windows(2).all(|w| w[1] == w[0] + 1));
}

#[test]
fn a_pipe_that_is_opened_again_goes_on_with_the_number_of_its_arrival() {
    let mut numbering = Numbering::default();
    assert_eq!(placed(&mut numbering, [0, 20]), [Some(0), Some(1)]);
    numbering.opened();
    assert_eq!(numbering.due(&CLOCK, false), 0);
    // 5 ms before number 100 and 14 ms after it.
    assert_eq!(placed(&mut numbering, [1_995]), [Some(100)]);
    numbering.opened();
    assert_eq!(placed(&mut numbering, [3_014, 3_020]), [Some(150), Some(151)]);
    numbering.opened();
    assert_eq!(placed(&mut numbering, [3_021]), [Some(152)], "no number comes twice");
}

/// Numbers of fields that a camera stamps with these instants after the start, ms.
fn stamped(numbering: &mut Numbering, at_ms: impl IntoIterator<Item = i64>) -> Vec<Option<u64>> {
    let place = |ms: i64| {
        let at = CLOCK.start_ns.wrapping_add_signed(ms * MS as i64);
        match numbering.place_stamped(&CLOCK, at, at + 2 * MS, at + 2 * MS) {
            Place::Taken { number, delay_ns } => {
                assert_eq!(delay_ns, 2 * MS);
                Some(number)
            }
            Place::Late | Place::Before | Place::Surplus => None,
        }
    };
    at_ms.into_iter().map(place).collect()
}

#[test]
fn a_stamped_field_has_the_number_of_its_instant() {
    let numbers = stamped(&mut Numbering::default(), [-40, 0, 20, 80, 100]);
    assert_eq!(numbers, [None, Some(0), Some(1), Some(4), Some(5)]);
    let before = CLOCK.start_ns - P;
    assert_eq!(Numbering::default().place_stamped(&CLOCK, before, before, before), Place::Before);
}

#[test]
fn a_camera_between_two_numbers_does_not_waver() {
    // Half a period beside the others, and 1 ms of jitter.
    let mut numbering = Numbering::default();
    let at = (0..50).map(|k| 20 * k + if k % 2 == 0 { 9 } else { 11 });
    let numbers: Vec<u64> = stamped(&mut numbering, at).into_iter().flatten().collect();
    assert_eq!(numbers, (0..50).collect::<Vec<u64>>());
}

#[test]
fn a_camera_that_is_faster_than_the_rig_leaves_fields_over() {
    let numbers = stamped(&mut Numbering::default(), (0..100).map(|k| 15 * k));
    let taken: Vec<u64> = numbers.iter().flatten().copied().collect();
    assert!(taken.windows(2).all(|w| w[1] > w[0]), "{taken:?}");
    assert!((70..=76).contains(&taken.len()), "{}", taken.len());
}

#[test]
fn a_stamped_field_waits_for_the_others_and_not_for_what_is_late() {
    let mut numbering = Numbering::default();
    let at = CLOCK.start_ns + 3 * P;
    stamped(&mut numbering, [0]);
    assert_eq!(numbering.stamped_due(&CLOCK, at, CLOCK.read_out(4)), 0);
    assert_eq!(numbering.stamped_due(&CLOCK, at, CLOCK.read_out(3)), at + CLOCK.patience_ns);
    let old = numbering.place_stamped(&CLOCK, at, at, at + 2 * P + 1);
    assert_eq!(old, Place::Late);
}

proptest! {
    #[test]
    fn numbers_grow_and_none_is_taken_beyond_its_time(
        steps in prop::collection::vec((0u64..200, any::<bool>(), 0u64..100), 1..200)
    ) {
        let (mut numbering, mut at, mut last) = (Numbering::default(), CLOCK.start_ns, None);
        for (wait_ms, opened, looked_ms) in steps {
            at += wait_ms * MS;
            if opened {
                numbering.opened();
            }
            let now = at + looked_ms * MS;
            if let Place::Taken { number, delay_ns } = numbering.place(&CLOCK, at, now) {
                prop_assert!(last.is_none_or(|last| number > last));
                prop_assert!(now.saturating_sub(CLOCK.read_out(number)) <= LATE_PERIODS * P);
                prop_assert_eq!(delay_ns, at.saturating_sub(CLOCK.read_out(number)));
                prop_assert!(!opened || number >= CLOCK.number_at(at));
                last = Some(number);
            }
            prop_assert_eq!(numbering.next() > 0, true);
        }
    }
}
