//! The quality governor: picks resolution and shading so that frames keep their budget.
//!
//! Pure: fed with measured frame times. It steps down within five frames of an overload, as far as
//! the median frame requires: a few late frames are a disturbance that a lower tier would not help.
//! It comes back slowly, only where the cost expected there fits with a margin, and waits longer
//! after every return that failed. What other tiers cost was measured on this adapter (`costs`). A
//! frame below the floor breaks the budget by itself, so only lasting overload leads there.

use crate::costs::Costs;
use protocol::frames::TierReason;
use std::fmt;

/// A quality tier.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tier {
    /// Width of a channel, px.
    pub width_px: u32,
    /// Height of a channel, px.
    pub height_px: u32,
    /// Edge of a shadow map, px.
    pub shadow_px: u32,
    /// What is computed.
    pub shading: Shading,
}

/// What the shaders compute; a pipeline is made for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shading {
    /// Every pixel is lit; soft shadows from a depth map.
    Full,
    /// Corners are lit; one fetch from a mask of shadows.
    Lean,
}

impl Shading {
    /// Both, in the order in which passes keep their pipelines.
    pub const ALL: [Shading; 2] = [Shading::Full, Shading::Lean];

    /// Samples of a pixel, which smooth the edges of what is drawn.
    pub fn samples(self) -> u32 {
        match self {
            Shading::Full => 4,
            Shading::Lean => 1,
        }
    }

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Shading::Full => "full",
            Shading::Lean => "lean",
        }
    }
}

const fn full(width_px: u32, height_px: u32, shadow_px: u32) -> Tier {
    Tier { width_px, height_px, shadow_px, shading: Shading::Full }
}

const fn lean(width_px: u32, height_px: u32, shadow_px: u32) -> Tier {
    Tier { width_px, height_px, shadow_px, shading: Shading::Lean }
}

/// All tiers, the best first.
pub const TIERS: [Tier; 9] = [
    full(1280, 1024, 2048),
    full(800, 640, 1024),
    full(640, 512, 1024),
    lean(640, 512, 512),
    lean(480, 384, 512),
    lean(400, 320, 256),
    lean(320, 256, 256),
    lean(240, 192, 256),
    lean(160, 128, 128),
];

/// The tier a software adapter starts at.
pub const SOFTWARE_START: usize = 5;
/// The tier a real GPU starts at.
pub const HARDWARE_START: usize = 1;
/// The least tier that a surgeon can train with; a frame at a lower one breaks the budget.
pub const FLOOR: usize = 6;
/// Frames examined for an overload.
const RECENT: usize = 5;
/// Late frames among them that make an overload: the median is late.
const LATE: usize = 3;
/// The same from the floor on, where the next step would break the budget with every frame: only
/// what lasts counts.
const LASTING: usize = 25;
const LASTING_LATE: usize = 13;
/// Frames examined before going up, and below the floor, where every frame breaks the budget.
const WINDOW: usize = 100;
const WINDOW_BELOW_FLOOR: usize = 25;
/// Share of the budget that the expected time of the better tier may take.
const MARGIN: f64 = 0.75;
/// The same for a typical frame of a tier to step down to.
const MARGIN_DOWN: f64 = 0.9;
/// Right after a change: frames longer than this many budgets count, and this many of them in a
/// row.
const HOPELESS: (u64, u32) = (4, 2);
/// Frames of rest after a change, so that a single hiccup does not count twice.
const REST: u32 = 5;
/// Longest back-off, in windows.
const MAX_BACK_OFF: u32 = 32;

/// Why the governor is at its tier, with the figure that decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reason {
    /// Why.
    pub why: TierReason,
    /// Time of the worst frame, or that under which 95 of 100 frames stayed, ms; 0 where none was
    /// measured.
    pub took_ms: f64,
    /// Time a frame may take, ms.
    pub budget_ms: f64,
}

impl fmt::Display for Reason {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Reason { why, took_ms, budget_ms } = self;
        match why {
            TierReason::Overload => write!(out, "frames of up to {took_ms:.0} ms, {budget_ms:.0} allowed"),
            TierReason::Slow => write!(out, "1 frame in 20 over {took_ms:.0} ms, {budget_ms:.0} allowed"),
            TierReason::Room => write!(out, "room: 19 frames in 20 under {took_ms:.0} ms"),
            other => out.write_str(other.text()),
        }
    }
}

/// State of the governor.
#[derive(Debug, Clone)]
pub struct Governor {
    budget_ns: u64,
    tier: usize,
    fixed: bool,
    times_ns: [u64; WINDOW],
    count: usize,
    rest: u32,
    /// Hopeless frames in a row since the last change.
    hopeless: u32,
    costs: Costs,
    /// Windows to wait before the next try upwards.
    back_off: u32,
    waited: u32,
    /// The last change went up, and is on trial.
    on_trial: bool,
    reason: Reason,
}

impl Governor {
    /// Starts at `start`, or stays at `fixed` for ever; both are limited to the tiers there are.
    pub fn new(budget_ns: u64, start: usize, fixed: Option<usize>, costs: Costs) -> Self {
        Self {
            budget_ns,
            tier: fixed.unwrap_or(start).min(TIERS.len() - 1),
            fixed: fixed.is_some(),
            times_ns: [0; WINDOW],
            count: 0,
            rest: REST,
            hopeless: 0,
            costs,
            back_off: 1,
            waited: 0,
            on_trial: false,
            reason: Reason {
                why: if fixed.is_some() { TierReason::Fixed } else { TierReason::Start },
                took_ms: 0.0,
                budget_ms: budget_ns as f64 * 1e-6,
            },
        }
    }

    /// Why it is at this tier.
    pub fn reason(&self) -> Reason {
        self.reason
    }

    /// Index of the tier to draw with.
    pub fn tier_index(&self) -> usize {
        self.tier
    }

    /// The tier to draw with.
    pub fn tier(&self) -> &'static Tier {
        &TIERS[self.tier]
    }

    /// Takes in how long a frame of the present tier took; true if the tier has changed.
    pub fn record_frame(&mut self, frame_ns: u64) -> bool {
        if self.fixed {
            return false;
        }
        if self.rest > 0 {
            return self.record_at_rest(frame_ns);
        }
        self.times_ns[self.count % WINDOW] = frame_ns;
        self.count += 1;
        let (most, enough) = if self.tier < FLOOR { (RECENT, LATE) } else { (LASTING, LASTING_LATE) };
        let recent = most.min(self.count);
        let late = (1..=recent).filter(|&k| self.nth_last(k) > self.budget_ns).count();
        if late >= enough {
            let mut last = [0; LASTING];
            (0..recent).for_each(|k| last[k] = self.nth_last(k + 1));
            last[..recent].sort_unstable();
            let (typical, worst) = (last[recent / 2], last[recent - 1]);
            return self.step_down(self.tier_for(typical), TierReason::Overload, worst);
        }
        let window = if self.tier > FLOOR { WINDOW_BELOW_FLOOR } else { WINDOW };
        if self.count < window {
            return false;
        }
        self.end_of_window(window)
    }

    /// Right after a change: two frames in a row that are far over the budget leave the tier.
    fn record_at_rest(&mut self, frame_ns: u64) -> bool {
        self.rest -= 1;
        let (budgets, in_a_row) = HOPELESS;
        self.hopeless = if frame_ns > budgets * self.budget_ns { self.hopeless + 1 } else { 0 };
        let leave = self.hopeless >= in_a_row && self.tier < FLOOR;
        leave && self.step_down(self.tier_for(frame_ns), TierReason::Overload, frame_ns)
    }

    /// The best lower tier at which a frame that took `typical_ns` here fits; below the floor only
    /// from the floor on.
    fn tier_for(&self, typical_ns: u64) -> usize {
        let fits = |&to: &usize| {
            typical_ns as f64 * self.costs.ratio(self.tier, to) <= MARGIN_DOWN * self.budget_ns as f64
        };
        let next = self.tier + 1;
        (next..TIERS.len()).find(fits).unwrap_or(TIERS.len() - 1).min(next.max(FLOOR))
    }

    fn nth_last(&self, k: usize) -> u64 {
        self.times_ns[(self.count - k) % WINDOW]
    }

    /// A full window: leave if more than one frame in twenty was late, try upwards if it fits.
    fn end_of_window(&mut self, window: usize) -> bool {
        self.times_ns[..window].sort_unstable();
        let p95 = self.times_ns[window * 95 / 100 - 1];
        self.count = 0;
        if p95 > self.budget_ns {
            // Below the floor all frames would break the budget to save a few.
            return self.tier < FLOOR && self.step_down(self.tier + 1, TierReason::Slow, p95);
        }
        if self.on_trial {
            // A whole window held: the doubt is over.
            self.on_trial = false;
            self.back_off = (self.back_off / 2).max(1);
        }
        self.waited += 1;
        if self.tier == 0 || self.waited < self.back_off {
            return false;
        }
        if p95 as f64 * self.costs.ratio(self.tier, self.tier - 1) > self.budget_ns as f64 * MARGIN {
            return false;
        }
        self.on_trial = true;
        self.change_to(self.tier - 1, TierReason::Room, p95)
    }

    fn step_down(&mut self, to: usize, why: TierReason, took_ns: u64) -> bool {
        if self.on_trial {
            self.back_off = (self.back_off * 2).min(MAX_BACK_OFF);
            self.on_trial = false;
        }
        let to = to.min(TIERS.len() - 1);
        if to == self.tier {
            self.count = 0;
            return false;
        }
        self.change_to(to, why, took_ns)
    }

    fn change_to(&mut self, tier: usize, why: TierReason, took_ns: u64) -> bool {
        self.reason = Reason { why, took_ms: took_ns as f64 * 1e-6, ..self.reason };
        self.tier = tier;
        self.count = 0;
        self.waited = 0;
        self.rest = REST;
        self.hopeless = 0;
        true
    }
}

#[cfg(test)]
mod tests {
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
        (0..20).for_each(|_| assert!(!disturbed.record_frame(14_000_000)));
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

    #[test]
    fn a_few_late_frames_change_nothing() {
        let mut governor = governor(3);
        for i in 0..400 {
            let late = i % 50 == 20 || i % 50 == 21;
            assert!(!governor.record_frame(if late { 40_000_000 } else { 11_000_000 }), "frame {i}");
        }
    }

    #[test]
    fn failed_returns_become_rare() {
        // Tier 5 always fails although its expected cost fits.
        let mut governor = governor(6);
        let mut tries = Vec::new();
        for i in 0..20_000 {
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
    fn slow_frames_that_never_crowd_are_named_as_such_and_do_not_lead_below_the_floor() {
        let mut governor = governor(3);
        // One in ten is late, and never two among five.
        let mut note = |frames: usize| {
            (0..frames)
                .filter(|i| governor.record_frame(if i % 10 == 0 { 16_000_000 } else { 9_000_000 }))
                .count()
        };
        assert_eq!(note(150), 1);
        assert_eq!(note(1_000), 2);
        assert_eq!((governor.tier_index(), governor.reason().why), (FLOOR, TierReason::Slow));
        assert_eq!(governor.reason().to_string(), "1 frame in 20 over 16 ms, 15 allowed");
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
}
