//! The quality governor: picks resolution and shading so that frames keep their budget.
//!
//! Pure: fed with measured frame times. It judges as the budget does, by the time under which 99 of
//! 100 frames stay, but asks for a margin: it leaves a tier as soon as more than one frame in a
//! hundred of the last 500 is over 14 of 15 parts of the budget, and goes to a better one only where
//! 99 of 100 are expected within 12. What is expected follows from what the frames took here, from
//! what the tiers cost on this adapter (`costs`), and from what the better tier took when it was left;
//! that is remembered the longer, the more often a return failed. A gross overload is answered within
//! five frames, as far as the median frame requires. A frame below the floor breaks the budget by
//! itself, so only lasting overload leads there.

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
/// The best tier with lean shading, and the best for which a software driver makes room.
pub const FIRST_LEAN: usize = 3;
/// The tier a real GPU starts at.
pub const HARDWARE_START: usize = 1;
/// The least tier that a surgeon can train with; a frame at a lower one breaks the budget.
pub const FLOOR: usize = 6;
/// Frames that are judged together, ten seconds of them at 50 a second.
const WINDOW: usize = 500;
/// As many of them may be late: the rest are 99 of 100.
const MAY_BE_LATE: usize = WINDOW / 100;
/// Frames below the floor, where every one breaks the budget, and those that may be late.
const WINDOW_BELOW_FLOOR: usize = 25;
const MAY_BE_LATE_BELOW_FLOOR: usize = 2;
/// Share of the budget over which a frame is late, and within which the frames of a better tier are
/// expected: 14 and 12 ms of 15.
const LATE: f64 = 14.0 / 15.0;
const ROOM: f64 = 12.0 / 15.0;
/// Frames examined for a gross overload, and those over the budget among them that make one: the
/// median is.
const RECENT: usize = 5;
const OVER: usize = 3;
/// The same from the floor on, where the next step would break the budget with every frame: only
/// what lasts counts.
const LASTING: usize = 25;
const LASTING_OVER: usize = 13;
/// Share of the budget that a typical frame of a tier to step down to may take.
const MARGIN_DOWN: f64 = 0.9;
/// Right after a change: frames longer than this many budgets count, and this many of them in a
/// row.
const HOPELESS: (u64, u32) = (4, 2);
/// Frames of rest after a change, so that a single hiccup does not count twice.
const REST: u32 = 5;
/// Windows for which it is remembered what a tier took that was left: at first and at most.
const REMEMBERED: u32 = 2;
const REMEMBERED_AT_MOST: u32 = 32;

/// Why the governor is at its tier, with the figure that decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reason {
    /// Why.
    pub why: TierReason,
    /// Time of the worst frame, or that under which 99 of 100 frames stayed, ms; 0 where none was
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
            TierReason::Slow => write!(out, "1 frame in 100 over {took_ms:.1} ms, {budget_ms:.0} allowed"),
            TierReason::Room => write!(out, "room: 99 frames in 100 under {took_ms:.1} ms"),
            other => out.write_str(other.text()),
        }
    }
}

/// What frames of a tier took when it was left.
#[derive(Debug, Clone, Copy)]
struct Left {
    tier: usize,
    took_ns: u64,
    /// Windows for which that still counts.
    windows: u32,
}

/// State of the governor.
#[derive(Debug, Clone)]
pub struct Governor {
    budget_ns: u64,
    tier: usize,
    fixed: bool,
    times_ns: [u64; WINDOW],
    /// Frames since the last change or rest.
    count: usize,
    /// Late ones of those that `times_ns` holds.
    late: usize,
    rest: u32,
    /// Hopeless frames in a row since the last change.
    hopeless: u32,
    costs: Costs,
    left: Option<Left>,
    /// Windows for which the next tier that is left is remembered.
    memory: u32,
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
            late: 0,
            rest: REST,
            hopeless: 0,
            costs,
            left: None,
            memory: REMEMBERED,
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
        self.keep(frame_ns);
        if let Some((typical, worst)) = self.gross_overload() {
            return self.step_down(self.tier_for(typical), TierReason::Overload, worst);
        }
        // However the frames after these turn out, 99 of 100 are not in time. Below the floor all of
        // them would break the budget to save a few.
        if self.late > MAY_BE_LATE && self.tier < FLOOR {
            return self.step_down(self.tier + 1, TierReason::Slow, self.all_but(MAY_BE_LATE));
        }
        let below = self.tier > FLOOR;
        let window = if below { WINDOW_BELOW_FLOOR } else { WINDOW };
        self.count.is_multiple_of(window)
            && self.end_of_window(if below { MAY_BE_LATE_BELOW_FLOOR } else { MAY_BE_LATE })
    }

    /// Right after a change: two frames in a row that are far over the budget leave the tier.
    fn record_at_rest(&mut self, frame_ns: u64) -> bool {
        self.rest -= 1;
        let (budgets, in_a_row) = HOPELESS;
        self.hopeless = if frame_ns > budgets * self.budget_ns { self.hopeless + 1 } else { 0 };
        let leave = self.hopeless >= in_a_row && self.tier < FLOOR;
        leave && self.step_down(self.tier_for(frame_ns), TierReason::Overload, frame_ns)
    }

    /// Takes a time in, in place of the oldest.
    fn keep(&mut self, frame_ns: u64) {
        let late_ns = self.share(LATE);
        let place = &mut self.times_ns[self.count % WINDOW];
        if self.count >= WINDOW && *place > late_ns {
            self.late -= 1;
        }
        self.late += usize::from(frame_ns > late_ns);
        *place = frame_ns;
        self.count += 1;
    }

    fn share(&self, of_budget: f64) -> u64 {
        (self.budget_ns as f64 * of_budget).round() as u64
    }

    /// Typical and worst of the last frames, if the typical one is over the budget.
    fn gross_overload(&self) -> Option<(u64, u64)> {
        let (most, enough) = if self.tier < FLOOR { (RECENT, OVER) } else { (LASTING, LASTING_OVER) };
        let recent = most.min(self.count);
        let over = (1..=recent).filter(|&k| self.nth_last(k) > self.budget_ns).count();
        if over < enough {
            return None;
        }
        let mut last = [0; LASTING];
        (0..recent).for_each(|k| last[k] = self.nth_last(k + 1));
        last[..recent].sort_unstable();
        Some((last[recent / 2], last[recent - 1]))
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

    /// The longest of the frames that are kept, but for so many.
    fn all_but(&self, longer: usize) -> u64 {
        let mut times = self.times_ns;
        let kept = &mut times[..self.count.min(WINDOW)];
        let place = kept.len().saturating_sub(longer + 1);
        *kept.select_nth_unstable(place).1
    }

    /// Whole windows were in time: up, if 99 of 100 frames of the next tier are expected to be so.
    fn end_of_window(&mut self, may_be_late: usize) -> bool {
        let took = self.all_but(may_be_late);
        if std::mem::take(&mut self.on_trial) {
            self.memory = (self.memory / 2).max(REMEMBERED);
        }
        let up = self.tier.checked_sub(1);
        let expected = up.map_or(f64::INFINITY, |better| self.expected_ns(better, took));
        self.left = self.left.filter(|l| l.windows > 1).map(|l| Left { windows: l.windows - 1, ..l });
        if expected > self.budget_ns as f64 * ROOM {
            return false;
        }
        self.on_trial = true;
        self.change_to(self.tier - 1, TierReason::Room, took)
    }

    /// Time under which 99 of 100 frames of a better tier would stay, where they stay under `took_ns`
    /// here; no less than follows from what a tier took that was left a while ago.
    fn expected_ns(&self, better: usize, took_ns: u64) -> f64 {
        let from = |tier: usize, took: u64| took as f64 * self.costs.ratio(tier, better);
        let then = self.left.map_or(0.0, |left| from(left.tier, left.took_ns));
        from(self.tier, took_ns).max(then)
    }

    fn step_down(&mut self, to: usize, why: TierReason, took_ns: u64) -> bool {
        if std::mem::take(&mut self.on_trial) {
            self.memory = (self.memory * 2).min(REMEMBERED_AT_MOST);
        }
        let to = to.min(TIERS.len() - 1);
        if to == self.tier {
            (self.count, self.late) = (0, 0);
            return false;
        }
        self.left = Some(Left { tier: self.tier, took_ns, windows: self.memory });
        self.change_to(to, why, took_ns)
    }

    fn change_to(&mut self, tier: usize, why: TierReason, took_ns: u64) -> bool {
        self.reason = Reason { why, took_ms: took_ns as f64 * 1e-6, ..self.reason };
        self.tier = tier;
        (self.count, self.late) = (0, 0);
        self.rest = REST;
        self.hopeless = 0;
        true
    }
}

#[cfg(test)]
mod tests;
