//! The quality governor: picks resolution and shading so that frames keep their budget.
//!
//! Pure: fed with measured frame times. It steps down within five frames of an overload and
//! comes back slowly, only where the cost expected there fits with a margin, and waits longer
//! after every return that failed.

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

impl Tier {
    /// About what a frame costs, compared with other tiers: a fully shaded pixel takes four times
    /// a lean one (`docs/rendering.md`).
    fn cost(&self) -> f64 {
        let pixel = if self.shading == Shading::Full { 4.0 } else { 1.0 };
        pixel * f64::from(self.width_px * self.height_px)
    }
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
/// Frames looked at for an overload.
const RECENT: usize = 5;
/// This many late ones among them are an overload.
const LATE: usize = 2;
/// Frames looked at before going up.
const WINDOW: usize = 100;
/// Share of the budget that the expected time of the better tier may take.
const MARGIN: f64 = 0.75;
/// Frames of rest after a change, so that a single hiccup does not count twice.
const REST: u32 = 5;
/// Longest back-off, in windows.
const MAX_BACK_OFF: u32 = 32;

/// Why the governor is at its tier, with the figure that decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reason {
    /// Why.
    pub why: TierReason,
    /// Time of the worst frame, or that under which 95 of 100 frames stayed, ms; 0 where none was measured.
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
    /// Windows to wait before the next try upwards.
    back_off: u32,
    waited: u32,
    /// The last change went up, and is on trial.
    on_trial: bool,
    reason: Reason,
}

impl Governor {
    /// Starts at `start`, or stays at `fixed` for ever; both are limited to the tiers there are.
    pub fn new(budget_ns: u64, start: usize, fixed: Option<usize>) -> Self {
        Self {
            budget_ns,
            tier: fixed.unwrap_or(start).min(TIERS.len() - 1),
            fixed: fixed.is_some(),
            times_ns: [0; WINDOW],
            count: 0,
            rest: REST,
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
    pub fn note(&mut self, frame_ns: u64) -> bool {
        if self.fixed {
            return false;
        }
        if self.rest > 0 {
            // Far too long is believed at once: the start may be hopelessly high.
            self.rest -= 1;
            return frame_ns > 4 * self.budget_ns && self.step_down(2, TierReason::Overload, frame_ns);
        }
        self.times_ns[self.count % WINDOW] = frame_ns;
        self.count += 1;
        let recent = RECENT.min(self.count);
        let late = (1..=recent).filter(|&k| self.nth_last(k) > self.budget_ns).count();
        if late >= LATE {
            let worst = (1..=recent).map(|k| self.nth_last(k)).max().unwrap_or(0);
            let steps = if worst > 2 * self.budget_ns { 2 } else { 1 };
            return self.step_down(steps, TierReason::Overload, worst);
        }
        if self.count < WINDOW {
            return false;
        }
        self.end_of_window()
    }

    fn nth_last(&self, k: usize) -> u64 {
        self.times_ns[(self.count - k) % WINDOW]
    }

    /// A full window: leave if more than one frame in twenty was late, try upwards if it fits.
    fn end_of_window(&mut self) -> bool {
        self.times_ns.sort_unstable();
        let p95 = self.times_ns[WINDOW * 95 / 100 - 1];
        self.count = 0;
        if p95 > self.budget_ns {
            return self.step_down(1, TierReason::Slow, p95);
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
        let ratio = TIERS[self.tier - 1].cost() / TIERS[self.tier].cost();
        if p95 as f64 * ratio > self.budget_ns as f64 * MARGIN {
            return false;
        }
        self.on_trial = true;
        self.change_to(self.tier - 1, TierReason::Room, p95)
    }

    fn step_down(&mut self, steps: usize, why: TierReason, took_ns: u64) -> bool {
        if self.on_trial {
            self.back_off = (self.back_off * 2).min(MAX_BACK_OFF);
            self.on_trial = false;
        }
        let to = (self.tier + steps).min(TIERS.len() - 1);
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
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUDGET: u64 = 15_000_000;

    /// A machine that needs `ns_per_px` for each pixel of both channels and 1 ms besides.
    fn run(governor: &mut Governor, ns_per_px: u64, frames: usize) -> usize {
        let mut late = 0;
        for _ in 0..frames {
            let t = governor.tier();
            let time = 1_000_000 + 2 * u64::from(t.width_px * t.height_px) * ns_per_px;
            late += usize::from(time > BUDGET);
            governor.note(time);
        }
        late
    }

    #[test]
    fn settles_where_the_budget_holds() {
        for ns_per_px in [1, 10, 40, 100, 200] {
            let mut governor = Governor::new(BUDGET, SOFTWARE_START, None);
            run(&mut governor, ns_per_px, 3_000);
            let settled = governor.tier_index();
            assert_eq!(run(&mut governor, ns_per_px, 2_000), 0, "{ns_per_px} ns/px at tier {settled}");
        }
        let mut fast = Governor::new(BUDGET, HARDWARE_START, None);
        run(&mut fast, 1, 2_000);
        assert_eq!(fast.tier_index(), 0);
        assert_eq!((fast.reason().why, fast.reason().took_ms), (TierReason::Room, 2.024));
    }

    #[test]
    fn overload_is_answered_within_five_frames() {
        let mut governor = Governor::new(BUDGET, 3, None);
        (0..50).for_each(|_| assert!(!governor.note(8_000_000)));
        let answered = (0..5).position(|_| governor.note(16_000_000));
        assert!(answered.is_some());
        assert_eq!(governor.tier_index(), 4);
        assert_eq!(governor.reason().to_string(), "frames of up to 16 ms, 15 allowed");
    }

    #[test]
    fn a_single_late_frame_changes_nothing() {
        let mut governor = Governor::new(BUDGET, 3, None);
        for i in 0..400 {
            assert!(!governor.note(if i % 50 == 20 { 40_000_000 } else { 11_000_000 }), "frame {i}");
        }
    }

    #[test]
    fn failed_returns_become_rare() {
        // Tier 5 always fails although its expected cost fits.
        let mut governor = Governor::new(BUDGET, 6, None);
        let mut tries = Vec::new();
        for i in 0..20_000 {
            let before = governor.tier_index();
            governor.note(if before <= 5 { 20_000_000 } else { 3_000_000 });
            if governor.tier_index() < before {
                tries.push(i);
            }
        }
        let gaps: Vec<i32> = tries.windows(2).map(|w| w[1] - w[0]).collect();
        assert!(gaps.len() >= 3 && gaps[gaps.len() - 1] > 4 * gaps[0], "{gaps:?}");
    }

    #[test]
    fn hopeless_start_is_left_at_once_and_fixed_stays() {
        let mut governor = Governor::new(BUDGET, 0, None);
        assert!(governor.note(300_000_000));
        assert_eq!(governor.tier_index(), 2);
        assert_eq!(governor.reason().why, TierReason::Overload);
        let mut fixed = Governor::new(BUDGET, 0, Some(99));
        assert_eq!(fixed.reason().to_string(), "fixed by --tier");
        assert_eq!(fixed.tier_index(), TIERS.len() - 1);
        assert!((0..500).all(|_| !fixed.note(300_000_000)));
    }

    #[test]
    fn slow_frames_that_never_crowd_are_named_as_such() {
        let mut governor = Governor::new(BUDGET, 3, None);
        // One in ten is late, and never two among five.
        let moved =
            (0..150).filter(|i| governor.note(if i % 10 == 0 { 16_000_000 } else { 9_000_000 })).count();
        assert_eq!(moved, 1);
        assert_eq!((governor.tier_index(), governor.reason().why), (4, TierReason::Slow));
        assert_eq!(governor.reason().to_string(), "1 frame in 20 over 16 ms, 15 allowed");
    }

    #[test]
    fn tiers_fall_and_keep_their_shape() {
        for pair in TIERS.windows(2) {
            assert!(pair[1].cost() < pair[0].cost() && pair[1].width_px <= pair[0].width_px);
        }
        assert!(TIERS.iter().all(|t| t.width_px * 4 == t.height_px * 5), "5:4");
    }
}
