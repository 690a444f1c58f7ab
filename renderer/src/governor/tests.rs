//! Tests of the governor on made-up times.

use super::*;

const BUDGET: u64 = 15_000_000;

fn governor(start: usize) -> Governor {
    Governor::new(BUDGET, start, None, Costs::default())
}

/// A machine that needs `ns_per_px` for each pixel of both channels, 20 times as long for a
/// fully shaded one, and 1 ms besides.
fn run(governor: &mut Governor, ns_per_px: u64, frames: usize) -> usize {
    let mut late = 0;
    for _ in 0..frames {
        let t = governor.tier();
        let dearer = if t.shading == Shading::Full { 20 } else { 1 };
        let time = 1_000_000 + 2 * dearer * u64::from(t.width_px * t.height_px) * ns_per_px;
        late += usize::from(time > BUDGET);
        governor.record_frame(time);
    }
    late
}

#[test]
fn settles_where_the_budget_holds() {
    for ns_per_px in [1, 10, 40, 100, 200] {
        let mut governor = governor(SOFTWARE_START);
        run(&mut governor, ns_per_px, 3_000);
        let settled = governor.tier_index();
        assert_eq!(run(&mut governor, ns_per_px, 2_000), 0, "{ns_per_px} ns/px at tier {settled}");
    }
    let alike = Costs::measured(&[Some(1_000_000); TIERS.len()]);
    let mut fast = Governor::new(BUDGET, HARDWARE_START, None, alike);
    run(&mut fast, 0, 2_000);
    assert_eq!(fast.tier_index(), 0);
    assert_eq!((fast.reason().why, fast.reason().took_ms), (TierReason::Room, 1.0));
}

#[test]
fn overload_is_answered_within_five_frames() {
    let mut governor = governor(3);
    (0..50).for_each(|_| assert!(!governor.record_frame(8_000_000)));
    let answered = (0..5).position(|_| governor.record_frame(16_000_000));
    assert!(answered.is_some());
    assert_eq!(governor.tier_index(), 4);
    assert_eq!(governor.reason().to_string(), "frames of up to 16 ms, 15 allowed");
}

#[test]
fn it_falls_no_further_than_it_must() {
    // Twice the budget at 2×640×512: the next tier would need 17 ms, the one after that 12.
    let mut steady = governor(3);
    (0..20).any(|_| steady.record_frame(30_000_000));
    assert_eq!(steady.tier_index(), 5);
    // Two frames of 100 ms among good ones do not count, and one more does not make the good
    // ones bad.
    let mut disturbed = governor(3);
    (0..20).for_each(|_| assert!(!disturbed.record_frame(13_000_000)));
    assert!(
        !disturbed.record_frame(100_000_000)
            && !disturbed.record_frame(100_000_000)
            && disturbed.record_frame(16_000_000)
    );
    assert_eq!(disturbed.tier_index(), 4, "for the typical one, 16 ms");
    // Below the floor only what lasts at the floor leads.
    let mut long = governor(SOFTWARE_START);
    let mut changes = Vec::new();
    for _ in 0..70 {
        if long.record_frame(200_000_000) {
            changes.push(long.tier_index());
        }
    }
    assert_eq!(changes, [6, 7, 8], "after 2, 18 and 18 frames");
}

#[test]
fn a_hiccup_right_after_a_change_is_none() {
    let mut governor = governor(SOFTWARE_START);
    assert!(!governor.record_frame(90_000_000));
    (0..90).for_each(|i| assert!(!governor.record_frame(8_000_000), "frame {i}"));
    assert_eq!(governor.tier_index(), SOFTWARE_START);
}

/// Feeds frames of which one in `every` takes `late`, the rest 9 ms; how often the tier changed.
fn one_in(governor: &mut Governor, every: usize, late: u64, frames: usize) -> usize {
    (0..frames)
        .filter(|i| governor.record_frame(if i % every == every - 1 { late } else { 9_000_000 }))
        .count()
}

#[test]
fn one_frame_in_a_hundred_may_be_late_and_two_may_not() {
    let mut kept = governor(3);
    assert_eq!(one_in(&mut kept, 100, 40_000_000, 5_000), 0);
    let mut left = governor(3);
    // The sixth of 500 decides, long before the 500 are full.
    assert_eq!(one_in(&mut left, 50, 14_500_000, 299), 0);
    assert_eq!(one_in(&mut left, 50, 14_500_000, 50), 1);
    assert_eq!((left.tier_index(), left.reason().why), (4, TierReason::Slow));
    assert_eq!(left.reason().to_string(), "1 frame in 100 over 14.5 ms, 15 allowed");
    // Within 14 ms nothing is late, and late frames of long ago do not count.
    assert_eq!(one_in(&mut governor(3), 2, 13_900_000, 5_000), 0);
    let mut calm = governor(3);
    assert_eq!(one_in(&mut calm, 20, 16_000_000, 105) + one_in(&mut calm, 600, 0, 500), 0);
    assert_eq!(one_in(&mut calm, 20, 16_000_000, 105), 0, "five of the first 105 frames are forgotten");
    assert_eq!(one_in(&mut calm, 20, 16_000_000, 20), 1);
}

#[test]
fn it_climbs_where_99_of_100_frames_are_expected_in_12_ms() {
    // From tier 5 to tier 4 a frame gets at most 1.44 times dearer.
    let mut fits = governor(SOFTWARE_START);
    assert_eq!(one_in(&mut fits, 50, 8_300_000, 505), 0, "9 ms are 12.96 there");
    let climbs = |typical: u64, late: u64| {
        let mut governor = governor(SOFTWARE_START);
        (0..505).filter(|i| governor.record_frame(if i % 50 == 7 { late } else { typical })).count()
    };
    assert_eq!(climbs(5_000_000, 8_300_000), 1);
    assert_eq!(climbs(5_000_000, 8_400_000), 0, "99 of 100 would stay within 12.1 ms");
    assert_eq!(climbs(8_300_000, 1_000_000), 1);
}

#[test]
fn what_a_tier_took_is_remembered() {
    let mut governor = governor(SOFTWARE_START);
    (0..20).any(|_| governor.record_frame(16_000_000));
    assert_eq!(governor.tier_index(), FLOOR);
    // 3 ms here are 4.7 at tier 5, but it took 16 a while ago.
    let frames = (0..5_000).position(|_| governor.record_frame(3_000_000)).unwrap();
    assert_eq!(frames + 1, REST as usize + 3 * WINDOW);
    assert_eq!(governor.tier_index(), SOFTWARE_START);
}

#[test]
fn failed_returns_become_rare() {
    // Tier 5 always fails although its expected cost fits.
    let mut governor = governor(6);
    let mut tries = Vec::new();
    for i in 0..60_000 {
        let before = governor.tier_index();
        governor.record_frame(if before <= 5 { 20_000_000 } else { 3_000_000 });
        if governor.tier_index() < before {
            tries.push(i);
        }
    }
    let gaps: Vec<i32> = tries.windows(2).map(|w| w[1] - w[0]).collect();
    assert!(gaps.len() >= 3 && gaps[gaps.len() - 1] > 4 * gaps[0], "{gaps:?}");
}

#[test]
fn hopeless_start_is_left_at_once_and_fixed_stays() {
    let mut governor = governor(HARDWARE_START);
    assert!(!governor.record_frame(300_000_000) && governor.record_frame(300_000_000));
    assert_eq!(governor.tier_index(), 3, "a thirtieth: a twentieth for its shading, and fewer pixels");
    assert_eq!(governor.reason().why, TierReason::Overload);
    let mut fixed = Governor::new(BUDGET, 0, Some(99), Costs::default());
    assert_eq!(fixed.reason().to_string(), "fixed by --tier");
    assert_eq!(fixed.tier_index(), TIERS.len() - 1);
    assert!((0..500).all(|_| !fixed.record_frame(300_000_000)));
}

#[test]
fn slow_frames_do_not_lead_below_the_floor() {
    let mut governor = governor(3);
    // One in ten is late, and never two among five.
    assert_eq!(one_in(&mut governor, 10, 16_000_000, 5_000), FLOOR - 3);
    assert_eq!((governor.tier_index(), governor.reason().why), (FLOOR, TierReason::Slow));
}

#[test]
fn it_leaves_the_depths_below_the_floor_soon() {
    let mut governor = governor(FLOOR + 1);
    let frames = (0..100).position(|_| governor.record_frame(5_000_000));
    assert!(frames.is_some_and(|n| n <= 30), "{frames:?}");
    assert_eq!(governor.tier_index(), FLOOR);
}

#[test]
fn tiers_fall_and_keep_their_shape() {
    for pair in TIERS.windows(2) {
        assert!(pair[1].width_px <= pair[0].width_px);
        assert!(pair[1].width_px < pair[0].width_px || pair[1].shading != pair[0].shading);
    }
    assert!(TIERS.iter().all(|t| t.width_px * 4 == t.height_px * 5), "5:4");
}
