//! Kinds of problems of a pedal or of handles, and rates of defective lines. Pure.

use protocol::condition::{self, ProblemKind};
use protocol::limits::TEXT_BYTES;
use protocol::time::Nanos;

/// A device's problem in words.
pub type Trouble = condition::Trouble<Kind>;
/// A device's problems, present and former.
pub type Condition = condition::Condition<Kind>;

/// Time over which bad lines are counted, ns.
const WINDOW_NS: u64 = 1_000_000_000;
/// So many of them within that time are a trouble.
const MANY: u64 = 5;

/// Kind of a device's problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// It is not there, or cannot be opened or used.
    Absent,
    /// It was there and is gone.
    Gone,
    /// A recorded file is over.
    Over,
    /// It is open and sends nothing.
    Silent,
    /// Much of what it sends cannot be used.
    Garbled,
    /// Much of what it sends does not arrive.
    Gaps,
    /// A handle sends of which the rig says nothing.
    Uncalibrated,
}

impl ProblemKind for Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Absent => "absent",
            Kind::Gone => "gone",
            Kind::Over => "over",
            Kind::Silent => "silent",
            Kind::Garbled => "garbled",
            Kind::Gaps => "gaps",
            Kind::Uncalibrated => "uncalibrated",
        }
    }

    fn over(self) -> &'static str {
        "works again"
    }
}

/// What is wrong with the devices, for a heartbeat: sentences, or the words of `docs/controls.md` where those do not
/// fit.
pub fn in_words(devices: [(&str, Option<&Condition>); 2]) -> String {
    let conditions = || devices.into_iter().filter_map(|(name, condition)| Some((name, condition?)));
    let sentences: Vec<String> = conditions().filter_map(|(_, condition)| condition.sentence()).collect();
    let text = sentences.join("; ");
    if text.len() <= TEXT_BYTES {
        return text;
    }
    let kinds = conditions().filter_map(|(name, c)| Some(format!("{name}: {}", c.trouble()?.kind.name())));
    kinds.collect::<Vec<_>>().join("; ")
}

/// Counts of something that happens now and then, and whether it is much of late.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rate {
    /// Since the beginning.
    pub total: u64,
    in_window: u64,
    window_ns: Nanos,
    is_much: bool,
}

impl Rate {
    /// Counts `more` at `now`.
    pub fn note(&mut self, more: u64, now: Nanos) {
        self.turn(now);
        self.total += more;
        self.in_window += more;
        self.is_much |= self.in_window >= MANY;
    }

    /// Whether it was much within the second before the present one, or is much in it.
    pub fn is_much(&mut self, now: Nanos) -> bool {
        self.turn(now);
        self.is_much
    }

    /// Begins another second where one is over.
    fn turn(&mut self, now: Nanos) {
        if now >= self.window_ns + WINDOW_NS {
            self.is_much = self.in_window >= MANY && now < self.window_ns + 2 * WINDOW_NS;
            (self.window_ns, self.in_window) = (now, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn two_problems_are_shown_whole() {
        let of = |name: &'static str, kind, text: &str| {
            let mut condition = Condition::new(name);
            condition.note(Some(Trouble::new(kind, text)), 0);
            condition
        };
        let gone = of("the pedal", Kind::Gone, "is disconnected: it counts as up");
        let words = |handles| in_words([("the pedal", Some(&gone)), ("the handles", handles)]);
        assert_eq!(words(None), "the pedal is disconnected: it counts as up");
        let silent =
            of("the line of the handles", Kind::Silent, "is silent: tools and jaws keep their state");
        assert!(
            words(Some(&silent))
                .ends_with("; the line of the handles is silent: tools and jaws keep their state")
        );
        let text = "is noisy: lines are rejected; check cable and baud rate";
        let noisy = of("the line of the handles", Kind::Garbled, text);
        assert_eq!(words(Some(&noisy)), "the pedal: gone; the handles: garbled");
        assert_eq!(in_words([("the pedal", None), ("the handles", None)]), "");
    }

    #[test]
    fn a_few_are_counted_and_many_are_a_trouble_until_a_quiet_second() {
        let mut rate = Rate::default();
        rate.note(MANY - 1, 10 * S);
        assert!(!rate.is_much(10 * S));
        rate.note(1, 10 * S + 1);
        assert!(rate.is_much(10 * S + 2) && rate.is_much(11 * S));
        assert!(!rate.is_much(12 * S + 5), "a second without any");
        rate.note(MANY, 13 * S);
        assert!(!rate.is_much(100 * S), "long ago");
        assert_eq!(rate.total, 2 * MANY);
    }
}
