//! From a writer's clock to this machine's.
//!
//! A line arrives some time after the instant that it claims to have been received at: the difference of
//! the two clocks, and a delay that is never negative. So the least difference of late is the best guess of
//! the clocks' own, and jitter of delivery moves no exposure. The guess follows slowly; where stamps jump,
//! it is made again.

use protocol::time::Nanos;

/// Window of the least difference, ns. In the first one the estimate falls at once.
const WINDOW_NS: u64 = 2_000_000_000;
/// Number of parts in which the window moves on.
const PARTS: usize = 8;
/// Step back of a stamp, against an earlier one, that counts as a jump, ns.
const BACK_NS: i128 = 1_000_000_000;
/// So much earlier than the guess allows no line arrives: the stamps have jumped ahead, ns. The same later
/// for a whole window: they have jumped back.
const STEP_NS: i128 = 20_000_000;
/// Lines in the window without which nothing is concluded from their being late.
const ENOUGH: u32 = 10;
/// The guess moves at most by the time that passes over this: 1 ms a second, ten times what quartzes drift.
const SLOWLY: u64 = 1_000;
/// Time between two lines that counts at most for moving, ns.
const LONGEST_STEP_NS: u64 = 100_000_000;

/// Why the clocks were tied to each other again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Begun {
    /// By the first line.
    First,
    /// Another writer has another clock.
    AnotherWriter,
    /// Two lines in a row were further ahead than can be.
    Ahead,
    /// Two lines in a row were more than a second behind.
    Back,
    /// All lines of a window came late.
    Late,
}

impl Begun {
    /// In words.
    pub fn text(self) -> &'static str {
        match self {
            Begun::First => "by its first line",
            Begun::AnotherWriter => "another writer has another clock",
            Begun::Ahead => "its stamps jumped ahead",
            Begun::Back => "its stamps jumped back by more than a second",
            Begun::Late => "every line of two seconds came later than those before",
        }
    }
}

/// What a line's stamp is on this machine's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mapped {
    /// Add `shift_ns`; the line came `late_ns` after its stamp said.
    By {
        /// This machine's clock less the writer's, ns. The stamp is never in the future by it.
        shift_ns: i128,
        /// Delay of the delivery, ns.
        late_ns: u64,
        /// The reason, if this line tied the clocks again.
        begun: Option<Begun>,
    },
    /// The stamp contradicts those before it. Where the next one agrees with it, both clocks are tied again;
    /// where not, this one alone was wrong.
    Doubtful {
        /// By how much it is ahead, or behind if negative, ms.
        off_ms: i64,
    },
}

/// The difference of the two clocks, as far as it is known.
#[derive(Debug, Clone, Default)]
pub struct ClockMap {
    tied: Option<Tied>,
    another: bool,
    /// The difference of a line that contradicts.
    doubt_ns: Option<i128>,
}

#[derive(Debug, Clone)]
struct Tied {
    shift_ns: i128,
    /// When they were tied, and when the last line arrived.
    since_ns: Nanos,
    last_ns: Nanos,
    newest_stamp_ns: u64,
    /// Least difference in each part of the window, with the number of the part.
    least: [(u64, i128); PARTS],
    /// Since when every line has been late, and how many they are.
    late: Option<(Nanos, u32)>,
}

impl ClockMap {
    /// The next line may be by another clock.
    pub fn expect_another(&mut self) {
        self.another = self.tied.is_some();
    }

    /// Takes a line's stamp and the instant of its arrival.
    pub fn map(&mut self, stamp_ns: u64, arrival_ns: Nanos) -> Mapped {
        let difference = i128::from(arrival_ns) - i128::from(stamp_ns);
        let another = std::mem::take(&mut self.another);
        let Some(tied) = &mut self.tied else {
            return self.begin(stamp_ns, arrival_ns, Begun::First);
        };
        let ahead_ns = tied.shift_ns - difference;
        if another && ahead_ns.abs() > STEP_NS {
            return self.begin(stamp_ns, arrival_ns, Begun::AnotherWriter);
        }
        let behind_ns = i128::from(tied.newest_stamp_ns) - i128::from(stamp_ns);
        let jump = if ahead_ns > tied.most_ahead(arrival_ns) {
            Some((Begun::Ahead, ahead_ns))
        } else {
            (behind_ns > BACK_NS).then_some((Begun::Back, -behind_ns))
        };
        let doubt = self.doubt_ns.take();
        if let Some((why, off_ns)) = jump {
            if doubt.is_some_and(|doubt| (doubt - difference).abs() <= STEP_NS) {
                return self.begin(stamp_ns, arrival_ns, why);
            }
            self.doubt_ns = Some(difference);
            return Mapped::Doubtful { off_ms: (off_ns / 1_000_000) as i64 };
        }
        if let Some(shift_ns) = tied.follow(stamp_ns, arrival_ns, difference) {
            self.tied = Some(Tied { shift_ns, ..Tied::new(stamp_ns, arrival_ns) });
            return Mapped::By { shift_ns, late_ns: late(difference, shift_ns), begun: Some(Begun::Late) };
        }
        let shift_ns = tied.shift_ns.min(difference);
        Mapped::By { shift_ns, late_ns: late(difference, shift_ns), begun: None }
    }

    fn begin(&mut self, stamp_ns: u64, arrival_ns: Nanos, why: Begun) -> Mapped {
        let tied = Tied::new(stamp_ns, arrival_ns);
        let shift_ns = tied.shift_ns;
        (self.tied, self.doubt_ns) = (Some(tied), None);
        Mapped::By { shift_ns, late_ns: 0, begun: Some(why) }
    }
}

impl Tied {
    /// As if the line had arrived without a delay.
    fn new(stamp_ns: u64, arrival_ns: Nanos) -> Self {
        let shift_ns = i128::from(arrival_ns) - i128::from(stamp_ns);
        let mut tied = Tied {
            shift_ns,
            since_ns: arrival_ns,
            last_ns: arrival_ns,
            newest_stamp_ns: stamp_ns,
            least: [(u64::MAX, 0); PARTS],
            late: None,
        };
        tied.note(arrival_ns, shift_ns);
        tied
    }

    fn is_settled(&self, arrival_ns: Nanos) -> bool {
        arrival_ns.saturating_sub(self.since_ns) >= WINDOW_NS
    }

    /// How far ahead of the guess a line may be, ns: the first may have been delayed for long.
    fn most_ahead(&self, arrival_ns: Nanos) -> i128 {
        if self.is_settled(arrival_ns) { STEP_NS } else { BACK_NS }
    }

    /// Follows a line; returns another difference where all lines of a window were late by this one.
    fn follow(&mut self, stamp_ns: u64, arrival_ns: Nanos, difference: i128) -> Option<i128> {
        let passed_ns = arrival_ns.saturating_sub(self.last_ns).min(LONGEST_STEP_NS);
        self.last_ns = self.last_ns.max(arrival_ns);
        self.newest_stamp_ns = self.newest_stamp_ns.max(stamp_ns);
        self.note(arrival_ns, difference);
        let least = self.least(arrival_ns).unwrap_or(difference);
        if !self.is_settled(arrival_ns) {
            self.shift_ns = self.shift_ns.min(difference);
            return None;
        }
        self.late = (difference - self.shift_ns > STEP_NS).then(|| {
            let (since_ns, lines) = self.late.unwrap_or((arrival_ns, 0));
            (since_ns, lines.saturating_add(1))
        });
        let lasts = |(since_ns, lines): (Nanos, u32)| arrival_ns - since_ns >= WINDOW_NS && lines >= ENOUGH;
        if self.late.is_some_and(lasts) {
            return Some(least);
        }
        let most = i128::from(passed_ns / SLOWLY);
        self.shift_ns += (least - self.shift_ns).clamp(-most, most);
        None
    }

    /// Notes a difference in its part of the window.
    fn note(&mut self, arrival_ns: Nanos, difference: i128) {
        let part = arrival_ns / (WINDOW_NS / PARTS as u64);
        let (number, least) = &mut self.least[(part % PARTS as u64) as usize];
        *least = if *number == part { difference.min(*least) } else { difference };
        *number = part;
    }

    /// The least difference of the window.
    fn least(&self, arrival_ns: Nanos) -> Option<i128> {
        let part = arrival_ns / (WINDOW_NS / PARTS as u64);
        let recent = |number: u64| number <= part && part - number < PARTS as u64;
        self.least.iter().filter(|(number, _)| recent(*number)).map(|(_, least)| *least).min()
    }
}

fn late(difference: i128, shift_ns: i128) -> u64 {
    (difference - shift_ns).clamp(0, i128::from(u64::MAX)) as u64
}
