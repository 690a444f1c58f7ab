//! The governor on recorded series: what frames of 2×400×320 took on a software driver. On the busy
//! machine, whose cores other programs kept busy, one in nine was late, now and then two or three at a
//! time. On the other one, at the edge, the renderer had the cores nearly to itself: p99 14.5 ms of 15.

use renderer::costs::Costs;
use renderer::governor::{FLOOR, Governor, SOFTWARE_START, TIERS};

const BUDGET_NS: u64 = 15_000_000;

const BUSY: &str = include_str!("../../tests/data/frame-times/busy.txt");
const EDGE: &str = include_str!("../../tests/data/frame-times/edge.txt");

/// Times at tier 5, ns.
fn series(text: &str) -> Vec<u64> {
    text.split_whitespace().map(|tenths| tenths.parse::<u64>().expect("a number") * 100_000).collect()
}

/// What a frame cost on that driver, tenths of a ms: processor time, docs/gpu.md.
const COSTS: [u64; TIERS.len()] = [36_000, 14_000, 3_600, 190, 130, 100, 70, 50, 33];

#[test]
fn a_busy_machine_does_not_push_it_below_the_floor() {
    let costs = Costs::measured(&COSTS.map(Some));
    let mut governor = Governor::new(BUDGET_NS, SOFTWARE_START, None, costs.clone());
    let (mut late, mut late_ungoverned, mut changes) = (0, 0, 0);
    let series = series(BUSY);
    assert!(series.len() > 200);
    for at_5 in &series {
        let took = (*at_5 as f64 * costs.ratio(SOFTWARE_START, governor.tier_index())) as u64;
        late += usize::from(took > BUDGET_NS);
        late_ungoverned += usize::from(*at_5 > BUDGET_NS);
        changes += usize::from(governor.record_frame(took));
        assert!(governor.tier_index() <= FLOOR, "tier {}", governor.tier_index());
    }
    assert!((1..4).contains(&changes), "{changes} changes");
    assert!(3 * late < 2 * late_ungoverned, "{late} of {late_ungoverned} late frames are left");
    // And it still answers what is no disturbance.
    let mut governor = Governor::new(BUDGET_NS, SOFTWARE_START, None, costs);
    series.iter().filter(|t| **t < 14_000_000).for_each(|t| assert!(!governor.record_frame(*t)));
    let answered = (0..5).position(|_| governor.record_frame(2 * BUDGET_NS));
    assert!(answered.is_some() && governor.tier_index() == FLOOR);
}

#[test]
fn a_tier_at_the_edge_of_the_budget_is_left_in_time() {
    let series = series(EDGE);
    assert_eq!(series.len(), 950, "as many as the demo judges");
    let costs = Costs::measured(&COSTS.map(Some));
    let mut governor = Governor::new(BUDGET_NS, SOFTWARE_START, None, costs.clone());
    let mut took: Vec<u64> = Vec::new();
    let mut changes = 0;
    for at_5 in &series {
        took.push((*at_5 as f64 * costs.ratio(SOFTWARE_START, governor.tier_index())) as u64);
        changes += usize::from(governor.record_frame(took[took.len() - 1]));
    }
    took.sort_unstable();
    assert_eq!((governor.tier_index(), changes), (FLOOR, 1));
    // At tier 5 the p99 was 14.5.
    assert!(took[took.len() * 99 / 100] <= 14 * BUDGET_NS / 15);
    assert!(took.iter().filter(|t| **t > BUDGET_NS).count() < took.len() / 100);
}
